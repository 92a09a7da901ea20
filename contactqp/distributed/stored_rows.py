"""The rows of a matrix on this rank where PETSc has them: a copy would take as much as the matrix.

petsc4py shows entries in copies only; PETSc's own functions, which it has loaded, say where they lie.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.formats import block_type
from contactqp.errors import BackendFailed, Unsupported

# Blocks of rows that are copied at a time: with the eighty entries a row of bodies in space some 0.01 GB.
AT_A_TIME = 2**12


@dataclass(frozen=True, eq=False)
class StoredBlocks:
    """Blocks in compressed rows, as PETSc stores them: nothing is copied."""

    indptr: NDArray[Any]
    indices: NDArray[Any]
    values: NDArray[np.float64]  # (stored, size, size)
    columns: int  # blocks of a row

    def rows(self, begin: int, end: int) -> sp.bsr_matrix:
        """The rows of blocks from one to before another, their values a copy."""
        cut = slice(self.indptr[begin], self.indptr[end])
        return self._matrix(cut, self.indptr[begin : end + 1] - self.indptr[begin])

    def chosen(self, blocks: NDArray[Any]) -> sp.bsr_matrix:
        """Some rows of blocks, copied."""
        count = np.diff(self.indptr)[blocks]
        ends = np.append(0, np.cumsum(count))
        return self._matrix(np.repeat(self.indptr[blocks] - ends[:-1], count) + np.arange(ends[-1]), ends)

    def _matrix(self, entries: Any, indptr: NDArray[Any]) -> sp.bsr_matrix:
        size = self.values.shape[1]
        parts = np.array(self.values[entries], order="C"), self.indices[entries], indptr
        return sp.bsr_matrix(parts, shape=((len(indptr) - 1) * size, self.columns * size))


@dataclass(frozen=True, eq=False)
class StoredRows:
    """The rows of this rank in blocks: what couples them with one another, and what with blocks of other ranks.

    Attributes
    ----------
    size : int
        Unknowns of a block.
    first : int
        The number of this rank's first block among those of all ranks.
    here : StoredBlocks
        Over the blocks of this rank.
    away : StoredBlocks
        Over the blocks `others`.
    others : array of int
        Numbers of blocks of other ranks, ascending.
    """

    size: int
    first: int
    here: StoredBlocks
    away: StoredBlocks
    others: NDArray[Any]

    def parts(self) -> Iterator[tuple[int, int]]:
        """From which row of blocks to before which, some at a time."""
        count = len(self.here.indptr) - 1
        for begin in range(0, count, AT_A_TIME):
            yield begin, min(begin + AT_A_TIME, count)

    @property
    def unknowns_of_others(self) -> NDArray[Any]:
        """The numbers of the unknowns of `others`."""
        return (self.others[:, None] * self.size + np.arange(self.size)).ravel()


@contextmanager
def stored_rows(matrix: Any) -> Iterator[StoredRows]:
    """The rows of this rank, as long as the context lasts; the matrix must stay as it is meanwhile. Not collective.

    Parameters
    ----------
    matrix : PETSc.Mat
        AIJ of single unknowns, or BAIJ.

    Raises
    ------
    Unsupported
        It is of another type.
    """
    size, (first, last) = matrix.getBlockSize(), matrix.getOwnershipRange()
    kind = block_type(size).upper()
    if matrix.getType() not in (f"seq{kind}".lower(), f"mpi{kind}".lower()):
        raise Unsupported(
            f"stiffness: expected PETSc's {kind} for blocks of {size} unknowns, got {matrix.getType()}; "
            "contactqp.distributed.formats.held_in_blocks makes it"
        )
    here, count = ctypes.c_void_p(matrix.handle), (last - first) // size
    with ExitStack() as stack:
        if matrix.comm.size == 1:
            own = _stored(stack, kind, here, size, count)
            none = np.zeros(0, dtype=petsc().IntType)
            away = StoredBlocks(np.zeros_like(own.indptr), none, np.zeros((0, size, size)), 0)
            yield StoredRows(size, first // size, own, away, none)
            return
        diagonal, beside, numbers = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
        _call(f"MatMPI{kind}GetSeq{kind}", here, *map(ctypes.byref, (diagonal, beside, numbers)))
        columns = _integer()
        _call("MatGetSize", beside, None, ctypes.byref(columns))
        others = _seen(numbers, columns.value // size, petsc().IntType)
        own = _stored(stack, kind, diagonal, size, count)
        yield StoredRows(size, first // size, own, _stored(stack, kind, beside, size, len(others)), others)


def chosen_rows(matrix: Any, chosen: NDArray[np.intp]) -> sp.csr_matrix:
    """A copy of some rows of this rank over the unknowns of all ranks."""
    with stored_rows(matrix) as stored:
        blocks = np.unique(chosen // stored.size)
        rows = sp.hstack([part.chosen(blocks) for part in (stored.here, stored.away)], format="csr")
        own = np.arange(*matrix.getOwnershipRange())
        number = np.concatenate([own, stored.unknowns_of_others])
        place = np.searchsorted(blocks, chosen // stored.size) * stored.size + chosen % stored.size
    rows = rows[place]
    shape = (len(chosen), matrix.getSize()[1])
    return sp.csr_matrix((rows.data, number[rows.indices], rows.indptr), shape=shape)


def _stored(stack: ExitStack, kind: str, matrix: ctypes.c_void_p, size: int, columns: int) -> StoredBlocks:
    """The blocks of a matrix of one process."""
    PETSc = petsc()
    rows, begins, numbers = _integer(), ctypes.c_void_p(), ctypes.c_void_p()
    found, values = ctypes.c_int(), ctypes.c_void_p()
    structure = (matrix, _integer(), ctypes.c_int(0), ctypes.c_int(size > 1))
    places = [ctypes.byref(item) for item in (rows, begins, numbers, found)]
    _call("MatGetRowIJ", *structure, *places)
    if not found:
        raise BackendFailed(f"PETSc shows no rows of this matrix as {kind}")
    stack.callback(_call, "MatRestoreRowIJ", *structure, *places)
    get, restore = {"AIJ": ("GetArrayRead", "RestoreArrayRead"), "BAIJ": ("GetArray", "RestoreArray")}[kind]
    _call(f"MatSeq{kind}{get}", matrix, ctypes.byref(values))
    stack.callback(_call, f"MatSeq{kind}{restore}", matrix, ctypes.byref(values))
    indptr = _seen(begins, rows.value + 1, PETSc.IntType)
    stored = int(indptr[-1])
    blocks = _seen(values, stored * size**2, PETSc.ScalarType).reshape(stored, size, size)
    # PETSc stores a block column by column.
    return StoredBlocks(indptr, _seen(numbers, stored, PETSc.IntType), blocks.transpose(0, 2, 1), columns)


def _seen(start: ctypes.c_void_p, count: int, dtype: Any) -> NDArray[Any]:
    """An array where it lies in memory; it cannot be written to."""
    if not count:
        return np.zeros(0, dtype=dtype)
    kind = np.ctypeslib.as_ctypes_type(dtype)
    found = np.ctypeslib.as_array(ctypes.cast(start, ctypes.POINTER(kind)), (count,))
    found.flags.writeable = False
    return found


def _integer() -> Any:
    """A PetscInt, zero."""
    return np.ctypeslib.as_ctypes_type(petsc().IntType)()


def _call(name: str, *arguments: Any) -> None:
    """One of PETSc's functions, by its name in C."""
    if code := _library()[name](*arguments):
        raise petsc().Error(code)


@cache
def _library() -> Any:
    return ctypes.CDLL(petsc().__file__)
