"""Aggregates of nodes over the ranks, and the prolongation of a few motions from them.

PETSc's GAMG makes the aggregates from the graph of a stiffness alone, one number for each block: its own levels, of all
unknowns, take more memory than the stiffness does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.options import PREFIX, given
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.stored_rows import StoredBlocks, StoredRows
from contactqp.errors import Unsupported
from contactqp.model.arrays import Array

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
    """Those that GAMG makes of blocks that K couples; None where that makes nothing coarser. Collective.

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
