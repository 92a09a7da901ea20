"""Curves of error against run time, one for each method and route, and how charts are laid out and styled."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any
from zlib import crc32

from contactqp.errors import counted
from contactqp.study import rows
from contactqp.study.rows import Row, milliseconds
from contactqp.study.settings import STIFFNESSES
from contactqp.study.statistics import Route


@dataclass(frozen=True)
class Chart:
    """One chart of a page: its figure, a caption that explains it, and its numbers as a table.

    Parameters
    ----------
    name : str, its identifier on the page
    title : str
    caption : str, what the chart shows and how to read it
    figure : mapping
        "data" and "layout" of Plotly; colours of text, grid and background are the page's, not the figure's.
    headings, lines : tuples of str, the same numbers as a table
    """

    name: str
    title: str
    caption: str
    figure: Mapping[str, Any]
    headings: tuple[str, ...] = ()
    lines: tuple[tuple[str, ...], ...] = ()


# Okabe and Ito (2008), distinct to colour-blind readers. Their yellow is too light on white; for their black stands a
# grey that is visible on white and on black.
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
GREY = "#767676"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, GREY)
# Plotly's names; each has an "-open" twin.
SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "triangle-down", "pentagon", "star", "hexagram")
# "solid", or lengths of line and space.
DASHES = ("solid", "6px,3px", "2px,2px", "8px,2px,2px,2px", "12px,3px", "8px,2px,2px,2px,2px,2px")


@dataclass(frozen=True)
class MethodStyle:
    """Colour, symbol and dash of one method in every chart, in Plotly's words."""

    colour: str
    symbol: str
    dash: str

    @property
    def hollow(self) -> str:
        """Return the symbol without filling."""
        return f"{self.symbol}-open"


# No two share a symbol, so that print without colour can be read; no two share colour and dash, for lines without
# symbols.
STYLES: Mapping[str, MethodStyle] = {
    "active-set": MethodStyle(VERMILION, "star", DASHES[0]),
    "osqp": MethodStyle(BLUE, "circle", DASHES[0]),
    "clarabel": MethodStyle(GREEN, "square", DASHES[0]),
    "piqp": MethodStyle(PURPLE, "diamond", DASHES[0]),
    "proxqp": MethodStyle(ORANGE, "triangle-up", DASHES[0]),
    "daqp": MethodStyle(SKY, "triangle-down", DASHES[0]),
    "highs": MethodStyle(GREY, "pentagon", DASHES[0]),
    "scs": MethodStyle(BLUE, "cross", DASHES[1]),
    "qpalm": MethodStyle(GREEN, "x", DASHES[1]),
    "pyqpmad": MethodStyle(PURPLE, "triangle-left", DASHES[1]),
    "sip": MethodStyle(ORANGE, "triangle-right", DASHES[1]),
    "qtqp": MethodStyle(SKY, "hexagram", DASHES[1]),
    "gurobi": MethodStyle(GREY, "hexagon", DASHES[1]),
    "cvxpy": MethodStyle(VERMILION, "diamond-tall", DASHES[1]),
    "lemke": MethodStyle(BLUE, "hourglass", DASHES[2]),
    "projected-gauss-seidel": MethodStyle(GREEN, "bowtie", DASHES[2]),
    "master-slave": MethodStyle(PURPLE, "star-square", DASHES[2]),
    "lagrange-multiplier": MethodStyle(ORANGE, "star-diamond", DASHES[2]),
    "penalty": MethodStyle(SKY, "diamond-wide", DASHES[2]),
    "perturbed-lagrangian": MethodStyle(GREY, "star-triangle-up", DASHES[2]),
    "augmented-lagrangian": MethodStyle(VERMILION, "star-triangle-down", DASHES[2]),
}


