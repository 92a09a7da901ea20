"""CSV tables with named columns, and contacts, ties and loads stated by the names of unknowns.

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
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import counted
from contactqp.exchange.files import HEAD, Ledger, Path, no_number, number, read_bytes, read_text, wrong
from contactqp.model.arrays import Array
from contactqp.model.names import plain_name

EXPECTED = "a table with named columns"
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
        """Return a column of numbers; raises InvalidProblem with the line of a cell that is none."""
        return [cell_number(self.path, line, cell) for line, cell in zip(self.lines, self.column(name), strict=True)]


def cell_number(path: Path, line: int, cell: str) -> float:
    try:
        return number(cell)
    except ValueError:
        raise no_number(path, f"line {line}", cell) from None


def is_table(path: Path, key: str) -> bool:
    """Return whether the first line that is neither empty nor a comment begins with a key."""
    return begins_with(read_bytes(path, EXPECTED, HEAD), (key,))


def begins_with(head: bytes, keys: Collection[str]) -> bool:
    """Return whether the first cell of a file is one of the keys."""
    for line in head.decode("utf-8-sig", errors="replace").splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            return re.split(r"[,;\t]", line)[0].strip().strip('"').lower() in keys
    return False


def read_tables(path: Path, keys: Collection[str]) -> list[Table]:
    """Return the tables in a file, each of which begins with a line whose first cell is one of the keys.

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


# Contacts, ties and loads by the names of unknowns, for a stiffness whose unknowns are called like "12.x".
#
#     contacts.csv   contact,dof,coefficient,gap[,tangent[,tangent_2],friction,slip_origin[,slip_origin_2]]
#     ties.csv       tie,dof,coefficient[,value]
#     load.csv       dof,load
#
# A contact has a row for every unknown in it: its coefficient in E_N (and E_T); what belongs to the contact as a whole
# stands in its first row, and in the others the same or nothing. Without names unknowns are positions counted from 0.

TANGENTS = ("tangent", "tangent_2")
ORIGINS = ("slip_origin", "slip_origin_2")


class Unknowns:
    """The indices of unknowns by name, in any known spelling, or by position where there are no names."""

    def __init__(self, names: Sequence[str] | None, count: int) -> None:
        self.count = count
        self.named = names is not None
        self.respelled: dict[str, str] = {}  # what a table calls an unknown, and what it is called here
        self._place = {name: j for j, name in enumerate(names if names is not None else map(str, range(count)))}
        self._meaning: dict[str, list[str]] = {}
        for name in self._place if self.named else ():
            self._meaning.setdefault(plain_name(name) or name, []).append(name)

    def place(self, table: Table, line: int, name: str) -> int:
        if name in self._place:
            return self._place[name]
        found = self._meaning.get(plain_name(name) or "", [])
        if len(found) > 1:
            raise wrong(table.path, f"line {line}", f"one of {found[0]!r:.40} and {found[1]!r:.40}", repr(name[:40]))
        if not found:
            known = f"one of the {self.count} unknowns, such as {next(iter(self._place), '')!r:.40}"
            raise wrong(table.path, f"line {line}", known, repr(name[:40]))
        self.respelled[name] = found[0]
        return self._place[found[0]]

    def say(self, what: str, ledger: Ledger) -> None:
        """Note in the ledger what was assumed about names, once for each table."""
        if not self.named:
            ledger.assumed.append(f"{what}: the stiffness has no names: unknowns are positions counted from 0")
        if self.respelled:
            theirs, ours = next(iter(self.respelled.items()))
            count = len(self.respelled)
            ledger.assumed.append(f"{what}: {count} unknowns spelled otherwise, such as {theirs:.40} for {ours:.40}")
            self.respelled.clear()


