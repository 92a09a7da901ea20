"""One case on the page of a report, in words and tables, whose lines the filters of the page can hide; and bars.

The bars are the safe range of each method along each axis of the stability study.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from contactqp.errors import counted
from contactqp.scene.explaining import shortened
from contactqp.scene.tables import MOST_ROWS, shown
from contactqp.study import rows
from contactqp.study.curves import Chart, variant_name
from contactqp.study.footprint import footprint_lines, footprint_outcome, share_text
from contactqp.study.page.formulation import Formulation, formulation
from contactqp.study.report_data import CaseRecord
from contactqp.study.rows import READABLE, Row, readable, shortened_text
from contactqp.study.statistics import Route

# The filters of a page, and the headings of columns in the tables of charts that they apply to.
FACETS: Mapping[str, tuple[str, ...]] = {
    "method": ("method",),
    "variant": ("answer", "variant"),
    "verdict": ("verdict",),
}
# Letters of a message that a table shows; results.csv has the whole message.
WIDEST_MESSAGE = 300
# Signs of verdicts, which are not distinguished by colour alone.
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
    """The cells of a line, whether they are highlighted, and what stands below them."""

    cells: tuple[str, ...]
    bad: bool = False
    note: str = ""  # a line of its own below the cells


@dataclass(frozen=True)
class Table:
    """A table of the page; `label` is for screen readers, `facets` are the columns that the filters apply to."""

    label: str
    headings: tuple[str, ...]
    lines: tuple[Line, ...]
    facets: Mapping[int, str] = field(default_factory=dict)


def plain_table(label: str, headings: Iterable[str], lines: Iterable[Sequence[object]]) -> Table:
    """Return a table that no filter applies to."""
    return Table(label, tuple(headings), tuple(Line(tuple(map(str, line))) for line in lines))


def table_of_rows(label: str, chosen: Sequence[Row]) -> Table:
    """Return a table of rows with their readable columns, without those that are empty throughout."""
    cells = [readable(row) for row in chosen]
    cells = [line | _shown_otherwise(row) for row, line in zip(chosen, cells, strict=True)]
    shown = [name for name in READABLE if name != "message" and any(line[name] for line in cells)]
    lines = (
        Line(
            tuple(line[name] for name in shown),
            row.verdict == rows.WRONG or bool(row.expectations_unmet),
            line["message"],
        )
        for row, line in zip(chosen, cells, strict=True)
    )
    headings = dict(READABLE) | {"variant": "answer"}
    facets = {place: name for place, name in enumerate(shown) if name in FACETS}
    return Table(label, tuple(headings[name] for name in shown), tuple(lines), facets)


def _shown_otherwise(row: Row) -> dict[str, str]:
    """Return the cells of filters as these name their values, and a shortened message."""
    message = shortened_text(row.message, WIDEST_MESSAGE)
    return facets_of(row) | {"verdict": marked(row.verdict), "message": message}


def facets_of(row: Row) -> dict[str, str]:
    """Return the values of a row by which the filters choose."""
    return {"method": row.method, "variant": variant_name(Route.of(row)), "verdict": row.verdict}


def table_of_chart(chart: Chart) -> Table | None:
    """Return the numbers of a chart as a table; filters apply to the columns that are named like them."""
    if not chart.lines:
        return None
    columns = [(name, heading) for name, headings in FACETS.items() for heading in headings]
    facets = {chart.headings.index(heading): name for name, heading in columns if heading in chart.headings}
    return Table(f"numbers of: {chart.title}", chart.headings, tuple(map(Line, chart.lines)), facets)


def marked(verdict: str) -> str:
    """Return a verdict with its sign: ``"✓ right"``."""
    return f"{MARKS.get(verdict, OTHER_MARK)} {verdict}"


_HELD = ("method", "expected of the answer", "value", "got", "unit", "error", "allowed", "verdict", "derivation")
_PRINTED = ("method", "the source prints", "value", "ours", "unit", "difference", "half a digit", "verdict", "why")


@dataclass(frozen=True)
class FootprintView:
    """The footprint of one answer, in words and times."""

    outcome: str
    stages: Table | None
    lines: tuple[str, ...]


@dataclass(frozen=True)
class CaseView:
    """One case, ready for its template."""

    anchor: str
    case: CaseRecord
    formulation: Formulation
    parts: Sequence[tuple[str, str]]  # the number and the names of unknowns, supports, contacts and ties
    blocks: Table
    expectations: Table | None
    published: Table | None
    failures: tuple[str, ...]  # trials without an answer
    rows: Table
    footprint: FootprintView | None

    @property
    def headline(self) -> str:
        """Return whether all expectations of the case are met, in words."""
        if self.case.unmet:
            return f"✗ {counted('expectation', len(self.case.unmet))} not met"
        count = sum(len(table.lines) for table in (self.expectations, self.published) if table)
        return f"✓ {'all ' if count > 1 else ''}{counted('expectation', count)} met" if count else "no expectations"

    @property
    def about(self) -> tuple[str, ...]:
        """Return the paragraphs of the description in the case's file, each on one line."""
        paragraphs = re.split(r"\n\s*\n", self.case.about.strip())
        return tuple(" ".join(text.split()) for text in paragraphs if text)

    @property
    def picture(self) -> str:
        """Return the picture as a data URL; empty where there is none."""
        return _url(self.case.picture)

    @property
    def thumbnail(self) -> str:
        """Return the picture of the geometry alone, small, as a data URL; empty where there is none."""
        return _url(self.case.thumbnail)

    @property
    def history_picture(self) -> str:
        """Return the picture of the history as a data URL; empty where there is none."""
        return _url(self.case.history_picture)


