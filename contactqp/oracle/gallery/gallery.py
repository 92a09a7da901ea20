"""The gallery: problems with exact answers by name, by kind, by difficulty and by seed.

`redundant-17` is the problem of the kind "redundant" with the seed 17, on every platform and in every version; its
difficulty goes with the seed: 0, 3, 6, ... are easy, 1, 4, 7, ... moderate, 2, 5, 8, ... hard.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from contactqp.errors import InvalidProblem
from contactqp.exchange.problem_folder import write_problem
from contactqp.oracle.gallery import random_problems as plain
from contactqp.oracle.gallery.algebra import Draw
from contactqp.oracle.gallery.classical import CLASSICAL
from contactqp.oracle.gallery.problem import Contents, GalleryProblem
from contactqp.oracle.gallery.random_problems import frictional
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


@lru_cache(maxsize=64)
def problem(name: str) -> GalleryProblem:
    """The problem of a name, such as "truss-over-floor" or "redundant-17".

    Raises
    ------
    InvalidProblem
        No problem has that name; the message gives the nearest one.
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


def problems(
    kind: str | None = None, difficulty: str | None = None, count: int | None = None, seed: int = 0
) -> list[GalleryProblem]:
    """Problems of a kind, or of every kind, for `pytest.mark.parametrize`.

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
            raise InvalidProblem(f"gallery: {name}: expected an integer >= 0, got {value!r}")
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
    """The problems of the names, where there are some, else `problems` of the rest.

    Raises
    ------
    InvalidProblem
        Names and a choice among kinds are given, or either knows no such problem.
    """
    if names and (kind, difficulty, count, seed) != (None, None, None, 0):
        raise InvalidProblem(f"gallery: expected names or a kind, got both {names[0]!r} and a choice among kinds")
    return [problem(name) for name in dict.fromkeys(names)] if names else problems(kind, difficulty, count, seed)


def refuse_unknown(what: str, value: object, known: tuple[str, ...]) -> None:
    """Raise unless a word is None or known."""
    if value is not None and value not in known:
        near = get_close_matches(str(value), known, 1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise InvalidProblem(f"gallery: {what}: expected one of {', '.join(known)}, got {value!r}{hint}")


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
# What the problem.json of a problem says beside its data.
ABOUT = ("name", "kind", "difficulty", "unique_displacement", "unique_forces", "description", "formula", "source")


def write_gallery(
    folder: str | Path,
    problems: Sequence[GalleryProblem],
    progress: Callable[[GalleryProblem], None] | None = None,
) -> Path:
    """Write problems and their exact answers to a folder that is new or empty: all of them, or nothing.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InvalidProblem
        Something is in the folder, it is none, nothing is to be written, or the file system refuses.
    """

    def fill(root: Path) -> None:
        for known in problems:
            _write_one(root / known.name, known)
            if progress is not None:
                progress(known)
        index = {
            "format": FORMAT,
            "version": VERSION,
            "contactqp": version("contactqp"),
            "problems": [summary(known) for known in problems],
        }
        (root / INDEX).write_text(json.dumps(index, indent=1) + "\n", encoding="utf-8")

    if not problems:
        raise InvalidProblem(f"{folder}: no problem of the gallery is chosen; expected at least one")
    return filled(folder, fill, last=INDEX)


def filled(folder: str | Path, fill: Callable[[Path], None], last: str) -> Path:
    """Return a folder that is new or was empty, filled by `fill` or left as it was; `last` is its last part.

    Raises
    ------
    InvalidProblem
        Something is in the folder, it is none, or the file system refuses.
    """
    root = Path(folder)
    _refuse_taken(root)
    # An empty folder is filled and not replaced: it may be a link, a mount, or where the user stands.
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


def summary(known: GalleryProblem) -> dict[str, Any]:
    """What a list of problems says of one."""
    data = known.data
    return {
        "name": known.name,
        "kind": known.kind,
        "difficulty": known.difficulty,
        "folder": known.name,
        "unknowns": data.unknowns,
        "contacts": data.contacts,
        "directions_of_slip": data.directions,
        "ties": len(data.tie),
        "unique_displacement": known.unique_displacement,
        "unique_forces": known.unique_forces,
        "description": known.description,
        "formula": known.formula,
        "source": known.source,
    }


def _write_one(folder: Path, known: GalleryProblem) -> None:
    exact: dict[str, Any] = {part: getattr(known.exact, part) for part in PARTS if getattr(known.exact, part)}
    answer = {part: getattr(known, part) for part in PARTS}
    about = {key: value for key, value in summary(known).items() if key in ABOUT}
    rounded = known.data.rounded()
    if rounded:
        # The answer belongs to these fractions; files hold the nearest doubles.
        about["exact_data"] = {name: [str(x) for x in getattr(known.data, name)] for name in rounded}
        about["rounding"] = float(known.rounding)
    write_problem(folder, known.problem, answer | {"contact_status": known.exact.contact_status, "exact": exact}, about)


def _refuse_taken(root: Path, but: str = "") -> None:
    if root.exists() and not root.is_dir():
        raise InvalidProblem(f"{root}: expected a folder, this is a file")
    if root.is_dir() and (first := next((one for one in sorted(root.iterdir()) if one.name != but), None)):
        raise InvalidProblem(f"{root}: expected a new or an empty folder, {first.name!r} is in it")
    if not root.absolute().parent.is_dir():
        raise InvalidProblem(f"{root}: there is no folder {str(root.absolute().parent)!r}")
