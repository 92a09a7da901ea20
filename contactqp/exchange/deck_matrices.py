"""Read the stiffness matrices that Abaqus and CalculiX print as lists of entries."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.files import Ledger, MatrixFile, MatrixReader, Path, check_finite, one_line, text_lines, wrong
from contactqp.model.arrays import Array, Index, Vector

Integers = Index
# Floats hold every integer up to here.
EXACT = 2**53


def number_table(path: Path, lines: Iterable[str], columns: int, expected: str) -> Array:
    """Return the numbers (rows, columns) of a text in which blanks separate them.

    Raises InvalidProblem: no number at all, a word that is not a number, a line of another length.

    Parameters
    ----------
    path : the file, for messages
    lines : iterable of str, its text; lines without a word are skipped
    columns : how many numbers stand in each line
    expected : what the file should hold, for messages
    """
    rows = (line for line in lines if line.strip())
    first = next(rows, None)
    if first is None:
        raise wrong(path, "content", expected, "nothing")
    try:
        table = np.loadtxt(chain([first], rows), ndmin=2, comments=None)
    except InvalidProblem:
        raise
    except ValueError as error:
        raise wrong(path, "content", expected, one_line(error)) from None
    if table.shape[1] != columns:
        raise wrong(path, "content", f"{expected}, {columns} numbers a line", table.shape[1])
    return np.asarray(table, dtype=float)


def whole_numbers(path: Path, place: str, values: Vector) -> Integers:
    """Return the values as integers from 1 on.

    Raises InvalidProblem: one is not an integer, or below 1, or beyond what a float counts exactly.
    """
    bad = np.flatnonzero(~((values == np.floor(values)) & (values >= 1) & (values < EXACT)))
    if bad.size:
        raise wrong(path, place, "whole numbers from 1 on", f"{values[bad[0]]:g} in line {bad[0] + 1}")
    return np.asarray(values, dtype=np.int64)


def symmetric_matrix(path: Path, row: Integers, column: Integers, value: Vector, size: int, ledger: Ledger) -> Any:
    """Return the matrix (size, size) of a list of entries, indices from 0; one triangle is mirrored.

    Raises InvalidProblem: a value that is not finite, an entry given twice, some mirrored and some not, a missing
    diagonal entry: no stiffness has a zero there, so that the list must have been cut off.

    Parameters
    ----------
    path
        The file, for messages.
    row, column, value : (e,) arrays, the entries, with indices from 0
    size : the number of unknowns
    ledger : a Ledger, which notes what was read and mirrored
    """
    check_finite(path, "values", value)
    key = row * size + column
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    if twice.size:
        raise wrong(path, "entries", "each once", _place(row, column, order[twice[0] + 1]) + " twice")
    missing = np.setdiff1d(np.arange(size), row[row == column])
    if missing.size:
        raise wrong(path, "diagonal", f"an entry for each of {size} unknowns", f"none for unknown {missing[0] + 1}")
    off = np.flatnonzero(row != column)
    mirrored = np.isin(column[off] * size + row[off], key)
    if mirrored.any() and not mirrored.all():
        lonely = _place(row, column, off[np.argmin(mirrored)])
        raise wrong(path, "entries", "one triangle or both", f"both of some entries, and {lonely} without its mirror")
    matrix = sp.csr_matrix((value, (row, column)), shape=(size, size))
    if off.size and mirrored.all():
        ledger.read.append(f"{len(value)} entries, both triangles, {size} unknowns")
        return matrix
    ledger.read.append(f"{len(value)} entries of one triangle, {size} unknowns")
    if off.size:
        ledger.converted.append("the other triangle is its mirror image")
    return sp.csr_matrix(matrix + matrix.T - sp.diags(matrix.diagonal()))


def _place(row: Integers, column: Integers, at: int) -> str:
    return f"entry ({row[at] + 1}, {column[at] + 1})"


# Stiffness matrices that Abaqus prints: *MATRIX GENERATE, STIFFNESS and *MATRIX OUTPUT, job_STIF1.mtx.
#
# FORMAT=MATRIX INPUT and LABELS: "node, direction, node, direction, value" a line; FORMAT=COORDINATE: "row, column,
# value", indices from 1 (Abaqus Analysis User's Guide, "Generating structural matrices"). A symmetric matrix is one
# triangle or both. Lines of ** are comments. An unknown with a boundary condition stays, with 1e36 on its diagonal.

ABAQUS_NAME = "Abaqus matrix text"
ABAQUS_EXPECTED = "entries of Abaqus's stiffness: node, direction, node, direction, value or row, column, value"
FIXED = 1e36
NUMBER = rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
LABELLED = re.compile(rb"\s*" + rb"-?\d+\s*,\s*\d+\s*,\s*" * 2 + NUMBER + rb"\s*,?\s*")
DIRECTIONS = 100  # of a node: displacements, rotations, warping, temperatures up to 11 and on


def read_abaqus_matrix(path: Path) -> MatrixFile:
    """Return the stiffness, its unknowns called "node.direction"; those of COORDINATE files have no names.

    Unknowns with 1e36 on the diagonal, which Abaqus holds fixed, are left out.

    Raises InvalidProblem: no such file, words that are not numbers, a list of entries that is not whole; Unsupported:
    internal nodes, whose labels are negative.
    """
    ledger = Ledger(str(path))
    comments: list[int] = []
    rows = _rows(path, comments)
    first = next(rows, "")
    width = len(first.split())
    if width not in (3, 5):
        raise wrong(path, "first line", ABAQUS_EXPECTED, f"{width} words")
    table = number_table(path, chain([first], rows), width, ABAQUS_EXPECTED)
    if comments:
        ledger.ignored.append(f"{len(comments)} lines of comments and keywords")
    if width == 3:
        row, column = (whole_numbers(path, name, table[:, at]) - 1 for at, name in enumerate(("rows", "columns")))
        size, labels = int(max(row.max(), column.max())) + 1, None
        if size > len(row):
            raise wrong(path, "diagonal", f"an entry for each of {size} unknowns", f"{len(row)} entries in all")
        ledger.assumed.append("FORMAT=COORDINATE: unknowns have no names and are taken in their order")
    else:
        row, column, labels = _labelled(path, table)
        size = len(labels)
    matrix = symmetric_matrix(path, row, column, table[:, -1], size, ledger)
    ledger.assumed.append("the stiffness is that of the first step's base state, without contact")
    return _without_fixed(path, matrix, labels, ledger)


def _rows(path: Path, comments: list[int]) -> Iterator[str]:
    """Yield the lines of numbers, blanks for commas; the numbers of the other lines are left in `comments`."""
    for number, line in enumerate(text_lines(path, ABAQUS_EXPECTED), 1):
        if line.lstrip().startswith("*"):
            comments.append(number)
        elif line.strip():
            yield line.replace(",", " ")


def _labelled(path: Path, table: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[Integers, Integers, tuple[str, ...]]:
    """Return rows, columns and the names of the unknowns, which are made of node and direction."""
    if np.any(table[:, [0, 2]] < 0):
        line = int(np.argmax(np.any(table[:, [0, 2]] < 0, axis=1))) + 1
        raise Unsupported(f"{path}: line {line}: internal nodes (negative labels) are not supported")
    nodes = [whole_numbers(path, "node labels", table[:, at]) for at in (0, 2)]
    directions = [whole_numbers(path, "directions", table[:, at]) for at in (1, 3)]
    if max(direction.max() for direction in directions) >= DIRECTIONS:
        raise wrong(path, "directions", f"numbers below {DIRECTIONS}", max(d.max() for d in directions))
    if max(node.max() for node in nodes) >= 2**40:
        raise wrong(path, "node labels", "numbers below 2^40", max(node.max() for node in nodes))
    keys = np.concatenate([node * DIRECTIONS + direction for node, direction in zip(nodes, directions, strict=True)])
    unknowns, place = np.unique(keys, return_inverse=True)
    labels = tuple(f"{key // DIRECTIONS}.{key % DIRECTIONS}" for key in unknowns)
    row, column = np.split(place.ravel(), 2)
    return row.astype(np.int64), column.astype(np.int64), labels


def _without_fixed(path: Path, matrix: Any, labels: tuple[str, ...] | None, ledger: Ledger) -> MatrixFile:
    free = np.flatnonzero(matrix.diagonal() < FIXED)
    fixed = matrix.shape[0] - len(free)
    if not fixed:
        return MatrixFile(matrix, labels, ledger)
    if not free.size:
        raise wrong(path, "diagonal", "an unknown that is not fixed", f"{fixed} of 1e36")
    ledger.converted.append(f"{fixed} fixed unknowns (1e36 on the diagonal) are left out")
    ledger.assumed.append("prescribed displacements are zero")
    kept = None if labels is None else tuple(labels[i] for i in free)
    return MatrixFile(sp.csr_matrix(matrix[free][:, free]), kept, ledger)


def is_abaqus_matrix(head: bytes) -> bool:
    """Return whether a file begins with "node, direction, node, direction, value", after comments and the line of
    *MATRIX.
    """
    lines = [line for line in head.split(b"\n")[:-1] if line.strip()] if b"\n" in head else [head]
    while lines and lines[0].lstrip().startswith((b"**", b"*MATRIX")):
        lines.pop(0)
    return bool(lines) and LABELLED.fullmatch(lines[0].rstrip(b"\r")) is not None


ABAQUS = MatrixReader(ABAQUS_NAME, (".mtx",), read_abaqus_matrix, is_abaqus_matrix)


# The stiffness that CalculiX stores by ``*FREQUENCY, SOLVER=MATRIXSTORAGE``: job.sti, with job.dof beside it.
#
# A line of .sti is "row column value", indices from 1, the upper triangle column by column. A line of .dof is
# "node.axis", 12.2 for the second direction of node 12; fixed unknowns, and those that a multi-point constraint
# eliminates, are in neither (ccx 2.20, files of its own making).

CALCULIX_NAME = "CalculiX .sti"
CALCULIX_EXPECTED = "entries of CalculiX's stiffness: row, column, value"
UNKNOWN = re.compile(r"\d{1,12}\.\d{1,2}", re.ASCII)


def read_sti(path: Path) -> MatrixFile:
    """Return the stiffness, its unknowns called "node.axis".

    Raises
    ------
    InvalidProblem
        No such file, no .dof beside it or one of another model, a list of entries that is not whole.
    """
    labels = read_dof(FilePath(path).with_suffix(".dof"))
    ledger = Ledger(str(path))
    table = number_table(path, text_lines(path, CALCULIX_EXPECTED), 3, CALCULIX_EXPECTED)
    row, column = (whole_numbers(path, name, table[:, at]) - 1 for at, name in enumerate(("rows", "columns")))
    if max(row.max(), column.max()) >= len(labels):
        largest = max(row.max(), column.max()) + 1
        raise wrong(path, "indices", f"at most {len(labels)}, the lines of the .dof beside it", largest)
    matrix = symmetric_matrix(path, row, column, table[:, 2], len(labels), ledger)
    ledger.read.append(f"names of the unknowns from {FilePath(path).with_suffix('.dof').name}, such as {labels[0]}")
    ledger.assumed.append("the stiffness is that of the unloaded body: no geometric stiffness of a step before")
    ledger.assumed.append("prescribed displacements are zero: fixed unknowns are not in the file")
    return MatrixFile(matrix, labels, ledger)


def read_dof(path: Path) -> tuple[str, ...]:
    """Return the names "node.axis" of the unknowns, in the order of rows and columns.

    Raises InvalidProblem: no such file, a line that is not such a name, or a name twice.
    """
    expected = "CalculiX's list of unknowns, node.axis a line"
    names = [name for line in text_lines(path, expected) if (name := line.strip())]
    if not names:
        raise wrong(path, "content", expected, "nothing")
    bad = next((i for i, name in enumerate(names) if not UNKNOWN.fullmatch(name)), None)
    if bad is not None:
        raise wrong(path, f"line {bad + 1}", "node.axis", repr(names[bad][:40]))
    if len(set(names)) < len(names):
        seen: set[str] = set()
        again = next(name for name in names if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise wrong(path, "content", "each unknown once", f"{again} twice")
    return tuple(names)


def refuse_mass(path: Path) -> MatrixFile:
    """Refuse a .mas file: same form, other matrix."""
    raise InvalidProblem(f"{path}: expected a stiffness, got CalculiX's mass matrix; the stiffness is in the .sti")


CALCULIX = MatrixReader(CALCULIX_NAME, (".sti",), read_sti, stiffness=True, beside=(".dof", ".mas"))
MASS = MatrixReader("CalculiX .mas", (".mas",), refuse_mass)