def case_view(anchor: str, case: CaseRecord, rows: Sequence[Row]) -> CaseView:
    """Return all tables and formulas of a case."""
    judged = [trial for trial in case.judgements if "failure" not in trial]
    blocks = case.explanation.blocks
    return CaseView(
        anchor=anchor,
        case=case,
        formulation=formulation(case),
        parts=tuple(_parts(case)),
        blocks=plain_table(
            f"{case.title}: what was included and what was left out",
            ("part", "", "why"),
            ((b.name, "✓ included" if b.included else "○ left out", b.reason) for b in blocks),
        ),
        expectations=_comparisons(f"{case.title}: expectations", _HELD, judged, "expectations"),
        published=_comparisons(f"{case.title}: what the source prints", _PRINTED, judged, "published"),
        failures=tuple(str(trial["failure"]) for trial in case.judgements if "failure" in trial),
        rows=table_of_rows(f"{case.title}: every method with every value of its knob", rows),
        footprint=_footprint(case),
    )


def _parts(case: CaseRecord) -> Iterator[tuple[str, str]]:
    explanation = case.explanation
    for name, items in (("Unknowns", explanation.unknowns), ("Fixed", explanation.fixed)):
        if items:
            yield f"{name}: {len(items)}", shortened(items)
    for name, items in (("Contacts", explanation.contacts), ("Ties", explanation.ties)):
        if items:
            more = f"; and {len(items) - MOST_ROWS} more" if len(items) > MOST_ROWS else ""
            yield f"{name}: {len(items)}", "; ".join(items[:MOST_ROWS]) + more


def _footprint(case: CaseRecord) -> FootprintView | None:
    found = case.footprint
    if found is None:
        return None
    outcome, whole = f"By {found.method} in a fresh interpreter: {footprint_outcome(found)}.", found.seconds
    if whole is None:
        return FootprintView(outcome, None, ())
    stages = [(stage.name, f"{1e3 * stage.seconds:.4g}", share_text(stage.seconds / whole)) for stage in found.stages]
    label, headings = f"{case.title}: time of each stage", ("stage", "time [ms]", "share")
    table = plain_table(label, headings, [*stages, ("total", f"{1e3 * whole:.4g}", "")])
    return FootprintView(outcome, table, tuple(footprint_lines(found)))


