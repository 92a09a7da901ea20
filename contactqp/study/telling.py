"""What a report tells in brief: the cases that it takes, the charts that it begins with, and what was left out.

The cases are examples small enough to be checked by hand, and Hertz's contact at three sizes. The charts show the error
of the contact forces against run time, on the case that tells most and over the small ones.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from contactqp.errors import SceneError
from contactqp.scene.shipped import shipped_folder
from contactqp.study import rows
from contactqp.study.curves import FLOOR, MARKS, Chart, Curve, curves, legend, method_style, rounded
from contactqp.study.report_charts import QUANTITIES, case_chart, median_chart
from contactqp.study.report_data import CaseRecord, ReportData
from contactqp.study.rows import Row
from contactqp.study.statistics import BODY, Route, median_cases, solved

# Of the cases that come with the package: a bar, a truss with and without friction, a string, a multi-point constraint.
EXAMPLES = ("bar_wall", "truss_floor", "truss_friction", "string_over_floor", "master_slave_gap")
# Elements along the radius of Hertz's cylinder, by about how many unknowns they make.
HERTZ = {1_000: 9, 8_000: 26, 40_000: 58}
_HERTZ_CASE = """\
title = "Hertz: a cylinder on a rigid plane, {unknowns} unknowns"
source = "Hertz 1882; K. L. Johnson, Contact Mechanics, 1985, section 4.2(c)"
about = \"\"\"
The lower half of a cylinder, R = 10 mm, in plane strain is pressed on a rigid plane by a uniform traction on its flat
side. Hertz: p0 = 2 P / (pi a), a = sqrt(4 P R / (pi E*)), E* = E / (1 - nu^2), P the force per thickness.
\"\"\"
units = {{ length = "mm", force = "N" }}
axes = ["x", "y"]
obstacles = [{{ name = "plane", point = ["0 mm", "-10 mm"], normal = [0, 1] }}]
contacts = [{{ name = "foot", side = "cylinder.arc", obstacle = "plane" }}]
supports = [{{ name = "middle", on = "cylinder.pole", axis = "x" }}]
tractions = [{{ name = "press", side = "cylinder.top", value = ["0 MPa", "-50 MPa"] }}]

[[bodies]]
name = "cylinder"
model = "plane-strain"
thickness = "1 mm"
modulus = "21 GPa"
poisson = 0.3

[bodies.shape]
kind = "half-disc"
element = "quad4"
radius = "10 mm"
divisions = [{divisions}, {divisions}]
grading = 20

[[expect]]
quantity = "contact force"
at = "foot"
value = "1000 N"
tolerance = 1e-9
derivation = "equilibrium: 50 MPa times 20 mm times 1 mm; no discretisation error"
"""


def telling_cases(folder: Path) -> tuple[Path, ...]:
    """Return the files of the telling cases; those of Hertz's contact are written to the report's folder.

    Raises
    ------
    SceneError
        The package has come without its cases, or the folder cannot be written.
    """
    shipped = shipped_folder()
    if shipped is None:
        raise SceneError("report: the cases that come with contactqp are missing here; name case files instead")
    return *(shipped / f"{name}.toml" for name in EXAMPLES), *(_hertz(folder, size) for size in HERTZ)


def _hertz(folder: Path, size: int) -> Path:
    file = folder / f"hertz_{size}.toml"
    text = _HERTZ_CASE.format(unknowns=f"{size:,}".replace(",", " "), divisions=HERTZ[size])
    written = file.with_suffix(".unfinished")
    try:
        written.write_text(text, encoding="utf-8")
        os.replace(written, file)
    except OSError as error:
        raise SceneError(f"{file}: cannot be written: {error.strerror}") from None
    return file


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


def left_out_lines(case: CaseRecord, all_rows: Sequence[Row], titles: Mapping[str, str]) -> Iterator[str]:
    """Yield what the problem of a case left out, and what that saved there and over all rows.

    `titles` are those of the cases, by their names.
    """
    left = [block.name for block in case.explanation.blocks if not block.included]
    if left:
        yield f"{case.title}: left out, as nothing of it is in the case: {', '.join(left)}."
    if case.sizes.unknowns > case.sizes.contacts > 0:
        yield (
            f"{case.title}: its {case.sizes.unknowns} unknowns are condensed onto those of {case.sizes.contacts} "
            "contacts before a method is called."
        )
    yield from _saved(all_rows, titles)
    count = case.footprint.contacts if case.footprint else None
    if count is not None and count.dropped:
        yield (
            f"{case.title}: {count.dropped} of {count.looked_at} contacts are out of reach, left out, and checked "
            "afterwards."
        )
    modules = case.footprint.modules if case.footprint else None
    if modules is not None and modules.left_out:
        yield f"{case.title}: installed and not imported: {', '.join(modules.left_out)}."


def _saved(all_rows: Sequence[Row], titles: Mapping[str, str]) -> Iterator[str]:
    """Yield how many times as long right answers take on all unknowns as on those of the contacts."""
    condensed = {_answer(row): row for row in all_rows if row.condensed == rows.CONDENSED and solved(row)}
    for case in dict.fromkeys(row.case for row in all_rows):
        whole = [row for row in all_rows if row.case == case and row.condensed == rows.WHOLE and solved(row)]
        factors = {
            row.method: row.seconds / pair.seconds
            for row in whole
            if (pair := condensed.get(_answer(row))) is not None and row.seconds and pair.seconds
        }
        if factors and (whole[0].unknowns or 0) >= BODY:
            mean = float(np.exp(np.mean(np.log(list(factors.values())))))
            yield (
                f"{titles.get(case, case)}: on all {whole[0].unknowns} unknowns the same answers take {mean:.2g} times "
                f"as long (geometric mean of {', '.join(factors)})."
            )


def _answer(row: Row) -> tuple[str, Route, str, float | None]:
    return row.case, Route(row.method, row.variant), row.knob, row.knob_value
