"""Return problems with exact answers by name, kind, difficulty and seed, and write them to folders.

`redundant-17` is the problem of the kind "redundant" with the seed 17, on every platform and in every version; its
difficulty depends on the seed: 0, 3, 6, ... are easy, 1, 4, 7, ... moderate, 2, 5, 8, ... hard.

`write_gallery` writes problems with their answers to a folder; `write_qpbenchmark` writes a test set in the form
required by qpbenchmark's CONTRIBUTING.md, together with exact answers:

    contact_problems.py    the class ContactProblems: `qpbenchmark contact_problems.py run`
    data/NAME.npz          one problem, as `qpsolvers.Problem.save` writes it
    answers/NAME.json      its exact answer in qpsolvers' names and signs: x, y, z, and the cost
    results/               the folder of qpbenchmark's report
    README.md              a description of the problems

With G = E_N, h = g, A, b of the ties, z is l_N and y is nu, with the same signs. Problems with Coulomb friction are no
quadratic programs and are left out.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from fractions import Fraction
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from contactqp.errors import InvalidProblem, shown
from contactqp.exchange.problem_folder import write_problem
from contactqp.model.arguments import checked
from contactqp.oracle.gallery import random_problems as plain
from contactqp.oracle.gallery.classical import CLASSICAL
from contactqp.oracle.gallery.problem import Contents, GalleryProblem, times
from contactqp.oracle.gallery.random_problems import Draw, frictional
from contactqp.oracle.gallery.seed_examples import SEED

DIFFICULTIES = ("easy", "moderate", "hard")
RANDOM: dict[str, Callable[[Draw, str], Contents]] = {
    "well-posed": plain.well_posed,
    "degenerate": plain.degenerate,
    "redundant": plain.redundant,
    "floating": plain.floating,
    "frictional": frictional,
    "stiff": plain.stiff,
    "tied": plain.tied,
    "large": plain.large,
}
NAMED = SEED | CLASSICAL
KINDS = ("named", *RANDOM)
LARGEST_COUNT = 100_000


@checked
@lru_cache(maxsize=64)
def problem(name: str) -> GalleryProblem:
    """Return the problem of a name, such as "truss-over-floor" or "redundant-17".

    Raises
    ------
    InvalidProblem
        No problem has that name; the message suggests the nearest one.
    """
    if name in NAMED:
        return GalleryProblem(name, "named", "easy", NAMED[name])
    found = re.fullmatch(r"(.+)-(0|[1-9]\d{0,17})", str(name))
    if found is None or found[1] not in RANDOM:
        near = get_close_matches(str(name), [*NAMED, *(f"{kind}-0" for kind in RANDOM)], 1)
        hint = f"; did you mean {near[0]!r}?" if near else "."
        raise InvalidProblem(
            f"gallery: no problem is called {name!r}{hint} Names are those of `problems(kind='named')`, and a kind "
            f"({', '.join(RANDOM)}) with a seed, as in 'redundant-17'"
        )
    kind, seed = found[1], int(found[2])
    difficulty = DIFFICULTIES[seed % len(DIFFICULTIES)]
    return GalleryProblem(name, kind, difficulty, partial(_made, RANDOM[kind], name, difficulty))


@checked
def problems(
    kind: str | None = None, difficulty: str | None = None, count: int | None = None, seed: int = 0
) -> list[GalleryProblem]:
    """Return problems of a kind, or of every kind, for `pytest.mark.parametrize`.

    Parameters
    ----------
    kind : str, optional
        One of "named", "well-posed", "degenerate", "redundant", "floating", "frictional", "stiff", "tied", "large".
    difficulty : str, optional
        "easy", "moderate" or "hard"; all by default. The named problems are easy: they are small.
    count : int, optional
        How many of each kind; 3 by default, and all of the named ones.
    seed : int
        Where the seeds of the random kinds start: the first `count` from there on that have the difficulty.

    Raises
    ------
    InvalidProblem
        An unknown kind or difficulty, a negative count or seed.
    """
    refuse_unknown("kind", kind, KINDS)
    refuse_unknown("difficulty", difficulty, DIFFICULTIES)
    for name, value in (("count", count), ("seed", seed)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
            raise InvalidProblem(f"gallery: {name}: expected an integer >= 0, got {shown(value)}")
    if count is not None and count > LARGEST_COUNT:
        raise InvalidProblem(f"gallery: count: expected at most {LARGEST_COUNT}, got {count}")
    found: list[GalleryProblem] = []
    for each in KINDS if kind is None else (kind,):
        if each == "named":
            found += [problem(name) for name in NAMED][:count] if difficulty in (None, "easy") else []
        else:
            found += _of_kind(each, difficulty, 3 if count is None else count, seed)
    return found


def chosen_problems(
    names: Sequence[str],
    kind: str | None = None,
    difficulty: str | None = None,
    count: int | None = None,
    seed: int = 0,
) -> list[GalleryProblem]:
    """Return the problems of the names if any are given, else `problems` for the other arguments.

    Raises InvalidProblem: names and other arguments are both given, or a problem does not exist.

    Parameters
    ----------
    names : sequence of str, may be empty
    kind, difficulty, count, seed
        As in `problems`; at their defaults where there are names.
    """
    if names and (kind, difficulty, count, seed) != (None, None, None, 0):
        raise InvalidProblem(f"gallery: expected names or a kind, got both {names[0]!r} and a choice among kinds")
    return [problem(name) for name in dict.fromkeys(names)] if names else problems(kind, difficulty, count, seed)


def refuse_unknown(what: str, value: object, allowed: tuple[str, ...]) -> None:
    """Raise InvalidProblem unless a word is None or among the allowed ones."""
    if value is not None and value not in allowed:
        near = get_close_matches(str(value), allowed, 1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise InvalidProblem(f"gallery: {what}: expected one of {', '.join(allowed)}, got {shown(value)}{hint}")


def _of_kind(kind: str, difficulty: str | None, count: int, seed: int) -> list[GalleryProblem]:
    step = 1
    if difficulty is not None:
        step = len(DIFFICULTIES)
        seed += (DIFFICULTIES.index(difficulty) - seed) % step
    return [problem(f"{kind}-{seed + step * i}") for i in range(count)]


def _made(build: Callable[[Draw, str], Contents], name: str, difficulty: str) -> Contents:
    return build(Draw(name), difficulty)


FORMAT, VERSION, INDEX = "contactqp gallery", 1, "index.json"
# The gallery as folders of JSON and Matrix Market files, for codes in any language.
#
# index.json every problem: name, kind, difficulty, folder, sizes, what is unique, source two-bars/problem.json
# stiffness.mtx, load.mtx, ...: see `contactqp.exchange.problem_folder` two-bars/answer.json the exact answer in doubles
# and, under "exact", as fractions

PARTS = ("displacement", "normal_force", "friction_force", "tie_force", "gap")
# Entries of problem.json in addition to the data.
ABOUT = ("name", "kind", "difficulty", "unique_displacement", "unique_forces", "description", "formula", "source")


def write_gallery(folder: str | Path, problems: Sequence[GalleryProblem]) -> Path:
    """Write problems and their exact answers to a new or empty folder, all or none.

    Raises InvalidProblem: the folder is not empty or not a folder, there are no problems, or writing fails.

    Returns
    -------
    Path
        The folder.
    """

    def fill(root: Path) -> None:
        for exact in problems:
            _write_one(root / exact.name, exact)
        index = {
            "format": FORMAT,
            "version": VERSION,
            "contactqp": version("contactqp"),
            "problems": [summary(exact) for exact in problems],
        }
        (root / INDEX).write_text(json.dumps(index, indent=1) + "\n", encoding="utf-8")

    if not problems:
        raise InvalidProblem(f"{folder}: no problem of the gallery is chosen; expected at least one")
    return filled(folder, fill, last=INDEX)


def filled(folder: str | Path, fill: Callable[[Path], None], last: str) -> Path:
    """Fill a new or empty folder by `fill`, or leave it unchanged on failure; `last` is written last.

    Raises InvalidProblem: the folder is not empty or not a folder, or writing fails.
    """
    root = Path(folder)
    _refuse_taken(root)
    # An empty folder is filled and not replaced, as it may be a link, a mount, or the working directory.
    there = root.is_dir()
    beside = root / f".{os.getpid()}" if there else root.absolute().with_name(f".{root.absolute().name}.{os.getpid()}")
    try:
        beside.mkdir()
        fill(beside)
        if not there:
            beside.rename(root)
        else:
            _refuse_taken(root, but=beside.name)
            for part in sorted(beside.iterdir(), key=lambda part: (part.name == last, part.name)):
                part.rename(root / part.name)
    except OSError as error:
        raise InvalidProblem(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return root


def summary(exact: GalleryProblem) -> dict[str, Any]:
    """Return the entry of a problem in a list of problems."""
    data = exact.data
    return {
        "name": exact.name,
        "kind": exact.kind,
        "difficulty": exact.difficulty,
        "folder": exact.name,
        "unknowns": data.unknowns,
        "contacts": data.contacts,
        "directions_of_slip": data.directions,
        "ties": len(data.tie),
        "unique_displacement": exact.unique_displacement,
        "unique_forces": exact.unique_forces,
        "description": exact.description,
        "formula": exact.formula,
        "source": exact.source,
    }


def _write_one(folder: Path, posed: GalleryProblem) -> None:
    exact: dict[str, Any] = {part: getattr(posed.exact, part) for part in PARTS if getattr(posed.exact, part)}
    answer = {part: getattr(posed, part) for part in PARTS}
    about = {key: value for key, value in summary(posed).items() if key in ABOUT}
    rounded = posed.data.rounded()
    if rounded:
        # The answer belongs to these fractions; files contain the nearest doubles.
        about["exact_data"] = {name: [str(x) for x in getattr(posed.data, name)] for name in rounded}
        about["rounding"] = float(posed.rounding)
    write_problem(folder, posed.problem, answer | {"contact_status": posed.exact.contact_status, "exact": exact}, about)


def _refuse_taken(root: Path, but: str = "") -> None:
    if root.exists() and not root.is_dir():
        raise InvalidProblem(f"{root}: expected a folder, this is a file")
    if root.is_dir() and (first := next((one for one in sorted(root.iterdir()) if one.name != but), None)):
        raise InvalidProblem(f"{root}: expected a new or an empty folder, {first.name!r} is in it")
    if not root.absolute().parent.is_dir():
        raise InvalidProblem(f"{root}: there is no folder {str(root.absolute().parent)!r}")


SCRIPT = "contact_problems.py"
PROGRAM = '''"""Contact problems with exact answers: bodies on obstacles, redundant contacts, bodies that float."""

from pathlib import Path
from typing import Iterator

import qpbenchmark
from qpbenchmark.benchmark import main
from qpbenchmark.problem import Problem

HERE = Path(__file__).resolve().parent


class ContactProblems(qpbenchmark.TestSet):
    """The problems in data/, whose exact answers lie in answers/."""

    @property
    def title(self) -> str:
        return "Contact problems with exact answers"

    @property
    def description(self) -> str:
        return "Elastic bodies pressed onto obstacles; every answer is known in rational numbers."

    @property
    def sparse_only(self) -> bool:
        return False

    def __iter__(self) -> Iterator[Problem]:
        for path in sorted((HERE / "data").glob("*.npz")):
            yield Problem.load(str(path))


if __name__ == "__main__":
    main(test_set_path=str(Path(__file__).resolve()), results_path=str(HERE / "results" / "qpbenchmark_results.csv"))
'''
README = """# Contact problems with exact answers

