"""Curves of error against run time, one for each method and route, and how charts are laid out and styled."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from zlib import crc32

from contactqp.study import rows
from contactqp.study.rows import Row
from contactqp.study.statistics import Route

# A chart of a page: what Plotly draws, what a newcomer must know to read it, and its numbers as a table.


@dataclass(frozen=True)
class Chart:
    """One chart.

    Parameters
    ----------
    name : str
        Its identifier on the page.
    title : str
    caption : str
        What is drawn, and how to read it.
    figure : mapping
        "data" and "layout" of Plotly; colours of text, grid and background are the page's, not the figure's.
    headings, lines : tuples of str
        The same numbers as a table, for those who read.
    """

    name: str
    title: str
    caption: str
    figure: Mapping[str, Any]
    headings: tuple[str, ...] = ()
    lines: tuple[tuple[str, ...], ...] = ()


# Okabe and Ito (2008), distinct to colour-blind readers. Their yellow is too light on white; for their black stands a
# grey that is seen on white and on black.
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
# How a method looks in every chart: the same colour, symbol and dash wherever it appears.

GREY = "#767676"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, GREY)
# Plotly's names; each has an "-open" twin.
SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "triangle-down", "pentagon", "star", "hexagram")
# "solid", or lengths of line and space.
DASHES = ("solid", "6px,3px", "2px,2px", "8px,2px,2px,2px", "12px,3px", "8px,2px,2px,2px,2px,2px")


@dataclass(frozen=True)
class MethodStyle:
    """Colour, symbol and dash of one method, in Plotly's words."""

    colour: str
    symbol: str
    dash: str

    @property
    def hollow(self) -> str:
        """The symbol without filling."""
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
    """The style of a method, whatever else is shown beside it.

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


# Numbers in charts: rounded as data, so that pages stay small, and written as text.

# Digits that a screen can show.
DIGITS = 4


def rounded(value: float) -> float:
    """To four digits.

    >>> rounded(0.0123456), rounded(1234567.0)
    (0.01235, 1235000.0)
    """
    return float(f"{value:.{DIGITS}g}")


def error_text(value: float | None) -> str:
    """An error in a table.

    >>> error_text(3.14e-9), error_text(0.0), error_text(None)
    ('3.1e-09', '0', '')
    """
    return "" if value is None else "0" if value == 0 else f"{value:.1e}"


def milliseconds(seconds: float | None) -> str:
    """A time in a table [ms].

    >>> milliseconds(0.01234), milliseconds(None)
    ('12.3', '')
    """
    return "" if seconds is None else f"{1e3 * seconds:.3g}"


def percent(part: int, whole: int) -> str:
    """Return a part of a whole in per cent; of nothing, nothing.

    >>> percent(1, 3), percent(0, 0)
    ('33 %', '')
    """
    return f"{100 * part / whole:.0f} %" if whole else ""


def plural(count: int, word: str) -> str:
    """A number of things.

    >>> plural(1, "case"), plural(2, "case")
    ('1 case', '2 cases')
    """
    return f"{count} {word}{'' if count == 1 else 's'}"


# Room around the points of a logarithmic axis: a factor, and at least this part of it, which shows symbols whole.
ROOM, MARGIN = 1.6, 0.03
# Axes, legends and lines that charts share, in Plotly's words; colours of text, grid and background are the page's.

# A logarithmic axis of more than so many is labelled at powers of ten alone.
DECADES = 6
METHOD = dict(text="method", standoff=12)  # title of an axis, clear of the names


def on_cases(cases: Sequence[str]) -> str:
    """The problems that a chart of many cases rests on."""
    return f"On the {plural(len(cases), 'case')} with a known answer that every installed method was put to."


def log_axis(title: str, values: Iterable[float]) -> dict[str, Any]:
    """A logarithmic axis around positive values."""
    known = [value for value in values if value > 0 and math.isfinite(value)] or [1.0]
    lowest, highest = math.log10(min(known)), math.log10(max(known))
    room = max(math.log10(ROOM), MARGIN * (highest - lowest))
    ends = lowest - room, highest + room
    # Powers of ten where there are many, else 2 and 5 between them.
    ticks = dict(dtick=2, exponentformat="power") if ends[1] - ends[0] > DECADES else dict(dtick="D2", tickformat="~g")
    return dict(type="log", title=dict(text=title), range=[rounded(end) for end in ends], **ticks)


def legend(title: str, **changes: Any) -> dict[str, Any]:
    """Beside each other in lines, under the chart."""
    below = dict(orientation="h", x=0, xanchor="left", y=-0.22, yanchor="top", title=dict(text=title, side="top"))
    return below | dict(itemsizing="trace") | changes


def layout(xaxis: Mapping[str, Any], yaxis: Mapping[str, Any], height: int, **others: Any) -> dict[str, Any]:
    """What every chart has: its axes, its height in pixels, margins, hover at the nearest point."""
    around = dict(margin=dict(l=70, r=20, t=40, b=60), hovermode="closest", showlegend=True)
    return dict(xaxis=dict(xaxis), yaxis=dict(yaxis), height=height) | around | others


def vertical_line(x: float, text: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """A shape across the chart at x on a logarithmic axis, and its label."""
    line = dict(color=GREY, width=2, dash="12px,4px,2px,4px")
    shape = dict(type="line", xref="x", yref="paper", x0=x, x1=x, y0=0, y1=1, line=line)
    place = dict(x=rounded(math.log10(x)), y=1, xref="x", yref="paper", xanchor="left", yanchor="top", xshift=4)
    return shape, dict(**place, text=text, showarrow=False, textangle=90)


def method_line(name: str, xs: Sequence[float], ys: Sequence[float], variant: str, **changes: Any) -> dict[str, Any]:
    """A curve in the colour and dash of its method."""
    style = method_style(name)
    drawn = dict(type="scatter", name=name, x=list(xs), y=list(ys), legendgroup=name, line=method_dash(name))
    marker = dict(symbol=style.symbol, color=style.colour, size=8)
    return drawn | dict(marker=marker, meta=meta(name, variant)) | changes


def method_dash(name: str) -> dict[str, Any]:
    """The line of a method where dashes tell methods apart."""
    style = method_style(name)
    return dict(color=style.colour, dash=style.dash, width=2)


def meta(method: str, variant: str) -> dict[str, str]:
    """What a page filters traces by; both empty for what belongs to no method."""
    return dict(method=method, variant=variant)


# Errors below are drawn here: a logarithm has no zero, and doubles have no more digits.
FLOOR = 1e-17
# Written over the points of answers that nobody should use.
MARKS: Mapping[str, str] = {rows.REFUSED: "\u00d7", rows.NOT_CONVERGED: "+", rows.BACKEND_FAILED: "+", rows.WRONG: "‼"}
# What stands for the variants of the rows: a method that does not polish hands its answer over as it is.
FINAL, RAW, UZAWA, ALL_UNKNOWNS = "final", "raw", "Uzawa", ", all unknowns"
VARIANTS: Mapping[str, str] = {"": FINAL, "raw": RAW, "uzawa": UZAWA}
LINES: Mapping[str, str] = {"": "solid", "raw": "5px,3px", "uzawa": "1px,3px"}
# What Plotly adds to the names of symbols.
FILLINGS: Mapping[str, str] = {"raw": "-open", "uzawa": "-open-dot"}
# On all unknowns lines are thinner and symbols smaller [px].
WIDTHS, SIZES = {False: 2.0, True: 1.0}, {False: 9, True: 6}


@dataclass(frozen=True)
class Curve:
    """The rows of one method, one way and one knob that have a time and an error."""

    route: Route
    knob: str
    points: tuple[Row, ...]


def curves(all_rows: Iterable[Row], error: str) -> tuple[Curve, ...]:
    """Curves of a column of errors, in the order of the rows."""
    found: dict[tuple[Route, str], list[Row]] = {}
    for row in all_rows:
        if getattr(row, error) is not None and row.seconds is not None:
            found.setdefault((Route.of(row), row.knob), []).append(row)
    return tuple(Curve(route, knob, tuple(points)) for (route, knob), points in found.items())


def variant_name(route: Route) -> str:
    """ "final", "raw, all unknowns" and so on."""
    return VARIANTS.get(route.variant, route.variant) + (ALL_UNKNOWNS if route.whole else "")


# What all traces of such a figure have, once: Plotly's template of a layout.
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
    """One trace for each curve; each method is in the legend once. `stiffness` is the unit of penalties."""
    first = {curve.route.method: i for i, curve in reversed(list(enumerate(drawn)))}
    return [
        _trace(curve, error, stiffness) | dict(showlegend=first[curve.route.method] == i)
        for i, curve in enumerate(drawn)
    ]


def _trace(curve: Curve, error: str, stiffness: str) -> dict[str, Any]:
    route, style = curve.route, method_style(curve.route.method)
    marks = [MARKS.get(row.verdict, "") for row in curve.points]
    mode = "lines+markers+text" if any(marks) else "lines+markers"
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
    """Knob, error in u, error in λ and verdict in words."""
    errors = error_text(row.error_displacement), error_text(row.error_force)
    return [knob_text(row, stiffness), *errors, row.verdict or "median"]


def knob_text(row: Row, stiffness: str) -> str:
    """A knob and its value with its unit."""
    if row.knob_value is None:
        return f"{row.knob}: its default" if row.knob else "no knob"
    unit = f" {stiffness}" if row.knob in ("penalty", "perturbation") else ""
    return f"{row.knob} = {row.knob_value:g}{unit}"


def line(colour: str, variant: str, whole: bool) -> dict[str, Any]:
    """Solid, dashed before polish, dotted by Uzawa's iteration; thin on all unknowns."""
    return dict(color=colour, dash=LINES.get(variant, "solid"), width=WIDTHS[whole])


