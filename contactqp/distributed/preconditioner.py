"""Preconditioners M that approximate the inverse of K: a V-cycle on own levels, PETSc's multigrids, or a direct
solver.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.distributed import smoothed_aggregation
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import (
    PREFIX,
    Ranks,
    aij_copy,
    petsc,
    release_free_memory,
    rows_of_other_ranks,
    temporary_options,
)
from contactqp.distributed.rows import Rows
from contactqp.distributed.smoothed_aggregation import DistributedLevel, smoothed_levels
from contactqp.errors import BackendFailed, Unsupported, shown
from contactqp.linalg.measures import reciprocal
from contactqp.linalg.multigrid import CoarsestLevel, HeldCoarsestLevel, SingularLevel, largest_eigenvalue
from contactqp.linalg.v_cycle import HeldLevel, VCycle, held_strength
from contactqp.model.arrays import Array, Vector

# The most unknowns of the coarsest level, whose factor is dense and on every rank.
LARGEST_DENSE = 6000


class DistributedHierarchy:
    """Levels of a stiffness for the V-cycle of `contactqp.linalg.v_cycle`, with rows on them: E, E P, E P P, ...

    All methods are collective.

    Parameters
    ----------
    ranks : Ranks, the processes
    stiffness : PETSc.Mat, K
    diagonal : (n_here,) array, D of the finest level, positive
    motions : (n_here, q) array, motions that cost little energy
    rows : Rows, rows that touch the same unknowns as those that `cycle` is given
    """

    def __init__(self, ranks: Ranks, stiffness: Any, diagonal: Vector, motions: Array, rows: Rows) -> None:
        self._ranks, self._compliance = ranks, rows.at_touched(1 / diagonal)
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
        self._place = place.ravel()[(first := ranks.offset(len(last.touched))) : first + len(last.touched)]
        try:
            self._coarsest = CoarsestLevel(_whole(ranks, coarsest), self._columns)
        except SingularLevel:
            raise BackendFailed(
                "PETSc's gamg failed: the stiffness is singular, or too near to it; use mumps"
            ) from None
        self._coarse_unknowns = slice(*coarsest.getOwnershipRange())

    def cycle(self, entries: sp.csr_matrix) -> VCycle:
        """Return M for K + E'CE; `entries` (a, t) are the rows of E on this rank."""
        strength = held_strength(np.asarray(entries.multiply(entries) @ self._compliance))
        held = sp.csr_matrix(sp.diags(strength) @ entries)
        levels = []
        for level, touched in zip(self._levels, self._touched, strict=False):
            levels.append(_HeldLevel(level, touched.with_entries(held @ touched.entries)))
        rows = sp.csr_matrix(held @ self._touched[-1].entries)
        shape = (rows.shape[0], len(self._columns))
        moved = sp.csr_matrix((rows.data, self._place[rows.indices], rows.indptr), shape).toarray()
        factor = HeldCoarsestLevel(self._coarsest, self._ranks.sum(moved.T @ moved))

        def solve(right: Vector) -> Vector:
            return factor.solve(self._ranks.gathered(right))[self._coarse_unknowns]

        return VCycle(levels, solve)


class _HeldLevel(HeldLevel):
    """A level with constrained rows, C^1/2 E."""

    def __init__(self, level: DistributedLevel, added: Rows) -> None:
        self._level, self._added = level, added
        self.diagonal, self.largest = level.diagonal, level.largest
        self._any = level.ranks.any(added.entries.nnz > 0)
        if not self._any:
            return
        own = added.assembled(np.asarray(added.entries.multiply(added.entries).sum(axis=0)).ravel())
        self.diagonal = level.diagonal + own
        scale = reciprocal(own)

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
    """Return the values at touched unknowns as rows over the next coarser level."""
    starts = np.asarray(touched.like.getOwnershipRanges())
    row, column, values = rows_of_other_ranks(ranks, starts, touched.touched, prolong.entries, prolong.touched)
    prolong_rows = sp.csr_matrix((values, (row, column)), shape=(len(touched.touched), prolong.like.getSize()[1]))
    return Rows.from_csr(sp.csr_matrix(touched.entries @ prolong_rows), prolong.like)


def _whole(ranks: Ranks, matrix: Any) -> sp.csr_matrix:
    """Gather a small matrix on every rank."""
    indptr, indices, values = matrix.getValuesCSR()
    count, columns = ranks.gathered(np.diff(indptr)), ranks.gathered(indices)
    whole = np.concatenate([[0], np.cumsum(count)])
    return sp.csr_matrix((ranks.gathered(values), columns, whole), shape=matrix.getSize())


# Twice the memory estimated by MUMPS, as its need depends on the order of messages.
MUMPS: dict[str, Any] = {"pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_14": 100}
# The default options of each solver; the user's override them: -contactqp_pc_type, -contactqp_pc_gamg_...
SOLVERS: dict[str, dict[str, Any]] = {
    "gamg": smoothed_aggregation.OPTIONS,
    "hypre": {"pc_type": "hypre", "pc_hypre_boomeramg_strong_threshold": 0.5},
    "mumps": MUMPS,
}
# PETSc's types that keep no reference to the given matrix; others may point into it.
INDEPENDENT = ("hypre", "cholesky")
# Up to this many unknowns in space a factorisation is as fast as multigrid, and more accurate.
AUTO, FACTORISED = "auto", 100_000
# The relative increase of the diagonal of a floating body, small compared to any deformation's stiffness but large
# compared to rounding.
LIFT = 1e-5


