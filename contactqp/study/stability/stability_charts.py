"""Charts of the stability study: curves of digits lost, heat maps of methods by values, and the best penalty."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from contactqp.study import rows as report_rows
from contactqp.study.curves import Chart, method_style
from contactqp.study.stability import problem_axes
from contactqp.study.stability.axis_problem import NEXT_TO_ONE, UNIT_ROUNDOFF, Axis
from contactqp.study.stability.problem_axes import GAP, STIFFNESS, closed_form
from contactqp.study.stability.stability_cells import ALL_DIGITS, CUT_OFF, STATED, StabilityRow, digits_lost

# Pixels between the labels of an axis and its title.
STANDOFF = 14


def rows_drawn(rows: Sequence[StabilityRow]) -> tuple[StabilityRow, ...]:
    """Return the rows of methods that are installed."""
    return tuple(row for row in rows if row.verdict != report_rows.MISSING)


def methods_of(rows: Sequence[StabilityRow]) -> tuple[str, ...]:
    """Return the names of methods with variants, in the order of the rows."""
    return tuple(dict.fromkeys(row.name for row in rows))


def is_logarithmic(axis: Axis) -> bool:
    """Return whether the values are drawn on a logarithmic scale; else they are categories side by side."""
    near = any(0 < abs(value - 1.0) < NEXT_TO_ONE for value in axis.values)
    return not axis.labels and min(axis.values) > 0 and not near


def place(axis: Axis, value: float) -> float | str:
    """Return the place of a value on its axis: itself, or its label."""
    return value if is_logarithmic(axis) else axis.label(value)


def horizontal(axis: Axis) -> dict[str, Any]:
    """Return the horizontal axis of a curve."""
    if is_logarithmic(axis):
        return dict(title=dict(text=axis.quantity), type="log", exponentformat="power")
    labels = [axis.label(value) for value in axis.values]
    return dict(title=dict(text=axis.quantity), type="category", categoryorder="array", categoryarray=labels)


def sideways(axis: Axis) -> dict[str, Any]:
    """Return the horizontal axis of a heat map, whose values stand side by side."""
    title = dict(text=axis.quantity, standoff=STANDOFF)
    return dict(title=title, type="category", tickangle=-60, automargin=True)


def short(value: float | None) -> str:
    """Return a number as the text of a cell or a hint."""
    return "" if value is None else f"{value:.3g}"


# Predictions are drawn in one colour, each with a dash of its own: they belong to no method.
PREDICTED, DASHES = (
    "#767676",
    ("6px,3px", "2px,2px", "8px,2px,2px,2px", "12px,3px", "2px,6px", "12px,2px,2px,2px", "4px"),
)
# Names are long, and stand below, where a narrow screen has room.
LEGEND = dict(orientation="h", yanchor="top", y=-0.2)
HEIGHT = 560  # pixels


def digits_curves(axis: Axis, rows: Sequence[StabilityRow]) -> Chart:
    """Return the curves of digits lost in λ over the axis by method, and of the losses predicted for their systems."""
    shown = rows_drawn(rows)
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
    """Return the curve of one method over the axis, in its own style.

    Parameters
    ----------
    axis : Axis
    name : the method with its variant
    rows : sequence of StabilityRow, the points of the curve
    heights : sequence of float or None, the ordinates of the points
    """
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
    values = [value for value in axis.values if found.get(value) is not None]
    return dict(
        type="scatter",
        mode="lines",
        name=f"predicted: log₁₀ κ({system})",
        x=[place(axis, value) for value in values],
        y=[found[value] for value in values],
        line=dict(color=PREDICTED, dash=dash),
        hovertemplate="%{fullData.name}, %{x}: %{y:.3g}<extra></extra>",
        meta=dict(method=None, variant=None),
    )


def _line(axis: Axis, name: str, rows: Sequence[StabilityRow]) -> tuple[str, ...]:
    found = {row.value: row.digits_lost_force for row in rows}
    return (name, *(short(found.get(value)) for value in axis.values))


# The letter of each verdict, so that no colour is needed, and a colour from Okabe's and Ito's palette, which is half
# transparent, so that the letters, in the page's own colour, are legible on light and on dark pages.
LETTERS: Mapping[str, tuple[str, str]] = {
    report_rows.RIGHT: ("R", "rgba(0,158,115,0.45)"),
    report_rows.APPROXIMATE: ("A", "rgba(86,180,233,0.45)"),
    STATED: ("S", "rgba(240,228,66,0.45)"),
    report_rows.REFUSED: ("X", "rgba(230,159,0,0.5)"),
    report_rows.NOT_CONVERGED: ("N", "rgba(204,121,167,0.5)"),
    report_rows.BACKEND_FAILED: ("B", "rgba(213,94,0,0.5)"),
    report_rows.CRASHED: ("D", "rgba(213,94,0,0.7)"),
    report_rows.UNSUPPORTED: ("U", "rgba(128,128,128,0.25)"),
    CUT_OFF: ("C", "rgba(128,128,128,0.1)"),
    report_rows.WRONG: ("W", "rgba(255,0,0,0.8)"),
}
# One hue from transparent to opaque, for any colour vision and for light and dark pages.
LOST = [[0.0, "rgba(0,114,178,0.0)"], [1.0, "rgba(0,114,178,0.8)"]]
ROW_HEIGHT, FRAME = 22, 190  # pixels


def digits_heat_map(axis: Axis, rows: Sequence[StabilityRow]) -> Chart:
    """Return the heat map of digits lost in u or λ, whichever has lost more."""
    grid = _Grid(axis, rows)
    trace = grid.trace(_worst_digits) | dict(
        colorscale=LOST,
        zmin=0.0,
        zmax=ALL_DIGITS,
        colorbar=dict(title=dict(text="digits lost [1]")),
        texttemplate="%{text}",
        xgap=1,
        ygap=1,
    )
    trace["text"] = grid.cells(lambda row: "" if _worst_digits(row) is None else f"{_worst_digits(row):.0f}")
    return Chart(
        name=f"stability-{axis.name}-digits",
        title=f"{axis.title}: digits lost",
        caption=(
            f"{axis.about} Of the 16 digits of a double, how many are wrong in u or in λ, whichever has more: 0 is as "
            "good as a double can be, 16 is nothing right. Empty: no answer. Hover for u, λ, the answer before "
            "polish, the condition number and what it predicts."
        ),
        figure=grid.figure(trace),
        headings=("method", *grid.labels),
        lines=grid.lines(lambda row: short(_worst_digits(row))),
    )


def verdict_heat_map(axis: Axis, rows: Sequence[StabilityRow]) -> Chart:
    """Return the heat map of verdicts, a letter in each cell."""
    grid, names = _Grid(axis, rows), list(LETTERS)
    count = len(names)
    colours = [colour for _, colour in LETTERS.values()]
    steps = [[(i + end) / count, colour] for i, colour in enumerate(colours) for end in (0, 1)]
    trace = grid.trace(lambda row: float(names.index(row.verdict))) | dict(
        colorscale=steps, zmin=-0.5, zmax=count - 0.5, showscale=False, texttemplate="%{text}", xgap=1, ygap=1
    )
    trace["text"] = grid.cells(lambda row: LETTERS[row.verdict][0])
    key = "; ".join(f"{letter}: {name}" for name, (letter, _) in LETTERS.items())
    return Chart(
        name=f"stability-{axis.name}-verdicts",
        title=f"{axis.title}: how it ended",
        caption=f"{key}. Empty: the method does not have the knob that is swept.",
        figure=grid.figure(trace),
        headings=("method", *grid.labels),
        lines=grid.lines(lambda row: LETTERS[row.verdict][0]),
    )


def _worst_digits(row: StabilityRow) -> float | None:
    return max((x for x in (row.digits_lost_displacement, row.digits_lost_force) if x is not None), default=None)


class _Grid:
    """The rows of one axis as a grid of methods by values."""

    def __init__(self, axis: Axis, rows: Sequence[StabilityRow]) -> None:
        self._axis, shown = axis, rows_drawn(rows)
        self._methods = methods_of(shown)
        self._found = {(row.name, row.value): row for row in shown}
        self.labels = tuple(axis.label(value) for value in axis.values)

    def cells(self, of: Any, missing: Any = "") -> list[list[Any]]:
        """Return a line for each method and a cell for each value; `missing` where nothing was tried."""
        found = self._found
        return [
            [of(found[name, value]) if (name, value) in found else missing for value in self._axis.values]
            for name in self._methods
        ]

    def lines(self, of: Any) -> tuple[tuple[str, ...], ...]:
        """Return the cells with the methods' names in front, as lines of a table."""
        return tuple((name, *line) for name, line in zip(self._methods, self.cells(of), strict=True))

    def trace(self, of: Any) -> dict[str, Any]:
        """Return the trace of the heat map with the hints of its cells."""
        return dict(
            type="heatmap",
            x=list(self.labels),
            y=list(self._methods),
            z=self.cells(of, None),
            customdata=self.cells(_hint),
            hovertemplate="%{y}, %{x}<br>%{customdata}<extra></extra>",
            hoverongaps=False,
            meta=dict(method=None, variant=None),
        )

    def figure(self, trace: dict[str, Any]) -> dict[str, Any]:
        """Return the trace in a layout whose first method stands on top."""
        layout = dict(
            xaxis=sideways(self._axis),
            yaxis=dict(
                autorange="reversed",
                automargin=True,
                dtick=1,
                title=dict(text="method", standoff=STANDOFF),
                type="category",
            ),
            height=FRAME + ROW_HEIGHT * len(self._methods),
        )
        return dict(data=[trace], layout=layout)


