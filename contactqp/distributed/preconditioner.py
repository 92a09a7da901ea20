"""z = M r, M near the inverse of K: PETSc's multigrids, or a direct solver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed import aggregates
from contactqp.distributed.environment import petsc
from contactqp.distributed.formats import held_in_rows
from contactqp.distributed.memory import give_back
from contactqp.distributed.options import PREFIX, given
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.rows import Rows
from contactqp.distributed.v_cycle import DistributedHierarchy
from contactqp.errors import BackendFailed, Unsupported
from contactqp.model.arrays import Vector

# Names of `solver`, and what PETSc calls them. Its own options come after: -contactqp_pc_type, -contactqp_pc_gamg_...
SOLVERS: dict[str, dict[str, Any]] = {
    "gamg": aggregates.OPTIONS,
    "hypre": {"pc_type": "hypre", "pc_hypre_boomeramg_strong_threshold": 0.5},
    # Twice the memory that MUMPS expects to need: what it needs depends on the order in which messages come.
    "mumps": {"pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_14": 100},
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
