"""A report of two cases by three methods, one of them missing, made of rows written by hand."""

from __future__ import annotations

from dataclasses import replace

from contactqp.scene.explaining import Explanation
from contactqp.study import rows
from contactqp.study.report_data import CaseRecord, ReportData, Sizes, summarise
from contactqp.study.rows import Row
from tests.study.statistics_examples import gave_up, right, wrong

LIMIT = 1e-4  # seconds


def _ladder(case: str, variant: str, condensed: str, errors: list[float]) -> list[Row]:
    """By osqp; looser errors are refused, and the loosest is called solved all the same."""
    found = []
    for i, error in enumerate(errors):
        make = right if error < 1e-6 else wrong
        row = make(case, "osqp", 1e-3 * (i + 1), variant=variant, condensed=condensed, knob="tolerance")
        row = replace(row, knob_value=10.0**-i, error_judged=error, error_displacement=error, error_force=10 * error)
        found.append(row)
    return found


def case_rows(case: str) -> list[Row]:
    """Raw and polished, condensed and not, a penalty method, one that is missing, and one that cannot do it."""
    return [
        right(case, "active-set", 2e-3, kind="active set", error_displacement=0.0, error_force=0.0),
        *_ladder(case, "polished", "yes", [0.0, 0.0]),
        *_ladder(case, "raw", "yes", [1e-2, 1e-9]),
        *_ladder(case, "raw", "no", [1e-2, 1e-9]),
        gave_up(case, "lemke", rows.UNSUPPORTED, variant="raw"),
        gave_up(case, "gurobi", rows.MISSING),
        right(case, "penalty", 3e-3, verdict=rows.APPROXIMATE, knob="penalty", knob_value=1e5, promises_exact=False),
    ]


def report(*cases: str) -> ReportData:
    """Of some cases, "one" and "two" by default."""
    names = cases or ("one", "two")
    all_rows = tuple(row for name in names for row in case_rows(name))
    return ReportData(tuple(map(_record, names)), all_rows, summarise(all_rows, ()), {})


def _record(name: str) -> CaseRecord:
    return CaseRecord(
        name=name,
        title=f"Case {name}",
        file="",
        source="",
        about="",
        length="mm",
        force="kN",
        sizes=Sizes(3, 1, 0, 0, 7),
        explanation=Explanation(name, "", (), (), (), (), ()),
        truth="exact",
        judgements=(),
        unmet=(),
        remarks=(),
        linear_solve=LIMIT,
    )
