"""Tables of a page: cells, and by which of its filters a line can be hidden."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from contactqp.study import rows
from contactqp.study.charts.curves import variant_name
from contactqp.study.report.chart import Chart
from contactqp.study.rows import READABLE, Row, readable, shortened
from contactqp.study.statistics.routes import Route

# What the filters of a page choose by: of a row, by `meta` of a trace, by the headings of a chart's table.
FACETS: Mapping[str, tuple[str, ...]] = {
    "method": ("method",),
    "variant": ("answer", "variant"),
    "verdict": ("verdict",),
}
# Letters of a message that a table shows; results.csv has all of them.
WIDEST_MESSAGE = 160
# A verdict is told by its word and its sign, not by colour alone.
MARKS: Mapping[str, str] = {
    rows.RIGHT: "✓",
    rows.APPROXIMATE: "≈",
    rows.REFUSED: "⊘",
    rows.NOT_CONVERGED: "…",
    rows.BACKEND_FAILED: "✗",
    rows.UNSUPPORTED: "∅",
    rows.MISSING: "□",
    rows.CRASHED: "†",
    rows.WRONG: "‼",
}
OTHER_MARK = "?"


@dataclass(frozen=True)
class Line:
    """Cells, the value of each facet it has, and whether it must catch the eye."""

    cells: tuple[str, ...]
    facets: Mapping[str, str] = field(default_factory=dict)
    bad: bool = False


@dataclass(frozen=True)
class Table:
    """Headings and lines; `label` is what a screen reader calls it."""

    label: str
    headings: tuple[str, ...]
    lines: tuple[Line, ...]


def plain_table(label: str, headings: Iterable[str], lines: Iterable[Sequence[object]]) -> Table:
    """Lines without facets."""
    return Table(label, tuple(headings), tuple(Line(tuple(map(str, line))) for line in lines))


def table_of_rows(label: str, chosen: Sequence[Row]) -> Table:
    """The readable columns of a study's rows, without those that are empty throughout."""
    cells = [readable(row) for row in chosen]
    shown = [name for name in READABLE if any(line[name] for line in cells)]
    lines = (_line(row, [line[name] for name in shown], shown) for row, line in zip(chosen, cells, strict=True))
    return Table(label, tuple(READABLE[name] for name in shown), tuple(lines))


def _line(row: Row, cells: list[str], shown: Sequence[str]) -> Line:
    if "verdict" in shown:
        cells[shown.index("verdict")] = marked(row.verdict)
    if "message" in shown:
        cells[shown.index("message")] = shortened(row.message, WIDEST_MESSAGE)
    return Line(tuple(cells), facets_of(row), row.verdict == rows.WRONG or bool(row.expectations_unmet))


def facets_of(row: Row) -> dict[str, str]:
    """What the filters choose a row by."""
    return {"method": row.method, "variant": variant_name(Route.of(row)), "verdict": row.verdict}


def table_of_chart(chart: Chart) -> Table | None:
    """The numbers of a chart; columns that are named like a facet are what filters go by."""
    if not chart.lines:
        return None
    columns = [(name, heading) for name, headings in FACETS.items() for heading in headings]
    places = {name: chart.headings.index(heading) for name, heading in columns if heading in chart.headings}
    lines = (Line(line, {name: line[place] for name, place in places.items()}) for line in chart.lines)
    return Table(f"numbers of: {chart.title}", chart.headings, tuple(lines))


def marked(verdict: str) -> str:
    """``"✓ right"``."""
    return f"{MARKS.get(verdict, OTHER_MARK)} {verdict}"
