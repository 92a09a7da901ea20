"""Statistics over a study's rows: comparable routes, rates, mean and median times, performance profiles."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np

from contactqp.model.arrays import Array
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
        """Return the route of a row."""
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

    A case counts as unsupported if the method said so of every setting, else as failed if no answer is right.
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


# The shifted geometric mean of run times (Mittelmann's benchmarks): neither the longest nor the shortest decide.

# What is added to every time before and taken off after the mean [s]: times far below it count as equal.
SHIFT = 1e-3
# What a failure counts as, and where the clock stops [s].
LIMIT = 10.0


def shifted_geometric_mean(seconds: Iterable[float], shift: float = SHIFT, limit: float = LIMIT) -> float:
    """exp(mean log(min(t, limit) + shift)) - shift [s]; failures are infinite and count as the limit.

    Examples
    --------
    >>> round(shifted_geometric_mean([0.001, 0.007]), 12)
    0.003
    >>> round(shifted_geometric_mean([float("inf"), 10.0]), 12)
    10.0
    """
    times = np.minimum(np.array(list(seconds), dtype=float), limit)
    return float(np.exp(np.mean(np.log(times + shift))) - shift)


# The median over cases of error and run time, for each setting that all cases share.


def median_cases(all_rows: Sequence[Row]) -> tuple[str, ...]:
    """The compared cases whose errors are all relative: others cannot be put beside them."""
    absolute = {row.case for row in all_rows if row.error_judged is not None and row.error_measure != "relative"}
    return tuple(case for case in compared_cases(all_rows) if case not in absolute)


def median_rows(all_rows: Sequence[Row]) -> tuple[Row, ...]:
    """One row for each way and value of the knob that was tried on each of `median_cases`.

    An answer that failed has infinite errors and takes infinitely long; a median that is infinite is None. Knobs with
    units differ from case to case and are left out.
    """
    cases = median_cases(all_rows)
    shared = [row for row in all_rows if row.case in cases and (row.knob == "tolerance" or row.knob_value is None)]
    shared = [row for row in shared if row.verdict != rows.MISSING]
    tried = dict.fromkeys((Route.of(row), row.variant, row.knob, row.knob_value) for row in shared)
    found = []
    for route, *setting in tried:
        group = [row for row in shared if route.takes(row) and [row.variant, row.knob, row.knob_value] == setting]
        if {row.case for row in group} == set(cases):
            found.append(_median_row(route, group))
    return tuple(found)


def median_limit(all_rows: Sequence[Row]) -> float | None:
    """The median over `median_cases` of one linear solve [s]; None if one of them has none."""
    cases = median_cases(all_rows)
    limits = {row.case: row.linear_solve_seconds for row in all_rows if row.case in cases}
    known = [limit for limit in limits.values() if limit is not None]
    return statistics.median(known) if known and len(known) == len(limits) else None


def _median_row(route: Route, group: Sequence[Row]) -> Row:
    one = group[0]
    return Row(
        method=one.method,
        kind=one.kind,
        promises_exact=one.promises_exact,
        variant=one.variant,
        condensed=rows.WHOLE if route.whole else "",
        knob=one.knob,
        knob_value=one.knob_value,
        seconds=_median(group, "seconds"),
        error_displacement=_median(group, "error_displacement"),
        error_force=_median(group, "error_force"),
    )


def _median(group: Sequence[Row], column: str) -> float | None:
    values = [getattr(row, column) if row.verdict in (*ANSWERED, rows.WRONG) else None for row in group]
    middle = statistics.median(math.inf if value is None else value for value in values)
    return middle if math.isfinite(middle) else None


# How often methods call their own answers solved, how often those are right, and what the certificate makes of it.


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
    """The rows of a method's own answers: none of a method that promises no exact answer, or has no flag."""
    exact = [row for row in tried if row.promises_exact and row.kind != "active set"]
    return [row for row in exact if row.variant == "raw"] or exact


def _right(row: Row) -> bool:
    if row.verdict not in ANSWERED or row.error_judged is None or row.error_asked is None:
        return False
    return row.error_judged <= row.error_asked


# What all rows of a study come to, computed once for the page, the JSON and the terminal.


@dataclass(frozen=True)
class Overview:
    """Methods compared on the cases that all of them were put to."""

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
    """As it stands in results.json; a time without end is null."""
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
        seconds=[value if math.isfinite(value) else None for value in times.seconds],
    )


# Performance profiles (Dolan and More 2002): the part of the problems solved within a factor of the fastest time.

Solver = TypeVar("Solver")


def ratios(seconds: Mapping[Solver, Sequence[float]]) -> dict[Solver, Array]:
    """t / min t of every problem, (problems,) a solver; infinite where a solver did not solve it.

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
    """rho(tau) = the part of all problems with t / min t <= tau, for every factor tau.

    Examples
    --------
    >>> profile(np.array([1.0, 3.0, np.inf]), np.array([1.0, 2.0, 4.0])).round(2)
    array([0.33, 0.33, 0.67])
    """
    return np.asarray(np.mean(compared[:, None] <= factors, axis=0))
