"""Axes, legends and lines that charts share, in Plotly's words; colours of text, grid and background are the page's."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from contactqp.study.charts.numbers import plural, rounded
from contactqp.study.charts.style import GREY, method_style

# Room around the points of a logarithmic axis: a factor, and at least this part of it, which shows symbols whole.
ROOM, MARGIN = 1.6, 0.03
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
