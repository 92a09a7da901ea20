"""The penalty method's error over β: its valley, the best β as predicted, and 21.684 kN."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from contactqp.study.charts.curves import Chart
from contactqp.study.stability import problem_axes
from contactqp.study.stability.cells import StabilityRow, digits_lost
from contactqp.study.stability.charts import (
    DASHES,
    HEIGHT,
    LEGEND,
    PREDICTED,
    curve,
    drawn,
    horizontal,
    methods_of,
    short,
)
from contactqp.study.stability.condition import UNIT_ROUNDOFF
from contactqp.study.stability.problem_axes import GAP, STIFFNESS, closed_form

# The best penalty β: where what it leaves out and what it loses to rounding are together the least.
#
# In exact arithmetic the force is λ β / (S + β): the relative error S / (S + β), about S / β, falls with β. In doubles
# λ = β (E u − g), a difference of lengths of the size of the gap: it is a multiple of β ulp(g), so that the relative
# error β ulp(g) / λ rises with β. The sum S / β + β ulp(g) / λ is least where both are equal,
#
#     β = √(S λ / ulp(g)),    error = 2 √(S ulp(g) / λ)


@dataclass(frozen=True)
class BestPenalty:
    """The best penalty of a single contact [force / length]."""

    stiffness: float  # S, which the contact feels
    force: float  # λ
    last_place: float  # ulp(g), the spacing of doubles at the gap

    @property
    def penalty(self) -> float:
        """√(S λ / ulp(g))."""
        return math.sqrt(self.stiffness * self.force / self.last_place)

    @property
    def error(self) -> float:
        """2 √(S ulp(g) / λ)."""
        return 2 * math.sqrt(self.stiffness * self.last_place / self.force)

    def error_at(self, penalty: float) -> float:
        """S / (S + β) + β ulp(g) / λ."""
        return self.stiffness / (self.stiffness + penalty) + penalty * self.last_place / self.force

    def quantum(self, penalty: float) -> Fraction:
        """β ulp(g), exactly: the forces that the textbook's λ = β (E u − g) can have are its multiples."""
        return Fraction(penalty) * Fraction(self.last_place)


def of_truss() -> BestPenalty:
    """Return the best penalty of Example 2.10: S = K22 − K12² / K11."""
    (k11, k12), (_, k22) = ((Fraction(x) for x in row) for row in STIFFNESS)
    return BestPenalty(
        stiffness=float(k22 - k12 * k12 / k11),
        force=float(closed_form().normal_force[0]),
        last_place=float(np.spacing(GAP)),
    )


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
        traces.append(curve(problem_axes.PENALTY_STIFFNESS, name, mine, errors))
    return traces


def _predicted(best: BestPenalty) -> list[dict[str, Any]]:
    betas, nobody = list(problem_axes.VALUES), dict(method=None, variant=None)
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
        xaxis=horizontal(problem_axes.PENALTY_STIFFNESS),
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
