"""Constraint rows E over the unknowns of all ranks, and access to the rows of a matrix in PETSc's memory."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.ranks import block_type, entries_of_rows, petsc
from contactqp.errors import BackendFailed, Unsupported
from contactqp.model.arrays import Array, Index, Indices, Vector


class Rows:
    """The a rows of one rank, which may touch unknowns of other ranks.

    The constructor and all methods except `with_entries` are collective.

    Parameters
    ----------
    entries : (a, t) sparse matrix, the coefficients at the touched unknowns
    touched : (t,) array of int, the unknowns that the columns stand for, in PETSc's numbering of all ranks, each once
    like : PETSc.Mat, a matrix whose columns are distributed as the unknowns are: K
    """

    def __init__(self, entries: Any, touched: Index, like: Any) -> None:
        PETSc = petsc()
        self.entries = sp.csr_matrix(entries)
        self.touched = np.asarray(touched, dtype=PETSc.IntType)
        self.like = like
        self._everywhere = like.createVecRight()
        self._here = PETSc.Vec().createSeq(len(self.touched), comm=PETSc.COMM_SELF)
        there = PETSc.IS().createGeneral(self.touched, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(self._everywhere, there, self._here, None)

    @classmethod
    def from_csr(cls, rows: Any, like: Any, numbers: Index | None = None) -> Rows:
        """Make rows from CSR rows of this rank over the unknowns of all ranks. Collective.

        With `numbers`, column j of the CSR rows is the unknown numbers[j].
        """
        touched, place = np.unique(rows.indices, return_inverse=True)
        entries = sp.csr_matrix((rows.data, place.ravel(), rows.indptr), (len(rows.indptr) - 1, len(touched)))
        return cls(entries, touched if numbers is None else numbers[touched], like)

    def with_entries(self, entries: Any) -> Rows:
        """Return rows with other entries at the same unknowns."""
        other = copy(self)
        other.__dict__.pop("sizes", None)
        other.entries = sp.csr_matrix(entries)
        return other

    @property
    def count(self) -> int:
        """Return the number a of rows on this rank."""
        return int(self.entries.shape[0])

    @cached_property
    def sizes(self) -> sp.csr_matrix:
        """Return |E| (a, t)."""
        return abs(self.entries)

    def at_touched(self, x: Vector) -> Vector:
        """Return the values (t,) of a distributed vector at the unknowns touched by the rows of this rank."""
        self._everywhere.array[:] = x
        self._scatter.scatter(self._everywhere, self._here, addv=False, mode="forward")
        return np.array(self._here.array)

    def assembled(self, values: Vector) -> Vector:
        """Return the distributed vector of the sums of values (t,) of all ranks at touched unknowns."""
        self._here.array[:] = values
        self._everywhere.set(0.0)
        self._scatter.scatter(self._here, self._everywhere, addv=True, mode="reverse")
        return np.array(self._everywhere.array)

    def lengths(self, x: Vector) -> Vector:
        """Return E x (a,)."""
        return np.asarray(self.entries @ self.at_touched(x))

    def length_sizes(self, x: Vector) -> Vector:
        """Return |E||x| (a,)."""
        return np.asarray(self.sizes @ self.at_touched(abs(x)))

    def forces(self, force: Vector) -> Vector:
        """Return E'l (n_here,)."""
        return self.assembled(self.entries.T @ force)

    def force_sizes(self, force: Vector) -> Vector:
        """Return |E|'|l| (n_here,)."""
        return self.assembled(self.sizes.T @ abs(force))


# The rows of a matrix are read in PETSc's memory, as a copy would be as large as the matrix. petsc4py returns entries
# as copies only, but the C functions of its library return their addresses.

# Rows of blocks copied at a time: about 0.01 GB with the eighty entries per row of bodies in space.
AT_A_TIME = 2**12


