"""What many judged problems add up to: tables, rates, and what makes a run fail."""

from __future__ import annotations

import os
import platform
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from benchmarks.judging import EPS, REPRESENTABLE, SLACK, Report
from contactqp.solving.methods import find
from contactqp.solving.methods.method import ACTIVE_SET, MODELLING_LANGUAGE, QUADRATIC_PROGRAM

# Ratios of bound and true error are taken of errors that are well above rounding: of 1e-14, and of as many roundings of
# the displacement as that has eps, which is more where bodies move much and strain little.
MEANINGFUL = 1e-14
# Bounds beneath a hundredth of the tolerance of 1e-6 are as good as exact, however small the errors are: what rounding
# of K makes on bodies that float is in them.
AS_GOOD_AS_EXACT = 1e-8
NEEDED_ACTIVE_SET, NEEDED_BACKEND = 0.999, 0.95
# Right answers that may be refused, as a part of those tried.
NEEDLESSLY_BACKEND = 0.01
LARGEST_RATIO, MEDIAN_RATIO = 1000.0, 10.0
PACKAGES = (
    *("contactqp", "numpy", "scipy", "qpsolvers", "osqp", "clarabel", "piqp"),
    *("proxsuite", "daqp", "highspy", "scs", "qpalm", "cvxpy", "python-flint"),
)


def counts(reports: Iterable[Report]) -> dict[tuple[str, str], Counter]:
    """(family, method) -> verdicts, "raw" for wrong flags, "needlessly" for right answers refused."""
    table: dict[tuple[str, str], Counter] = defaultdict(Counter)
    for report in reports:
        for outcome in report.outcomes:
            cell = table[report.family, outcome.method]
            cell[outcome.verdict] += 1
            cell["raw"] += outcome.raw_wrong
            cell["needlessly"] += outcome.needlessly
    return table


def rates(reports: Iterable[Report], methods: Iterable[str]) -> dict[str, tuple[int, int]]:
    """method -> right and attempted, on the well-posed problems."""
    posed = [report for report in reports if report.well_posed]
    solved = {}
    for method in methods:
        tried = [o for r in posed for o in r.outcomes if o.method == method and o.verdict != "unsupported"]
        solved[method] = (sum(o.verdict == "right" for o in tried), len(tried))
    return solved


def ratios(reports: Iterable[Report]) -> dict[tuple[str, str], np.ndarray]:
    """(figure, kind) -> bound / true error on well-posed problems; of errors well above rounding, finite bounds.

    Of a bound that is `AS_GOOD_AS_EXACT` the ratio is one.
    """
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    for report in reports:
        for b in report.bounds if report.well_posed else ():
            if b.error >= MEANINGFUL * max(1.0, b.slack / SLACK, b.rounding / EPS) and b.bound < np.inf:
                found[b.figure, b.kind].append(1.0 if b.bound <= AS_GOOD_AS_EXACT else b.bound / b.largest)
    return {key: np.array(values) for key, values in sorted(found.items())}


def failures(reports: list[Report], methods: Iterable[str]) -> list[str]:
    """What makes the run fail, in words."""
    table = counts(reports)
    found = []
    totals = {verdict: sum(cell[verdict] for cell in table.values()) for verdict in ("wrong", "crashed", "denied")}
    found += [f"{number} answers {verdict}" for verdict, number in totals.items() if number]
    if number := sum(len(r.spoiled_passed) for r in reports):
        found.append(f"{number} spoiled answers passed")
    if number := sum(b.below for r in reports for b in r.bounds):
        found.append(f"{number} bounds below the true error")
    for (figure, kind), values in ratios(reports).items():
        if figure != "force_bound" and (np.median(values) > MEDIAN_RATIO or np.max(values) > LARGEST_RATIO):
            median, worst = np.median(values), np.max(values)
            found.append(f"{figure} ({kind}): {median:.3g} times the error in the median, {worst:.3g} at worst")
    for method, (right, tried) in rates(reports, methods).items():
        needed = needed_rate(method)
        if tried and right < needed * tried:
            found.append(f"{method}: {right} of {tried} well-posed problems solved, needed {needed:.1%}")
        needlessly = sum(cell["needlessly"] for (_, name), cell in table.items() if name == method)
        allowed = 0 if needed == NEEDED_ACTIVE_SET else NEEDLESSLY_BACKEND * tried
        if needed and needlessly > allowed:
            found.append(f"{method}: {needlessly} right answers refused, at most {allowed:.0f} allowed")
    return found


def needed_rate(method: str) -> float:
    entry = find(method.split()[0])
    if entry.kind == ACTIVE_SET:
        return NEEDED_ACTIVE_SET
    return NEEDED_BACKEND if entry.polish and entry.kind in (QUADRATIC_PROGRAM, MODELLING_LANGUAGE) else 0.0


