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
    """Cells, and whether they must catch the eye."""

    cells: tuple[str, ...]
    bad: bool = False


@dataclass(frozen=True)
class Table:
    """Headings and lines; `label` is what a screen reader calls it, `facets` by which columns filters choose lines."""

    label: str
    headings: tuple[str, ...]
    lines: tuple[Line, ...]
    facets: Mapping[int, str] = field(default_factory=dict)


def plain_table(label: str, headings: Iterable[str], lines: Iterable[Sequence[object]]) -> Table:
    """Lines without facets."""
    return Table(label, tuple(headings), tuple(Line(tuple(map(str, line))) for line in lines))


def table_of_rows(label: str, chosen: Sequence[Row]) -> Table:
    """The readable columns of a study's rows, without those that are empty throughout."""
    cells = [readable(row) for row in chosen]
    cells = [line | _shown_otherwise(row) for row, line in zip(chosen, cells, strict=True)]
    shown = [name for name in READABLE if any(line[name] for line in cells)]
    lines = (
        Line(tuple(line[name] for name in shown), row.verdict == rows.WRONG or bool(row.expectations_unmet))
        for row, line in zip(chosen, cells, strict=True)
    )
    headings = dict(READABLE) | {"variant": "answer"}
    facets = {place: name for place, name in enumerate(shown) if name in FACETS}
    return Table(label, tuple(headings[name] for name in shown), tuple(lines), facets)


def _shown_otherwise(row: Row) -> dict[str, str]:
    """Facets as the filters have them, and messages cut."""
    told = {"verdict": marked(row.verdict), "message": shortened(row.message, WIDEST_MESSAGE)}
    return facets_of(row) | told


def facets_of(row: Row) -> dict[str, str]:
    """What the filters choose a row by."""
    return {"method": row.method, "variant": variant_name(Route.of(row)), "verdict": row.verdict}


def table_of_chart(chart: Chart) -> Table | None:
    """The numbers of a chart; columns that are named like a facet are what filters go by."""
    if not chart.lines:
        return None
    columns = [(name, heading) for name, headings in FACETS.items() for heading in headings]
    facets = {chart.headings.index(heading): name for name, heading in columns if heading in chart.headings}
    return Table(f"numbers of: {chart.title}", chart.headings, tuple(map(Line, chart.lines)), facets)


def marked(verdict: str) -> str:
    """``"✓ right"``."""
    return f"{MARKS.get(verdict, OTHER_MARK)} {verdict}"