@dataclass(frozen=True, eq=False)
class StoredBlocks:
    """Blocks in compressed rows, in PETSc's memory."""

    indptr: NDArray[Any]
    indices: NDArray[Any]
    values: Array  # (stored, rows of a block, columns of a block)
    columns: int  # the number of columns of blocks

    def rows(self, begin: int, end: int) -> sp.bsr_matrix:
        """Return the rows of blocks begin, ..., end - 1; their values are a copy."""
        cut = slice(self.indptr[begin], self.indptr[end])
        return self._matrix(cut, self.indptr[begin : end + 1] - self.indptr[begin])

    def chosen(self, blocks: NDArray[Any]) -> sp.bsr_matrix:
        """Return a copy of some rows of blocks."""
        entries, counts = entries_of_rows(self.indptr, blocks)
        return self._matrix(entries, np.append(0, np.cumsum(counts)))

    def _matrix(self, entries: Any, indptr: NDArray[Any]) -> sp.bsr_matrix:
        _, height, width = self.values.shape
        parts = np.array(self.values[entries], order="C"), self.indices[entries], indptr
        return sp.bsr_matrix(parts, shape=((len(indptr) - 1) * height, self.columns * width))


@dataclass(frozen=True, eq=False)
class StoredRows:
    """The rows of a distributed matrix on this rank, split by the rank of their columns.

    Attributes
    ----------
    size : the number of unknowns of a block
    first : the number of this rank's first block among those of all ranks
    here : the entries in columns of this rank
    away : the entries in the columns `others`
    others : array of int, numbers of blocks of other ranks, ascending
    """

    size: int
    first: int
    here: StoredBlocks
    away: StoredBlocks
    others: NDArray[Any]

    def parts(self) -> Iterator[tuple[int, int]]:
        """Yield ranges (begin, end) of rows of blocks small enough to be copied."""
        count = len(self.here.indptr) - 1
        for begin in range(0, count, AT_A_TIME):
            yield begin, min(begin + AT_A_TIME, count)

    @property
    def unknowns_of_others(self) -> NDArray[Any]:
        """Return the numbers of the unknowns in the blocks `others`."""
        return (self.others[:, None] * self.size + np.arange(self.size)).ravel()


@contextmanager
def stored_rows(matrix: Any) -> Iterator[StoredRows]:
    """Open the rows of this rank; the matrix must not be changed within the context. Not collective.

    Raises Unsupported: the matrix has another type.

    Parameters
    ----------
    matrix : PETSc.Mat, AIJ of single unknowns, or BAIJ
    """
    size, (first, last) = matrix.getBlockSize(), matrix.getOwnershipRange()
    kind = block_type(size).upper()
    if matrix.getType() not in (f"seq{kind}".lower(), f"mpi{kind}".lower()):
        raise Unsupported(
            f"stiffness: expected PETSc's {kind} for blocks of {size} unknowns, got {matrix.getType()}; "
            "contactqp.distributed.ranks.block_matrix makes it"
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
        others = _array_at(numbers, columns.value // size, petsc().IntType)
        own = _stored(stack, kind, diagonal, size, count)
        yield StoredRows(size, first // size, own, _stored(stack, kind, beside, size, len(others)), others)


def chosen_rows(matrix: Any, chosen: Indices) -> sp.csr_matrix:
    """Return a copy of some rows of this rank, numbered from its first, over the unknowns of all ranks."""
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
    """Return the blocks of a matrix of one process, which are returned to PETSc when the stack closes."""
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
    indptr = _array_at(begins, rows.value + 1, PETSc.IntType)
    stored = int(indptr[-1])
    blocks = _array_at(values, stored * size**2, PETSc.ScalarType).reshape(stored, size, size)
    # PETSc stores a block column by column.
    return StoredBlocks(indptr, _array_at(numbers, stored, PETSc.IntType), blocks.transpose(0, 2, 1), columns)


def _array_at(start: ctypes.c_void_p, count: int, dtype: Any) -> NDArray[Any]:
    """Return a read-only array at an address."""
    if not count:
        return np.zeros(0, dtype=dtype)
    kind = np.ctypeslib.as_ctypes_type(dtype)
    found = np.ctypeslib.as_array(ctypes.cast(start, ctypes.POINTER(kind)), (count,))
    found.flags.writeable = False
    return found


def _integer() -> Any:
    """Return a PetscInt of value zero."""
    return np.ctypeslib.as_ctypes_type(petsc().IntType)()


def _call(name: str, *arguments: Any) -> None:
    """Call a C function of PETSc by name."""
    if code := _library()[name](*arguments):
        raise petsc().Error(code)


@cache
def _library() -> Any:
    return ctypes.CDLL(petsc().__file__)