def easy(reports: list[Report]) -> list[str]:
    """Families that no raw method gets wrong."""
    table = counts(reports)
    hard = {name for (name, _), cell in table.items() if cell["raw"]}
    return sorted({report.family for report in reports} - hard)


def _grid(title: str, rows: list[str], columns: list[str], cell: Any) -> Iterator[str]:
    yield ""
    yield title
    wide = max(len(r) for r in rows) + 1
    for start in range(0, len(columns), 6):
        part = columns[start : start + 6]
        widths = [max(len(c), 13) + 2 for c in part]
        yield " " * wide + "".join(c.rjust(w) for c, w in zip(part, widths, strict=True))
        for row in rows:
            yield row.ljust(wide) + "".join(cell(row, c).rjust(w) for c, w in zip(part, widths, strict=True))
        yield ""


def text(reports: list[Report], methods: list[str], seconds: float) -> Iterator[str]:
    """The report, line by line."""
    table, names = counts(reports), list(dict.fromkeys(r.family for r in reports))

    def cell(name: str, method: str) -> str:
        c = table[name, method]
        refused = c["refused"] + c["crashed"] + c["denied"]
        return "-" if not (c["right"] + refused + c["wrong"]) else f"{c['right']}/{refused}/{c['wrong']}/{c['raw']}"

    yield from _heading(reports, seconds)
    yield from _grid("right / refused / WRONG BUT PASSED / raw flag wrong", names, methods, cell)
    yield from _family_lines(reports, names)
    yield from _method_lines(reports, methods)
    yield from _bound_lines(reports)
    yield f"\ntoo easy (no raw flag wrong): {', '.join(easy(reports)) or 'none'}"


def _heading(reports: list[Report], seconds: float) -> Iterator[str]:
    known = Counter(r.truth for r in reports)
    solves = sum(len(r.outcomes) for r in reports)
    yield f"{len(reports)} problems, {solves} solves, {seconds:.0f} s; truth: {dict(known)}"
    yield f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    yield ", ".join(f"{name} {_version(name)}" for name in PACKAGES)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _family_lines(reports: list[Report], names: list[str]) -> Iterator[str]:
    heads = f"{'kappa':>9s}{'right':>7s}{'refused':>9s}{'wrong':>7s}{'raw':>6s}{'truth refused':>15s}{'below':>7s}"
    yield f"{'family':28s}{'posed':>7s}{heads}"
    table = counts(reports)
    for name in names:
        own = [r for r in reports if r.family == name]
        total: Counter = sum((c for (f, _), c in table.items() if f == name), Counter())
        refused = total["refused"] + total["crashed"] + total["denied"]
        objected = sum(bool(r.truth_refused) and r.representable <= REPRESENTABLE for r in own)
        below = sum(b.below for r in own for b in r.bounds)
        kappa = max(r.kappa for r in own)
        posed = sum(r.well_posed for r in own)
        yield (
            f"{name:28s}{posed:>3d}/{len(own):<3d}{kappa:>9.0e}{total['right']:>7d}{refused:>9d}"
            f"{total['wrong']:>7d}{total['raw']:>6d}{objected:>15d}{below:>7d}"
        )
    yield ""


def _method_lines(reports: list[Report], methods: list[str]) -> Iterator[str]:
    solved, table = rates(reports, methods), counts(reports)
    heads = f"{'denied':>8s}{'crashed':>9s}{'needlessly':>12s}{'raw wrong':>11s}{'seconds':>9s}"
    yield f"{'method':28s}{'well-posed solved':>26s}{heads}"
    for method in methods:
        right, tried = solved[method]
        total: Counter = sum((c for (_, m), c in table.items() if m == method), Counter())
        spent = sum(o.seconds for r in reports for o in r.outcomes if o.method == method)
        rate = f"{right} of {tried} = {right / tried:.2%}" if tried else "-"
        yield (
            f"{method:28s}{rate:>26s}{total['denied']:>8d}{total['crashed']:>9d}{total['needlessly']:>12d}"
            f"{total['raw']:>11d}{spent:>9.1f}"
        )
    yield ""


def _bound_lines(reports: list[Report]) -> Iterator[str]:
    below = Counter((b.figure, b.kind) for r in reports for b in r.bounds if b.below)
    compared = Counter((b.figure, b.kind) for r in reports for b in r.bounds)
    unbounded = Counter((b.figure, b.kind) for r in reports for b in r.bounds if b.bound == np.inf)
    heads = f"{'compared':>10s}{'below':>8s}{'infinite':>10s}{'median ratio':>14s}{'99 %':>10s}{'max':>10s}"
    yield f"{'bound':14s}{'of answers':12s}{heads}"
    for (figure, kind), values in ratios(reports).items():
        numbers = f"{np.median(values):>14.3g}{np.percentile(values, 99):>10.3g}{np.max(values):>10.3g}"
        key = (figure, kind)
        yield f"{figure:14s}{kind:12s}{compared[key]:>10d}{below[key]:>8d}{unbounded[key]:>10d}{numbers}"
