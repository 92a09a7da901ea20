"""Rows E over the unknowns of all ranks: each stands on one rank, what it touches may stand on others."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import block_type, petsc
from contactqp.errors import BackendFailed, Unsupported
from contactqp.model.arrays import Vector


class Rows:
    """The rows of one rank. Making them is collective, and so are `lengths` and `forces`.

    Parameters
    ----------
    entries : (a, t) sparse matrix
    touched : (t,) array of int
        The unknowns of all ranks that the columns stand for, in PETSc's numbering, each once.
    like : PETSc.Mat
        K: it says which rank has which unknowns.
    """

    def __init__(self, entries: Any, touched: NDArray[np.int64], like: Any) -> None:
        PETSc = petsc()
        self.entries = sp.csr_matrix(entries)
        self.touched = np.asarray(touched, dtype=PETSc.IntType)
        self.like = like
        self._everywhere = like.createVecRight()
        self._here = PETSc.Vec().createSeq(len(self.touched), comm=PETSc.COMM_SELF)
        there = PETSc.IS().createGeneral(self.touched, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(self._everywhere, there, self._here, None)

    @classmethod
    def over_touched(cls, rows: Any, like: Any) -> Rows:
        """Make rows of CSR rows over the unknowns of all ranks. Collective."""
        touched, place = np.unique(rows.indices, return_inverse=True)
        shape = (len(rows.indptr) - 1, len(touched))
        return cls(sp.csr_matrix((rows.data, place.ravel(), rows.indptr), shape=shape), touched, like)

    def standing(self, entries: Any) -> Rows:
        """Other rows over the same unknowns; not collective."""
        other = copy(self)
        other.entries = sp.csr_matrix(entries)
        return other

    @property
    def count(self) -> int:
        """a."""
        return int(self.entries.shape[0])

    def near(self, x: Vector) -> Vector:
        """(t,) the values of x at what the rows of this rank touch."""
        self._everywhere.array[:] = x
        self._scatter.scatter(self._everywhere, self._here, addv=False, mode="forward")
        return np.array(self._here.array)

    def spread(self, values: Vector) -> Vector:
        """The sum over the ranks of values (t,) at what their rows touch, as a vector of all unknowns."""
        self._here.array[:] = values
        self._everywhere.set(0.0)
        self._scatter.scatter(self._here, self._everywhere, addv=True, mode="reverse")
        return np.array(self._everywhere.array)

    def lengths(self, x: Vector) -> Vector:
        """(a,) E x."""
        return np.asarray(self.entries @ self.near(x))

    def forces(self, force: Vector) -> Vector:
        """E'l."""
        return self.spread(self.entries.T @ force)

    def matrix(self, scale: Vector | None = None) -> Any:
        """E, its columns scaled by a vector over all unknowns, as PETSc.Mat. Collective."""
        PETSc = petsc()
        entries = self.entries if scale is None else sp.csr_matrix(self.entries.multiply(self.near(scale)[None, :]))
        n = self._everywhere.getSizes()
        indices = self.touched[entries.indices]
        csr = (entries.indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), entries.data)
        return PETSc.Mat().createAIJ(size=((self.count, None), n), csr=csr, comm=self._everywhere.comm)


# The rows of a matrix on this rank where PETSc has them: a copy would take as much as the matrix.
#
# petsc4py shows entries in copies only; PETSc's own functions, which it has loaded, say where they lie.

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
            "contactqp.distributed.environment.held_in_blocks makes it"
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
