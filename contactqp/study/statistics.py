"""Statistics of the rows of a study: comparable routes, rates, mean and median times, performance profiles."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np

from contactqp.model.arrays import Array
from contactqp.model.summary import finite
from contactqp.solving.methods.method import ACTIVE_SET
from contactqp.study import rows
from contactqp.study.rows import Row

# Verdicts of rows in which a method returned an answer.
ANSWERED = (rows.RIGHT, rows.APPROXIMATE, rows.REFUSED)


@dataclass(frozen=True, order=True)
class Route:
    """A method and its variant, with or without condensation, whatever the value of its knob."""

    method: str
    variant: str = ""  # "": as `solve` runs it, polished where it polishes; "raw", "uzawa"
    whole: bool = False  # on all unknowns, though the contact unknowns alone would do

    @classmethod
    def of(cls, row: Row) -> Route:
        """Return the route of a row."""
        return cls(row.method, "" if row.variant == "polished" else row.variant, row.condensed == rows.WHOLE)

    def takes(self, row: Row) -> bool:
        """Return whether a row belongs to this route; where nothing can be condensed both routes are the same."""
        other = Route.of(row)
        same = other.method == self.method and other.variant == self.variant
        return same and (other.whole == self.whole or not row.condensed)

    def __str__(self) -> str:
        parts = [self.method, {"uzawa": "Uzawa"}.get(self.variant, self.variant), "all unknowns" if self.whole else ""]
        return ", ".join(filter(None, parts))


def solved(row: Row) -> bool:
    """Return whether the true error of an answer is at most 1e-6 and rounding, whatever the method reports."""
    if row.verdict not in ANSWERED or row.error_judged is None or row.error_allowed is None:
        return False
    return row.error_judged <= row.error_allowed


def compared_cases(all_rows: Iterable[Row]) -> tuple[str, ...]:
    """Return the cases that every installed method of a study was tried on and whose truth is known."""
    tried: dict[str, set[str]] = {}
    judged = set()
    for row in all_rows:
        if row.verdict == rows.MISSING:
            continue
        tried.setdefault(row.case, set()).add(row.method)
        if row.error_judged is not None:
            judged.add(row.case)
    everyone = set().union(*tried.values())
    return tuple(case for case, methods in tried.items() if methods == everyone and case in judged)


@dataclass(frozen=True)
class RouteTimes:
    """The run times of one route over the compared cases: those of its fastest right answers, by any value of the knob.

    A case counts as unsupported if every setting of the method is, else as failed if no answer is right.
    """

    route: Route
    cases: tuple[str, ...]
    seconds: tuple[float, ...]  # for each case; infinite where it is not solved
    solved: int
    failed: int
    unsupported: int


def route_times(all_rows: Sequence[Row]) -> tuple[RouteTimes, ...]:
    """Return the run times of every route of the installed methods, in the order of the rows.

    What was tried on all unknowns of some of the cases only is not a route over all of them.
    """
    cases = compared_cases(all_rows)
    compared = [row for row in all_rows if row.case in cases and row.verdict != rows.MISSING]
    routes = {route: [row for row in compared if route.takes(row)] for route in map(Route.of, compared)}
    everywhere = {route for route, mine in routes.items() if {row.case for row in mine} == set(cases)}
    return tuple(_times(route, cases, mine) for route, mine in routes.items() if route in everywhere or not route.whole)


def _times(route: Route, cases: Sequence[str], mine: Sequence[Row]) -> RouteTimes:
    by_case = [[row for row in mine if row.case == case] for case in cases]
    seconds = tuple(_fastest(tried) for tried in by_case)
    count = sum(math.isfinite(time) for time in seconds)
    unable = sum(bool(tried) and all(row.verdict == rows.UNSUPPORTED for row in tried) for tried in by_case)
    return RouteTimes(route, tuple(cases), seconds, count, len(cases) - count - unable, unable)


def _fastest(tried: Iterable[Row]) -> float:
    return min((row.seconds for row in tried if row.seconds is not None and solved(row)), default=math.inf)


# The shifted geometric mean (Mittelmann's benchmarks): the shift [s] is added to every time and taken off the mean, so
# that neither the longest nor the shortest times decide.
SHIFT = 1e-3
# The time of a failure, and the largest time that counts [s].
LIMIT = 10.0


def shifted_geometric_mean(seconds: Iterable[float], shift: float = SHIFT, limit: float = LIMIT) -> float:
    """Return exp(mean log(min(t, limit) + shift)) - shift [s]; failures are infinite and count as the limit.

    Examples
    --------
    >>> round(shifted_geometric_mean([0.001, 0.007]), 12)
    0.003
    >>> round(shifted_geometric_mean([float("inf"), 10.0]), 12)
    10.0
    """
    times = np.minimum(np.array(list(seconds), dtype=float), limit)
    return float(np.exp(np.mean(np.log(times + shift))) - shift)


def median_cases(all_rows: Sequence[Row]) -> tuple[str, ...]:
    """Return the compared cases whose errors are all relative, since only those can be put beside each other."""
    absolute = {row.case for row in all_rows if row.error_judged is not None and row.error_measure != "relative"}
    return tuple(case for case in compared_cases(all_rows) if case not in absolute)


def median_rows(all_rows: Sequence[Row]) -> tuple[Row, ...]:
    """Return the medians of error and run time over `median_cases`, one row for each route and value of the knob.

    An answer that failed has infinite errors and takes infinitely long; a median that is infinite is None. Penalties
    are the same where they are the same multiples of the contact stiffness; other knobs with units are left out.
    """
    cases = median_cases(all_rows)
    shared = [row for row in all_rows if row.case in cases and row.verdict != rows.MISSING]
    tried = dict.fromkeys((Route.of(row), row.variant, *_knob(row)) for row in shared)
    found = []
    for route, *setting in tried:
        group = [row for row in shared if route.takes(row) and [row.variant, *_knob(row)] == setting]
        if {row.case for row in group} == set(cases):
            found.append(_median_row(route, group))
    return tuple(found)


def _knob(row: Row) -> tuple[str, float | None]:
    """Return a knob with its value, a stiffness as a multiple of that of the contacts, rounded to one digit."""
    if row.knob_stiffnesses is not None:
        return row.knob, float(f"{row.knob_stiffnesses:.1g}")
    return row.knob, row.knob_value


def median_limit(all_rows: Sequence[Row]) -> float | None:
    """Return the median over `median_cases` of one linear solve [s]; None if one of them has none."""
    cases = median_cases(all_rows)
    limits = {row.case: row.linear_solve_seconds for row in all_rows if row.case in cases}
    measured = [limit for limit in limits.values() if limit is not None]
    return statistics.median(measured) if measured and len(measured) == len(limits) else None


def _median_row(route: Route, group: Sequence[Row]) -> Row:
    one = group[0]
    return Row(
        method=one.method,
        kind=one.kind,
        promises_exact=one.promises_exact,
        variant=one.variant,
        condensed=rows.WHOLE if route.whole else "",
        knob=one.knob,
        knob_value=None if one.knob_stiffnesses is not None else one.knob_value,
        knob_stiffnesses=None if one.knob_stiffnesses is None else _knob(one)[1],
        seconds=_median(group, "seconds"),
        error_displacement=_median(group, "error_displacement"),
        error_force=_median(group, "error_force"),
    )


def _median(group: Sequence[Row], column: str) -> float | None:
    values = [getattr(row, column) if row.verdict in (*ANSWERED, rows.WRONG) else None for row in group]
    middle = statistics.median(math.inf if value is None else value for value in values)
    return middle if math.isfinite(middle) else None


@dataclass(frozen=True)
class Rates:
    """Counts of one method; failures are in `own` and in `certifiable`, and are neither claimed nor right.

    A method's own answers are its raw ones, or all where it has no others; that of the active set is the refined one,
    and has no flag. They are right by what was asked of them (`error_asked`), certified ones by 1e-6.
    """

    method: str
    installed: bool
    cases: int
    own: int  # rows of the method's own answers
    claimed: int  # of these, that it called solved
    right: int  # of `own`, that are right
    silently_wrong: int  # of `claimed`, that are wrong
    unsupported: int  # of `own`, that it refused to try
    certifiable: int  # rows as `solve` runs it
    certified: int  # of these, that the certificate passed
    wrong_but_passed: int  # of `certified`, that are wrong: must be 0


def method_rates(all_rows: Iterable[Row], cases: Sequence[str] | None = None) -> tuple[Rates, ...]:
    """Return the rates of every method over some cases, or all."""
    taken = [row for row in all_rows if cases is None or row.case in cases]
    return tuple(
        _rates(name, [row for row in taken if row.method == name]) for name in dict.fromkeys(r.method for r in taken)
    )


def _rates(name: str, mine: Sequence[Row]) -> Rates:
    tried = [row for row in mine if row.verdict != rows.MISSING]
    own, as_solve = own_answers(tried), [row for row in tried if row.variant in ("", "polished")]
    return Rates(
        method=name,
        installed=bool(tried),
        cases=len({row.case for row in mine}),
        own=len(own),
        claimed=sum(row.claimed is True for row in own),
        right=sum(_right(row) for row in own),
        silently_wrong=sum(row.flag_wrong is True for row in own),
        unsupported=sum(row.verdict == rows.UNSUPPORTED for row in own),
        certifiable=len(as_solve),
        certified=sum(row.verdict in (rows.RIGHT, rows.WRONG) for row in as_solve),
        wrong_but_passed=sum(row.verdict == rows.WRONG for row in mine),
    )


def own_answers(tried: Sequence[Row]) -> list[Row]:
    """Return the rows of a method's own answers: none of a method that is approximate or has no flag."""
    exact = [row for row in tried if row.promises_exact and row.kind != ACTIVE_SET]
    return [row for row in exact if row.variant == "raw"] or exact


