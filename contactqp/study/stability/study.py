"""The study: its axes and rows, what they come to, as JSON and in words."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from contactqp.study import rows as report_rows
from contactqp.study.rows import aligned
from contactqp.study.stability.cells import COLUMNS, CUT_OFF, STATED, VERDICTS, StabilityRow, short_dicts
from contactqp.study.stability.penalty_valley import of_truss
from contactqp.study.stability.posed import Axis

# Where each method is right, in words and numbers, computed from the rows of one axis.

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


SCHEMA, SCHEMA_VERSION = "contactqp-stability", 1


@dataclass(frozen=True)
class StabilityStudy:
    """The axes, and every method at each of their values."""

    axes: tuple[Axis, ...]
    rows: tuple[StabilityRow, ...]
    facts: Mapping[str, Any]  # created, machine, versions, settings

    def rows_of(self, axis: Axis) -> tuple[StabilityRow, ...]:
        """Return the rows of one axis."""
        return tuple(row for row in self.rows if row.axis == axis.name)

    def ranges(self, axis: Axis) -> tuple[SafeRange, ...]:
        """Return the range of values in which each method is right."""
        return safe_ranges(axis, self.rows_of(axis))

    @property
    def wrong(self) -> tuple[StabilityRow, ...]:
        """What passed and is wrong, and the certificate says nothing: there must be none."""
        return tuple(row for row in self.rows if row.wrong)

    @property
    def flags_wrong(self) -> int:
        """How often a method's own flag was wrong."""
        return sum(row.flag_wrong is True for row in self.rows)

    @property
    def refused_right(self) -> tuple[StabilityRow, ...]:
        """Answers that are right and were refused."""
        return tuple(row for row in self.rows if row.refused_right)

    @property
    def exit_code(self) -> int:
        """1 if anything of ours is wrong and passed, else 0."""
        return 1 if self.wrong else 0

    def cells(self) -> list[list[str]]:
        """A table of the axes: how many rows ended how; headings first."""
        endings = [name for name in VERDICTS if name != report_rows.MISSING]
        table = [["axis", "from", "to", *endings, "right answers refused"]]
        for axis in self.axes:
            mine = self.rows_of(axis)
            counts = Counter(row.verdict for row in mine)
            refused = sum(row.refused_right is True for row in mine)
            ends = [axis.label(axis.values[0]), axis.label(axis.values[-1])]
            table.append([axis.name, *ends, *(str(counts[name] or "") for name in endings), str(refused or "")])
        return table

    def __str__(self) -> str:
        counts = Counter(row.verdict for row in self.rows)
        return (
            f"{len(self.rows)} rows; wrong but passed: {len(self.wrong)}; errors that the certificate states: "
            f"{counts[STATED]}; right answers refused: {len(self.refused_right)}; cut off: {counts[CUT_OFF]}; "
            f"methods silently wrong by themselves: {self.flags_wrong}"
        )


def as_json(study: StabilityStudy) -> str:
    """stability.json."""
    written = dict(schema=SCHEMA, schema_version=SCHEMA_VERSION, **study.facts)
    written |= dict(columns=dict(COLUMNS), verdicts=dict(VERDICTS), summary=_summary(study))
    written["axes"] = [_axis(study, axis) for axis in study.axes]
    head = json.dumps(written, indent=1, allow_nan=False, ensure_ascii=False).removesuffix("\n}")
    rows = (json.dumps(row, allow_nan=False, ensure_ascii=False) for row in short_dicts(study.rows))
    return head + ',\n "rows": [\n  ' + ",\n  ".join(rows) + "\n ]\n}\n"


def _summary(study: StabilityStudy) -> dict[str, Any]:
    best = of_truss()
    return dict(
        rows=len(study.rows),
        verdicts=dict(Counter(row.verdict for row in study.rows)),
        wrong_but_passed=len(study.wrong),
        refused_right=len(study.refused_right),
        backends_silently_wrong=study.flags_wrong,
        best_penalty=dict(asdict(best), penalty=best.penalty, error=best.error),
    )


def _axis(study: StabilityStudy, axis: Axis) -> dict[str, Any]:
    known: dict[str, Any] = dict(name=axis.name, title=axis.title, quantity=axis.quantity, about=axis.about)
    known |= dict(values=list(axis.values), labels=list(axis.labels))
    return known | dict(ranges=[asdict(found) for found in study.ranges(axis)])


def lines(study: StabilityStudy) -> Iterator[str]:
    """What the terminal gets to see."""
    yield aligned(study.cells())
    for axis in study.axes:
        yield f"\n{axis.title} ({axis.quantity})"
        yield from (f"  {words}" for words in grouped(study.ranges(axis)))
    for row in study.wrong:
        yield f"WRONG BUT PASSED: {row.axis} = {row.label}: {row.name}: error {row.error}: {row.message}"
    yield str(study)
