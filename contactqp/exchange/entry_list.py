"""Symmetric matrices that a program printed as a list of entries, one triangle or both, a line each."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.exchange.ledger import Ledger
from contactqp.exchange.refusal import Path, check_finite, one_line, wrong
from contactqp.model.arrays import Vector

Integers = NDArray[np.int64]
# Floats hold every integer up to here.
EXACT = 2**53


def number_table(path: Path, lines: Iterable[str], columns: int, expected: str) -> NDArray[np.float64]:
    """(rows, columns) the numbers of a text, apart by blanks.

    Raises
    ------
    InvalidProblem
        No number at all, a word that is none, a line of another length.
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


def whole_numbers(path: Path, place: str, values: Vector, least: int = 1) -> Integers:
    """The values as integers.

    Raises
    ------
    InvalidProblem
        One is no integer, or below `least`, or beyond what a float counts exactly.
    """
    bad = np.flatnonzero(~((values == np.floor(values)) & (values >= least) & (values < EXACT)))
    if bad.size:
        raise wrong(path, place, f"whole numbers from {least} on", f"{values[bad[0]]:g} in line {bad[0] + 1}")
    return np.asarray(values, dtype=np.int64)


def symmetric_matrix(path: Path, row: Integers, column: Integers, value: Vector, size: int, ledger: Ledger) -> Any:
    """The matrix (size, size) of a list of entries, indices from 0; one triangle is mirrored.

    Raises
    ------
    InvalidProblem
        A value that is not finite, an entry given twice, some mirrored and some not, a missing diagonal entry: no
        stiffness has a zero there, so that the list must have been cut off.
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
