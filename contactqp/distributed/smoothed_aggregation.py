"""Levels of smoothed aggregation on the aggregates that PETSc's GAMG makes, as `contactqp.linalg.multigrid` has them.

    P = (I - 4/(3 rho) D^-1 K) T,    K_coarse = P'K P,

T of the motions that cost little energy. Both products are made of some rows of K at a time, in blocks of nodes: GAMG's
own hold K P as a whole, which on several ranks takes more than K.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.aggregates import Tentative, aggregates, tentative
from contactqp.distributed.formats import held_in_blocks
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows
from contactqp.distributed.rows_of_others import rows_of_others
from contactqp.distributed.stored_rows import StoredRows, stored_rows
from contactqp.linalg.multigrid import JACOBI, constants, largest_eigenvalue, of_size_one
from contactqp.model.arrays import Vector

# Unknowns of the coarsest level: a dense factor on every rank, part of it anew for every contact set.
COARSEST = 600


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
class DistributedLevel:
    """One level: its matrix as a product, D, the largest eigenvalue of D^-1 K, and P to the next coarser one."""

    ranks: Ranks
    product: Product
    diagonal: Vector
    largest: float
    prolong: Rows


def smoothed_levels(
    ranks: Ranks, stiffness: Any, diagonal: Vector, motions: NDArray[np.float64]
) -> tuple[list[DistributedLevel], Any]:
    """All levels but the coarsest, from the finest on, and the matrix of the coarsest. Collective.

    Parameters
    ----------
    stiffness : PETSc.Mat
        K of the finest level.
    diagonal : (n_here,) array
        D of the finest level, positive.
    motions : (n_here, q) array
        What costs little energy.

    Raises
    ------
    PETSc.Error
        GAMG gave up.
    """
    levels: list[DistributedLevel] = []
    matrix, D, B = stiffness, diagonal, of_size_one(motions, ranks.max)
    B = B if B.shape[1] else constants(len(B), stiffness.getBlockSize())
    while matrix.getSize()[0] > COARSEST:
        with stored_rows(matrix) as stored:
            found = aggregates(matrix.comm, stored, finest=not levels)
            if found is None or found.starts[-1] * B.shape[1] >= matrix.getSize()[0]:
                break
            T, B = tentative(ranks, found, B, stored.size)
            level, matrix = smoothed_level(ranks, matrix, stored, T, D)
        levels.append(level)
        D = positive_diagonal(matrix)
    return levels, matrix


def smoothed_level(
    ranks: Ranks, matrix: Any, stored: StoredRows, tentative: Tentative, diagonal: Vector
) -> tuple[DistributedLevel, Any]:
    """One level, and the matrix of the next. Collective."""
    product = Product(matrix)
    largest = largest_eigenvalue(product, diagonal, ranks.dot)
    blocks = _Blocks(ranks, matrix, stored)
    prolong = blocks.smoothed(tentative.rows, JACOBI / largest / diagonal)
    coarse = blocks.galerkin(prolong, tentative.starts)
    return DistributedLevel(ranks, product, diagonal, largest, _rows_of(prolong, coarse)), coarse


def positive_diagonal(matrix: Any) -> Vector:
    """A coarse unknown that an aggregate had no motion for has a zero row: one stands for its diagonal."""
    diagonal = np.array(matrix.getDiagonal().array)
    return np.where(diagonal > 0, diagonal, 1.0)


class _Blocks:
    """Products with a matrix of which this rank has some rows, of some of these at a time.

    Matrices over the coarse unknowns have the columns of all ranks here, of which few are filled.
    """

    def __init__(self, ranks: Ranks, matrix: Any, stored: StoredRows) -> None:
        self._ranks, self._comm, self._stored = ranks, matrix.comm, stored
        self._starts = np.asarray(matrix.getOwnershipRanges()) // stored.size

    def smoothed(self, tentative: sp.bsr_matrix, damping: Vector) -> sp.bsr_matrix:
        """(I - damping K) T, the rows of this rank."""
        size = self._stored.size
        scale, unit, away = -damping.reshape(-1, size, 1), np.eye(size), self._of_others(tentative)
        parts = []
        for begin, here, beside in self._parts():
            row = _rows_of_entries(here)
            here.data *= scale[begin + row]
            here.data[here.indices == begin + row] += unit
            beside.data *= scale[begin + _rows_of_entries(beside)]
            parts.append(_product(here, tentative, beside, away))
        return _stacked(parts, tentative)

    def galerkin(self, prolong: sp.bsr_matrix, starts: NDArray[Any]) -> Any:
        """P'K P as PETSc.Mat, its unknowns dealt to the ranks as told."""
        size = prolong.blocksize[1]
        blocksize, away = (size, size), self._of_others(prolong)
        product = sp.bsr_matrix((prolong.shape[1], prolong.shape[1]), blocksize=blocksize)
        for begin, here, beside in self._parts():
            moved = _product(here, prolong, beside, away)
            product = product + sp.bsr_matrix(_cut(prolong, begin, here.shape[0]).T @ moved, blocksize=blocksize)
        owner = np.searchsorted(starts // size, (row := _rows_of_entries(product)), side="right") - 1
        row, column, values = self._ranks.exchanged(owner, row, product.indices, product.data)
        first, last = starts[self._ranks.rank], starts[self._ranks.rank + 1]
        shape = (int(last - first), product.shape[1])
        return held_in_blocks(self._comm, _bsr(row - first // size, column, values, shape))

    def _parts(self) -> Iterator[tuple[int, sp.bsr_matrix, sp.bsr_matrix]]:
        """Some rows of K from a row of blocks on, over the unknowns of this rank and over those of others."""
        for begin, end in self._stored.parts():
            yield begin, self._stored.here.rows(begin, end), self._stored.away.rows(begin, end)

    def _of_others(self, rows: sp.bsr_matrix) -> sp.bsr_matrix:
        """The rows of the blocks of other ranks that some rows here couple with."""
        others = self._stored.others
        entries = rows_of_others(self._ranks, self._starts, others, rows)
        return _bsr(*entries, (len(others) * self._stored.size, rows.shape[1]))


def _product(here: sp.bsr_matrix, own: sp.bsr_matrix, beside: sp.bsr_matrix, away: sp.bsr_matrix) -> sp.bsr_matrix:
    """Some rows of K by what this rank and the others have of a matrix."""
    product = sp.bsr_matrix(here @ own, blocksize=own.blocksize)
    if beside.nnz:
        product = product + sp.bsr_matrix(beside @ away, blocksize=own.blocksize)
    return product


def _rows_of_entries(matrix: sp.bsr_matrix) -> NDArray[Any]:
    """The row, of blocks, of each stored block."""
    return np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))


def _bsr(row: NDArray[Any], column: NDArray[Any], values: NDArray[np.float64], shape: tuple[int, int]) -> sp.bsr_matrix:
    """Blocks at rows and columns of blocks; those at one place are added."""
    order = np.argsort(row, kind="stable")
    indptr = np.append(0, np.cumsum(np.bincount(row, minlength=shape[0] // values.shape[1])))
    matrix = sp.bsr_matrix((values[order], column[order], indptr), shape=shape)
    matrix.sum_duplicates()
    return matrix


def _cut(matrix: sp.bsr_matrix, begin: int, count: int) -> sp.bsr_matrix:
    """So many rows from a row of blocks on."""
    indptr = matrix.indptr[begin : begin + count // matrix.blocksize[0] + 1]
    entries = slice(indptr[0], indptr[-1])
    parts = matrix.data[entries], matrix.indices[entries], indptr - indptr[0]
    return sp.bsr_matrix(parts, shape=(count, matrix.shape[1]))


def _stacked(parts: list[sp.bsr_matrix], like: sp.bsr_matrix) -> sp.bsr_matrix:
    """One below the other, together of a shape that is told."""
    ends = np.append(0, np.cumsum([part.indptr[-1] for part in parts]))
    indptr = np.concatenate([[0], *(part.indptr[1:] + end for part, end in zip(parts, ends, strict=False))])
    indices = np.concatenate([like.indices[:0], *(part.indices for part in parts)])
    data = np.concatenate([like.data[:0], *(part.data for part in parts)])
    return sp.bsr_matrix((data, indices, indptr), shape=like.shape)


def _rows_of(prolong: sp.bsr_matrix, coarse: Any) -> Rows:
    """P over the coarse unknowns that it touches."""
    size = prolong.blocksize[1]
    blocks, place = np.unique(prolong.indices, return_inverse=True)
    shape = (prolong.shape[0], len(blocks) * size)
    entries = sp.bsr_matrix((prolong.data, place.ravel(), prolong.indptr), shape=shape)
    return Rows(entries, (blocks[:, None] * size + np.arange(size)).ravel(), coarse)
