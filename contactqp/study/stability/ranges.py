"""Where each method is right, in words and numbers, computed from the rows of one axis."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from contactqp.study import rows as report_rows
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.rows import CUT_OFF, STATED, StabilityRow

# An approximate method is called useful up to this error.
USEFUL = 1e-3


@dataclass(frozen=True)
class SafeRange:
    """One method on one axis."""

    axis: str
    method: str  # with its variant
    lowest: float | None  # where it is right, the longest run of neighbouring values; None: nowhere
    highest: float | None
    everywhere: bool
    best: float | None  # the smallest error of u and λ together
    best_value: float | None
    refused: tuple[float, ...]  # values at which it was refused, or gave up
    words: str  # without the method's name


def safe_ranges(axis: Axis, rows: Sequence[StabilityRow]) -> tuple[SafeRange, ...]:
    """One for each method that was tried on the axis."""
    names = dict.fromkeys(row.name for row in rows if row.axis == axis.name and row.verdict != report_rows.MISSING)
    return tuple(_safe_range(axis, name, [r for r in rows if (r.axis, r.name) == (axis.name, name)]) for name in names)


def _safe_range(axis: Axis, name: str, rows: Sequence[StabilityRow]) -> SafeRange:
    tried = sorted((row for row in rows if row.verdict != CUT_OFF), key=lambda row: row.value)
    exact = all(row.promises_exact for row in tried)
    runs = _runs(tried, _is_right if exact else _is_useful)
    run = max(runs, key=len, default=[])
    known = [(row.error, row.value) for row in tried if row.error is not None and row.verdict != report_rows.REFUSED]
    best = min(known, default=(None, None))
    refused = tuple(row.value for row in tried if row.verdict in _GIVEN_UP)
    whole = len(run) == len(tried)
    found = SafeRange(
        axis=axis.name,
        method=name,
        lowest=run[0].value if run else None,
        highest=run[-1].value if run else None,
        everywhere=whole and bool(run),
        best=best[0],
        best_value=best[1],
        refused=refused,
        words="",
    )
    return replace(found, words="; ".join(_parts(axis, found, runs, rows, exact)) + ".")


def grouped(ranges: Sequence[SafeRange]) -> Iterator[str]:
    """In words, methods that end alike together; those that are right everywhere last."""
    alike: dict[str, list[str]] = {}
    for found in sorted(ranges, key=lambda found: found.everywhere):
        alike.setdefault(found.words, []).append(found.method)
    for words, methods in alike.items():
        yield f"{', '.join(methods)}: {words}"


_GIVEN_UP = (report_rows.REFUSED, report_rows.NOT_CONVERGED, report_rows.BACKEND_FAILED)


def _is_right(row: StabilityRow) -> bool:
    return row.right


def _is_useful(row: StabilityRow) -> bool:
    return row.right or (row.error is not None and row.error <= USEFUL and row.verdict == report_rows.APPROXIMATE)


def _runs(rows: Sequence[StabilityRow], good: Callable[[StabilityRow], bool]) -> list[list[StabilityRow]]:
    """Neighbouring rows that are good, together."""
    return [list(run) for is_good, run in itertools.groupby(rows, good) if is_good]


def _parts(
    axis: Axis, found: SafeRange, runs: Sequence[Sequence[StabilityRow]], rows: Sequence[StabilityRow], exact: bool
) -> Iterator[str]:
    quality = "right" if exact else f"error below {USEFUL:g}"
    where = " and ".join(_span(axis, run[0].value, run[-1].value) for run in runs) or "nowhere"
    yield f"{quality} {'at all values tried, ' if found.everywhere else ''}{where}"
    if not exact and found.best is not None and found.best_value is not None:
        yield f"best {found.best:.1e} at {axis.label(found.best_value)}"
    yield from _others(axis, rows)


def _span(axis: Axis, lowest: float, highest: float) -> str:
    if lowest == highest:
        return f"at {axis.label(lowest)}"
    return f"from {axis.label(lowest)} to {axis.label(highest)}"


def _others(axis: Axis, rows: Sequence[StabilityRow]) -> Iterator[str]:
    """Each other ending, with the values at which it was."""
    endings = (*_GIVEN_UP, STATED, report_rows.UNSUPPORTED, CUT_OFF, report_rows.WRONG)
    for ending in endings:
        values = sorted(row.value for row in rows if row.verdict == ending)
        if values:
            where = axis.label(values[0]) if len(values) == 1 else f"{len(values)} values, "
            where += "" if len(values) == 1 else f"{axis.label(values[0])} to {axis.label(values[-1])}"
            yield f"{ending} at {where}"
