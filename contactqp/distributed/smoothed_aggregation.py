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

from contactqp.distributed.environment import PREFIX, given, held_in_blocks, petsc
from contactqp.distributed.ranks import Ranks, rows_of_others
from contactqp.distributed.rows import Rows, StoredBlocks, StoredRows, stored_rows
from contactqp.errors import Unsupported
from contactqp.linalg.multigrid import JACOBI, constants, largest_eigenvalue, of_size_one
from contactqp.model.arrays import Array, Vector

# Aggregates of nodes over the ranks, and the prolongation of a few motions from them.
#
# PETSc's GAMG makes the aggregates from the graph of a stiffness alone, one number for each block: its own levels, of
# all unknowns, take more memory than the stiffness does.

OPTIONS = {
    "pc_type": "gamg",
    "pc_mg_levels": 2,
    "pc_gamg_coarse_eq_limit": 1,
    "mg_levels_ksp_type": "richardson",
    "mg_coarse_pc_type": "none",
}
# The aggregates of the finest level are made of neighbours of neighbours.
AGGRESSIVE = "pc_gamg_aggressive_coarsening"
# No aggregate.
NONE = -1
# A motion of which the others leave an aggregate no more than this part of its square is one of them there.
SAME_MOTION = 1e-13


@dataclass(frozen=True, eq=False)
class Aggregates:
    """Which aggregate each block of this rank is in, of those of all ranks; and where those of each rank begin."""

    of: NDArray[Any]  # (blocks here,) NONE: in none, since nothing couples with it
    starts: NDArray[Any]  # (ranks + 1,)


def aggregates(comm: Any, stored: StoredRows, *, finest: bool) -> Aggregates | None:
    """Return GAMG's aggregates of blocks that K couples; None where these are no coarser. Collective.

    Raises
    ------
    Unsupported
        An option of the user's names another preconditioner.
    PETSc.Error
        GAMG gave up.
    """
    PETSc = petsc()
    graph = _graph(comm, stored)
    pc = PETSc.PC().create(comm)
    pc.setOptionsPrefix(PREFIX)
    pc.setOperators(graph)
    try:
        with given(PREFIX, {**OPTIONS, AGGRESSIVE: int(finest)}):
            pc.setFromOptions()
            if pc.getType() != OPTIONS["pc_type"]:
                raise Unsupported(f"solver: gamg, but the option -{PREFIX}pc_type is {pc.getType()}")
            pc.setGAMGSmooths(0)
            pc.setUp()
        return _found(pc, graph)
    finally:
        pc.destroy()
        graph.destroy()


def _found(pc: Any, graph: Any) -> Aggregates | None:
    finest = pc.getMGLevels() - 1
    if not finest:
        return None
    prolongation = pc.getMGInterpolation(finest)
    indptr, indices, _ = prolongation.getValuesCSR()
    of = np.full(len(indptr) - 1, NONE, dtype=indices.dtype)
    of[np.diff(indptr) > 0] = indices  # one a row
    count = prolongation.getSize()[1]
    coarser = 0 < count < graph.getSize()[0]
    return Aggregates(of, np.array(prolongation.getOwnershipRangesColumn())) if coarser else None


def _graph(comm: Any, stored: StoredRows) -> Any:
    """The Frobenius norms of the blocks of K, as AIJ."""
    PETSc = petsc()
    count = len(stored.here.indptr) - 1
    rows = sp.hstack([_norms(stored.here), _norms(stored.away)], format="csr")
    rows.eliminate_zeros()
    number = np.concatenate([stored.first + np.arange(count), stored.others])[rows.indices]
    csr = (rows.indptr.astype(PETSc.IntType), number.astype(PETSc.IntType), rows.data)
    return PETSc.Mat().createAIJ(size=((count, None), (count, None)), csr=csr, comm=comm)


def _norms(blocks: StoredBlocks) -> sp.csr_matrix:
    norms = np.sqrt(np.einsum("kij,kij->k", blocks.values, blocks.values))
    shape = (len(blocks.indptr) - 1, blocks.columns)
    return sp.csr_matrix((norms, blocks.indices, blocks.indptr), shape=shape)


@dataclass(frozen=True, eq=False)
class Tentative:
    """T: its rows on this rank over the coarse unknowns of all, and where those of each rank begin."""

    rows: sp.bsr_matrix
    starts: NDArray[Any]  # (ranks + 1,)


def tentative(ranks: Ranks, found: Aggregates, motions: Array, size: int) -> tuple[Tentative, Array]:
    """T with T'T = 1, zero for motions that an aggregate has not, and B_coarse with B = T B_coarse. Collective.

    With G = B'B of an aggregate, whose nodes may be on several ranks, T = B W with W upper triangular and W'GW = 1: the
    Q of B = Q R, from sums.

    Parameters
    ----------
    motions : (n_here, q) array
        B.
    size : int
        Unknowns of a block.
    """
    q, first = motions.shape[1], found.starts[ranks.rank]
    blocks = motions.reshape(-1, size, q)
    numbers, place = np.unique(found.of, return_inverse=True)
    gram = np.einsum("nik,nil->nkl", blocks, blocks).reshape(len(blocks), q * q)
    member = sp.csr_matrix((np.ones(len(place)), (place, np.arange(len(place)))), shape=(len(numbers), len(place)))
    some = numbers != NONE
    owner = np.searchsorted(found.starts, numbers[some], side="right") - 1
    asker = np.full(len(owner), ranks.rank)
    number, part, back, asker = ranks.exchanged(
        owner, numbers[some], (member @ gram)[some], np.flatnonzero(some), asker
    )
    count = int(found.starts[ranks.rank + 1] - first)
    here = sp.csr_matrix((np.ones(len(number)), (number - first, np.arange(len(number)))), shape=(count, len(number)))
    whole = (here @ part).reshape(count, q, q)
    mix = _orthonormal(whole)
    back, came = ranks.exchanged(asker, back, mix[number - first])
    mixes = np.zeros((len(numbers), q, q))
    mixes[back] = came
    within = found.of != NONE
    indptr = np.append(0, np.cumsum(within))
    shape = (len(motions), q * int(found.starts[-1]))
    rows = sp.bsr_matrix((blocks[within] @ mixes[place[within]], found.of[within], indptr), shape=shape)
    return Tentative(rows, q * found.starts), np.asarray(np.swapaxes(mix, 1, 2) @ whole).reshape(count * q, q)


def _orthonormal(gram: Array) -> Array:
    """W (a, q, q) with W'GW = 1 for G (a, q, q); a column of zeros for a motion that those before it make up."""
    W = np.zeros_like(gram)
    for k in range(gram.shape[1]):
        w = np.zeros(gram.shape[:2])
        w[:, k] = 1.0
        for _ in range(2):  # once leaves the rounding of motions that are nearly one
            w -= np.einsum("akj,aj->ak", W, np.einsum("akj,ak->aj", W, np.einsum("akl,al->ak", gram, w)))
        left = np.einsum("ak,akl,al->a", w, gram, w)
        own = left > SAME_MOTION * gram[:, k, k]
        W[own, :, k] = w[own] / np.sqrt(left[own])[:, None]
    return W


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
