"""Print tables on a terminal, and draw numbers with block characters, as bars or as a curve in one line."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich import box
from rich.console import Console, Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from contactqp.model.summary import aligned
from contactqp.solving.methods import Method

# The most rows of a table on a terminal; --json has all.
MOST_ROWS = 60
# Widths of a column of pictures in characters, the widest first; if none fits, the column is left out.
WIDTHS = (24, 16, 10, 6)
# A width beyond any table, with which its natural width is measured.
ENDLESS = 10_000
# Values below this part of the largest are drawn as zero.
DRAWN_AS_ZERO = 1e-12
# A number in a cell, with or without unit; short ones are not shortened.
NUMBER = re.compile(r"([-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?)( rad(?:/s)?)?")
SHORT = 8
# The longest word that a narrow column does not break.
LONGEST_WORD = 16


@dataclass(frozen=True)
class Letters:
    """The characters of bars and curves."""

    full: str
    starts: str  # growing parts of a letter, from the left
    ends: str  # growing parts of a letter, from the right
    heights: str  # growing from the bottom
    zero: str
    axis: str


BLOCKS = Letters("█", "▏▎▍▌▋▊▉", "▐", "▁▂▃▄▅▆▇█", "·", "│")
# Used where the output's encoding has no block characters.
ASCII = Letters("#", "", "", ".:-=+*#@", "0", "|")


def bars(values: ArrayLike, width: int, letters: Letters = BLOCKS) -> list[str]:
    """Return a horizontal bar for each value, the largest as long as `width`; every value above rounding is visible.

    If some values are negative, bars extend to both sides of an axis, and `width` is that of each side.
    """
    sizes = np.asarray(values, dtype=float)
    finite = np.abs(sizes[np.isfinite(sizes)])
    largest = float(np.max(finite, initial=0.0))
    both_sides = bool(np.any(sizes[np.isfinite(sizes)] < 0))
    return [_bar(value, largest, width, both_sides, letters) for value in sizes.tolist()]


def _bar(value: float, largest: float, width: int, both_sides: bool, letters: Letters) -> str:
    if not math.isfinite(value):
        return ""
    if abs(value) <= DRAWN_AS_ZERO * largest:
        return f"{'':{width}}{letters.axis}" if both_sides else letters.zero
    # Divide first, since the width times the largest double would overflow.
    length = abs(value) / largest * width
    if not both_sides:
        return _filled(length, letters.full, letters.starts)
    if value > 0:
        return f"{'':{width}}{letters.axis}{_filled(length, letters.full, letters.starts)}"
    return f"{_filled(length, letters.full, letters.ends)[::-1]:>{width}}{letters.axis}"


def _filled(length: float, full: str, parts: str) -> str:
    """Return a bar of this length in characters, the last one partly filled, at least with the smallest part."""
    steps = len(parts) + 1
    whole, part = divmod(max(round(length * steps), 1), steps)
    return full * whole + (parts[part - 1] if part else "")


def course(values: ArrayLike, width: int, letters: Letters = BLOCKS) -> str:
    """Return values as a curve in one line of at most `width` characters, from the least of them, or zero, to the
    largest.

    Of values that share a character the one furthest from zero is drawn; zero has a separate character.
    """
    numbers = np.asarray(values, dtype=float)
    finite = numbers[np.isfinite(numbers)]
    low, high = float(np.min(finite, initial=0.0)), float(np.max(finite, initial=0.0))
    return "".join(_height(value, low, high, letters) for value in _furthest(numbers, width))


def _furthest(numbers: np.ndarray, width: int) -> Sequence[float]:
    parts = np.array_split(numbers, min(width, len(numbers))) if len(numbers) else []
    return [float(part[np.argmax(np.abs(part))]) for part in parts]


def _height(value: float, low: float, high: float, letters: Letters) -> str:
    if not math.isfinite(value):
        return "?"
    if high <= low or abs(value) <= DRAWN_AS_ZERO * max(high, -low):
        return letters.zero
    steps = len(letters.heights)
    # Halved only where the difference would overflow, as half of the smallest double is zero.
    half = 1.0 if math.isfinite(high - low) else 0.5
    part = (half * value - half * low) / (half * high - half * low)
    return letters.heights[min(int(part * steps), steps - 1)]


@dataclass(frozen=True)
class Drawn:
    """A column of pictures, made as wide as there is room for."""

    before: int  # the column to the right of it
    draw: Callable[[int, Letters], Sequence[str]]


def written(value: float) -> str:
    """Return a number with twelve digits."""
    return f"{value:.12g}"


def shown(value: float | str | Sequence[float]) -> str:
    """Return a stated or computed value as text: a number, a word, or the numbers of a matrix."""
    if isinstance(value, str):
        return value
    return "(" + ", ".join(f"{x:.6g}" for x in value) + ")" if isinstance(value, Sequence) else written(value)


def print_table(
    console: Console,
    header: Sequence[str],
    rows: Sequence[Sequence[str | Text]],
    drawn: Sequence[Drawn] = (),
    most: int = MOST_ROWS,
) -> None:
    """Print the first rows of a table, with as many pictures as the terminal has room for.

    Parameters
    ----------
    console : Console
    header : sequence of str
    rows : sequence of rows, as many cells each as the header; all are text
    drawn : sequence of Drawn, columns of pictures; the last of them are left out first where the terminal is narrow
    most : the rows that are printed; how many more there are is said
    """
    if not rows:
        return
    console.print(_fitting(console, header, rows[:most], drawn))
    if len(rows) > most:
        console.print(f"... and {len(rows) - most} more rows (--json has all)")


def _fitting(
    console: Console, header: Sequence[str], rows: Sequence[Sequence[str | Text]], drawn: Sequence[Drawn]
) -> RenderableType:
    letters = ASCII if console.options.ascii_only else BLOCKS
    for count in range(len(drawn), 0, -1):
        for width in WIDTHS:
            pictures = [(column.before, column.draw(width, letters)) for column in drawn[:count]]
            table = _table(header, rows, pictures)
            if fits(console, table):
                return table
    table = _table(header, rows, ())
    if fits(console, table):
        return table
    return _one_below_another(console, header, [[_shortened(cell) for cell in row] for row in rows])


def fits(console: Console, table: Table) -> bool:
    """Return whether the terminal is wide enough for the table without folding any cell."""
    return console.measure(table, options=console.options.update(width=ENDLESS)).maximum <= console.width


def _one_below_another(console: Console, header: Sequence[str], rows: Sequence[Sequence[str | Text]]) -> RenderableType:
    """Return the columns in as many tables as keep all words whole; each begins with the first column."""

    def of_columns(places: Sequence[int]) -> Table:
        chosen = [[row[place] for place in places] for row in rows]
        return _table([header[place] for place in places], chosen, (), whole_numbers=True)

    tables, places = [], [0]
    for place in range(1, len(header)):
        wider = of_columns([*places, place])
        if (
            len(places) > 1
            and console.measure(wider, options=console.options.update(width=ENDLESS)).minimum > console.width
        ):
            tables.append(of_columns(places))
            places = [0]
        places.append(place)
    return Group(*tables, of_columns(places))


def _shortened(cell: str | Text) -> str | Text:
    """Return a number with six digits if it has more; other text is unchanged."""
    match = NUMBER.fullmatch(cell) if isinstance(cell, str) else None
    return cell if match is None or len(match[0]) <= SHORT else f"{float(match[1]):.6g}{match[2] or ''}"


def _table(
    header: Sequence[str],
    rows: Sequence[Sequence[str | Text]],
    pictures: Sequence[tuple[int, Sequence[str]]],
    whole_numbers: bool = False,
) -> Table:
    """Return the table; with `whole_numbers` words are folded where it is too wide, but numbers are not."""
    columns = [list(column) for column in zip(header, *rows, strict=True)]
    for before, cells in sorted(pictures, reverse=True):
        columns.insert(before, ["", *cells[: len(rows)]])
    table = Table(box=box.SIMPLE, pad_edge=False, padding=(0, 0) if whole_numbers else (0, 1))
    for name, *cells in columns:
        widest = max(map(len, [*cells, *str(name).split()]))
        numbers = whole_numbers and any(isinstance(cell, str) and NUMBER.fullmatch(cell) for cell in cells)
        words = [word for cell in (name, *cells) for word in str(cell).split()]
        least = min(max(map(len, words), default=1), LONGEST_WORD) if whole_numbers and not numbers else None
        table.add_column(escape(str(name)), overflow="fold", width=widest if numbers else None, min_width=least)
    for row in zip(*(column[1:] for column in columns), strict=True):
        table.add_row(*(escape(cell) if isinstance(cell, str) else cell for cell in row))
    return table


def print_noted(
    console: Console, header: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[Sequence[str]]
) -> None:
    """Print a table whose last columns are sentences, which are put below their rows on a narrow terminal.

    Parameters
    ----------
    console : Console
    header : sequence of str, the names of all columns
    rows : sequence of rows, of each row the cells of the first columns, which are short
    notes : sequence of rows, of each row the sentences of the other columns; empty ones are left out below a row
    """
    whole = _table(header, [[*row, *note] for row, note in zip(rows, notes, strict=True)], ())
    if fits(console, whole):
        console.print(whole)
        return
    names = header[: len(rows[0])] if rows else ()
    room = max(console.width - 1, 20)
    styles = ["bold", *("" for _ in rows)]
    for line, note, style in zip(aligned([names, *rows]), [header[len(names) :], *notes], styles, strict=True):
        console.print(Text(line, style=style))
        for text in textwrap.wrap("; ".join(filter(None, note)), room, initial_indent="    ", subsequent_indent="    "):
            console.print(Text(text))


def print_wrapped(console: Console, lines: Iterable[str]) -> None:
    """Print lines of text without markup, folded between words where the terminal is narrow; paths stay whole."""
    for line in lines:
        indent = " " * (len(line) - len(line.lstrip()) + 2)
        folded = textwrap.wrap(
            line,
            max(console.width, 20),
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
            drop_whitespace=True,
            replace_whitespace=False,
        )
        for part in folded or [""]:
            console.print(Text(part), soft_wrap=True)


def print_methods(console: Console, methods: Iterable[Method]) -> None:
    """Print every method, installed or how to install it, and what it can do."""
    known = list(methods)
    rows = [[m.name, m.kind, "exact" if m.exact else "approximate", "yes" if m.installed else "no"] for m in known]
    notes = [[_abilities(m), m.note, "" if m.installed else m.install] for m in known]
    print_noted(console, ["method", "kind", "answer", "installed", "can do", "note", "how to install"], rows, notes)


def _abilities(method: Method) -> str:
    yes = [
        "floating bodies" if method.semidefinite else "",
        "sparse" if method.sparse else "",
        f"friction: {method.friction}" if method.friction else "",
        f"knob: {method.knob}" if method.knob else "",
    ]
    return ", ".join(text for text in yes if text)


def method_data(method: Method) -> dict[str, Any]:
    """Return one method for JSON."""
    keys = (
        "name",
        "kind",
        "installed",
        "install",
        "exact",
        "semidefinite",
        "sparse",
        "friction",
        "options",
        "required",
        "knob",
        "note",
    )
    return {key: getattr(method, key) for key in keys}