def _hint(row: StabilityRow) -> str:
    lines = [row.verdict]
    for name, value in (
        ("error in u", row.error_displacement),
        ("error in λ", row.error_force),
        ("digits lost in u before polish", row.raw_digits_lost_displacement),
        ("digits lost in λ before polish", row.raw_digits_lost_force),
        (f"κ of {row.system}", row.condition),
    ):
        lines += [f"{name} {value:.2g}"] if value is not None else []
    return "<br>".join(lines)


# The best penalty β is where the errors of modelling and rounding have the least sum.
#
# In exact arithmetic the force is λ β / (S + β): the relative error S / (S + β), about S / β, falls with β. In doubles
# λ = β (E u − g), a difference of lengths of the size of the gap: it is a multiple of β ulp(g), so that the relative
# error β ulp(g) / λ rises with β. The sum S / β + β ulp(g) / λ is least where both are equal,
#
#     β = √(S λ / ulp(g)),    error = 2 √(S ulp(g) / λ)


@dataclass(frozen=True)
class BestPenalty:
    """The best penalty of a single contact, and the error of any other."""

    stiffness: float  # S, of the body at the contact [force / length]
    force: float  # λ [force]
    last_place: float  # ulp(g), the spacing of doubles at the gap [length]

    @property
    def penalty(self) -> float:
        """Return the best penalty √(S λ / ulp(g)) [force / length]."""
        return math.sqrt(self.stiffness * self.force / self.last_place)

    @property
    def error(self) -> float:
        """Return the relative error 2 √(S ulp(g) / λ) of the best penalty."""
        return 2 * math.sqrt(self.stiffness * self.last_place / self.force)

    def error_at(self, penalty: float) -> float:
        """Return the predicted relative error S / (S + β) + β ulp(g) / λ of a penalty β."""
        return self.stiffness / (self.stiffness + penalty) + penalty * self.last_place / self.force

    def quantum(self, penalty: float) -> Fraction:
        """Return β ulp(g) exactly: forces λ = β (E u − g) in doubles are multiples of it."""
        return Fraction(penalty) * Fraction(self.last_place)


