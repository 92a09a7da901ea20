"""The curves of error against run time: one for each method and way, traced by the knob."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from contactqp.study import rows
from contactqp.study.charts.layout import meta
from contactqp.study.charts.numbers import error_text, milliseconds, rounded
from contactqp.study.charts.style import GREY, method_style
from contactqp.study.rows import Row
from contactqp.study.statistics.routes import Route

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


def keys(drawn: Sequence[Curve]) -> list[dict[str, Any]]:
    """What the lines and marks mean, as far as they are there: entries of a second legend."""
    routes = {(curve.route.variant, curve.route.whole) for curve in drawn}
    verdicts = {row.verdict for curve in drawn for row in curve.points}
    shown = [
        way_key(*way) | dict(mode="lines+markers", line=line(GREY, *way), legend="legend2")
        for way in _WAYS
        if way in routes
    ]
    marks = [
        _key(f"{MARKS[verdict]} {words}") | dict(mode="none", legend="legend2")
        for verdict, words in _MARKED.items()
        if verdict in verdicts
    ]
    return shown + marks


_WAYS: Mapping[tuple[str, bool], str] = {
    ("", False): "final answer, polished where the method is",
    ("raw", False): "the method's raw answer",
    ("uzawa", False): "Uzawa's iteration",
    ("", True): "final answer, on all unknowns",
    ("raw", True): "raw answer, on all unknowns",
    ("uzawa", True): "Uzawa's iteration, on all unknowns",
}
_MARKED: Mapping[str, str] = {
    rows.REFUSED: "refused: the certificate does not pass",
    rows.NOT_CONVERGED: "gave up: its last iterate",
    rows.WRONG: "wrong, and the certificate passes",
}


def way_key(variant: str, whole: bool) -> dict[str, Any]:
    """An entry of a legend that says what hollow and small symbols mean."""
    return _key(_WAYS[variant, whole]) | dict(mode="markers", marker=marker(GREY, "circle", variant, whole))


def _key(words: str) -> dict[str, Any]:
    # Nothing is drawn of it but its entry.
    nowhere = dict(type="scatter", x=[None], y=[None], name=words, hoverinfo="skip", showlegend=True)
    return nowhere | dict(meta=meta("", ""))


TABLE = ("method", "answer", "knob", "run time [ms]")


def cells(row: Row, stiffness: str) -> tuple[str, ...]:
    """Of `TABLE`."""
    return row.method, variant_name(Route.of(row)), knob_text(row, stiffness), milliseconds(row.seconds)