def read_contact_rows(path: Path, unknowns: Unknowns, ledger: Ledger) -> tuple[dict[str, Any], list[str]]:
    """Read contacts from a table; return the parts of the problem that it gives, and the names of the contacts.

    Raises
    ------
    InvalidProblem
        As `read_tables`; a column that is missing or unknown, an unknown twice in a contact, two gaps of one contact.
    """
    table = _table(path, "contact", ("dof", "coefficient", "gap"), (*TANGENTS, "friction", *ORIGINS))
    names, row = _grouped(table)
    parts: dict[str, Any] = {
        "normal": _rows(table, "coefficient", row, len(names), unknowns),
        "gap": np.array(_of_group(table, "gap", row, names)),
    }
    directions = [column for column in TANGENTS if column in table.columns]
    if directions:
        blocks = [_rows(table, column, row, len(names), unknowns) for column in directions]
        order = np.arange(len(directions) * len(names)).reshape(len(directions), -1).T.ravel()
        parts["tangent"] = sp.csr_array(sp.vstack(blocks))[order]
    if "friction" in table.columns:
        parts["friction"] = np.array(_of_group(table, "friction", row, names))
    origins = [column for column in ORIGINS if column in table.columns]
    if origins:
        parts["slip_origin"] = np.array([_of_group(table, column, row, names) for column in origins]).T
    _say(table, names, "contact", unknowns, ledger)
    return parts, names


def read_tie_rows(path: Path, unknowns: Unknowns, ledger: Ledger) -> tuple[dict[str, Any], list[str]]:
    """Return tie, tie_value where its column is there, and the ties' names; raises as `read_contact_rows`."""
    table = _table(path, "tie", ("dof", "coefficient"), ("value",))
    names, row = _grouped(table)
    parts: dict[str, Any] = {"tie": _rows(table, "coefficient", row, len(names), unknowns)}
    if "value" in table.columns:
        parts["tie_value"] = np.array(_of_group(table, "value", row, names))
    _say(table, names, "tie", unknowns, ledger)
    return parts, names


def read_load_rows(path: Path, unknowns: Unknowns, ledger: Ledger) -> Array:
    """Return the load (n,), zero at unknowns that the table does not name; raises as `read_contact_rows`."""
    table = _table(path, "dof", ("load",), ())
    places = [unknowns.place(table, line, name) for line, name in zip(table.lines, table.column("dof"), strict=True)]
    _refuse_twice(table, places)
    load = np.zeros(unknowns.count)
    load[places] = table.numbers("load")
    ledger.read.append(f"load: {len(places)} of {unknowns.count} unknowns")
    if len(places) < unknowns.count:
        others = counted("unknown", unknowns.count - len(places))
        ledger.assumed.append(f"load: zero at {others} that the table does not name")
    unknowns.say("load", ledger)
    return load


def _table(path: Path, key: str, needed: Sequence[str], possible: Sequence[str]) -> Table:
    tables = read_tables(path, (key,))
    if len(tables) != 1:
        raise wrong(path, "content", f"one table that begins with {key}", f"{len(tables)}")
    columns = set(tables[0].columns) - {key}
    missing, odd = set(needed) - columns, columns - set(needed) - set(possible)
    if missing or odd:
        expected = f"the columns {', '.join((key, *needed))}, and at most {', '.join(possible) or 'these'}"
        raise wrong(path, "columns", expected, ", ".join(tables[0].columns)[:100])
    return tables[0]


def _grouped(table: Table) -> tuple[list[str], list[int]]:
    """Return the names of contacts or ties in the order in which they come, and the row of the matrix of each line."""
    given = table.column(table.columns[0])
    names = list(dict.fromkeys(given))
    place = {name: i for i, name in enumerate(names)}
    return names, [place[name] for name in given]


def _rows(table: Table, column: str, row: list[int], count: int, unknowns: Unknowns) -> Any:
    entries = zip(table.lines, table.column("dof"), strict=True)
    places = [unknowns.place(table, line, name) for line, name in entries]
    _refuse_twice(table, list(zip(row, places, strict=True)))
    values = [_cell(table, k, column) for k in range(len(row))]
    stored = sp.coo_array((values, (row, places)), shape=(count, unknowns.count))
    return sp.csr_array(stored)


