"""Write a receipt of `contactqp check`, with files, version and verdict, and verify it later."""

from __future__ import annotations

import datetime
import hashlib
import json
import math
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from contactqp.errors import InvalidProblem, shown
from contactqp.exchange.files import file_size, read_text, write_whole, wrong
from contactqp.exchange.problem_files import is_problem_file
from contactqp.model.summary import finite
from contactqp.oracle.judged_answer import COMPRESSION
from contactqp.scene.scene import load_scene
from contactqp.scene.shipped import case_path
from contactqp.study.checking import check_answer
from contactqp.study.verdict import CheckOptions, Verdict, is_written_out

SCHEMA, SCHEMA_VERSION = "contactqp-receipt", 1
# Options that name files, which are hashed as well.
FILES = ("pressure_areas", "dof_map", "contact_map")
# The entries by which verdicts are compared, and the factor by which a figure or bound may grow between versions or
# machines.
COMPARED_ENTRIES = ("right", "proven")
EXPECTED = "a receipt, as `contactqp check PROBLEM CANDIDATE --receipt FILE` writes"
GROWTH = 10.0
# Figures and bounds below this are rounding errors and are not compared.
ROUNDING_OF_FIGURES = 1e-11


def write_receipt(file: str, problem: str, candidate: str, options: CheckOptions, verdict: Verdict) -> None:
    """Write the receipt of a verdict; paths in it are relative to its own folder.

    Raises InvalidProblem: the problem or the candidate is standard input, the file is one of those that are judged or
    no regular file, or it cannot be written.

    Parameters
    ----------
    file : the receipt
    problem, candidate : the files that were judged
    options : the options of the check, with the files that they name
    verdict : Verdict
    """
    target, problem = receipt_path(file, problem, candidate, options), str(case_path(problem))
    asked = {
        name: _relative(value, target.parent) if name in options.files() else value
        for name, value in asdict(options).items()
    }
    found = verdict.data()
    data = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "contactqp": version("contactqp"),
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "problem": _relative(problem, target.parent),
        "candidate": _relative(candidate, target.parent),
        "options": asked,
        "sha256": hashes(target, problem, candidate, options),
        "verdict": {name: found.get(name) for name in (*COMPARED_ENTRIES, "basis", "diagnosis", "failures", "notes")},
        "figures": _figures(verdict),
        "wrong_contacts": found.get("worst", []),
        "ignored": found["ledgers"][-1]["ignored"],
    }
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    write_whole(target, lambda beside: _write(beside, text))


def receipt_path(file: str, problem: str, candidate: str, options: CheckOptions) -> Path:
    """Return the file of a receipt, if one can be written there.

    Raises InvalidProblem as `write_receipt` does.

    Parameters
    ----------
    file, problem, candidate, options
        As in `write_receipt`.
    """
    if "-" in (problem, candidate):
        raise InvalidProblem("--receipt: expected files, whose hashes it holds, got standard input")
    target = Path(file).resolve()
    if not file or target.is_dir() or (target.exists() and not target.is_file()) or not target.parent.is_dir():
        raise InvalidProblem(f"--receipt: expected a file in a folder that is there, got {shown(file)}")
    judged = (str(case_path(problem)), candidate, *options.files().values())
    if target in {Path(name).resolve() for name in judged}:
        raise InvalidProblem(f"--receipt: {file} is one of the files that are judged; expected another")
    return target


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8")


def _figures(verdict: Verdict) -> dict[str, float | None]:
    """Return the figures and bounds of a verdict; None where one is not finite."""
    names = ("energy_error", "force_error", "distance")
    bounds = {name: getattr(verdict.certificate, name, None) for name in names}
    stated = {name: finite(value) for name, value in bounds.items() if value is not None}
    return dict(verdict.data()["certificate"]) | stated


def _relative(path: str, folder: Path) -> str:
    return Path(os.path.relpath(os.path.abspath(path), folder)).as_posix()


def hashes(receipt: Path, problem: str, candidate: str, options: CheckOptions) -> dict[str, str]:
    """Return the SHA-256 of everything that a verdict rests on, by its path beside the receipt.

    Of a folder of matrices, and of a problem.json, those are all files of the folder, but for the receipt itself.

    Parameters
    ----------
    receipt : the receipt, absolute
    problem, candidate : the files that are judged
    options : the options of the check, with the files that they name
    """
    named = [problem, candidate, *_meshes(problem), *options.files().values()]
    return {
        _relative(str(file), receipt.parent): _hash(file)
        for path in filter(None, named)
        for file in _files(Path(path))
        if file.resolve() != receipt
    }


def _hash(path: Path) -> str:
    file_size(path, "a file to hash")  # reading a device would not end
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _files(path: Path) -> Iterable[Path]:
    folder = path if path.is_dir() else path.parent if path.name == "problem.json" else None
    return [path] if folder is None else sorted(file for file in folder.rglob("*") if file.is_file())


def _meshes(problem: str) -> list[str]:
    """Return the mesh files that a case file names."""
    if is_problem_file(problem):
        return []
    scene = load_scene(problem)
    return [str(Path(problem).parent / part.mesh.file) for part in scene.meshed if part.mesh is not None]