def best_penalty_of_truss() -> BestPenalty:
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
    """Return the chart of the error in λ over β and κ, of the methods that have them."""
    shown, best = rows_drawn(rows), best_penalty_of_truss()
    return Chart(
        name="stability-penalty-valley",
        title="The best penalty, and where 21.684 comes from",
        caption=_valley_caption(best),
        figure=dict(data=[*_valley_prediction(best), *_valley_curves(shown)], layout=_valley_layout(best)),
        headings=("method", "β, κ [kN/m]", "λ [kN]", "error in λ", "predicted", "digits lost", "log₁₀ κ", "verdict"),
        lines=tuple(_valley_line(row) for row in shown),
    )


def _valley_caption(best: BestPenalty) -> str:
    return (
        f"Relative error of the contact force of Example 2.10 (exact: {best.force:.6f} kN) over β and κ. Too soft, the "
        "contact gives way: S/β. Too stiff, λ = β (E u - g) is a multiple of β times the last place of the gap: "
        f"β ulp(g)/λ. At β = 1e20 one unit of it is {float(best.quantum(TABLE_END)):.3f} kN, the force that Table 2.1 "
        "prints. Errors below 2⁻⁵³ are drawn there."
    )


def _valley_curves(rows: Sequence[StabilityRow]) -> list[dict[str, Any]]:
    """Return the curves in reverse, so that the penalty method itself, drawn last, lies on top."""
    traces = []
    for name in reversed(methods_of(rows)):
        mine = [row for row in rows if row.name == name and row.error_force is not None]
        errors = [max(row.error_force or 0.0, UNIT_ROUNDOFF) for row in mine]
        traces.append(curve(problem_axes.PENALTY_STIFFNESS, name, mine, errors))
    return traces


def _valley_prediction(best: BestPenalty) -> list[dict[str, Any]]:
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


def _valley_layout(best: BestPenalty) -> dict[str, Any]:
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


def _valley_line(row: StabilityRow) -> tuple[str, ...]:
    force = "" if row.largest_force is None else f"{row.largest_force:.9g}"
    lost = short(digits_lost(row.error_force))
    predicted = (short(row.predicted_error_force), lost, short(row.predicted_digits_lost))
    return (row.name, f"{row.value:g}", force, short(row.error_force), *predicted, row.verdict)
