"""Read a case file into a checked `Scene`, and solve its contact problem."""

from __future__ import annotations

import codecs
import os
import re
import sys
import tomllib
from collections.abc import Sequence
from contextlib import suppress
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from types import GenericAlias
from typing import TYPE_CHECKING, Any

import scipy.sparse as sp
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from contactqp.analysis.history import History
from contactqp.errors import InvalidProblem, SceneError, Unsupported, shown
from contactqp.linalg.runtime import SERIAL, engine_named, refuse_unknown_engine
from contactqp.model.arguments import checked, is_readable
from contactqp.model.arrays import READ, STEPS, own_floating_point, stage
from contactqp.model.problem import ContactProblem
from contactqp.scene.blocks import BLOCKS, Frame
from contactqp.scene.blocks.element import Element
from contactqp.scene.building import build
from contactqp.scene.checking import check
from contactqp.scene.claims import QUANTITIES
from contactqp.scene.fields import first_errors
from contactqp.scene.geometry import warn_of_unpushed
from contactqp.scene.schema import SceneData, end_time
from contactqp.scene.shipped import case_path, nearest_files, nearest_names
from contactqp.solving.solve import solve

if TYPE_CHECKING:
    from contactqp.scene.building import Model


class Scene(SceneData):
    """A case: bodies, supports, ties, contacts, loads, and claims about the answer. Frozen and checked when made.

    Raises
    ------
    SceneError
        A key is unknown, missing or wrong, or the parts do not fit each other; one line with the key's path.
    """

    def __init__(self, /, **keys: Any) -> None:
        for key, value in keys.items():
            if sp.issparse(value) or not is_readable(value):
                raise SceneError(f"{key}: expected what a case file may hold, got {shown(value)}")
        try:
            super().__init__(**keys)
        except ValidationError as error:
            raise SceneError(first_errors(error, type(self), keys)) from None
        check(self)

    def problem(self) -> ContactProblem:
        """Return the contact problem on the free unknowns, in the scene's units.

        Raises
        ------
        InvalidProblem, SceneError
            The numbers are not a contact problem, or a mesh, a side or a pair of bodies is invalid.
        BackendMissing
            A mesh file that needs meshlane, which is not installed.
        """
        return build(self).problem


def register_block(key: str, kind: type[Element]) -> None:
    """Register another kind of elements as a block of case files, which are then loaded, checked, solved and drawn.

    Parameters
    ----------
    key : str
        What the list is called in a case file, as in ``springs``.
    kind : type
        A subclass of `contactqp.scene.blocks.element.Element` with a `title`, a `noun` and its keys.

    Raises
    ------
    InvalidProblem
        The key, the noun or a quantity is already in use, or `large` is set, which only bars support.
    """
    nouns = {other.noun for other in BLOCKS.values()} | {str(measure.at) for measure in QUANTITIES.values()}
    taken = [f"quantity {name!r}" for name in kind.quantities if name in QUANTITIES]
    taken += [f"noun {kind.noun!r}"] * (kind.noun in nouns)
    if kind.large:
        raise InvalidProblem(f"{key}: expected no form at large displacements, which only bars have, got one")
    if hasattr(Scene, key) or key in Scene.model_fields or taken:
        raise InvalidProblem(f"{key}: expected a block with names of its own, got {', '.join(taken) or repr(key)}")
    BLOCKS[key] = kind
    QUANTITIES.update(kind.quantities)
    entries: Any = GenericAlias(tuple, (kind, ...))
    for model in (Frame, SceneData, Scene):
        model.model_fields[key] = FieldInfo.from_annotated_attribute(entries, ())
        model.model_rebuild(force=True)


# Bytes; the parser takes about a second for each of a million.
LARGEST = 2**25


