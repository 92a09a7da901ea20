"""Curves: digits lost with their prediction beside them, and the penalty method's error over β."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from contactqp.study.charts.style import method_style
from contactqp.study.report.chart import Chart
from contactqp.study.stability.axes import penalty_stiffness
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.best_penalty import of_truss
from contactqp.study.stability.chart_axes import drawn, horizontal, methods_of, place, short
from contactqp.study.stability.condition import UNIT_ROUNDOFF
from contactqp.study.stability.rows import ALL_DIGITS, StabilityRow, digits_lost

# Predictions are drawn in one colour, each with a dash of its own: they belong to no method.
PREDICTED, DASHES = (
    "#767676",
    ("6px,3px", "2px,2px", "8px,2px,2px,2px", "12px,3px", "2px,6px", "12px,2px,2px,2px", "4px"),
)
# β of the last row of Table 2.1.
TABLE_END = 1e20


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
        figure=dict(data=traces, layout=dict(xaxis=horizontal(axis), yaxis=vertical)),
        headings=headings,
        lines=tuple(lines),
    )


def _measured(axis: Axis, name: str, rows: Sequence[StabilityRow]) -> dict[str, Any]:
    mine = [row for row in rows if row.name == name and row.digits_lost_force is not None]
    return _curve(axis, name, mine, [row.digits_lost_force for row in mine])


def _curve(axis: Axis, name: str, rows: Sequence[StabilityRow], heights: Sequence[float | None]) -> dict[str, Any]:
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


def penalty_curve(rows: Sequence[StabilityRow]) -> Chart:
    """The error in λ over β: its valley, the best β as predicted, and 21.684 kN."""
    axis, shown, best = penalty_stiffness.AXIS, drawn(rows), of_truss()
    traces = []
    for name in methods_of(shown):
        mine = [row for row in shown if row.name == name and row.error_force is not None]
        traces.append(_curve(axis, name, mine, [max(row.error_force or 0.0, UNIT_ROUNDOFF) for row in mine]))
    betas = list(axis.values)
    traces.append(
        dict(
            type="scatter",
            mode="lines",
            name="predicted: S/(S+β) + β ulp(g)/λ",
            x=betas,
            y=[best.error_at(beta) for beta in betas],
            line=dict(color=PREDICTED, dash=DASHES[0]),
            meta=dict(method=None, variant=None),
        )
    )
    traces.append(
        dict(
            type="scatter",
            mode="markers",
            name=f"predicted best β = √(Sλ/ulp(g)) = {best.penalty:.2g} kN/m, error {best.error:.1e}",
            x=[best.penalty],
            y=[best.error],
            marker=dict(color=PREDICTED, symbol="star", size=14),
            meta=dict(method=None, variant=None),
        )
    )
    quantum = float(best.quantum(TABLE_END))
    note = dict(
        x=20.0,  # the logarithm of TABLE_END: annotations on logarithmic axes want that
        y=-0.5,
        text=f"β = 1e20: λ is one ulp of the gap times β, {quantum:.3f} kN",
        showarrow=True,
        ay=40,
    )
    return Chart(
        name="stability-penalty-valley",
        title="The best penalty, and where 21.684 comes from",
        caption=(
            "Relative error of the contact force of Example 2.10 (exact: "
            f"{best.force:.6f} kN) over β and κ. Too soft, the contact gives way: S/β. Too stiff, "
            "λ = β (E u - g) is a multiple of β times the last place of the gap: β ulp(g)/λ. At β = 1e20 one unit "
            f"of it is {quantum:.3f} kN, the force that Table 2.1 prints. Errors below 2⁻⁵³ are drawn there."
        ),
        figure=dict(
            data=traces,
            layout=dict(
                xaxis=horizontal(axis),
                yaxis=dict(title=dict(text="relative error in λ [1]"), type="log", exponentformat="power"),
                annotations=[note],
            ),
        ),
        headings=("method", "β, κ [kN/m]", "λ [kN]", "error in λ", "predicted", "digits lost", "log₁₀ κ", "verdict"),
        lines=tuple(_penalty_line(row) for row in shown),
    )


def _penalty_line(row: StabilityRow) -> tuple[str, ...]:
    force = "" if row.largest_force is None else f"{row.largest_force:.9g}"
    lost = short(digits_lost(row.error_force))
    predicted = (short(row.predicted_error_force), lost, short(row.predicted_digits_lost))
    return (row.name, f"{row.value:g}", force, short(row.error_force), *predicted, row.verdict)
