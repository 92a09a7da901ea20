"""CSV with named columns, several tables in one file: a table begins at a line whose first cell is a known key.

    dof,displacement
    12.x,1e-3
    contact,normal_force,friction_force
    left,142.5,10.0

Cells are apart by commas, semicolons or tabs; comments begin with #.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection
from dataclasses import dataclass

from contactqp.exchange.refusal import Path, no_number, number, read_bytes, read_text, wrong

EXPECTED = "a table with named columns"
HEAD = 512
SEPARATORS = (";", "\t", ",")


@dataclass(frozen=True)
class Table:
    """One table; every row has a cell for each column."""

    path: Path
    columns: tuple[str, ...]  # lower case
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]  # where each row stands in the file

    def column(self, name: str) -> list[str]:
        place = self.columns.index(name)
        return [row[place] for row in self.rows]

    def numbers(self, name: str) -> list[float]:
        """A column of numbers; raises InvalidProblem with the line of a cell that is none."""
        return [cell_number(self.path, line, cell) for line, cell in zip(self.lines, self.column(name), strict=True)]


def cell_number(path: Path, line: int, cell: str) -> float:
    try:
        return number(cell)
    except ValueError:
        raise no_number(path, f"line {line}", cell) from None


def is_table(path: Path, key: str) -> bool:
    """Whether the first line that says anything begins with a key."""
    return begins_with(read_bytes(path, EXPECTED, HEAD), (key,))


def begins_with(head: bytes, keys: Collection[str]) -> bool:
    """Whether the first cell of what the first bytes of a file say is one of the keys."""
    for line in head.decode("utf-8-sig", errors="replace").splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            return re.split(r"[,;\t]", line)[0].strip().strip('"').lower() in keys
    return False


def read_tables(path: Path, keys: Collection[str]) -> list[Table]:
    """The tables in a file, each of which begins with a line whose first cell is one of the keys.

    Raises
    ------
    InvalidProblem
        No such file, no text, numbers before the first table, a row with too few or too many cells, a column twice.
    """
    text = read_text(path, EXPECTED)
    found: list[Table] = []
    columns: tuple[str, ...] = ()
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []

    def end() -> None:
        if columns:
            found.append(Table(path, columns, tuple(rows), tuple(lines)))
        rows.clear()
        lines.clear()

    for line, cells in _cells(path, text):
        if cells[0].lower() in keys:
            end()
            columns = tuple(cell.lower().replace(" ", "_") for cell in cells)
            if len(set(columns)) != len(columns):
                raise wrong(path, f"line {line}", "every column once", ", ".join(columns)[:100])
        elif len(cells) != len(columns):
            expected = f"{len(columns)} cells" if columns else f"a line of names that begins with {', '.join(keys)}"
            raise wrong(path, f"line {line}", expected, len(cells) if columns else repr(", ".join(cells)[:60]))
        else:
            rows.append(tuple(cells))
            lines.append(line)
    end()
    return found


def _cells(path: Path, text: str) -> list[tuple[int, list[str]]]:
    plain = (line.partition("#")[0] for line in text.splitlines())
    numbered = [(k + 1, line) for k, line in enumerate(plain) if line.strip(" \t,;")]
    first = numbered[0][1] if numbered else ""
    separator = next((mark for mark in SEPARATORS if mark in first), ",")
    try:
        reader = csv.reader(io.StringIO("\n".join(line for _, line in numbered)), delimiter=separator, strict=True)
        rows = [[cell.strip() for cell in row] for row in reader]
    except csv.Error as error:
        raise wrong(path, "content", EXPECTED, str(error)) from None
    if len(rows) != len(numbered):
        raise wrong(path, "content", EXPECTED, "a quoted cell that goes over a line's end")
    return [(number, row) for (number, _), row in zip(numbered, rows, strict=True)]
