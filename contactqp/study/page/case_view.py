"""What the page says of one case, in words and tables."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from contactqp.scene.explaining import shortened
from contactqp.scene.tables import MOST_ROWS, shown, written
from contactqp.study.footprint.printing import footprint_lines, footprint_outcome, share_text
from contactqp.study.page.formulation import Formulation, formulation
from contactqp.study.page.tables import Line, Table, plain_table, table_of_rows
from contactqp.study.report.case_record import CaseRecord
from contactqp.study.rows import Row

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
