"""Tables on a screen."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

# Rows of a table on a screen; --json has all.
MOST_ROWS = 60


def written(value: float) -> str:
    return f"{value:.12g}"


def shown(value: float | str | Sequence[float]) -> str:
    """A value that a case states, or an answer to it: a number, a word, or the numbers of a matrix."""
    if isinstance(value, str):
        return value
    return "(" + ", ".join(f"{x:.6g}" for x in value) + ")" if isinstance(value, Sequence) else written(value)


def print_table(console: Console, header: list[str], rows: Sequence[Sequence[str | Text]]) -> None:
    if not rows:
        return
    table = Table(*(escape(text) for text in header), box=box.SIMPLE, pad_edge=False)
    for row in rows[:MOST_ROWS]:
        table.add_row(*(escape(cell) if isinstance(cell, str) else cell for cell in row))
    console.print(table)
    if len(rows) > MOST_ROWS:
        console.print(f"... and {len(rows) - MOST_ROWS} more rows (--json has all)")