def _comparisons(label: str, headings: tuple[str, ...], judged: Sequence[Mapping[str, Any]], key: str) -> Table | None:
    lines = tuple(_comparison(_trial(trial), line) for trial in judged for line in trial[key])
    return Table(label, headings, lines) if lines else None


def _trial(trial: Mapping[str, Any]) -> str:
    return " ".join([trial["method"], *(f"{name}={value}" for name, value in trial["knobs"].items())])


def _comparison(trial: str, line: Mapping[str, Any]) -> Line:
    errors = [_number(line["error"]), _number(line["tolerance"])]
    if line["relative"]:
        errors = [f"{error} relative" for error in errors]
    cells = (trial, line["quantity"], shown(line["expected"]), shown(line["got"]), line["unit"], *errors)
    erratum = f" (erratum {line['erratum']})" if line.get("erratum") else ""
    return Line((*cells, _verdict(line), line["reason"] + erratum), bad=not line["ok"])


def _number(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.1e}" if value else "0"


def _verdict(line: Mapping[str, Any]) -> str:
    if line["verdict"] is None:
        return "✓ met" if line["ok"] else "✗ NOT MET"
    confirmed = "✓ right" if line["verdict"] == "right" else "⚠ wrong in the source"
    return confirmed if line["ok"] else f"✗ NOT {line['verdict']}, as the case states"


def _url(picture: bytes | None) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode('ascii')}" if picture else ""


FILE, PAGE = "stability.json", "stability.html"


@dataclass(frozen=True)
class Bar:
    """The longest run of neighbouring values of an axis at which a method is right."""

    start: float  # where it begins on the axis [%]
    width: float  # [%]; 0: nowhere
    words: str


@dataclass(frozen=True)
class StabilityBars:
    """One line of bars for each method, those that are right at most values first."""

    axes: tuple[tuple[str, str], ...]  # title, and from where to where its values go
    lines: tuple[tuple[str, tuple[Bar | None, ...]], ...]  # None: not tried on that axis
    page: str  # of the study, beside that of the report; empty where it is not there


def stability_bars(folder: Path) -> StabilityBars | None:
    """Return the safe ranges of the stability study in a folder; None where there is none that can be read."""
    try:
        axes = json.loads((folder / FILE).read_text(encoding="utf-8"))["axes"]
        return bars_of(axes, PAGE if (folder / PAGE).exists() else "")
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        return None


def bars_of(axes: Sequence[Mapping[str, Any]], page: str = "") -> StabilityBars:
    """Return the safe ranges on the axes of a study, as stability.json has them; `page` is that of the study."""
    named = tuple((str(axis["title"]), _ends(axis)) for axis in axes)
    bars = [{found["method"]: _bar(axis["values"], found) for found in axis["ranges"]} for axis in axes]
    methods = dict.fromkeys(method for found in bars for method, bar in found.items() if bar.width)
    lines = [(method, tuple(found.get(method) for found in bars)) for method in methods]
    lines.sort(key=lambda line: -sum(bar.width for bar in line[1] if bar is not None))
    return StabilityBars(named, tuple(lines), page)


def _ends(axis: Mapping[str, Any]) -> str:
    shown = axis["labels"] or [f"{value:g}" for value in axis["values"]]
    return f"{axis['quantity']}: {shown[0]} to {shown[-1]}"


def _bar(values: Sequence[float], found: Mapping[str, Any]) -> Bar:
    words = str(found["words"])
    if found["lowest"] is None:
        return Bar(0.0, 0.0, words)
    first, last = values.index(found["lowest"]), values.index(found["highest"])
    return Bar(100 * first / len(values), 100 * (last - first + 1) / len(values), words)