def marker(colour: str, symbol: str, variant: str, whole: bool) -> dict[str, Any]:
    """Hollow before polish, with a dot in it by Uzawa's iteration, small on all unknowns."""
    return dict(color=colour, symbol=symbol + FILLINGS.get(variant, ""), size=SIZES[whole])


def key_traces(drawn: Sequence[Curve]) -> list[dict[str, Any]]:
    """What the lines and marks mean, as far as they are there: entries of a second legend."""
    routes = {(curve.route.variant, curve.route.whole) for curve in drawn}
    verdicts = {row.verdict for curve in drawn for row in curve.points}
    shown = [
        route_key(*way) | dict(mode="lines+markers", line=line(GREY, *way), legend="legend2")
        for way in _ROUTES
        if way in routes
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
    """An entry of a legend that says what hollow and small symbols mean."""
    return _key(_ROUTES[variant, whole]) | dict(mode="markers", marker=marker(GREY, "circle", variant, whole))


def _key(words: str) -> dict[str, Any]:
    # Nothing is drawn of it but its entry.
    nowhere = dict(type="scatter", x=[None], y=[None], name=words, hoverinfo="skip", showlegend=True)
    return nowhere | dict(meta=meta("", ""))


TABLE = ("method", "answer", "knob", "run time [ms]")


def cells(row: Row, stiffness: str) -> tuple[str, ...]:
    """Return the cells of a row of `TABLE`."""
    return row.method, variant_name(Route.of(row)), knob_text(row, stiffness), milliseconds(row.seconds)
