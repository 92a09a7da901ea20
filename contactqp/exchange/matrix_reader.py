"""The interface of matrix readers, and FCLIB's and SciPy's ways to store a sparse matrix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, shown
from contactqp.exchange.files import Ledger, Path, check_finite, check_rows, wrong
from contactqp.model.arrays import Vector

# The three ways in which FCLIB stores a sparse matrix, and SciPy's.
#
# nz = -1: compressed columns, p the n + 1 column pointers, i the rows; nz = -2: compressed rows, p the m + 1 row
# pointers, i the columns; nz >= 0: nz triplets, p the COLUMN and i the row of each, as in CSparse (the comment in
# fclib.h says it the other way round, FCLIB's files do not). The arrays may be longer than what is used of them: nzmax
# is what was allocated.

Storage = Literal["csc", "csr", "triplet"]
COLUMNS, ROWS = -1, -2
MARKS: dict[str, int] = {"csc": COLUMNS, "csr": ROWS}
LARGEST_INT = int(np.iinfo(np.int32).max)

Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class StoredMatrix:
    """A matrix as FCLIB's file holds it."""

    nzmax: int
    m: int
    n: int
    nz: int
    p: Integers
    i: Integers
    x: NDArray[np.float64]


def matrix_of(stored: StoredMatrix, path: Path, place: str) -> Any:
    """Return the matrix in CSR form; entries that are stored twice are summed.

    Raises
    ------
    InvalidProblem
        A storage that does not exist, too few entries, pointers that go back, an index outside, a NaN.
    """
    if stored.nz < ROWS:
        raise wrong(path, f"{place}/nz", "-1 (columns), -2 (rows) or a number of triplets", stored.nz)
    if min(stored.m, stored.n) < 0:
        raise wrong(path, f"{place}/m, {place}/n", "a size", (stored.m, stored.n))
    check_rows(path, f"{place}/m", stored.m)
    row, column, used = _triplets(stored, path, place) if stored.nz >= 0 else _compressed(stored, path, place)
    x = stored.x[:used]
    check_finite(path, f"{place}/x", x)
    return sp.csr_array(sp.coo_array((x, (row, column)), shape=(stored.m, stored.n)))


def _triplets(stored: StoredMatrix, path: Path, place: str) -> tuple[Integers, Integers, int]:
    used = stored.nz
    _enough(stored, used, path, place, {"p": stored.p, "i": stored.i, "x": stored.x})
    row, column = stored.i[:used], stored.p[:used]
    _inside(row, stored.m, path, f"{place}/i (rows)")
    _inside(column, stored.n, path, f"{place}/p (columns)")
    return row, column, used


def _compressed(stored: StoredMatrix, path: Path, place: str) -> tuple[Integers, Integers, int]:
    lines, width = (stored.n, stored.m) if stored.nz == COLUMNS else (stored.m, stored.n)
    p = stored.p
    if len(p) < lines + 1:
        raise wrong(path, f"{place}/p", f"{lines + 1} pointers", len(p))
    p = p[: lines + 1]
    if p[0] != 0 or np.any(np.diff(p) < 0):
        raise wrong(path, f"{place}/p", "pointers that begin at 0 and never go back", _first_fault(p))
    used = int(p[-1])
    _enough(stored, used, path, place, {"i": stored.i, "x": stored.x})
    index = stored.i[:used]
    _inside(index, width, path, f"{place}/i")
    line = np.repeat(np.arange(lines), np.diff(p))
    return (index, line, used) if stored.nz == COLUMNS else (line, index, used)


def _first_fault(pointers: Integers) -> str:
    if pointers[0] != 0:
        return f"{pointers[0]} at [0]"
    at = int(np.argmax(np.diff(pointers) < 0))
    return f"{pointers[at]} and then {pointers[at + 1]} at [{at + 1}]"


def _enough(stored: StoredMatrix, used: int, path: Path, place: str, arrays: dict[str, NDArray[Any]]) -> None:
    if stored.nzmax < used:
        raise wrong(path, f"{place}/nzmax", f"at least the {used} entries that are stored", stored.nzmax)
    for name, values in arrays.items():
        if len(values) < used:
            raise wrong(path, f"{place}/{name}", f"{used} entries", len(values))


def _inside(index: Integers, size: int, path: Path, place: str) -> None:
    outside = np.flatnonzero((index < 0) | (index >= size))
    if outside.size:
        raise wrong(path, place, f"indices from 0 to {size - 1}", f"{index[outside[0]]} at [{outside[0]}]")


def stored_form(matrix: Any, storage: Storage, name: str) -> StoredMatrix:
    """Return a matrix as FCLIB stores it, nzmax = nz, no entry twice.

    Raises
    ------
    InvalidProblem
        A storage that FCLIB does not have, or a matrix that FCLIB's 32 bits do not hold.
    """
    if storage not in ("csc", "csr", "triplet"):
        raise InvalidProblem(f"storage: expected 'csc', 'csr' or 'triplet', got {shown(storage)}")
    entries = sp.csc_array(matrix) if storage == "csc" else sp.csr_array(matrix)
    entries.sort_indices()
    if max(entries.nnz, *entries.shape) > LARGEST_INT:
        raise InvalidProblem(f"{name}: FCLIB's integers have 32 bits, got shape {entries.shape}, {entries.nnz} entries")
    if storage == "triplet":
        list_ = entries.tocoo()
        p, i, x, nz = list_.col, list_.row, list_.data, entries.nnz
    else:
        p, i, x, nz = entries.indptr, entries.indices, entries.data, MARKS[storage]
    m, n = entries.shape
    return StoredMatrix(entries.nnz, m, n, nz, p, i, np.asarray(x, dtype=float))


class MatrixFile(NamedTuple):
    """A matrix from a file."""

    matrix: Any  # dense or sparse, any numbers: NaN is for the problem to refuse, which knows what they mean
    labels: tuple[str, ...] | None  # what the unknowns are called, such as "12.x", in the order of the columns
    ledger: Ledger


def say_sums(ledger: Ledger, stored: int, different: int) -> None:
    """Entries of a sparse matrix that are stored more than once add up, as in every assembly."""
    if stored > different:
        ledger.converted.append(f"{stored - different} entries are stored more than once: added up")


@dataclass(frozen=True)
class MatrixReader:
    """A format of matrices or vectors."""

    name: str
    suffixes: tuple[str, ...]  # lower case, with their dots
    read: Callable[[Path], MatrixFile]
    known: Callable[[bytes], bool] | None = None  # whether these first bytes are unmistakably of this format
    stiffness: bool = False  # files of this suffix hold a stiffness, whatever they are called
    load: Callable[[Path], tuple[Vector, Ledger] | None] | None = None  # the load stored with the stiffness, if any
    beside: tuple[str, ...] = ()  # suffixes of files that it reads along with its own, such as those of names