@checked
def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read and check a case file. Its numbers are read as decimals, so that 0.1 is 1/10.

    Parameters
    ----------
    path : path
        A file, "-" for standard input, or a bare name such as ``"bar_wall"``: without a file of that name it is a case
        that comes with the package.

    Raises
    ------
    SceneError
        The file cannot be read, is not TOML, or is not a scene; the message states file, key, what was expected and
        what came.
    """
    file, text = Path(path) if str(path) == STANDARD_INPUT else case_path(Path(path)), ""
    try:
        with stage(READ):
            text = _standard_input() if str(path) == STANDARD_INPUT else _text(file)
            scene = Scene(**_tables(text, file))
    except SceneError as error:
        place = "standard input" if str(path) == STANDARD_INPUT else path
        line = _line_of(text, str(error))
        raise SceneError(f"{place}: {'' if line is None else f'line {line}: '}{error}") from None
    scene._file = file
    return scene


# A path that stands for standard input.
STANDARD_INPUT = "-"


def _standard_input() -> str:
    return _decoded(read_standard_input("a case"))


def read_standard_input(what: str) -> bytes:
    """Return the content of standard input, which should be `what`.

    Raises SceneError: it is closed, or longer than a file may be.
    """
    if sys.stdin is None or sys.stdin.closed:
        raise SceneError(f"expected {what}, and it is closed")
    data: bytes = sys.stdin.buffer.read(LARGEST + 1)
    if len(data) > LARGEST:
        raise SceneError(f"expected {what} of at most {LARGEST >> 20} MiB, got more")
    return data


def _text(file: Path) -> str:
    try:
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise SceneError("expected a case file, got a pipe or a device")
        if file.is_file() and file.stat().st_size > LARGEST:
            size = file.stat().st_size >> 20
            raise SceneError(f"expected a case file of at most {LARGEST >> 20} MiB, got {size} MiB")
        data = file.read_bytes()
    except SceneError:
        raise
    except FileNotFoundError:
        here, near = nearest_files(file), nearest_names(file)
        files = f"; nearest: {', '.join(here)}" if here else ""
        cases = f"; of the cases that come with contactqp: {', '.join(near)}" if near else ""
        raise SceneError(f"expected a case file, and there is none of that name{files}{cases}") from None
    except IsADirectoryError:
        raise SceneError("expected a case file, got a directory") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"expected a case file that can be read, got: {reason}") from None
    return _decoded(data)


def _decoded(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise SceneError("expected text in UTF-8, got UTF-16: save it as UTF-8")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(
            f"expected text in UTF-8, got the byte 0x{data[error.start]:02x} at place {error.start}"
        ) from None


# The path of a key with which a message begins, as in ``bars[1].area``, and its parts.
_KEY_PATH, _KEY_PART = re.compile(r"[A-Za-z_][\w-]*(?:\[\d+\]|\.[\w-]+)*"), re.compile(r"\[\d+\]|[\w-]+")
# Text that closes a list or string which continues on the next line.
_CLOSING = ("", "]", "]]", '"""', "'''")
# Limits beyond which the line of an error is not searched, as this would take seconds.
_LONGEST, _MOST_LINES = 2**20, 20


def _line_of(text: str, message: str) -> int | None:
    """Return the line number of the key with which a message begins, None where the text does not have it.

    A missing key has the line of its table. The first lines of the file are parsed until they contain the key.
    """
    path, lines = _KEY_PATH.match(message), text.removeprefix("\ufeff").replace("\r\n", "\n").split("\n")
    whole = _read(lines) if path is not None and len(text) <= _LONGEST else None
    if path is None or whole is None:
        return None
    parts = [int(part[1:-1]) if part.startswith("[") else part for part in _KEY_PART.findall(path[0])]
    while parts and not _has(whole, parts):
        parts.pop()
    if not parts:
        return None
    first, last = 1, len(lines)
    while first < last:
        middle = (first + last) // 2
        ahead = range(middle, min(middle + _MOST_LINES, len(lines)) + 1)
        readable, data = next(((n, found) for n in ahead if (found := _read(lines[:n])) is not None), (0, None))
        if data is None:
            return None
        first, last = (first, middle) if _has(data, parts) else (readable + 1, last)
    # Earlier lines that cannot be parsed without this one belong to it.
    while first > 1 and _read(lines[: first - 1]) is None:
        first -= 1
    return first


def _read(lines: Sequence[str]) -> dict[str, Any] | None:
    for closing in _CLOSING:
        with suppress(ValueError, RecursionError, ArithmeticError):
            return tomllib.loads("\n".join(lines) + closing)
    return None


def _has(data: Any, parts: Sequence[int | str]) -> bool:
    for part in parts:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return False
    return True


# Suffixes of mesh files, which users mistake for cases.
_MESHES = frozenset((".msh", ".vtk", ".vtu", ".xdmf", ".med", ".stl", ".unv", ".bdf", ".nas", ".exo", ".mesh", ".ply"))


