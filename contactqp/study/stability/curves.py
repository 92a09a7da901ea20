"""Curves of digits lost, with what was predicted beside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from contactqp.study.charts.style import method_style
from contactqp.study.report.chart import Chart
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.chart_axes import drawn, horizontal, methods_of, place, short
from contactqp.study.stability.rows import ALL_DIGITS, StabilityRow

# Predictions are drawn in one colour, each with a dash of its own: they belong to no method.
PREDICTED, DASHES = (
    "#767676",
    ("6px,3px", "2px,2px", "8px,2px,2px,2px", "12px,3px", "2px,6px", "12px,2px,2px,2px", "4px"),
)
# Names are long: they stand below, where a narrow screen has room.
LEGEND = dict(orientation="h", yanchor="top", y=-0.2)
HEIGHT = 560  # pixels


def digits_curves(axis: Axis, rows: Sequence[StabilityRow]) -> Chart:
    """Digits lost in λ over the axis, a curve a method, and the predictions of the systems that they solve."""
    shown = drawn(rows)
    traces = [_measured(axis, name, shown) for name in methods_of(shown)]
    systems = dict.fromkeys(row.system for row in shown if row.predicted_digits_lost is not None)
    traces += [_predicted(axis, name, shown, DASHES[i % len(DASHES)]) for i, name in enumerate(systems)]
    vertical = dict(title=dict(text="digits lost in λ [1]"), range=[-0.5, ALL_DIGITS + 0.5])
    headings = ("method", *(axis.label(value) for value in axis.values))
    lines = [_line(axis, name, [r for r in shown if r.name == name]) for name in methods_of(shown)]
    return Chart(
        name=f"stability-{axis.name}-prediction",
        title=f"{axis.title}: digits lost in the forces, and what was predicted",
        caption=(
            "Dashed and grey: log₁₀ of the condition number of what a method solves, the digits that it may lose at "
            "worst. A curve far below its prediction: the matrix is badly scaled rather than ill-conditioned, or the "
            "answer was refined. Beyond it: λ is formed from a difference that cancels, as in the penalty method."
        ),
        figure=dict(data=traces, layout=dict(xaxis=horizontal(axis), yaxis=vertical, legend=LEGEND, height=HEIGHT)),
        headings=headings,
        lines=tuple(lines),
    )


def _measured(axis: Axis, name: str, rows: Sequence[StabilityRow]) -> dict[str, Any]:
    mine = [row for row in rows if row.name == name and row.digits_lost_force is not None]
    return curve(axis, name, mine, [row.digits_lost_force for row in mine])


def curve(axis: Axis, name: str, rows: Sequence[StabilityRow], heights: Sequence[float | None]) -> dict[str, Any]:
    """One method over the axis, in its own style."""
    method, variant = (rows[0].method, rows[0].variant) if rows else (name, "")
    style = method_style(method)
    return dict(
        type="scatter",
        mode="lines+markers",
        name=name,
        x=[place(axis, row.value) for row in rows],
        y=list(heights),
        line=dict(color=style.colour, dash=style.dash),
        marker=dict(color=style.colour, symbol=style.hollow if variant else style.symbol, size=8),
        customdata=[f"{row.verdict}, error in λ {short(row.error_force)}" for row in rows],
        hovertemplate="%{fullData.name}, %{x}: %{y:.3g}<br>%{customdata}<extra></extra>",
        meta=dict(method=method, variant=variant),
    )


def _predicted(axis: Axis, system: str, rows: Sequence[StabilityRow], dash: str) -> dict[str, Any]:
    found = {row.value: row.predicted_digits_lost for row in rows if row.system == system}
    known = [value for value in axis.values if found.get(value) is not None]
    return dict(
        type="scatter",
        mode="lines",
        name=f"predicted: log₁₀ κ({system})",
        x=[place(axis, value) for value in known],
        y=[found[value] for value in known],
        line=dict(color=PREDICTED, dash=dash),
        hovertemplate="%{fullData.name}, %{x}: %{y:.3g}<extra></extra>",
        meta=dict(method=None, variant=None),
    )


def _line(axis: Axis, name: str, rows: Sequence[StabilityRow]) -> tuple[str, ...]:
    found = {row.value: row.digits_lost_force for row in rows}
    return (name, *(short(found.get(value)) for value in axis.values))