def chosen_solver(solver: str, dimension: int) -> str:
    """Return the name of a solver, with "auto" resolved by the number of unknowns.

    Raises Unsupported: no solver has that name.
    """
    if solver == AUTO:
        return "mumps" if dimension <= FACTORISED and petsc().Sys.hasExternalPackage("mumps") else "gamg"
    if solver not in SOLVERS:
        raise Unsupported(f"solver: expected {AUTO}, {', '.join(SOLVERS)}, got {shown(solver)}")
    return solver


class Preconditioner:
    """The preconditioner M of one stiffness. The constructor and calls are collective.

    Raises Unsupported: PETSc was built without the solver; BackendFailed: PETSc failed, as K is singular or memory ran
    out.

    Parameters
    ----------
    problem : DistributedProblem, its K and near-null-space are used
    rows : Rows, rows that may be constrained
    motions : (n_here, r) array, rigid motions of bodies that float, for which M is that of K + LIFT D
    solver : str, ``"gamg"`` (smoothed aggregation), ``"hypre"`` (BoomerAMG) or ``"mumps"``, which factorises
    """

    def __init__(self, problem: DistributedProblem, rows: Rows, motions: Array, solver: str) -> None:
        if solver != "gamg" and not petsc().Sys.hasExternalPackage(solver):
            raise Unsupported(f"solver: this PETSc was built without {solver}")
        self._into, self._from = problem.stiffness.createVecs()
        self._constrained, self._solver = problem.constrained, solver
        self._hierarchy: DistributedHierarchy | None = None
        release_free_memory()
        with failing_as_backend(solver):
            self._set_up(problem, rows, motions)

    def _set_up(self, problem: DistributedProblem, rows: Rows, motions: Array) -> None:
        """Set up with the diagonal of floating bodies increased in K itself, to avoid a copy."""
        if not problem.ranks.any(motions != 0):
            self._make(problem, rows, problem.metric)
            return
        diagonal = problem.stiffness.getDiagonal()
        afloat = np.isin(problem.body, problem.ranks.gathered(np.unique(problem.body[np.any(motions != 0, axis=1)])))
        lifted = diagonal.copy()
        lifted.array[:] += np.where(afloat, LIFT * problem.metric, 0.0)
        problem.stiffness.setDiagonal(lifted)
        try:
            self._make(problem, rows, np.array(lifted.array))
        finally:  # another solver may be tried if this one fails
            problem.stiffness.setDiagonal(diagonal)

    def _make(self, problem: DistributedProblem, rows: Rows, diagonal: Vector) -> None:
        if self._solver == "gamg":
            near = problem.near_null_space
            self._hierarchy = DistributedHierarchy(problem.ranks, problem.stiffness, diagonal, near, rows)
            self._without_rows = self._hierarchy.cycle(rows.entries[:0])
            return
        self._pc = petsc().PC().create(problem.stiffness.comm)
        self._pc.setOptionsPrefix(PREFIX)
        with temporary_options(PREFIX, SOLVERS[self._solver]):
            self._pc.setOperators(aij_copy(problem.stiffness))
            self._pc.setFromOptions()
            self._pc.setUp()
        if self._solver == "mumps":
            refuse_failed_factors(self._pc)
        self._pc.setReusePreconditioner(True)  # even if the diagonal of K changes
        if self._pc.getType() in INDEPENDENT:
            self._pc.setOperators(problem.stiffness)  # the copy in rows is dropped

    def __call__(self, r: Vector) -> Vector:
        """Return the preconditioned residual M r."""
        if self._hierarchy is not None:
            return np.where(self._constrained, 0.0, self._without_rows(r))
        self._from.array[:] = r
        with failing_as_backend(self._solver):
            self._pc.apply(self._from, self._into)
        return np.where(self._constrained, 0.0, self._into.array)

    def with_rows(self, entries: sp.csr_matrix) -> Callable[[Vector], Vector]:
        """Return M with constrained rows of these entries (a, t): on own levels that of K + E'CE."""
        if self._hierarchy is None:
            return self
        cycle = self._hierarchy.cycle(entries)
        return lambda r: np.where(self._constrained, 0.0, cycle(r))


@contextmanager
def failing_as_backend(name: str) -> Iterator[None]:
    """Raise an error of PETSc as BackendFailed, with the last line of its message."""
    try:
        yield
    except petsc().Error as error:
        raise BackendFailed(f"PETSc's {name} failed: {str(error).splitlines()[-1]}") from error


def refuse_failed_factors(pc: Any) -> None:
    """Raise BackendFailed if MUMPS failed to factorise; PETSc would continue with infinities."""
    if pc.getType() not in ("cholesky", "lu") or pc.getFactorSolverType() != "mumps":
        return
    if (code := pc.getFactorMatrix().getMumpsInfog(1)) < 0:
        raise BackendFailed(f"PETSc's mumps failed: INFOG(1) = {code} (-9: memory, -10: a singular matrix)")
