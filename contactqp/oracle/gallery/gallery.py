"""The gallery: problems with exact answers by name, by kind, by difficulty and by seed.

`redundant-17` is the problem of the kind "redundant" with the seed 17, on every platform and in every version; its
difficulty goes with the seed: 0, 3, 6, ... are easy, 1, 4, 7, ... moderate, 2, 5, 8, ... hard.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from functools import lru_cache, partial

from contactqp.errors import InvalidProblem
from contactqp.oracle.gallery import random_problems as plain
from contactqp.oracle.gallery.classical import CLASSICAL
from contactqp.oracle.gallery.draw import Draw
from contactqp.oracle.gallery.friction import frictional
from contactqp.oracle.gallery.problem import Contents, GalleryProblem
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
