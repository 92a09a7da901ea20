"""The brief report: its selection of cases, its first charts, and notes on what was left out.

The cases are examples small enough to be checked by hand, and Hertz's contact at three sizes. The charts show the error
of the contact forces against run time, on the most informative case and over the small ones.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from contactqp.errors import SceneError
from contactqp.scene.shipped import shipped_folder
from contactqp.study import rows
from contactqp.study.curves import FLOOR, MARKS, Chart, curves, legend, method_style, rounded, variant_name
from contactqp.study.report_charts import QUANTITIES, case_chart, median_chart
from contactqp.study.report_data import CaseRecord, ReportData
from contactqp.study.rows import UNIT_ROUNDOFF, Row
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

    Raises SceneError: the package has come without its cases, or the folder cannot be written.
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


# A chart beside a table: its height and margins [px], so that both end on a screen of 800.
COMPACT_HEIGHT, COMPACT_MARGIN = 425, dict(l=64, r=12, t=4, b=46)
COMPACT_CAPTION = (
    "Filled: the answer as solve returns it; hollow: the method's raw answer; with a dot: Uzawa's iteration. "
    f"{MARKS[rows.REFUSED]} was refused by the certificate, {MARKS[rows.NOT_CONVERGED]} gave up."
)
FANNED = "In the grey band heights say nothing: points there stand apart, so that each is seen."
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
    arranged = {name: value for name, value in chart.figure["layout"].items() if name != "legend2"}
    found = curves(mine, "error_force")
    limit = [note for note in arranged["annotations"] if note.get("yref") == "paper"]
    lines = [note["x"] for note in limit if note["xref"] == "x"]
    spots = [
        Spot(curve.route.method, variant_name(curve.route), *_place(row)) for curve in found for row in curve.points
    ]
    times, errors = [*lines, *(spot.x for spot in spots)], [spot.y for spot in spots]
    across = _close_around(times)
    band = any(shape["type"] == "rect" for shape in arranged["shapes"])
    exact = [spot for spot in spots if band and spot.y <= math.log10(UNIT_ROUNDOFF)]
    rows_of, named = _fanned(exact, across)
    up = _above(max(rows_of.values(), default=-1) + 1, _close_around([math.log10(FLOOR), *errors]))
    moved = {spot: up.band(row) for spot, row in rows_of.items()}
    drawn = [_moved(trace, moved) for trace in chart.figure["data"] if trace["meta"]["method"]]
    arranged |= dict(
        xaxis=dict(arranged["xaxis"], range=across),
        yaxis=dict(arranged["yaxis"], range=[up.low, up.high], **(up.ticks() if exact else {})),
        shapes=[shape | dict(y0=10**up.low) if shape["type"] == "rect" else shape for shape in arranged["shapes"]],
    )
    spots = [replace(spot, y=moved.get(spot, spot.y)) for spot in spots]
    names = _labels(spots, arranged, lines, {replace(spot, y=moved[spot]): side for spot, side in named.items()})
    crowded = len({note["text"] for note in names}) < len({spot.method for spot in spots})
    arranged |= dict(annotations=[*limit, *names], height=COMPACT_HEIGHT, margin=COMPACT_MARGIN)
    arranged |= dict(legend=legend("", y=-0.14), showlegend=crowded)
    figure = dict(data=drawn, layout=arranged)
    fanned = f" {FANNED}" if exact else ""
    return replace(chart, name="telling", caption=f"{COMPACT_CAPTION}{fanned} {chart.caption}", figure=figure)


@dataclass(frozen=True)
class Spot:
    """A point of a chart: its method and variant, and where it is on logarithmic axes."""

    method: str
    variant: str
    x: float
    y: float


def _place(row: Row) -> tuple[float, float]:
    """Return where the point of a row is drawn, on logarithmic axes."""
    return (
        math.log10(rounded(1e3 * (row.seconds or 0.0)) or FLOOR),
        math.log10(rounded(max(row.error_force or 0.0, FLOOR))),
    )


def _close_around(values: Sequence[float]) -> list[float]:
    """Return the range of a logarithmic axis that ends close to its values, without empty decades."""
    low, high = min(values), max(values)
    room = max(0.04 * (high - low), 0.04)
    return [rounded(low - room), rounded(high + room)]


def _fanned(exact: Sequence[Spot], across: Sequence[float]) -> tuple[dict[Spot, int], dict[Spot, float]]:
    """Return the row of the grey band of each point, counted from the top, and the distance of its name's middle [px].

    Points of exact answers have no height of their own: each stands in the first row where it and its name have room.
    The first point of a method there has its name beside it, right of it or left [px]; what finds no row has none.
    """
    scale, most = AREA[0] / (across[1] - across[0]), max(int(MOST * AREA[1] / ROW), 1)
    ends: list[list[tuple[float, float]]] = []
    rows_of: dict[Spot, int] = {}
    named: dict[Spot, float] = {}
    methods: set[str] = set()
    for spot in sorted(exact, key=lambda spot: spot.x):
        x, width = scale * (spot.x - across[0]), 0.0
        left, right = x - MARK, x + MARK
        if spot.method not in methods:
            methods.add(spot.method)
            width = LETTER[0] * len(spot.method)
            beside = MARK + 3 + width / 2
            named[spot] = beside if right + 3 + width <= AREA[0] else -beside
            left, right = min(left, x + named[spot] - width / 2), max(right, x + named[spot] + width / 2)
        row = next((i for i, taken in enumerate(ends) if all(right < a or b < left for a, b in taken)), len(ends))
        if row == most:
            row = len(rows_of) % most
            named.pop(spot, None)
        if row == len(ends):
            ends.append([])
        ends[row].append((left, right))
        rows_of[spot] = row
    return rows_of, named


@dataclass(frozen=True)
class _Above:
    """A logarithmic axis of errors, with a band of rows below what is rounding."""

    low: float
    high: float
    each: float  # height of a row

    def band(self, row: int) -> float:
        """Return the height of the middle of a row of the band, counted from the top."""
        return rounded(math.log10(UNIT_ROUNDOFF) - (row + 0.5) * self.each)

    def ticks(self) -> dict[str, Any]:
        """Return ticks at every other power of ten above the band, and a word in its middle."""
        powers = [power for power in range(-16, 40, 2) if power < self.high]
        middle = (self.low + math.log10(UNIT_ROUNDOFF)) / 2
        words = [f"10<sup>{power}</sup>".replace("-", "\u2212") for power in powers]
        return dict(
            tickmode="array", tickvals=[*(10.0**power for power in powers), 10**middle], ticktext=[*words, "exact"]
        )


def _above(rows_below: int, around: Sequence[float]) -> _Above:
    """Return the axis around values whose band has so many rows; without any it ends where the values do."""
    if not rows_below:
        return _Above(around[0], around[1], 0.0)
    border = math.log10(UNIT_ROUNDOFF)
    high = max(around[1], border + 2)
    part = min((rows_below * ROW + 2) / AREA[1], MOST)
    total = (high - border) / (1 - part)
    return _Above(rounded(high - total), high, part * total / rows_below)


def _moved(trace: Mapping[str, Any], moved: Mapping[Spot, float]) -> dict[str, Any]:
    """Return a trace whose points in the band stand in their rows."""
    name, variant = trace["meta"]["method"], trace["meta"]["variant"]
    spots = [
        Spot(name, variant, math.log10(x or FLOOR), math.log10(y)) for x, y in zip(trace["x"], trace["y"], strict=True)
    ]
    heights = [rounded(10 ** moved[spot]) if spot in moved else 10**spot.y for spot in spots]
    return dict(trace) | dict(
        y=[y if spot not in moved else new for spot, y, new in zip(spots, trace["y"], heights, strict=True)]
    )


# The area that a chart beside a table has between its axes, a letter, and half a mark, with air around them [px].
AREA, LETTER, MARK = (530.0, 375.0), (6.3, 13.0), 6.5
# The label of a vertical line runs down beside it, from the top [px].
LINE_LABEL = (18.0, 190.0)
# The height of a row of exact answers [px], and the largest part of the area that rows take together.
ROW, MOST = 14.0, 0.45
# How far above or below its mark the middle of a name may stand that has a line to it [px].
LINE_OFFSETS = (24.0, 38.0, 54.0, 72.0, 92.0, 116.0)
# Methods whose names are placed first, as readers look for them.
NAMED_FIRST = ("active-set", "penalty", "perturbed-lagrangian", "augmented-lagrangian")

# The name by which the page finds labels, to hide them in narrow charts.
LABEL = "method"

Box = tuple[float, float, float, float]  # left, bottom, right, top [px]


def _labels(
    spots: Sequence[Spot], arranged: Mapping[str, Any], lines: Sequence[float], beside: Mapping[Spot, float]
) -> list[dict[str, Any]]:
    """Return the names of methods, in the band of exact answers and at a curve, where they lie over nothing else.

    Parameters
    ----------
    spots : sequence of Spot
    arranged : mapping, the layout, whose axes have ranges
    lines : sequence of float, where vertical lines with a label are
    beside : mapping, how far from such points of exact answers the middle of the method's name is [px]
    """
    (left, right), (low, high) = (arranged[axis]["range"] for axis in ("xaxis", "yaxis"))
    scale = AREA[0] / (right - left), AREA[1] / (high - low)
    places = [(spot.method, scale[0] * (spot.x - left), scale[1] * (spot.y - low)) for spot in spots]
    taken: list[Box] = [(x - MARK, y - MARK, x + MARK, y + MARK) for _, x, y in places]
    for line in lines:
        x = scale[0] * (line - left)
        taken.append((x - 2, AREA[1] - LINE_LABEL[1], x + LINE_LABEL[0], AREA[1]))
    notes = [_note(spot.method, spot.x, spot.y, away, 0.0) for spot, away in beside.items()]
    for spot, away in beside.items():
        x, y = scale[0] * (spot.x - left) + away, scale[1] * (spot.y - low)
        taken.append(_box(spot.method, x, y))
    free = scale[1] * (math.log10(UNIT_ROUNDOFF) - low) if beside else 0.0
    places = [place for place in places if place[2] >= free]
    first = {name: i for i, name in enumerate(NAMED_FIRST)}
    for name in sorted(dict.fromkeys(name for name, *_ in places), key=lambda name: first.get(name, len(first))):
        width = LETTER[0] * len(name)
        mine = [(x, y, dx, dy) for other, x, y in places if other == name for dx, dy in _offsets(width)]
        mine.sort(key=lambda place: math.hypot(max(abs(place[2]) - width / 2, 0.0), place[3]))
        for x, y, dx, dy in mine:
            box = _box(name, x + dx, y + dy)
            if _inside(box) and box[1] >= free and not any(_overlap(box, other) for other in taken):
                taken.append(box)
                notes.append(_note(name, left + x / scale[0], low + y / scale[1], dx, dy))
                break
    return notes


def _box(name: str, x: float, y: float) -> Box:
    """Return the box of a name around its middle."""
    half = LETTER[0] * len(name) / 2, LETTER[1] / 2
    return x - half[0], y - half[1], x + half[0], y + half[1]


def _offsets(width: float) -> Iterator[tuple[float, float]]:
    """Yield where the middle of a name of some width may stand from its mark [px]."""
    beside = MARK + 3 + width / 2
    yield from ((beside, 0.0), (-beside, 0.0), (0.0, 14.0), (0.0, -14.0))
    for away in LINE_OFFSETS:
        for share in (0.0, -0.5, 0.5, -1.0, 1.0):
            for side in (away, -away):
                yield share * (beside + away / 2), side


def _inside(box: Box) -> bool:
    return box[0] >= 0 and box[1] >= 0 and box[2] <= AREA[0] and box[3] <= AREA[1]


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _note(name: str, x: float, y: float, dx: float, dy: float) -> dict[str, Any]:
    """Return a name at a point of logarithmic axes, its middle so many pixels away; from afar with a line."""
    colour = method_style(name).colour
    far = abs(dy) > LINE_OFFSETS[0] - 1
    return dict(
        name=LABEL,
        x=rounded(x),
        y=rounded(y),
        text=name,
        font=dict(size=11, color=colour),
        showarrow=far,
        **(
            dict(ax=round(dx), ay=round(-dy), arrowhead=0, arrowwidth=1, arrowcolor=colour, standoff=5, borderpad=0)
            if far
            else dict(xshift=round(dx), yshift=round(dy))
        ),
    )


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
