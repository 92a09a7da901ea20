"""Tables on a screen, with pictures in letters where they fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from contactqp.scene.in_text import ASCII, BLOCKS, Letters

# Rows of a table on a screen; --json has all.
MOST_ROWS = 60
# Letters of a picture, the widest first; what does not fit the terminal with the narrowest is left out.
WIDTHS = (24, 16, 10, 6)
# Wider than any table: what it would like to have is then measured.
ENDLESS = 10_000


@dataclass(frozen=True)
class Drawn:
    """A column of pictures of as many letters as there is room for."""

    before: int  # the column that it stands in front of
    draw: Callable[[int, Letters], Sequence[str]]


def written(value: float) -> str:
    return f"{value:.12g}"


def shown(value: float | str | Sequence[float]) -> str:
    """A value that a case states, or an answer to it: a number, a word, or the numbers of a matrix."""
    if isinstance(value, str):
        return value
    return "(" + ", ".join(f"{x:.6g}" for x in value) + ")" if isinstance(value, Sequence) else written(value)


def print_table(
    console: Console, header: Sequence[str], rows: Sequence[Sequence[str | Text]], drawn: Sequence[Drawn] = ()
) -> None:
    """The first rows; the last of the columns `drawn` are left out first where the terminal is narrow."""
    if not rows:
        return
    console.print(_fitting(console, header, rows[:MOST_ROWS], drawn))
    if len(rows) > MOST_ROWS:
        console.print(f"... and {len(rows) - MOST_ROWS} more rows (--json has all)")


def _fitting(
    console: Console, header: Sequence[str], rows: Sequence[Sequence[str | Text]], drawn: Sequence[Drawn]
) -> Table:
    letters = ASCII if console.options.ascii_only else BLOCKS
    for count in range(len(drawn), 0, -1):
        for width in WIDTHS:
            pictures = [(column.before, column.draw(width, letters)) for column in drawn[:count]]
            table = _table(header, rows, pictures)
            if console.measure(table, options=console.options.update(width=ENDLESS)).maximum <= console.width:
                return table
    return _table(header, rows, ())


def _table(
    header: Sequence[str], rows: Sequence[Sequence[str | Text]], pictures: Sequence[tuple[int, Sequence[str]]]
) -> Table:
    columns = [list(column) for column in zip(header, *rows, strict=True)]
    for before, cells in sorted(pictures, reverse=True):
        columns.insert(before, ["", *cells[: len(rows)]])
    table = Table(*(escape(str(column[0])) for column in columns), box=box.SIMPLE, pad_edge=False)
    for row in zip(*(column[1:] for column in columns), strict=True):
        table.add_row(*(escape(cell) if isinstance(cell, str) else cell for cell in row))
    return table
