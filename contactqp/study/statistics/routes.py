"""Which answers are compared: the ways to an answer, the cases that all methods were put to, and what is solved."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from contactqp.study import rows
from contactqp.study.rows import Row

# Verdicts of answers that a method handed over as such.
ANSWERED = (rows.RIGHT, rows.APPROXIMATE, rows.REFUSED)


@dataclass(frozen=True, order=True)
class Route:
    """A way to an answer, whatever the value of the knob."""

    method: str
    variant: str = ""  # "": as `solve` runs it, polished where it polishes; "raw", "uzawa"
    whole: bool = False  # on all unknowns, though the contact unknowns alone would do

    @classmethod
    def of(cls, row: Row) -> Route:
        """That of a row."""
        return cls(row.method, "" if row.variant == "polished" else row.variant, row.condensed == rows.WHOLE)

    def takes(self, row: Row) -> bool:
        """Whether a row went this way; where nothing can be condensed both ways are one."""
        theirs = Route.of(row)
        same = theirs.method == self.method and theirs.variant == self.variant
        return same and (theirs.whole == self.whole or not row.condensed)

    def __str__(self) -> str:
        parts = [self.method, {"uzawa": "Uzawa"}.get(self.variant, self.variant), "all unknowns" if self.whole else ""]
        return ", ".join(filter(None, parts))


def solved(row: Row) -> bool:
    """Whether an answer was handed over whose true error is at most 1e-6, and rounding: whatever flags say."""
    if row.verdict not in ANSWERED or row.error_judged is None or row.error_allowed is None:
        return False
    return row.error_judged <= row.error_allowed


def compared_cases(all_rows: Iterable[Row]) -> tuple[str, ...]:
    """The cases that every installed method of a study was put to, and whose truth is known."""
    known: dict[str, set[str]] = {}
    judged = set()
    for row in all_rows:
        if row.verdict == rows.MISSING:
            continue
        known.setdefault(row.case, set()).add(row.method)
        if row.error_judged is not None:
            judged.add(row.case)
    everyone = set().union(*known.values())
    return tuple(case for case, methods in known.items() if methods == everyone and case in judged)


@dataclass(frozen=True)
class RouteTimes:
    """One route over the compared cases; the clock is that of its fastest right answer, by whichever value of the knob.

    A case counts as unsupported if the method said so of every rung, else as failed if no answer is right.
    """

    route: Route
    cases: tuple[str, ...]
    seconds: tuple[float, ...]  # for each case; infinite where it is not solved
    solved: int
    failed: int
    unsupported: int


def route_times(all_rows: Sequence[Row]) -> tuple[RouteTimes, ...]:
    """Every route of the installed methods, in the order of the rows."""
    cases = compared_cases(all_rows)
    compared = [row for row in all_rows if row.case in cases and row.verdict != rows.MISSING]
    routes = dict.fromkeys(Route.of(row) for row in compared)
    return tuple(_times(route, cases, [row for row in compared if route.takes(row)]) for route in routes)


def _times(route: Route, cases: Sequence[str], mine: Sequence[Row]) -> RouteTimes:
    by_case = [[row for row in mine if row.case == case] for case in cases]
    seconds = tuple(_fastest(tried) for tried in by_case)
    count = sum(math.isfinite(time) for time in seconds)
    unable = sum(bool(tried) and all(row.verdict == rows.UNSUPPORTED for row in tried) for tried in by_case)
    return RouteTimes(route, tuple(cases), seconds, count, len(cases) - count - unable, unable)


def _fastest(tried: Iterable[Row]) -> float:
    return min((row.seconds for row in tried if row.seconds is not None and solved(row)), default=math.inf)
