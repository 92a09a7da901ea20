"""Describe one case on the page in words and tables."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from contactqp.scene.explaining import shortened
from contactqp.scene.tables import MOST_ROWS, shown, written
from contactqp.study import rows
from contactqp.study.curves import Chart, variant_name
from contactqp.study.footprint import footprint_lines, footprint_outcome, share_text
from contactqp.study.page.formulation import Formulation, formulation
from contactqp.study.report_data import CaseRecord
from contactqp.study.rows import READABLE, Row, readable, shortened_text
from contactqp.study.statistics import Route

# Tables of a page: cells, and by which of its filters a line can be hidden.

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
    told = {"verdict": marked(row.verdict), "message": shortened_text(row.message, WIDEST_MESSAGE)}
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


_HELD = ("method", "expected of the answer", "value", "got", "unit", "error", "allowed", "verdict", "derivation")
_PRINTED = ("method", "the source prints", "value", "ours", "unit", "difference", "half a digit", "verdict", "why")


@dataclass(frozen=True)
class FootprintView:
    """What one answer takes in a process of its own, in words and times."""

    outcome: str
    stages: Table | None
    lines: tuple[str, ...]


@dataclass(frozen=True)
class CaseView:
    """One case, ready for its template."""

    anchor: str
    case: CaseRecord
    formulation: Formulation
    parts: Sequence[tuple[str, str]]  # unknowns, supports, contacts, ties: how many and which
    blocks: Table
    expectations: Table | None
    published: Table | None
    failures: tuple[str, ...]  # trials without an answer
    rows: Table
    footprint: FootprintView | None

    @property
    def headline(self) -> str:
        """Whether all that the case expects holds."""
        if self.case.unmet:
            return f"✗ {_counted(len(self.case.unmet), 'expectation')} not met"
        count = sum(len(table.lines) for table in (self.expectations, self.published) if table)
        return f"✓ {'all ' if count > 1 else ''}{_counted(count, 'expectation')} met" if count else "no expectations"

    @property
    def about(self) -> tuple[str, ...]:
        """The paragraphs of what the case's file says of it; lines of the file end nowhere on a page."""
        paragraphs = re.split(r"\n\s*\n", self.case.about.strip())
        return tuple(" ".join(text.split()) for text in paragraphs if text)

    @property
    def picture(self) -> str:
        """The picture as a data URL; empty where there is none."""
        return _url(self.case.picture)

    @property
    def history_picture(self) -> str:
        return _url(self.case.history_picture)


def case_view(anchor: str, case: CaseRecord, rows: Sequence[Row]) -> CaseView:
    """All tables and formulas of a case."""
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
    told = case.explanation
    for name, items in (("Unknowns", told.unknowns), ("Fixed", told.fixed)):
        if items:
            yield f"{name}: {len(items)}", shortened(items)
    for name, items in (("Contacts", told.contacts), ("Ties", told.ties)):
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
    return "not finite" if value is None else f"{value:.1e}"


def _verdict(line: Mapping[str, Any]) -> str:
    if line["verdict"] is None:
        return "✓ met" if line["ok"] else "✗ NOT MET"
    said = "✓ right" if line["verdict"] == "right" else "⚠ wrong in the source"
    return said if line["ok"] else f"✗ NOT {line['verdict']}, as the case states"


def _counted(count: int, what: str) -> str:
    return f"{written(count)} {what}{'s' * (count != 1)}"


def _url(picture: bytes | None) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode('ascii')}" if picture else ""
