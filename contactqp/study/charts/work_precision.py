"""Error against run time: the charts of one case."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from contactqp.study import rows
from contactqp.study.charts.curves import (
    FLOOR,
    GREY,
    TEMPLATE,
    Chart,
    curves,
    keys,
    layout,
    legend,
    log_axis,
    milliseconds,
    traces,
    vertical_line,
)
from contactqp.study.report.report_data import CaseRecord, ReportData
from contactqp.study.rows import Row
from contactqp.study.truth import ABSOLUTE_ENERGY, ABSOLUTE_FORCE

# Half the distance from 1 to the next double: relative errors below it are rounding of the answer itself.
ROUNDING = 1.1e-16
TIME_AXIS = "run time [ms]"
HEIGHT = 620


@dataclass(frozen=True)
class Quantity:
    """What an error is of."""

    column: str  # of the rows
    name: str
    title: str
    measure: str  # of the relative error
    absolute: str  # what `Row.error_measure` says where it is not relative


QUANTITIES = (
    Quantity("error_displacement", "u", "error in the displacements", "relative, energy norm", ABSOLUTE_ENERGY),
    Quantity("error_force", "λ", "error in the contact forces", "relative, largest contact", ABSOLUTE_FORCE),
)


def case_charts(data: ReportData, case: CaseRecord) -> tuple[Chart, ...]:
    """Error in u and in λ against run time; none where nothing could be measured.

    They have no tables: their numbers are the case's rows, which a page shows once.
    """
    mine = data.rows_of(case.name)
    charts = (_case_chart(mine, case, quantity) for quantity in QUANTITIES)
    return tuple(chart for chart in charts if chart is not None)


def _case_chart(mine: Sequence[Row], case: CaseRecord, quantity: Quantity) -> Chart | None:
    length, force = case.length or "length", case.force or "force"
    units = {"u": f"√({force}·{length})", "λ": force}
    absolute = any(quantity.absolute in row.error_measure for row in mine)
    unit = f"absolute [{units[quantity.name]}]" if absolute else f"{quantity.measure} [1]"
    figure = work_precision(mine, quantity, unit, f"{force}/{length}", case.linear_solve)
    if figure is None:
        return None
    said = _CAPTION, _limit_text(case.linear_solve), _truth_text(case), _without_points(mine, quantity)
    return Chart(
        name=f"{case.name}-error-{'u' if quantity.name == 'u' else 'force'}",
        title=f"{case.title}: {quantity.title} against run time",
        caption=" ".join(filter(None, said)),
        figure=figure,
    )


_CAPTION = (
    "Lower is more exact, further left is faster. Each curve is one method, from one value of its knob (tolerance, "
    "penalty, iterations) to the next. Run times are those to the answer, without its certificate. "
    "All numbers stand in the table of the case's answers."
)


def _limit_text(seconds: float | None) -> str:
    if seconds is None:
        return ""
    return (
        f"One linear solve of the same bodies without contact takes {milliseconds(seconds)} ms: no contact solver that "
        "factorises the stiffness can be faster."
    )


def _truth_text(case: CaseRecord) -> str:
    """Return a note on what a method's error does not tell where its own solution is the truth."""
    found = re.search(r"([\w-]+), proven to", case.truth)
    if found is None:
        return ""
    which = "The truth is" if found.start() == 0 else "Numbers that the case does not state are those of"
    return f"{which} the proven solution of {found[1]} itself, whose own error there is zero and tells nothing."


def work_precision(
    drawn_rows: Sequence[Row], quantity: Quantity, unit: str, stiffness: str, limit: float | None
) -> Mapping[str, Any] | None:
    """The figure, or None if no row has a time and an error.

    Parameters
    ----------
    unit : str
        Of the error, and what it is relative to.
    stiffness : str
        Unit of penalties.
    limit : float, optional
        Seconds of one linear solve.
    """
    drawn = curves(drawn_rows, quantity.column)
    if not drawn:
        return None
    points = [row for curve in drawn for row in curve.points]
    times = [1e3 * (row.seconds or 0.0) for row in points] + ([1e3 * limit] if limit else [])
    errors = [FLOOR, 1.0, *(getattr(row, quantity.column) for row in points)]
    shape, label = vertical_line(1e3 * limit, f"one linear solve: {milliseconds(limit)} ms") if limit else ({}, {})
    band, floor = _rounding(unit)
    arranged = layout(
        log_axis(TIME_AXIS, times),
        log_axis(f"true error in {quantity.name}, {unit}", errors),
        HEIGHT,
        template=TEMPLATE,
        shapes=[found for found in (band, shape) if found],
        annotations=[found for found in (floor, label) if found],
        legend=legend("Methods"),
        legend2=legend("Lines and marks", y=1.02, yanchor="bottom", itemclick=False, itemdoubleclick=False),
    )
    return dict(data=traces(drawn, quantity.column, stiffness) + keys(drawn), layout=arranged)


def _rounding(unit: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The band in which an error is that of writing the answer in double precision; only relative ones have it."""
    relative = unit.startswith("relative")
    text = f"zero is drawn at {FLOOR:g}"
    place = dict(x=1, y=-17, xref="paper", yref="y", xanchor="right", yanchor="bottom", showarrow=False)
    if not relative:
        return {}, dict(**place, text=text)
    band = dict(type="rect", xref="paper", yref="y", x0=0, x1=1, y0=FLOOR / 10, y1=ROUNDING, layer="below")
    filled = dict(**band, fillcolor=GREY, opacity=0.15, line=dict(width=0))
    return filled, dict(**place, text=f"no error in double precision; {text}")


def _without_points(mine: Sequence[Row], quantity: Quantity) -> str:
    """Which rows have no point, and why: none is left out silently."""
    missing = [row.method for row in mine if row.verdict == rows.MISSING]
    lacking = [row for row in mine if getattr(row, quantity.column) is None or row.seconds is None]
    verdicts = Counter(row.verdict for row in lacking if row.verdict != rows.MISSING)
    said = [f"Answers without a point: {_listed(verdicts)}."] if verdicts else []
    return " ".join(said + ([f"Not installed: {', '.join(dict.fromkeys(missing))}."] if missing else []))


def _listed(verdicts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