def method_style(name: str) -> MethodStyle:
    """Return the style of a method, which does not depend on the other methods of a chart.

    Names that are not in `STYLES` get one that depends on nothing but the name; two such may coincide.

    Examples
    --------
    >>> method_style("osqp")
    MethodStyle(colour='#0072B2', symbol='circle', dash='solid')
    """
    if name in STYLES:
        return STYLES[name]
    number = crc32(name.encode())
    symbol, rest = number % len(SYMBOLS), number // len(SYMBOLS)
    return MethodStyle(COLOURS[rest % len(COLOURS)], SYMBOLS[symbol], DASHES[rest // len(COLOURS) % len(DASHES)])


# Digits of the numbers in charts, which are rounded so that pages stay small.
DIGITS = 4


def rounded(value: float) -> float:
    """Return a value rounded to four digits.

    >>> rounded(0.0123456), rounded(1234567.0)
    (0.01235, 1235000.0)
    """
    return float(f"{value:.{DIGITS}g}")


def error_text(value: float | None) -> str:
    """Return an error as text in a table.

    >>> error_text(3.14e-9), error_text(0.0), error_text(None)
    ('3.1e-09', '0', '')
    """
    return "" if value is None else "0" if value == 0 else f"{value:.1e}"


def percent(part: int, whole: int) -> str:
    """Return a part of a whole in per cent as text; empty where the whole is zero.

    >>> percent(1, 3), percent(0, 0)
    ('33 %', '')
    """
    return f"{100 * part / whole:.0f} %" if whole else ""


# Room around the points of a logarithmic axis: a factor, and at least this part of the axis, so that symbols are whole.
ROOM, MARGIN = 1.6, 0.03
# Largest number of decades of a logarithmic axis that has labels between powers of ten.
DECADES = 6
METHOD = dict(text="method", standoff=12)  # title of an axis, clear of the names


def on_cases(cases: Sequence[str]) -> str:
    """Return the sentence that says on which cases a chart rests."""
    return f"On the {counted('case', len(cases))} with a known answer that every installed method was put to."


def log_axis(title: str, values: Iterable[float]) -> dict[str, Any]:
    """Return a logarithmic axis around positive values."""
    shown = [value for value in values if value > 0 and math.isfinite(value)] or [1.0]
    lowest, highest = math.log10(min(shown)), math.log10(max(shown))
    room = max(math.log10(ROOM), MARGIN * (highest - lowest))
    ends = lowest - room, highest + room
    # Powers of ten where there are many, else 2 and 5 between them.
    ticks = dict(dtick=2, exponentformat="power") if ends[1] - ends[0] > DECADES else dict(dtick="D2", tickformat="~g")
    return dict(type="log", title=dict(text=title), range=[rounded(end) for end in ends], **ticks)


def legend(title: str, **changes: Any) -> dict[str, Any]:
    """Return a legend whose entries stand beside each other under the chart."""
    below = dict(orientation="h", x=0, xanchor="left", y=-0.22, yanchor="top", title=dict(text=title, side="top"))
    return below | dict(itemsizing="trace") | changes


def layout(xaxis: Mapping[str, Any], yaxis: Mapping[str, Any], height: int, **others: Any) -> dict[str, Any]:
    """Return a layout with axes, height [px], margins, and hover at the nearest point."""
    around = dict(margin=dict(l=70, r=20, t=40, b=60), hovermode="closest", showlegend=True)
    return dict(xaxis=dict(xaxis), yaxis=dict(yaxis), height=height) | around | others


def vertical_line(x: float, text: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a vertical line at x on a logarithmic axis, and its label."""
    line = dict(color=GREY, width=2, dash="12px,4px,2px,4px")
    shape = dict(type="line", xref="x", yref="paper", x0=x, x1=x, y0=0, y1=1, line=line)
    place = dict(x=rounded(math.log10(x)), y=1, xref="x", yref="paper", xanchor="left", yanchor="top", xshift=4)
    return shape, dict(**place, text=text, showarrow=False, textangle=90)


def method_line(name: str, xs: Sequence[float], ys: Sequence[float], variant: str, **changes: Any) -> dict[str, Any]:
    """Return a curve in the colour and dash of its method.

    Parameters
    ----------
    name : name of the method
    xs, ys : sequences of float, the points of the curve
    variant : the variant, by which the page can hide the curve
    **changes
        Other properties of the trace.
    """
    style = method_style(name)
    drawn = dict(type="scatter", name=name, x=list(xs), y=list(ys), legendgroup=name, line=method_dash(name))
    marker = dict(symbol=style.symbol, color=style.colour, size=8)
    return drawn | dict(marker=marker, meta=meta(name, variant)) | changes


def method_dash(name: str) -> dict[str, Any]:
    """Return the line of a method in charts that distinguish methods by dashes."""
    style = method_style(name)
    return dict(color=style.colour, dash=style.dash, width=2)


def meta(method: str, variant: str) -> dict[str, str]:
    """Return the values by which a page filters traces; both are empty where a trace belongs to no method."""
    return dict(method=method, variant=variant)


# Smaller errors are drawn here: a logarithmic axis has no zero, and doubles have no more digits.
FLOOR = 1e-17
# Written over the points of answers that are not to be used.
MARKS: Mapping[str, str] = {rows.REFUSED: "\u00d7", rows.NOT_CONVERGED: "+", rows.BACKEND_FAILED: "+", rows.WRONG: "‼"}
# Names of the variants of rows; the answer of a method that does not polish is final.
FINAL, RAW, UZAWA, ALL_UNKNOWNS = "final", "raw", "Uzawa", ", all unknowns"
VARIANTS: Mapping[str, str] = {"": FINAL, "raw": RAW, "uzawa": UZAWA}
LINES: Mapping[str, str] = {"": "solid", "raw": "5px,3px", "uzawa": "1px,3px"}
# Suffixes of Plotly to the names of symbols.
FILLINGS: Mapping[str, str] = {"raw": "-open", "uzawa": "-open-dot"}
# On all unknowns lines are thinner and symbols smaller [px].
WIDTHS, SIZES = {False: 2.0, True: 1.0}, {False: 9, True: 6}


@dataclass(frozen=True)
class Curve:
    """The rows of one route and one knob that have a time and an error."""

    route: Route
    knob: str
    points: tuple[Row, ...]


def curves(all_rows: Iterable[Row], error: str) -> tuple[Curve, ...]:
    """Return the curves of a column of errors, in the order of the rows."""
    found: dict[tuple[Route, str], list[Row]] = {}
    for row in all_rows:
        if getattr(row, error) is not None and row.seconds is not None:
            found.setdefault((Route.of(row), row.knob), []).append(row)
    return tuple(Curve(route, knob, tuple(points)) for (route, knob), points in found.items())


def variant_name(route: Route) -> str:
    """Return the name of a variant: "final", "raw, all unknowns" and so on."""
    return VARIANTS.get(route.variant, route.variant) + (ALL_UNKNOWNS if route.whole else "")


# Properties of all traces of a figure of errors against time, as a template of Plotly.
TEMPLATE: Mapping[str, Any] = dict(
    data=dict(
        scatter=[
            dict(
                hovertemplate="<b>%{fullData.meta.method}</b>, %{fullData.meta.variant}<br>%{customdata[0]}<br>"
                "error in u %{customdata[1]}, in λ %{customdata[2]}<br>%{x} ms; %{customdata[3]}<extra></extra>",
                textposition="middle center",
                textfont=dict(size=14),
            )
        ]
    )
)


def traces(drawn: Sequence[Curve], error: str, stiffness: str) -> list[dict[str, Any]]:
    """Return one trace for each curve, each method once in the legend; `stiffness` is the unit of penalties."""
    first = {curve.route.method: i for i, curve in reversed(list(enumerate(drawn)))}
    points = [
        _trace(curve, error, stiffness) | dict(showlegend=first[curve.route.method] == i)
        for i, curve in enumerate(drawn)
    ]
    return [*points, *(_envelope(trace) for trace in points if "lines" not in trace["mode"])]


def _in_order(curve: Curve, error: str) -> bool:
    """Return whether a step of the knob that takes longer is always more exact: a line through the points then is."""
    steps = list(pairwise((row.seconds or 0.0, getattr(row, error)) for row in curve.points))
    return all((b[0] - a[0]) * (b[1] - a[1]) <= 0 for a, b in steps) and len({b[0] > a[0] for a, b in steps}) < 2


def _envelope(trace: Mapping[str, Any]) -> dict[str, Any]:
    """Return the line through the points of a trace that no faster one is as exact as."""
    kept: list[tuple[float, float]] = []
    for x, y in sorted(zip(trace["x"], trace["y"], strict=True)):
        if not kept or y < kept[-1][1]:
            kept.append((x, y))
    names = "type", "name", "legendgroup", "line", "meta"
    same = {name: trace[name] for name in names}
    return same | dict(mode="lines", x=[x for x, _ in kept], y=[y for _, y in kept], hoverinfo="skip", showlegend=False)


def _trace(curve: Curve, error: str, stiffness: str) -> dict[str, Any]:
    route, style = curve.route, method_style(curve.route.method)
    marks = [MARKS.get(row.verdict, "") for row in curve.points]
    mode = "lines+markers" if _in_order(curve, error) else "markers"
    mode += "+text" if any(marks) else ""
    drawn: dict[str, Any] = dict(
        type="scatter",
        mode=mode,
        name=route.method,
        legendgroup=route.method,
        x=[rounded(1e3 * (row.seconds or 0.0)) for row in curve.points],
        y=[rounded(max(getattr(row, error), FLOOR)) for row in curve.points],
        customdata=[hover(row, stiffness) for row in curve.points],
        line=line(style.colour, route.variant, route.whole),
        marker=marker(style.colour, style.symbol, route.variant, route.whole),
        meta=meta(route.method, variant_name(route)),
    )
    return drawn | (dict(text=marks) if any(marks) else {})


def hover(row: Row, stiffness: str) -> list[str]:
    """Return the hint of a point: knob, error in u, error in λ and verdict."""
    errors = error_text(row.error_displacement), error_text(row.error_force)
    return [knob_text(row, stiffness), *errors, row.verdict or "median"]


def knob_text(row: Row, stiffness: str) -> str:
    """Return a knob with its value and unit as text."""
    if row.knob_value is None and row.knob_stiffnesses is not None:
        return f"{row.knob} = {row.knob_stiffnesses:g} contact stiffnesses"
    if row.knob_value is None:
        return f"{row.knob}: its default" if row.knob else "no knob"
    unit = f" {stiffness}" if row.knob in STIFFNESSES else ""
    return f"{row.knob} = {row.knob_value:g}{unit}"


def line(colour: str, variant: str, whole: bool) -> dict[str, Any]:
    """Return a line: solid, dashed before polish, dotted by Uzawa's iteration; thin on all unknowns."""
    return dict(color=colour, dash=LINES.get(variant, "solid"), width=WIDTHS[whole])


def marker(colour: str, symbol: str, variant: str, whole: bool) -> dict[str, Any]:
    """Return a marker: hollow before polish, with a dot in it by Uzawa's iteration, small on all unknowns.

    Parameters
    ----------
    colour : str
    symbol : Plotly's name
    variant : "raw", "uzawa" or empty
    whole : whether the method worked on all unknowns, without condensation
    """
    return dict(color=colour, symbol=symbol + FILLINGS.get(variant, ""), size=SIZES[whole])


def key_traces(drawn: Sequence[Curve]) -> list[dict[str, Any]]:
    """Return the entries of a second legend, which explains the lines and marks that occur."""
    routes = {(curve.route.variant, curve.route.whole) for curve in drawn}
    verdicts = {row.verdict for curve in drawn for row in curve.points}
    shown = [
        route_key(*route) | dict(mode="lines+markers", line=line(GREY, *route), legend="legend2")
        for route in _ROUTES
        if route in routes
    ]
    marks = [
        _key(f"{MARKS[verdict]} {words}") | dict(mode="none", legend="legend2")
        for verdict, words in _MARK_MEANINGS.items()
        if verdict in verdicts
    ]
    return shown + marks


_ROUTES: Mapping[tuple[str, bool], str] = {
    ("", False): "final answer, polished where the method is",
    ("raw", False): "the method's raw answer",
    ("uzawa", False): "Uzawa's iteration",
    ("", True): "final answer, on all unknowns",
    ("raw", True): "raw answer, on all unknowns",
    ("uzawa", True): "Uzawa's iteration, on all unknowns",
}
_MARK_MEANINGS: Mapping[str, str] = {
    rows.REFUSED: "refused: the certificate does not pass",
    rows.NOT_CONVERGED: "gave up: its last iterate",
    rows.WRONG: "wrong, and the certificate passes",
}


def route_key(variant: str, whole: bool) -> dict[str, Any]:
    """Return an entry of a legend that explains hollow and small symbols."""
    return _key(_ROUTES[variant, whole]) | dict(mode="markers", marker=marker(GREY, "circle", variant, whole))


def _key(words: str) -> dict[str, Any]:
    # A trace without points, of which only the entry is shown.
    nowhere = dict(type="scatter", x=[None], y=[None], name=words, hoverinfo="skip", showlegend=True)
    return nowhere | dict(meta=meta("", ""))


TABLE = ("method", "answer", "knob", "run time [ms]")


def cells(row: Row, stiffness: str) -> tuple[str, ...]:
    """Return the cells of a row of `TABLE`."""
    return row.method, variant_name(Route.of(row)), knob_text(row, stiffness), milliseconds(row.seconds)
