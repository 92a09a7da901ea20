"""The V-cycle of `contactqp.linalg.v_cycle` on levels of a stiffness on all ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows
from contactqp.distributed.rows_of_others import rows_of_others
from contactqp.distributed.smoothed_aggregation import DistributedLevel, smoothed_levels
from contactqp.errors import BackendFailed, Unsupported
from contactqp.linalg.multigrid import CoarsestLevel, HeldCoarsestLevel, SingularLevel, largest_eigenvalue
from contactqp.linalg.v_cycle import HeldLevel, VCycle, held_strength
from contactqp.model.arrays import Array, Vector

# Unknowns of a coarsest level: its factor is dense, and on every rank.
LARGEST_DENSE = 6000


class DistributedHierarchy:
    """Levels of a stiffness on all ranks, and what rows are on them: E, E P, E P P, ... All of it is collective.

    Parameters
    ----------
    ranks : Ranks
    stiffness : PETSc.Mat
    diagonal : (n_here,) array
        D of the finest level, positive.
    motions : (n_here, q) array
        What costs little energy.
    rows : Rows
        What they touch; their entries may change later.
    """

    def __init__(self, ranks: Ranks, stiffness: Any, diagonal: Vector, motions: Array, rows: Rows) -> None:
        self._ranks, self._compliance = ranks, rows.near(1 / diagonal)
        self._levels, coarsest = smoothed_levels(ranks, stiffness, diagonal, motions)
        if (size := coarsest.getSize()[0]) > LARGEST_DENSE:
            raise Unsupported(
                f"solver: the coarsest level that PETSc's gamg comes to has {size} unknowns, more than the "
                f"{LARGEST_DENSE} that every rank factorises; use hypre or mumps"
            )
        self._touched = [Rows(sp.identity(len(rows.touched), format="csr"), rows.touched, stiffness)]
        for level in self._levels:
            self._touched.append(_on_coarser(ranks, self._touched[-1], level.prolong))
        last = self._touched[-1]
        self._columns, place = np.unique(ranks.gathered(last.touched), return_inverse=True)
        self._place = place.ravel()[(first := ranks.first(len(last.touched))) : first + len(last.touched)]
        try:
            self._coarsest = CoarsestLevel(_whole(ranks, coarsest), self._columns)
        except SingularLevel:
            raise BackendFailed(
                "PETSc's gamg failed: the stiffness is singular, or too near to it; use mumps"
            ) from None
        self._coarse_unknowns = slice(*coarsest.getOwnershipRange())

    def cycle(self, entries: sp.csr_matrix) -> VCycle:
        """M for K + E'CE; `entries` (a, t) are those of E on this rank."""
        strength = held_strength(np.asarray(entries.multiply(entries) @ self._compliance))
        held = sp.csr_matrix(sp.diags(strength) @ entries)
        levels = []
        for level, touched in zip(self._levels, self._touched, strict=False):
            levels.append(_HeldLevel(level, touched.standing(held @ touched.entries)))
        on_coarsest = sp.csr_matrix(held @ self._touched[-1].entries)
        return VCycle(levels, self._coarsest_solve(on_coarsest))

    def _coarsest_solve(self, rows: sp.csr_matrix) -> Any:
        size = len(self._columns)
        moved = sp.csr_matrix((rows.data, self._place[rows.indices], rows.indptr), (rows.shape[0], size)).toarray()
        stiffness = self._ranks.sum(moved.T @ moved)
        factor = HeldCoarsestLevel(self._coarsest, stiffness)

        def solve(right: Vector) -> Vector:
            return factor.solve(self._ranks.gathered(right))[self._coarse_unknowns]

        return solve


class _HeldLevel(HeldLevel):
    """A level with the stiffness of rows, C^1/2 E."""

    def __init__(self, level: DistributedLevel, added: Rows) -> None:
        self._level, self._added = level, added
        self.diagonal, self.largest = level.diagonal, level.largest
        self._any = level.ranks.any(added.entries.nnz > 0)
        if not self._any:
            return
        own = added.spread(np.asarray(added.entries.multiply(added.entries).sum(axis=0)).ravel())
        self.diagonal = level.diagonal + own
        scale = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0)

        def product(force: Vector) -> Vector:
            return added.lengths(scale * added.forces(force))

        self.largest = max(self.largest, largest_eigenvalue(product, np.ones(added.count), level.ranks.dot))

    def product(self, x: Vector) -> Vector:
        y = self._level.product(x)
        if self._any:
            y += self._added.forces(self._added.lengths(x))
        return y

    def restricted(self, r: Vector) -> Vector:
        return self._level.prolong.forces(r)

    def prolonged(self, z: Vector) -> Vector:
        return self._level.prolong.lengths(z)


def _on_coarser(ranks: Ranks, touched: Rows, prolong: Rows) -> Rows:
    """What the values at touched unknowns are of the values on the next coarser level."""
    starts = np.asarray(touched.like.getOwnershipRanges())
    row, column, values = rows_of_others(ranks, starts, touched.touched, prolong.entries, prolong.touched)
    few = sp.csr_matrix((values, (row, column)), shape=(len(touched.touched), prolong.like.getSize()[1]))
    return Rows.over_touched(sp.csr_matrix(touched.entries @ few), prolong.like)


def _whole(ranks: Ranks, matrix: Any) -> sp.csr_matrix:
    """A small matrix on every rank."""
    indptr, indices, values = matrix.getValuesCSR()
    count, columns = ranks.gathered(np.diff(indptr)), ranks.gathered(indices)
    whole = np.concatenate([[0], np.cumsum(count)])
    return sp.csr_matrix((ranks.gathered(values), columns, whole), shape=matrix.getSize())