@dataclass(frozen=True)
class Verified:
    """Whether a receipt still holds; `differences` says in words what does not."""

    file: str
    right: bool  # the verdict in the receipt
    tolerances: tuple[float, float]  # that it was judged with: of violations, and of errors
    written_by: str  # the version
    differences: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Return whether files and verdict are those of the receipt."""
        return not self.differences

    def data(self) -> dict[str, Any]:
        """Return the findings as plain data for JSON."""
        return {
            "receipt": self.file,
            "holds": self.holds,
            "right": self.right,
            "tolerance": self.tolerances[0],
            "error_tolerance": self.tolerances[1],
            "differences": list(self.differences),
        }


def verify(file: str) -> Verified:
    """Hash the files of a receipt and judge the answer again.

    Raises
    ------
    InvalidProblem
        The file is not a receipt, or a file that it names is not there.
    ContactQPError
        The files cannot be judged any more.
    """
    data, receipt = _read(file), Path(file).resolve()
    folder = receipt.parent
    asked: dict[str, Any] = {
        name: str(folder / value) if name in FILES and value is not None and not is_written_out(value) else value
        for name, value in data["options"].items()
    }
    options = CheckOptions(**asked)
    problem, candidate = (str(folder / data[name]) for name in ("problem", "candidate"))
    for name in data["sha256"]:
        if not (folder / name).is_file():
            raise wrong(file, "sha256", f"the file {name!r} beside the receipt", "none")
    differences = [*_changed(data["sha256"], hashes(receipt, problem, candidate, options))]
    differences += _other_verdict(data, check_answer(problem, candidate, options))
    tolerances = options.tolerance, options.error_tolerance
    return Verified(file, bool(data["verdict"]["right"]), tolerances, data["contactqp"], tuple(differences))


def _read(file: str) -> Mapping[str, Any]:
    text = read_text(file, EXPECTED)
    try:
        data = json.loads(text)
        known = _is_receipt(data)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        known = False
    if not known:
        raise wrong(file, "content", EXPECTED, "something else")
    return dict(data)


def _names_units(units: Any) -> bool:
    return units is None or (
        set(units) == {"length", "force"} and all(isinstance(unit, str) for unit in units.values())
    )


def _is_receipt(data: Mapping[str, Any]) -> bool:
    """Return whether data has all entries of a receipt with their types; raises if it is not a mapping."""
    options, verdict = data["options"], data["verdict"]
    texts = [data[name] for name in ("problem", "candidate", "contactqp", "created")]
    texts += [options["compression"], *data["sha256"], *data["sha256"].values()]
    maybe = [options[name] for name in FILES]
    numbers = [options["tolerance"], options["error_tolerance"]]
    figures = [value for value in data["figures"].values() if value is not None]
    return (
        (data["schema"], data["schema_version"]) == (SCHEMA, SCHEMA_VERSION)
        and set(options) | {"units"} == set(asdict(CheckOptions()))  # receipts of earlier versions have no units
        and _names_units(options.get("units"))
        and all(_may_name_a_file(text) for text in (*texts, *(value for value in maybe if value is not None)))
        and options["compression"] in COMPRESSION
        and all(type(value) in (int, float) and 0 <= value <= sys.float_info.max for value in (*numbers, *figures))
        and isinstance(verdict["right"], bool)
        and isinstance(verdict.get("proven"), bool | None)
    )


def _may_name_a_file(text: object) -> bool:
    """Return whether a value can be the name of a file; raises if it cannot be encoded."""
    return isinstance(text, str) and bool(text) and b"\0" not in os.fsencode(text)


def _changed(before: Mapping[str, str], now: Mapping[str, str]) -> Iterator[str]:
    for name in sorted({*before, *now}):
        if name not in before:
            yield f"{name} is judged too, and the receipt has no hash of it"
        elif name not in now:
            yield f"{name} is not judged any more"
        elif before[name] != now[name]:
            yield f"{name} has changed since the receipt was written"


def _other_verdict(data: Mapping[str, Any], verdict: Verdict) -> Iterator[str]:
    """Yield the differences between a receipt and a new verdict: verdict, text, figures or bounds that have grown."""
    found, before = verdict.data(), data["verdict"]
    for name in COMPARED_ENTRIES:
        if before.get(name) != found.get(name):
            now, then = (_in_words(name, values.get(name)) for values in (found, before))
            yield f"the answer is {now}, and the receipt says {then}"
    if data["contactqp"] == version("contactqp"):  # another version may word it differently
        for name in ("basis", "diagnosis"):
            if before.get(name) != found.get(name):
                yield f"the {name} is {found.get(name)!r:.100}, and the receipt says {before.get(name)!r:.100}"
    figures = _figures(verdict)
    for name in sorted({*figures, *data["figures"]}):
        old, new = (values.get(name, math.nan) for values in (data["figures"], figures))
        if _grown(old, new):
            yield f"{name.replace('_', ' ')} is {_figure_text(new)}, and the receipt says {_figure_text(old)}"


def _in_words(name: str, value: bool | None) -> str:
    if value is None:
        return f"neither {name} nor not"
    return {"right": ("wrong", "right"), "proven": ("not proven", "proven")}[name][value]


def _figure_text(value: float | None) -> str:
    return "not finite" if value is None else "not known" if math.isnan(value) else f"{value:.3g}"


def _grown(old: float | None, new: float | None) -> bool:
    """Return whether a figure has changed; None stands for one that is not finite, NaN for a missing one."""
    if old is None or new is None:
        return old is not new
    return not new <= GROWTH * max(old, ROUNDING_OF_FIGURES) or math.isnan(old)
