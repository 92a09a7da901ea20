"""All that a report says, before it is written to a page or a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from contactqp.study.report.case_record import CaseRecord
from contactqp.study.report.summary import Summary
from contactqp.study.rows import COLUMNS, VERDICTS, Row, as_dicts
from contactqp.study.statistics.overview import overview, overview_data

SCHEMA, SCHEMA_VERSION = "contactqp-report", 2


@dataclass(frozen=True)
class ReportData:
    """Cases, rows and what they come to, and where and with what they were made."""

    cases: tuple[CaseRecord, ...]
    rows: tuple[Row, ...]
    summary: Summary
    facts: Mapping[str, Any]  # created, machine, versions, settings, seeds

    def rows_of(self, case: str) -> tuple[Row, ...]:
        """Those of one case."""
        return tuple(row for row in self.rows if row.case == case)


def as_json(data: ReportData) -> str:
    """results.json."""
    written = dict(schema=SCHEMA, schema_version=SCHEMA_VERSION, **data.facts)
    written |= dict(columns=dict(COLUMNS), verdicts=dict(VERDICTS), summary=asdict(data.summary))
    written |= dict(overview=overview_data(overview(data.rows)))
    written["cases"] = [_case(case) for case in data.cases]
    written["rows"] = as_dicts(data.rows)
    return json.dumps(written, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _case(case: CaseRecord) -> dict[str, Any]:
    return dict(
        name=case.name,
        file=case.file,
        title=case.title,
        units=dict(length=case.length, force=case.force),
        **asdict(case.sizes),
        linear_solve_seconds=case.linear_solve,
        truth=case.truth,
        unmet=list(case.unmet),
        judgements=list(case.judgements),
        footprint=None if case.footprint is None else case.footprint.data(),
    )