def _cell(table: Table, k: int, column: str) -> float:
    cell = table.rows[k][table.columns.index(column)]
    return cell_number(table.path, table.lines[k], cell)


def _refuse_twice(table: Table, entries: Sequence[Any]) -> None:
    seen: set[Any] = set()
    for line, entry in zip(table.lines, entries, strict=True):
        if entry in seen:
            raise wrong(table.path, f"line {line}", "every unknown once", "one that was there before")
        seen.add(entry)


def _of_group(table: Table, column: str, row: list[int], names: list[str]) -> list[float]:
    """Return one value for each contact; further lines of the same contact may leave it out."""
    found: dict[int, float] = {}
    for k, i in enumerate(row):
        cell = table.rows[k][table.columns.index(column)]
        if cell == "" and i in found:
            continue
        value = _cell(table, k, column)
        if found.setdefault(i, value) != value:
            place = f"line {table.lines[k]}"
            raise wrong(table.path, place, f"the {column} {found[i]:g} of {names[i]!r:.40} again", f"{value:g}")
    return [found[i] for i in range(len(names))]


def _say(table: Table, names: list[str], what: str, unknowns: Unknowns, ledger: Ledger) -> None:
    ledger.read.append(f"{counted(what, len(names))} in {counted('row', len(table.rows))}")
    unknowns.say(f"{what}s", ledger)


# Load cases, a row each; a column for each unknown that is loaded, contact whose gap is another, or coefficient.
#
#     cases.csv      case[,UNKNOWN...][,CONTACT...][,friction]


@dataclass(frozen=True)
class CaseRows:
    """Load cases by name; each entry is a number, or None for an empty cell, where the problem's own value holds."""

    names: tuple[str, ...]
    loads: dict[int, tuple[float | None, ...]]  # by the place of the unknown
    gaps: dict[int, tuple[float | None, ...]]  # by the place of the contact
    friction: tuple[float | None, ...] | None  # one coefficient for all contacts


def read_case_rows(path: Path, unknowns: Sequence[str], contacts: Sequence[str]) -> CaseRows:
    """Return the load cases in a table whose columns have the names of unknowns and of contacts.

    Raises
    ------
    InvalidProblem
        As `read_tables`; a column that is neither an unknown nor a contact, or may be both; a case twice.
    """
    tables = read_tables(path, ("case",))
    if len(tables) != 1:
        raise wrong(path, "content", "one table that begins with case", f"{len(tables)}")
    table, names = tables[0], tuple(tables[0].column("case"))
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise wrong(path, "case", "every case once", repr(twice[:40]))
    places = [_spelled(known) for known in (unknowns, contacts)]
    loads: dict[int, tuple[float | None, ...]] = {}
    gaps: dict[int, tuple[float | None, ...]] = {}
    friction = None
    for column in table.columns[1:]:
        cells = tuple(
            None if cell == "" else cell_number(path, line, cell)
            for line, cell in zip(table.lines, table.column(column), strict=True)
        )
        at = [place.get(column, []) for place in places]
        if sum(map(len, at)) > 1:
            raise wrong(path, "columns", "names that one unknown or contact has", repr(column[:40]))
        if at[0] or at[1]:
            (loads if at[0] else gaps)[(at[0] or at[1])[0]] = cells
        elif column == "friction":
            friction = cells
        else:
            raise wrong(path, "columns", "names of unknowns (their loads), of contacts (their gaps) or friction",
                        repr(column[:40]))  # fmt: skip
    return CaseRows(names, loads, gaps, friction)


def _spelled(names: Sequence[str]) -> dict[str, list[int]]:
    """Return the indices of the names by their spelling in column heads: lower case, without blanks."""
    found: dict[str, list[int]] = {}
    for place, name in enumerate(names):
        found.setdefault(name.lower().replace(" ", "_"), []).append(place)
    return found