A test set for [qpbenchmark](https://github.com/qpsolvers/qpbenchmark), written by `contactqp gallery --as qpbenchmark`.

    pip install qpbenchmark
    python {script} run

`answers/NAME.json` has the exact answer of `data/NAME.npz` as doubles and as fractions: `x`, the multipliers `z` of
G x <= h and `y` of A x = b, and the cost. Where `unique_multipliers` is false, others are right too. Where `rounding`
is not zero, the answer is that of fractions to which the doubles are the nearest, and may be off by that part.

| problem | unknowns | rows of G | rows of A | what it is |
|---|---|---|---|---|
{rows}
"""


def write_qpbenchmark(folder: str | Path, problems: Sequence[GalleryProblem]) -> tuple[Path, int]:
    """Write the problems without friction as a test set of qpbenchmark to a new or empty folder.

    Raises InvalidProblem: the folder is not empty, all problems have friction, or writing fails.

    Returns
    -------
    tuple of Path and int
        The folder, and how many problems are in it.
    """
    programs = [exact for exact in problems if not exact.problem.frictional]
    if not programs:
        raise InvalidProblem(f"{folder}: expected a problem without friction, which alone is a quadratic program")

    def fill(root: Path) -> None:
        for name in ("data", "answers", "results"):
            (root / name).mkdir()
        for exact in programs:
            np.savez(root / "data" / f"{exact.name}.npz", **_arrays(exact))
            _write(root / "answers" / f"{exact.name}.json", json.dumps(_answer(exact), indent=1) + "\n")
        _write(root / "results" / ".gitkeep", "")
        _write(root / "README.md", README.format(script=SCRIPT, rows="\n".join(_row(exact) for exact in programs)))
        _write(root / SCRIPT, PROGRAM)

    return filled(folder, fill, last=SCRIPT), len(programs)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _row(exact: GalleryProblem) -> str:
    data = exact.data
    what = exact.description.replace("|", "/").replace("\n", " ")
    return f"| {exact.name} | {data.unknowns} | {data.contacts} | {len(data.tie)} | {what} |"


def _arrays(exact: GalleryProblem) -> dict[str, Any]:
    """Return P, q, G, h, A, b, lb and ub; missing ones are None in object arrays, as in `qpsolvers.Problem.save`."""
    program = exact.problem.to_qp()
    parts = {name: getattr(program, name) for name in ("P", "q", "G", "h", "A", "b", "lb", "ub")}
    return {name: np.array(part.toarray() if hasattr(part, "toarray") else part) for name, part in parts.items()}


def _answer(posed: GalleryProblem) -> dict[str, Any]:
    data, exact = posed.data, posed.exact
    u = exact.displacement
    terms = zip(times(data.stiffness, u), data.load, u, strict=True)
    cost = sum(((force / 2 - load) * moved for force, load, moved in terms), Fraction(0))
    parts = {"x": exact.displacement, "z": exact.normal_force, "y": exact.tie_force}
    return {
        **{name: [float(value) for value in values] for name, values in parts.items()},
        "cost": float(cost),
        "exact": {**{name: [str(value) for value in values] for name, values in parts.items()}, "cost": str(cost)},
        "unique_x": posed.unique_displacement,
        "unique_multipliers": posed.unique_forces,
        "rounding": float(posed.rounding),
        "source": posed.source,
    }