def _right(row: Row) -> bool:
    if row.verdict not in ANSWERED or row.error_judged is None or row.error_asked is None:
        return False
    return row.error_judged <= row.error_asked


@dataclass(frozen=True)
class Overview:
    """Methods compared on the cases that all of them were tried on, for the page, the JSON and the terminal."""

    cases: tuple[str, ...]
    rates: tuple[Rates, ...]  # on those cases
    times: tuple[RouteTimes, ...]
    means: tuple[float, ...]  # shifted geometric means of the times [s]


def overview(all_rows: Sequence[Row]) -> Overview:
    """Return the overview of the rows of a report."""
    cases, times = compared_cases(all_rows), route_times(all_rows)
    means = tuple(shifted_geometric_mean(found.seconds) for found in times)
    return Overview(cases, method_rates(all_rows, cases), times, means)


def overview_data(found: Overview) -> dict[str, Any]:
    """Return the overview as results.json has it; an infinite time is null."""
    return dict(
        compared_cases=list(found.cases),
        solved="error_judged at most error_allowed, by the truth, whatever flags say",
        shift_seconds=SHIFT,
        limit_seconds=LIMIT,
        rates=[asdict(rates) for rates in found.rates],
        times=[_overview_times(times, mean) for times, mean in zip(found.times, found.means, strict=True)],
    )


