"""Methods compared over all cases: rates, wrong flags, performance profiles, mean times, medians."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from contactqp.study.charts.curves import TABLE, cells
from contactqp.study.charts.numbers import error_text, plural
from contactqp.study.charts.rate_bars import rates_chart, silently_wrong_chart
from contactqp.study.charts.time_charts import means_chart, profile_charts
from contactqp.study.charts.work_precision import QUANTITIES, Quantity, work_precision
from contactqp.study.report.chart import Chart
from contactqp.study.report.report_data import ReportData
from contactqp.study.rows import Row
from contactqp.study.statistics.medians import median_cases, median_limit, median_rows
from contactqp.study.statistics.overview import overview


def overview_charts(data: ReportData) -> tuple[Chart, ...]:
    """Of all cases; what compares methods is left out where no case was put to all of them."""
    found, wrong = overview(data.rows), silently_wrong_chart(data.rows)
    if not found.cases:
        return (wrong,)
    return *_medians(data.rows), *profile_charts(found), means_chart(found), rates_chart(found), wrong


def _medians(all_rows: Sequence[Row]) -> Iterator[Chart]:
    cases, middle = median_cases(all_rows), median_rows(all_rows)
    for quantity in QUANTITIES:
        figure = work_precision(middle, quantity, f"{quantity.measure} [1]", "", median_limit(all_rows))
        if len(cases) > 1 and figure is not None:
            yield _median_chart(cases, middle, quantity, figure)


def _median_chart(cases: Sequence[str], middle: Sequence[Row], quantity: Quantity, figure: Mapping[str, Any]) -> Chart:
    return Chart(
        name=f"median-error-{'u' if quantity.name == 'u' else 'force'}",
        title=f"{quantity.title.capitalize()} against run time, median over {plural(len(cases), 'case')}",
        caption="Lower is more exact, further left is faster. Of each value of a knob, the median time and the median "
        f"error over the {len(cases)} cases that every installed method was put to and whose errors are relative. An "
        "answer that failed has infinite errors and takes infinitely long; what fails in more than half of the cases "
        "has no point. Penalties have units, differ from case to case, and are left out. One linear solve is the "
        "median time of factorising the stiffness of these bodies and solving once without contact: the physical limit "
        "of a solver that factorises.",
        figure=figure,
        headings=(*TABLE, f"error in {quantity.name}, {quantity.measure} [1]"),
        lines=tuple((*cells(row, ""), error_text(getattr(row, quantity.column))) for row in middle),
    )
