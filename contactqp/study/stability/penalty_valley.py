"""The penalty method's error over β: its valley, the best β as predicted, and 21.684 kN."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from contactqp.study.report.chart import Chart
from contactqp.study.stability.axes import penalty_stiffness
from contactqp.study.stability.best_penalty import BestPenalty, of_truss
from contactqp.study.stability.chart_axes import drawn, horizontal, methods_of, short
from contactqp.study.stability.condition import UNIT_ROUNDOFF
from contactqp.study.stability.curves import DASHES, HEIGHT, LEGEND, PREDICTED, curve
from contactqp.study.stability.rows import StabilityRow, digits_lost

# β of the last row of Table 2.1.
TABLE_END = 1e20


def penalty_valley(rows: Sequence[StabilityRow]) -> Chart:
    """The error in λ over β and κ, of the methods that have them."""
    shown, best = drawn(rows), of_truss()
    return Chart(
        name="stability-penalty-valley",
        title="The best penalty, and where 21.684 comes from",
        caption=_caption(best),
        figure=dict(data=[*_predicted(best), *_measured(shown)], layout=_layout(best)),
        headings=("method", "β, κ [kN/m]", "λ [kN]", "error in λ", "predicted", "digits lost", "log₁₀ κ", "verdict"),
        lines=tuple(_line(row) for row in shown),
    )


def _caption(best: BestPenalty) -> str:
    return (
        f"Relative error of the contact force of Example 2.10 (exact: {best.force:.6f} kN) over β and κ. Too soft, the "
        "contact gives way: S/β. Too stiff, λ = β (E u - g) is a multiple of β times the last place of the gap: "
        f"β ulp(g)/λ. At β = 1e20 one unit of it is {float(best.quantum(TABLE_END)):.3f} kN, the force that Table 2.1 "
        "prints. Errors below 2⁻⁵³ are drawn there."
    )


def _measured(rows: Sequence[StabilityRow]) -> list[dict[str, Any]]:
    """What is drawn last lies on top: the penalty method itself."""
    traces = []
    for name in reversed(methods_of(rows)):
        mine = [row for row in rows if row.name == name and row.error_force is not None]
        errors = [max(row.error_force or 0.0, UNIT_ROUNDOFF) for row in mine]
        traces.append(curve(penalty_stiffness.AXIS, name, mine, errors))
    return traces


def _predicted(best: BestPenalty) -> list[dict[str, Any]]:
    betas, nobody = list(penalty_stiffness.VALUES), dict(method=None, variant=None)
    line = dict(
        type="scatter",
        mode="lines",
        name="predicted: S/(S+β) + β ulp(g)/λ",
        x=betas,
        y=[best.error_at(beta) for beta in betas],
        line=dict(color=PREDICTED, dash=DASHES[0]),
        meta=nobody,
    )
    star = dict(
        type="scatter",
        mode="markers",
        name=f"predicted best β = √(Sλ/ulp(g)) = {best.penalty:.2g} kN/m, error {best.error:.1e}",
        x=[best.penalty],
        y=[best.error],
        marker=dict(color=PREDICTED, symbol="star", size=16),
        meta=nobody,
    )
    return [line, star]


def _layout(best: BestPenalty) -> dict[str, Any]:
    error = 1.0 - float(best.quantum(TABLE_END)) / best.force
    note = dict(
        # On logarithmic axes annotations stand at logarithms.
        x=math.log10(TABLE_END),
        y=math.log10(error),
        text=f"β = 1e20: λ is one ulp of the gap times β, {float(best.quantum(TABLE_END)):.3f} kN",
        showarrow=True,
        ax=0,
        ay=90,
    )
    return dict(
        xaxis=horizontal(penalty_stiffness.AXIS),
        yaxis=dict(title=dict(text="relative error in λ [1]"), type="log", exponentformat="power"),
        annotations=[note],
        legend=LEGEND,
        height=HEIGHT,
    )


def _line(row: StabilityRow) -> tuple[str, ...]:
    force = "" if row.largest_force is None else f"{row.largest_force:.9g}"
    lost = short(digits_lost(row.error_force))
    predicted = (short(row.predicted_error_force), lost, short(row.predicted_digits_lost))
    return (row.name, f"{row.value:g}", force, short(row.error_force), *predicted, row.verdict)