def _overview_times(times: RouteTimes, mean: float) -> dict[str, Any]:
    return dict(
        **asdict(times.route),
        solved=times.solved,
        failed=times.failed,
        unsupported=times.unsupported,
        shifted_geometric_mean_seconds=mean,
        seconds=finite(times.seconds),
    )


Solver = TypeVar("Solver")


def ratios(seconds: Mapping[Solver, Sequence[float]]) -> dict[Solver, Array]:
    """Return t / min t of every problem, (problems,) for each solver; infinite where a solver did not solve it.

    Parameters
    ----------
    seconds : solver -> (problems,), positive, infinite where not solved

    Examples
    --------
    >>> ratios({"a": [1.0, 4.0], "b": [3.0, np.inf]})
    {'a': array([1., 1.]), 'b': array([ 3., inf])}
    """
    times = np.array(list(seconds.values()), dtype=float)
    fastest = np.min(times, axis=0)
    compared = np.divide(times, fastest, out=np.full_like(times, np.inf), where=np.isfinite(times))
    return dict(zip(seconds, compared, strict=True))


def profile(compared: Array, factors: Array) -> Array:
    """Return the performance profile (Dolan and Moré 2002): the part of the problems with t / min t <= tau, each tau.

    Examples
    --------
    >>> profile(np.array([1.0, 3.0, np.inf]), np.array([1.0, 2.0, 4.0])).round(2)
    array([0.33, 0.33, 0.67])
    """
    return np.asarray(np.mean(compared[:, None] <= factors, axis=0))


# Times are compared on bodies of so many unknowns, where there are such: below, calls of Python decide.
BODY = 500
