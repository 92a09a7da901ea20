"""The charts that a report begins with: error of the contact forces against run time.

On the case that tells most, and over the cases that are small enough to be checked by hand.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from contactqp.study import rows
from contactqp.study.conclusion import BODY
from contactqp.study.curves import FLOOR, MARKS, Chart, Curve, curves, legend, method_style, rounded
from contactqp.study.report_charts import QUANTITIES, case_chart, median_chart
from contactqp.study.report_data import CaseRecord, ReportData
from contactqp.study.rows import Row
from contactqp.study.statistics import median_cases

COMPACT_HEIGHT, COMPACT_MARGIN = 520, dict(l=70, r=20, t=10, b=50)
COMPACT_CAPTION = (
    "Filled: the answer as solve returns it; hollow: the method's raw answer; with a dot: Uzawa's iteration. "
    f"{MARKS[rows.REFUSED]} was refused by the certificate, {MARKS[rows.NOT_CONVERGED]} gave up. "
    f"In the grey band there is no error in double precision; zero is drawn at {FLOOR:g}."
)
# The case of the first screen has at least this part of the methods, and of the points, of the case with the most.
NEARLY_ALL = 0.75


def telling_chart(data: ReportData) -> Chart | None:
    """Return the chart of the first screen: the error in the contact forces of the case that tells most."""
    case = telling_case(data)
    chart = None if case is None else case_chart(data.rows_of(case.name), case, QUANTITIES[1])
    return None if chart is None or case is None else _compact(chart, data.rows_of(case.name))


def examples_chart(data: ReportData) -> Chart | None:
    """Return the chart of the medians over the small cases of a report; None where there are fewer than two."""
    small = [row for row in data.rows if (row.unknowns or BODY) < BODY]
    chart = median_chart(small, QUANTITIES[1])
    if chart is None:
        return None
    names = ", ".join(median_cases(small))
    return replace(chart, name="examples", caption=f"{names}: {chart.caption}")


def telling_case(data: ReportData) -> CaseRecord | None:
    """Return the case of most unknowns among those with nearly all methods and nearly as many points as any."""
    points = {
        case.name: [row for row in data.rows_of(case.name) if row.error_force is not None and row.seconds is not None]
        for case in data.cases
    }
    most = max(map(len, points.values()), default=0)
    every = max((len({row.method for row in mine}) for mine in points.values()), default=0)
    telling = [
        case
        for case in data.cases
        if (mine := points[case.name])
        and len(mine) >= NEARLY_ALL * most
        and len({row.method for row in mine}) >= NEARLY_ALL * every
    ]
    return max(telling, key=lambda case: case.sizes.unknowns, default=None)


def _compact(chart: Chart, mine: Sequence[Row]) -> Chart:
    """Return a chart of forces that fits beside a table: names at the curves, and the explanation of marks in words."""
    drawn = [trace for trace in chart.figure["data"] if trace["meta"]["method"]]
    arranged = {name: value for name, value in chart.figure["layout"].items() if name != "legend2"}
    limit = [note for note in arranged["annotations"] if note.get("yref") == "paper"]
    notes = [*limit, *_labels(curves(mine, "error_force"), arranged)]
    arranged |= dict(annotations=notes, height=COMPACT_HEIGHT, legend=legend("", y=-0.2), margin=COMPACT_MARGIN)
    return replace(
        chart, name="telling", caption=f"{COMPACT_CAPTION} {chart.caption}", figure=dict(data=drawn, layout=arranged)
    )


# A chart beside a table, about so wide and high [px], and its letters.
LABELLED, LETTER = (400.0, 400.0), (6.5, 14.0)


def _labels(drawn: Sequence[Curve], arranged: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the names of methods at their curves, those that have room: one for each method, none over another.

    Parameters
    ----------
    drawn : sequence of Curve
        Curves of the contact forces.
    arranged : mapping
        The layout, whose axes have ranges.
    """
    low = [arranged[axis]["range"][0] for axis in ("xaxis", "yaxis")]
    scale = [
        size / (arranged[axis]["range"][1] - start)
        for axis, start, size in zip(("xaxis", "yaxis"), low, LABELLED, strict=True)
    ]
    taken: list[tuple[float, float, float]] = []
    found: dict[str, dict[str, Any]] = {}
    for curve in drawn:
        name, row = curve.route.method, curve.points[0]
        x, y = math.log10(1e3 * (row.seconds or FLOOR)), math.log10(max(row.error_force or 0.0, FLOOR))
        left, middle, width = scale[0] * (x - low[0]), scale[1] * (y - low[1]), LETTER[0] * len(name)
        apart = all(
            abs(middle - other) > LETTER[1] or left > end or left + width < begin for begin, end, other in taken
        )
        if name not in found and apart and left + width < LABELLED[0]:
            taken.append((left, left + width, middle))
            colour = method_style(name).colour
            found[name] = dict(
                x=rounded(x),
                y=rounded(y),
                text=name,
                showarrow=False,
                xanchor="left",
                xshift=7,
                font=dict(size=11, color=colour),
            )
    return list(found.values())