def _tables(text: str, file: Path) -> dict[str, Any]:
    if not text.strip():
        raise SceneError("expected a scene, got an empty file")
    try:
        # TOML files written on Windows may end their lines with CR LF and start with a mark of the byte order.
        return tomllib.loads(text.removeprefix("\ufeff"), parse_float=Decimal)
    except tomllib.TOMLDecodeError as error:
        example = f'bodies with mesh = {{ file = "{file.name}", unit = "mm" }}'
        cure = f"; a mesh is named in a case: {example}" if file.suffix.lower() in _MESHES else ""
        raise SceneError(f"expected TOML, got: {' '.join(str(error).split())}{cure}") from None
    except (RecursionError, ValueError, ArithmeticError) as error:
        raise SceneError(f"expected TOML, got numbers or tables that cannot be read ({type(error).__name__})") from None


@checked
@own_floating_point
def run(
    scene: Scene | str | Path,
    method: str = "active-set",
    *,
    engine: str = SERIAL,
    checkpoint: str | Path | None = None,
    **options: Any,
) -> History:
    """Solve a scene; ``history[-1]`` is the solution under the full load, or at the end of the motion.

    Parameters
    ----------
    scene : Scene, or str or Path
        A case file, or a scene from `load_scene`, or one built in Python. With `path`, loads grow from nothing,
        together or from corner to corner, and the history has the start, every step and the events; with
        `motion` it is the `MotionHistory` of `impact`; without both it has one solution. With ``deformation =
        "large"`` it is the `LargeHistory` of `large_deformation`.
    method : str
        A name of `contactqp.methods()`.
    engine : str
        "serial": in this process. "petsc": on all ranks of MPI, each of which calls this and gets the same history;
        `method` is "active-set", and load paths take steps. Each rank makes its own piece of elastic bodies; what a
        solution of them returns is gathered on access, so that all ranks have to access it together.
    checkpoint : str or Path, optional
        With "petsc", a folder where every step is kept. Steps that are there already are not solved again, whatever
        number of ranks has solved them.
    **options
        Options of `contactqp.solve`, with numbers in the scene's units; `time_limit` [s] is that of all steps.

    Raises
    ------
    Unsupported
        With "petsc", a motion, large deformations, exact events, a `checkpoint` of a load path with friction, or a
        method or an option of one process.
    InvalidProblem
        A `checkpoint` of another scene; and as `contactqp.solve`.
    """
    scene = load_scene(scene) if isinstance(scene, str | Path) else scene
    return run_model(build_for(scene, engine), method, engine, checkpoint, **options)


def build_for(scene: SceneData, engine: str = SERIAL) -> Any:
    """Return the scene's model, for an engine."""
    if isinstance(engine, str) and engine == SERIAL:
        return build(scene)
    refuse_unknown_engine(engine)
    return engine_named(engine).function("build")(scene)


def run_model(
    model: Model, method: str, engine: str = SERIAL, checkpoint: str | Path | None = None, **options: Any
) -> History:
    """Solve a scene whose model has been built.

    Parameters
    ----------
    model : NodeModel or BodyModel, from `build_for` with the same engine
    method, engine, checkpoint
        As for `run`.
    **options
        Further options of `contactqp.solve`.
    """
    if engine != SERIAL:
        found: History = engine_named(engine).function("run")(model, method, checkpoint, **options)
        return found
    if checkpoint is not None:
        raise Unsupported("checkpoint: only engine='petsc' keeps the steps of a load path")
    history = follow(model, model.problem, method, **options)
    warn_of_unpushed(model.scene, model.problem.gap, history)
    return history


def follow(model: Model, problem: ContactProblem, method: str, **options: Any) -> History:
    """Solve the model's problem, or a modified copy of it, as `run_model` does."""
    if model.scene.path is None and model.scene.motion is None:
        return History([solve(problem, method, **options)], [1.0])
    with stage(STEPS):
        return _steps(model, problem, method, **options)


def _steps(model: Model, problem: ContactProblem, method: str, **options: Any) -> History:
    if model.scene.large:
        from contactqp.scene.building import NodeModel
        from contactqp.scene.moving import deform

        assert isinstance(model, NodeModel)  # only scenes of nodes have large deformations
        return deform(model, method, **options)
    if model.scene.motion is not None:
        from contactqp.scene.moving import move

        return move(model, problem, method, **options)
    from contactqp.analysis.load_path import follow_path

    path = model.scene.path
    assert path is not None  # one instant where there is no path
    corners = [model.load_at(Fraction(i + 1)) for i in range(int(end_time(model.scene)))]
    return follow_path(problem, loads=corners, steps=path.steps, events=path.events, method=method, **options)
