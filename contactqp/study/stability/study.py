"""The study: its axes and rows, what they come to, as JSON and in words."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from contactqp.study import rows as report_rows
from contactqp.study.rows import aligned
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.best_penalty import of_truss
from contactqp.study.stability.ranges import SafeRange, grouped, safe_ranges
from contactqp.study.stability.rows import COLUMNS, CUT_OFF, STATED, VERDICTS, StabilityRow, short_dicts

SCHEMA, SCHEMA_VERSION = "contactqp-stability", 1


@dataclass(frozen=True)
class StabilityStudy:
    """The axes, and every method at each of their values."""

    axes: tuple[Axis, ...]
    rows: tuple[StabilityRow, ...]
    facts: Mapping[str, Any]  # created, machine, versions, settings

    def rows_of(self, axis: Axis) -> tuple[StabilityRow, ...]:
        """Those of one axis."""
        return tuple(row for row in self.rows if row.axis == axis.name)

    def ranges(self, axis: Axis) -> tuple[SafeRange, ...]:
        """Where each method is right."""
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
