"""Levels of smoothed aggregation on the aggregates of PETSc's GAMG, as in `contactqp.linalg.multigrid`:

    P = (I - 4/(3 rho) D^-1 K) T,    K_coarse = P'K P,

where T prolongs motions of low energy. Both products are computed from a few rows of K at a time, in blocks of nodes;
GAMG's own levels store K P as a whole, which on several ranks takes more memory than K. GAMG forms the aggregates from
the graph of K, with one number for each block.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.ranks import (
    PREFIX,
    Product,
    Ranks,
    ask_ranks,
    block_matrix,
    petsc,
    rows_of_other_ranks,
    temporary_options,
)
from contactqp.distributed.rows import Rows, StoredBlocks, StoredRows, stored_rows
from contactqp.errors import Unsupported
from contactqp.linalg.multigrid import JACOBI, constants, largest_eigenvalue, of_size_one
from contactqp.model.arrays import Array, Vector

OPTIONS = {
    "pc_type": "gamg",
    "pc_mg_levels": 2,
    "pc_gamg_coarse_eq_limit": 1,
    "mg_levels_ksp_type": "richardson",
    "mg_coarse_pc_type": "none",
}
# Aggregates of the finest level consist of neighbours of neighbours.
AGGRESSIVE = "pc_gamg_aggressive_coarsening"
# The number for no aggregate.
NONE = -1
# A motion whose square is reduced to at most this part by the others of an aggregate counts as dependent on them.
SAME_MOTION = 1e-13


@dataclass(frozen=True, eq=False)
class Aggregates:
    """The aggregate of each block of this rank, numbered over all ranks."""

    of: NDArray[Any]  # (blocks here,) NONE for uncoupled blocks
    starts: NDArray[Any]  # (ranks + 1,) number of the first aggregate of each rank


def aggregates(comm: Any, stored: StoredRows, *, finest: bool) -> Aggregates | None:
    """Return GAMG's aggregates of the blocks that K couples, or None if they are not coarser. Collective.

    Raises Unsupported: an option of the user names another preconditioner; PETSc.Error: GAMG failed.
    """
    PETSc = petsc()
    graph = _graph(comm, stored)
    pc = PETSc.PC().create(comm)
    pc.setOptionsPrefix(PREFIX)
    pc.setOperators(graph)
    try:
        with temporary_options(PREFIX, {**OPTIONS, AGGRESSIVE: int(finest)}):
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
    of[np.diff(indptr) > 0] = indices  # one per row
    count = prolongation.getSize()[1]
    coarser = 0 < count < graph.getSize()[0]
    return Aggregates(of, np.array(prolongation.getOwnershipRangesColumn())) if coarser else None


def _graph(comm: Any, stored: StoredRows) -> Any:
    """Return the Frobenius norms of the blocks of K, as AIJ."""
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
    """The tentative prolongation T."""

    rows: sp.bsr_matrix  # rows of this rank, over the coarse unknowns of all ranks
    starts: NDArray[Any]  # (ranks + 1,) number of the first coarse unknown of each rank


def tentative(ranks: Ranks, found: Aggregates, motions: Array, size: int) -> tuple[Tentative, Array]:
    """Return T with T'T = 1, zero for dependent motions of an aggregate, and B_coarse with B = T B_coarse. Collective.

    With G = B'B of an aggregate, whose nodes may be on several ranks, T = B W with W upper triangular and W'GW = 1 is
    the Q of B = Q R, computed by sums only.

    Parameters
    ----------
    ranks : the processes
    found : the aggregates of this rank's blocks
    motions : (n_here, q) array, B, the motions that cost little energy
    size : the number of unknowns of a block
    """
    q, first = motions.shape[1], found.starts[ranks.rank]
    blocks = motions.reshape(-1, size, q)
    numbers, place = np.unique(found.of, return_inverse=True)
    gram = np.einsum("nik,nil->nkl", blocks, blocks).reshape(len(blocks), q * q)
    member = sp.csr_matrix((np.ones(len(place)), (place, np.arange(len(place)))), shape=(len(numbers), len(place)))
    some = numbers != NONE
    owner = np.searchsorted(found.starts, numbers[some], side="right") - 1
    count, coarse = int(found.starts[ranks.rank + 1] - first), np.zeros((0, q))

    def orthonormalise(request: NDArray[Any], _: Any) -> tuple[Array]:
        nonlocal coarse
        number = request[:, 0].astype(np.int64) - first
        here = sp.csr_matrix((np.ones(len(number)), (number, np.arange(len(number)))), shape=(count, len(number)))
        whole = (here @ request[:, 1:]).reshape(count, q, q)
        mix = _orthonormal(whole)
        coarse = np.asarray(np.swapaxes(mix, 1, 2) @ whole).reshape(count * q, q)
        return (mix[number],)

    mixes = np.zeros((len(numbers), q, q))
    mixes[some] = ask_ranks(ranks, owner, np.column_stack([numbers, member @ gram])[some], orthonormalise)[0]
    within = found.of != NONE
    indptr = np.append(0, np.cumsum(within))
    shape = (len(motions), q * int(found.starts[-1]))
    rows = sp.bsr_matrix((blocks[within] @ mixes[place[within]], found.of[within], indptr), shape=shape)
    return Tentative(rows, q * found.starts), coarse


def _orthonormal(gram: Array) -> Array:
    """Return W (a, q, q) with W'GW = 1 for G (a, q, q), zeros for motions that depend on previous ones."""
    W = np.zeros_like(gram)
    for k in range(gram.shape[1]):
        w = np.zeros(gram.shape[:2])
        w[:, k] = 1.0
        for _ in range(2):  # repeated because of the rounding of nearly parallel motions
            w -= np.einsum("akj,aj->ak", W, np.einsum("akj,ak->aj", W, np.einsum("akl,al->ak", gram, w)))
        square = np.einsum("ak,akl,al->a", w, gram, w)
        own = square > SAME_MOTION * gram[:, k, k]
        W[own, :, k] = w[own] / np.sqrt(square[own])[:, None]
    return W


