"""What the charts of an axis share: the place of its values, the order of the methods, sparse layouts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from contactqp.study import rows as report_rows
from contactqp.study.stability.axis import NEXT_TO_ONE, Axis
from contactqp.study.stability.rows import StabilityRow

# Pixels between the words at an axis and its title.
STANDOFF = 14


def drawn(rows: Sequence[StabilityRow]) -> tuple[StabilityRow, ...]:
    """Rows of methods that are installed."""
    return tuple(row for row in rows if row.verdict != report_rows.MISSING)


def methods_of(rows: Sequence[StabilityRow]) -> tuple[str, ...]:
    """Names with variants, in the order of the rows."""
    return tuple(dict.fromkeys(row.name for row in rows))


def is_logarithmic(axis: Axis) -> bool:
    """Whether the values can be told apart on a logarithmic scale, or are to stand side by side."""
    near = any(0 < abs(value - 1.0) < NEXT_TO_ONE for value in axis.values)
    return not axis.labels and min(axis.values) > 0 and not near


def place(axis: Axis, value: float) -> float | str:
    """Where a value is drawn: itself, or its words."""
    return value if is_logarithmic(axis) else axis.label(value)


def horizontal(axis: Axis) -> dict[str, Any]:
    """The horizontal axis of a curve."""
    if is_logarithmic(axis):
        return dict(title=dict(text=axis.quantity), type="log", exponentformat="power")
    labels = [axis.label(value) for value in axis.values]
    return dict(title=dict(text=axis.quantity), type="category", categoryorder="array", categoryarray=labels)


def sideways(axis: Axis) -> dict[str, Any]:
    """The horizontal axis of a table of cells: values side by side."""
    title = dict(text=axis.quantity, standoff=STANDOFF)
    return dict(title=title, type="category", tickangle=-60, automargin=True)


def short(value: float | None) -> str:
    """A number in a cell or a hint."""
    return "" if value is None else f"{value:.3g}"
