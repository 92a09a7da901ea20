"""Preconditioners M near the inverse of K: the V-cycle of our own levels, PETSc's multigrids, or a direct solver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed import smoothed_aggregation
from contactqp.distributed.environment import PREFIX, give_back, given, held_in_rows, petsc
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks, rows_of_others
from contactqp.distributed.rows import Rows
from contactqp.distributed.smoothed_aggregation import DistributedLevel, smoothed_levels
from contactqp.errors import BackendFailed, Unsupported
from contactqp.linalg.multigrid import CoarsestLevel, HeldCoarsestLevel, SingularLevel, largest_eigenvalue
from contactqp.linalg.v_cycle import HeldLevel, VCycle, held_strength
from contactqp.model.arrays import Array, Vector

# The V-cycle of `contactqp.linalg.v_cycle` on levels of a stiffness on all ranks.

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


# Twice the memory that MUMPS expects to need: what it needs depends on the order in which messages come.
MUMPS: dict[str, Any] = {"pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_14": 100}
# Names of `solver`, and what PETSc calls them. Its own options come after: -contactqp_pc_type, -contactqp_pc_gamg_...
SOLVERS: dict[str, dict[str, Any]] = {
    "gamg": smoothed_aggregation.OPTIONS,
    "hypre": {"pc_type": "hypre", "pc_hypre_boomeramg_strong_threshold": 0.5},
    "mumps": MUMPS,
}
# Types of PETSc's that keep nothing of the matrix that they were made of; others may hold places in it.
APART = ("hypre", "cholesky")
# Up to this many unknowns, in space, a factorisation takes no longer than a multigrid and is more accurate.
AUTO, FACTORISED = "auto", 100_000
# What holds a body that floats, of its own diagonal: little beside what any deformation costs, much beside rounding.
LIFT = 1e-5


def chosen_solver(solver: str, dimension: int) -> str:
    """The name of a solver, "auto" resolved.

    Raises
    ------
    Unsupported
        There is none of that name.
    """
    if solver == AUTO:
        return "mumps" if dimension <= FACTORISED and petsc().Sys.hasExternalPackage("mumps") else "gamg"
    if solver not in SOLVERS:
        raise Unsupported(f"solver: expected {AUTO}, {', '.join(SOLVERS)}, got {solver!r}")
    return solver


class Preconditioner:
    """M, made once for a stiffness. Making and applying it is collective.

    Parameters
    ----------
    problem : DistributedProblem
        Its K and near-null-space.
    rows : Rows
        What may hold the bodies.
    motions : (n_here, r) array
        Rigid motions of bodies that float: on these M is that of K + LIFT D.
    solver : str
        ``"gamg"`` (smoothed aggregation), ``"hypre"`` (BoomerAMG) or ``"mumps"``, which factorises.

    Raises
    ------
    Unsupported
        PETSc was built without it.
    BackendFailed
        PETSc gave up: singular, or out of memory.
    """

    def __init__(self, problem: DistributedProblem, rows: Rows, motions: NDArray[np.float64], solver: str) -> None:
        PETSc = petsc()
        if solver != "gamg" and not PETSc.Sys.hasExternalPackage(solver):
            raise Unsupported(f"solver: this PETSc was built without {solver}")
        self._into, self._from = problem.stiffness.createVecs()
        self._held, self._solver = problem.held, solver
        self._hierarchy: DistributedHierarchy | None = None
        give_back()
        try:
            self._set_up(problem, rows, motions)
        except PETSc.Error as error:
            raise BackendFailed(f"PETSc's {solver} failed: {str(error).splitlines()[-1]}") from error

    def _set_up(self, problem: DistributedProblem, rows: Rows, motions: NDArray[np.float64]) -> None:
        """With the diagonal of bodies that float lifted for the while: a copy of K would take as much as K."""
        floating = problem.ranks.any(motions != 0)
        if not floating:
            self._make(problem, rows, problem.metric)
            return
        diagonal = problem.stiffness.getDiagonal()
        afloat = np.isin(problem.body, problem.ranks.gathered(np.unique(problem.body[np.any(motions != 0, axis=1)])))
        lifted = diagonal.copy()
        lifted.array[:] += np.where(afloat, LIFT * problem.metric, 0.0)
        problem.stiffness.setDiagonal(lifted)
        try:
            self._make(problem, rows, np.array(lifted.array))
        finally:  # what fails here may be tried with another solver
            problem.stiffness.setDiagonal(diagonal)

    def _make(self, problem: DistributedProblem, rows: Rows, diagonal: Vector) -> None:
        if self._solver == "gamg":
            near = problem.near_null_space
            self._hierarchy = DistributedHierarchy(problem.ranks, problem.stiffness, diagonal, near, rows)
            self._plain = self._hierarchy.cycle(rows.entries[:0])
            return
        self._pc = petsc().PC().create(problem.stiffness.comm)
        self._pc.setOptionsPrefix(PREFIX)
        with given(PREFIX, SOLVERS[self._solver]):
            self._pc.setOperators(held_in_rows(problem.stiffness))
            self._pc.setFromOptions()
            self._pc.setUp()
        _refuse_failed_factors(self._pc, self._solver)
        self._pc.setReusePreconditioner(True)  # even if the diagonal of K changes
        if self._pc.getType() in APART:
            self._pc.setOperators(problem.stiffness)  # the copy in rows is not kept

    def __call__(self, r: Vector) -> Vector:
        """M r."""
        if self._hierarchy is not None:
            return np.where(self._held, 0.0, self._plain(r))
        self._from.array[:] = r
        try:
            self._pc.apply(self._from, self._into)
        except petsc().Error as error:
            raise BackendFailed(f"PETSc's {self._solver} failed: {str(error).splitlines()[-1]}") from error
        return np.where(self._held, 0.0, self._into.array)

    def holding(self, entries: sp.csr_matrix) -> Callable[[Vector], Vector]:
        """M where rows hold, their entries (a, t): on GAMG's levels that of K + E'CE."""
        if self._hierarchy is None:
            return self
        cycle = self._hierarchy.cycle(entries)
        return lambda r: np.where(self._held, 0.0, cycle(r))


def _refuse_failed_factors(pc: Any, solver: str) -> None:
    """PETSc would go on with infinities."""
    if solver == "mumps" and pc.getType() == "cholesky" and (said := pc.getFactorMatrix().getMumpsInfog(1)) < 0:
        raise BackendFailed(f"PETSc's mumps failed: INFOG(1) = {said} (-9: memory, -10: a singular matrix)")