# Unknowns of the coarsest level, whose dense factor is on every rank and partly updated for every contact set.
COARSEST = 600


@dataclass(frozen=True, eq=False)
class DistributedLevel:
    """One level of the hierarchy."""

    ranks: Ranks
    product: Product  # x -> K x
    diagonal: Vector  # D (n_here,)
    largest: float  # largest eigenvalue of D^-1 K
    prolong: Rows  # P from the next coarser level


def smoothed_levels(
    ranks: Ranks, stiffness: Any, diagonal: Vector, motions: Array
) -> tuple[list[DistributedLevel], Any]:
    """Return all levels except the coarsest, from the finest on, and the matrix of the coarsest. Collective.

    Raises PETSc.Error: GAMG failed.

    Parameters
    ----------
    ranks : the processes
    stiffness : PETSc.Mat, K of the finest level
    diagonal : (n_here,) array, D of the finest level, positive
    motions : (n_here, q) array, motions that cost little energy
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
        # Coarse unknowns of dependent motions have zero rows, and get a diagonal of one.
        D = np.array(matrix.getDiagonal().array)
        D[D <= 0] = 1.0
    return levels, matrix


def smoothed_level(
    ranks: Ranks, matrix: Any, stored: StoredRows, tentative: Tentative, diagonal: Vector
) -> tuple[DistributedLevel, Any]:
    """Return one level and the matrix of the next coarser one. Collective.

    Parameters
    ----------
    ranks : the processes
    matrix : PETSc.Mat, K of this level
    stored : the rows of `matrix` on this rank
    tentative : T from the next coarser level
    diagonal : (n_here,) array, D of this level, positive
    """
    product = Product(matrix)
    largest = largest_eigenvalue(product, diagonal, ranks.dot)
    blocks = _Blocks(ranks, matrix, stored)
    prolong = blocks.smoothed(tentative.rows, JACOBI / largest / diagonal)
    coarse = blocks.galerkin(prolong, tentative.starts)
    return DistributedLevel(ranks, product, diagonal, largest, _rows_of(prolong, coarse)), coarse


class _Blocks:
    """Products with a distributed matrix, computed from a few of this rank's rows at a time.

    Matrices over the coarse unknowns have the columns of all ranks, most of them empty.
    """

    def __init__(self, ranks: Ranks, matrix: Any, stored: StoredRows) -> None:
        self._ranks, self._comm, self._stored = ranks, matrix.comm, stored
        self._starts = np.asarray(matrix.getOwnershipRanges()) // stored.size

    def smoothed(self, tentative: sp.bsr_matrix, damping: Vector) -> sp.bsr_matrix:
        """Return the rows of (I - damping K) T on this rank."""
        size = self._stored.size
        scale, unit, away = -damping.reshape(-1, size, 1), np.eye(size), self._rows_of_others(tentative)
        parts = []
        for begin, here, beside in self._parts():
            row = _rows_of_entries(here)
            here.data *= scale[begin + row]
            here.data[here.indices == begin + row] += unit
            beside.data *= scale[begin + _rows_of_entries(beside)]
            parts.append(_product(here, tentative, beside, away))
        return _stacked(parts, tentative)

    def galerkin(self, prolong: sp.bsr_matrix, starts: NDArray[Any]) -> Any:
        """Return P'K P as PETSc.Mat, with coarse unknowns distributed by `starts`."""
        size = prolong.blocksize[1]
        blocksize, away = (size, size), self._rows_of_others(prolong)
        product = sp.bsr_matrix((prolong.shape[1], prolong.shape[1]), blocksize=blocksize)
        blocks = StoredBlocks(prolong.indptr, prolong.indices, prolong.data, prolong.shape[1] // size)
        for begin, here, beside in self._parts():
            moved = _product(here, prolong, beside, away)
            rows = blocks.rows(begin, begin + len(here.indptr) - 1)
            product = product + sp.bsr_matrix(rows.T @ moved, blocksize=blocksize)
        owner = np.searchsorted(starts // size, (row := _rows_of_entries(product)), side="right") - 1
        row, column, values = self._ranks.exchange(owner, row, product.indices, product.data)
        first, last = starts[self._ranks.rank], starts[self._ranks.rank + 1]
        shape = (int(last - first), product.shape[1])
        return block_matrix(self._comm, _bsr(row - first // size, column, values, shape))

    def _parts(self) -> Iterator[tuple[int, sp.bsr_matrix, sp.bsr_matrix]]:
        """Yield a first row of blocks, and copies of some rows of K from it on, over unknowns here and of other
        ranks.
        """
        for begin, end in self._stored.parts():
            yield begin, self._stored.here.rows(begin, end), self._stored.away.rows(begin, end)

    def _rows_of_others(self, rows: sp.bsr_matrix) -> sp.bsr_matrix:
        """Fetch the rows of a matrix at the blocks of other ranks coupled by K with blocks here."""
        others = self._stored.others
        entries = rows_of_other_ranks(self._ranks, self._starts, others, rows)
        return _bsr(*entries, (len(others) * self._stored.size, rows.shape[1]))


def _product(here: sp.bsr_matrix, own: sp.bsr_matrix, beside: sp.bsr_matrix, away: sp.bsr_matrix) -> sp.bsr_matrix:
    """Multiply some rows of K by a matrix with rows `own` of this rank and `away` of others."""
    product = sp.bsr_matrix(here @ own, blocksize=own.blocksize)
    if beside.nnz:
        product = product + sp.bsr_matrix(beside @ away, blocksize=own.blocksize)
    return product


def _rows_of_entries(matrix: sp.bsr_matrix) -> NDArray[Any]:
    """Return the row of blocks of each stored block."""
    return np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))


def _bsr(row: NDArray[Any], column: NDArray[Any], values: Array, shape: tuple[int, int]) -> sp.bsr_matrix:
    """Return the matrix of blocks at given rows and columns of blocks; blocks at the same position are added."""
    order = np.argsort(row, kind="stable")
    indptr = np.append(0, np.cumsum(np.bincount(row, minlength=shape[0] // values.shape[1])))
    matrix = sp.bsr_matrix((values[order], column[order], indptr), shape=shape)
    matrix.sum_duplicates()
    return matrix


def _stacked(parts: list[sp.bsr_matrix], like: sp.bsr_matrix) -> sp.bsr_matrix:
    """Stack matrices, in the shape of `like`."""
    ends = np.append(0, np.cumsum([part.indptr[-1] for part in parts]))
    indptr = np.concatenate([[0], *(part.indptr[1:] + end for part, end in zip(parts, ends, strict=False))])
    indices = np.concatenate([like.indices[:0], *(part.indices for part in parts)])
    data = np.concatenate([like.data[:0], *(part.data for part in parts)])
    return sp.bsr_matrix((data, indices, indptr), shape=like.shape)


def _rows_of(prolong: sp.bsr_matrix, coarse: Any) -> Rows:
    """Return P restricted to its nonzero columns."""
    size = prolong.blocksize[1]
    blocks, place = np.unique(prolong.indices, return_inverse=True)
    shape = (prolong.shape[0], len(blocks) * size)
    entries = sp.bsr_matrix((prolong.data, place.ravel(), prolong.indptr), shape=shape)
    return Rows(entries, (blocks[:, None] * size + np.arange(size)).ravel(), coarse)
