"""Two tables of cells for each axis: digits lost, and how it ended; a row a method, a column a value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from contactqp.study import rows as report_rows
from contactqp.study.report.chart import Chart
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.chart_axes import STANDOFF, drawn, methods_of, short, sideways
from contactqp.study.stability.rows import ALL_DIGITS, CUT_OFF, STATED, StabilityRow

# One letter a verdict, so that no colour is needed, and one colour from Okabe's and Ito's palette; half transparent, so
# that the letters, in the page's own colour, are seen on light and on dark pages.
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
# One hue, from nothing to all: of any colour vision, and of light and dark pages.
LOST = [[0.0, "rgba(0,114,178,0.0)"], [1.0, "rgba(0,114,178,0.8)"]]
ROW_HEIGHT, FRAME = 22, 190  # pixels


def digits_heat_map(axis: Axis, rows: Sequence[StabilityRow]) -> Chart:
    """Digits lost in u or λ, the worse of them."""
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
    """How each cell ended, a letter in each."""
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
    known = [x for x in (row.digits_lost_displacement, row.digits_lost_force) if x is not None]
    return max(known, default=None)


class _Grid:
    """The rows of one axis in their places."""

    def __init__(self, axis: Axis, rows: Sequence[StabilityRow]) -> None:
        self._axis, shown = axis, drawn(rows)
        self._methods = methods_of(shown)
        self._found = {(row.name, row.value): row for row in shown}
        self.labels = tuple(axis.label(value) for value in axis.values)

    def cells(self, of: Any, missing: Any = "") -> list[list[Any]]:
        """A line a method, a cell a value; `missing` where nothing was tried."""
        found = self._found
        return [
            [of(found[name, value]) if (name, value) in found else missing for value in self._axis.values]
            for name in self._methods
        ]

    def lines(self, of: Any) -> tuple[tuple[str, ...], ...]:
        """The same with the methods' names in front, for those who read."""
        return tuple((name, *line) for name, line in zip(self._methods, self.cells(of), strict=True))

    def trace(self, of: Any) -> dict[str, Any]:
        """The cells with what they say when one points at them."""
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
        """The trace in a layout whose first method stands above."""
        layout = dict(
            xaxis=sideways(self._axis),
            yaxis=dict(
                autorange="reversed", automargin=True, title=dict(text="method", standoff=STANDOFF), type="category"
            ),
            height=FRAME + ROW_HEIGHT * len(self._methods),
        )
        return dict(data=[trace], layout=layout)


def _hint(row: StabilityRow) -> str:
    said = [row.verdict]
    for name, value in (
        ("error in u", row.error_displacement),
        ("error in λ", row.error_force),
        ("digits lost in u before polish", row.raw_digits_lost_displacement),
        ("digits lost in λ before polish", row.raw_digits_lost_force),
        (f"κ of {row.system}", row.condition),
    ):
        said += [f"{name} {value:.2g}"] if value is not None else []
    return "<br>".join(said)
