"""Levels of smoothed aggregation on the aggregates that PETSc's GAMG makes, as `contactqp.multigrid` has them.

    P = (I - 4/(3 rho) D^-1 K) T,    K_coarse = P'K P,

T from GAMG without smoothing. Both products are made of some rows of K at a time, in blocks of nodes: GAMG's own hold
K P as a whole, which on several ranks takes more than K.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.ranks import Ranks, Vector
from contactqp.distributed.row_parts import AT_A_TIME, row_parts
from contactqp.distributed.rows import Rows
from contactqp.multigrid import JACOBI, largest_eigenvalue


class Product:
    """x -> K x of a matrix that PETSc holds. Collective."""

    def __init__(self, matrix: Any) -> None:
        self._matrix = matrix
        self._at, self._into = matrix.createVecs()

    def __call__(self, x: Vector) -> Vector:
        self._at.array[:] = x
        self._matrix.mult(self._at, self._into)
        return np.array(self._into.array)


@dataclass(frozen=True, eq=False)
class Tentative:
    """T of one level: its rows on this rank over all coarse unknowns, and where those of each rank begin."""

    rows: sp.bsr_matrix
    starts: NDArray[Any]  # (ranks + 1,)

    @classmethod
    def of(cls, matrix: Any) -> Tentative:
        """Of a PETSc.Mat, which is not kept."""
        indptr, indices, values = matrix.getValuesCSR()
        rows = sp.csr_matrix((values, indices, indptr), shape=(len(indptr) - 1, matrix.getSize()[1]))
        return cls(rows.tobsr(matrix.getBlockSizes()), np.array(matrix.getOwnershipRangesColumn()))


@dataclass(frozen=True, eq=False)
class DistributedLevel:
    """One level: its matrix as a product, D, the largest eigenvalue of D^-1 K, and P to the next coarser one."""

    ranks: Ranks
    product: Product
    diagonal: Vector
    largest: float
    prolong: Rows


def smoothed_levels(
    ranks: Ranks, stiffness: Any, tentative: list[Tentative], diagonal: Vector
) -> tuple[list[DistributedLevel], Any]:
    """All levels but the coarsest, from the finest on, and the matrix of the coarsest. Collective.

    Parameters
    ----------
    stiffness : PETSc.Mat
        K of the finest level.
    tentative : list of Tentative
        T of each level.
    diagonal : (n_here,) array
        D of the finest level, positive.
    """
    levels: list[DistributedLevel] = []
    matrix, D = stiffness, diagonal
    for T in tentative:
        product = Product(matrix)
        largest = largest_eigenvalue(product, D, ranks.dot)
        blocks = _Blocks(ranks, matrix, T.rows.blocksize[0])
        prolong = blocks.smoothed(T.rows, JACOBI / largest / D)
        coarse = blocks.galerkin(prolong, T.starts)
        levels.append(DistributedLevel(ranks, product, D, largest, _rows_of(prolong, coarse)))
        matrix, D = coarse, positive_diagonal(coarse)
    return levels, matrix


def positive_diagonal(matrix: Any) -> Vector:
    """A coarse unknown that an aggregate had no motion for has a zero row: one stands for its diagonal."""
    diagonal = np.array(matrix.getDiagonal().array)
    return np.where(diagonal > 0, diagonal, 1.0)


class _Blocks:
    """Products with a matrix that PETSc holds, of some of its rows at a time, in blocks of nodes.

    Matrices over the coarse unknowns have the columns of all ranks here, of which few are filled.

    Parameters
    ----------
    size : int
        The unknowns of a block.
    """

    def __init__(self, ranks: Ranks, matrix: Any, size: int) -> None:
        self._ranks, self._matrix, self._size = ranks, matrix, size
        self._starts = np.asarray(matrix.getOwnershipRanges()) // size
        self._first, self._last = self._starts[ranks.rank], self._starts[ranks.rank + 1]
        self._away = self._coupled()

    def _coupled(self) -> NDArray[Any]:
        """The blocks of other ranks that some rows here couple with."""
        found = [np.zeros(0, dtype=self._starts.dtype)]
        for part in row_parts(self._ranks, self._matrix):
            block = part.indices // self._size
            found.append(np.unique(block[(block < self._first) | (block >= self._last)]))
        return np.unique(np.concatenate(found))

    def smoothed(self, tentative: sp.bsr_matrix, damping: Vector) -> sp.bsr_matrix:
        """(I - damping K) T, the rows of this rank."""
        scale, unit = damping.reshape(-1, self._size, 1), np.eye(self._size)
        near = self._with_those_away(tentative)
        parts = []
        for begin, K in self._parts():
            row = np.repeat(np.arange(len(K.indptr) - 1), np.diff(K.indptr)) + begin // self._size
            K.data *= -scale[row]
            K.data[K.indices == row] += unit
            parts.append(sp.bsr_matrix(K @ near, blocksize=tentative.blocksize))
        return _stacked(parts)

    def galerkin(self, prolong: sp.bsr_matrix, starts: NDArray[Any]) -> Any:
        """P'K P as PETSc.Mat, its unknowns dealt to the ranks as told."""
        size = prolong.blocksize[1]
        blocksize = (size, size)
        near = self._with_those_away(prolong)
        product = sp.bsr_matrix((prolong.shape[1], prolong.shape[1]), blocksize=blocksize)
        for begin, K in self._parts():
            moved = sp.bsr_matrix(K @ near, blocksize=prolong.blocksize)
            product = product + sp.bsr_matrix(_cut(prolong, begin, K.shape[0]).T @ moved, blocksize=blocksize)
        row = np.repeat(np.arange(len(product.indptr) - 1), np.diff(product.indptr))
        owner = np.searchsorted(starts // size, row, side="right") - 1
        row, column, values = self._ranks.exchanged(owner, row, product.indices, product.data)
        first, last = starts[self._ranks.rank], starts[self._ranks.rank + 1]
        shape = (int(last - first), product.shape[1])
        return _petsc(self._matrix.comm, _bsr(row - first // size, column, values, shape))

    def _parts(self) -> Iterator[tuple[int, sp.bsr_matrix]]:
        """Some rows of K from a place on, over the unknowns of this rank and then those away."""
        here = self._last - self._first
        for part in row_parts(self._ranks, self._matrix, AT_A_TIME // self._size * self._size):
            columns = part.indices - self._first * self._size
            elsewhere = np.flatnonzero((columns < 0) | (columns >= here * self._size))
            block, inner = np.divmod(part.indices[elsewhere], self._size)
            columns[elsewhere] = (here + np.searchsorted(self._away, block)) * self._size + inner
            shape = (part.end - part.begin, int(here + len(self._away)) * self._size)
            rows = sp.csr_matrix((part.values, columns, part.indptr), shape=shape)
            yield part.begin, rows.tobsr((self._size, self._size))

    def _with_those_away(self, rows: sp.bsr_matrix) -> sp.bsr_matrix:
        """Rows of this rank, and below those of the blocks of others."""
        owner = np.searchsorted(self._starts, self._away, side="right") - 1
        asked, asker = self._ranks.exchanged(owner, self._away, np.full(len(self._away), self._ranks.rank))
        place = asked - self._first
        begin, count = rows.indptr[place], np.diff(rows.indptr)[place]
        entry = np.repeat(begin - (np.cumsum(count) - count), count) + np.arange(count.sum())
        block, column, values = self._ranks.exchanged(
            np.repeat(asker, count), np.repeat(asked, count), rows.indices[entry], rows.data[entry]
        )
        shape = (len(self._away) * self._size, rows.shape[1])
        return _stacked([rows, _bsr(np.searchsorted(self._away, block), column, values, shape)])


def _bsr(row: NDArray[Any], column: NDArray[Any], values: NDArray[np.float64], shape: tuple[int, int]) -> sp.bsr_matrix:
    """Blocks at rows and columns of blocks; those at one place are added."""
    order = np.argsort(row, kind="stable")
    indptr = np.append(0, np.cumsum(np.bincount(row, minlength=shape[0] // values.shape[1])))
    matrix = sp.bsr_matrix((values[order], column[order], indptr), shape=shape)
    matrix.sum_duplicates()
    return matrix


def _cut(matrix: sp.bsr_matrix, begin: int, count: int) -> sp.bsr_matrix:
    """Some of the rows, whole blocks."""
    size = matrix.blocksize[0]
    indptr = matrix.indptr[begin // size : (begin + count) // size + 1]
    entries = slice(indptr[0], indptr[-1])
    parts = matrix.data[entries], matrix.indices[entries], indptr - indptr[0]
    return sp.bsr_matrix(parts, shape=(count, matrix.shape[1]))


def _stacked(parts: list[sp.bsr_matrix]) -> sp.bsr_matrix:
    """One below the other."""
    ends = np.cumsum([part.indptr[-1] for part in parts])
    indptr = [parts[0].indptr] + [part.indptr[1:] + end for part, end in zip(parts[1:], ends, strict=False)]
    indices, data = [part.indices for part in parts], [part.data for part in parts]
    shape = (sum(part.shape[0] for part in parts), parts[0].shape[1])
    return sp.bsr_matrix((np.concatenate(data), np.concatenate(indices), np.concatenate(indptr)), shape=shape)


def _petsc(comm: Any, rows: sp.bsr_matrix) -> Any:
    """Rows of this rank over the unknowns of all, as PETSc.Mat."""
    PETSc = petsc()
    block = rows.blocksize[0]
    csr = rows.tocsr()
    matrix = PETSc.Mat().create(comm)
    matrix.setType("aij")
    matrix.setSizes(((rows.shape[0], rows.shape[1]), (rows.shape[0], rows.shape[1])))
    matrix.setBlockSize(block)
    matrix.setPreallocationCSR((csr.indptr.astype(PETSc.IntType), csr.indices.astype(PETSc.IntType), csr.data))
    matrix.assemble()
    return matrix


def _rows_of(prolong: sp.bsr_matrix, coarse: Any) -> Rows:
    """P over the coarse unknowns that it touches."""
    size = prolong.blocksize[1]
    blocks, place = np.unique(prolong.indices, return_inverse=True)
    shape = (prolong.shape[0], len(blocks) * size)
    entries = sp.bsr_matrix((prolong.data, place.ravel(), prolong.indptr), shape=shape)
    return Rows(entries, (blocks[:, None] * size + np.arange(size)).ravel(), coarse)
