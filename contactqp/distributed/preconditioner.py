"""z = M r, M near the inverse of K: PETSc's multigrids, or a direct solver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.formats import held_in_rows
from contactqp.distributed.memory import give_back
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Vector
from contactqp.distributed.rows import Rows
from contactqp.distributed.smoothed_aggregation import Tentative
from contactqp.distributed.v_cycle import DistributedHierarchy
from contactqp.errors import BackendFailed, Unsupported

# Names of `solver`, and what PETSc calls them. Its own options come after: -contactqp_pc_type, -contactqp_pc_gamg_...
SOLVERS: dict[str, dict[str, Any]] = {
    "gamg": {
        "pc_type": "gamg",
        "pc_gamg_agg_nsmooths": 0,
        "mg_levels_ksp_type": "richardson",
        "mg_coarse_pc_type": "none",
    },
    "hypre": {"pc_type": "hypre", "pc_hypre_boomeramg_strong_threshold": 0.5},
    # Twice the memory that MUMPS expects to need: what it needs depends on the order in which messages come.
    "mumps": {"pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_14": 100},
}
PREFIX = "contactqp_"
# Unknowns of the coarsest of our levels: a dense factor on every rank, part of it anew for every contact set.
COARSEST = 600
# Up to this many unknowns, in space, a factorisation takes no longer than a multigrid and is more accurate.
AUTO, FACTORISED = "auto", 100_000
# What holds a body that floats, of its own diagonal: little beside what any deformation costs, much beside rounding.
LIFT = 1e-5
# A motion of which the others leave no more than this is one of them.
SAME_MOTION = 1e-10


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
        give_back()
        self._pc = PETSc.PC().create(problem.stiffness.comm)
        self._hierarchy: DistributedHierarchy | None = None
        self._pc.setOptionsPrefix(PREFIX)
        options = PETSc.Options(PREFIX)
        ours = dict(SOLVERS[solver])
        if solver == "gamg":
            ours["pc_gamg_coarse_eq_limit"] = COARSEST
        ours = {key: value for key, value in ours.items() if not options.hasName(key)}
        for key, value in ours.items():
            options[key] = value
        try:
            self._pc.setFromOptions()
            self._set_up(problem, rows, motions)
        except PETSc.Error as error:
            raise BackendFailed(f"PETSc's {solver} failed: {str(error).splitlines()[-1]}") from error
        finally:
            for key in ours:
                options.delValue(key)

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
        """PETSc's own, or levels on the aggregates of its GAMG, which are all that is kept of that."""
        if self._pc.getType() != "gamg":
            self._set_up_on(held_in_rows(problem.stiffness))
            _refuse_failed_factors(self._pc, self._solver)
            self._pc.setReusePreconditioner(True)  # even if the diagonal of K changes
            self._pc.setOperators(problem.stiffness)
            return
        tentative = []
        if problem.stiffness.getSize()[0] > COARSEST:  # of fewer GAMG makes one level
            self._set_up_on(with_near_null_space(problem))
            finest = self._pc.getMGLevels() - 1
            tentative = [Tentative.of(self._pc.getMGInterpolation(level)) for level in range(finest, 0, -1)]
        self._pc.destroy()
        give_back()
        hierarchy = DistributedHierarchy(problem.ranks, problem.stiffness, tentative, diagonal, rows)
        self._hierarchy, self._plain = hierarchy, hierarchy.cycle(rows.entries[:0])

    def _set_up_on(self, rows: Any) -> None:
        """Of K as AIJ, which is not kept."""
        self._pc.setOperators(rows)
        self._pc.setUp()

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


def with_near_null_space(problem: DistributedProblem) -> Any:
    """K as PETSc's GAMG takes it: AIJ that knows the motions that cost little energy. Collective."""
    PETSc, stiffness = petsc(), held_in_rows(problem.stiffness)
    basis: list[Any] = []
    for motion in problem.near_null_space.T:
        v = stiffness.createVecRight()
        v.array[:] = motion
        size = v.norm()
        for known in basis * 2:  # twice: once leaves the rounding of motions that are nearly one
            v.axpy(-v.dot(known), known)
        if v.norm() > SAME_MOTION * size:
            v.normalize()
            basis.append(v)
    stiffness.setNearNullSpace(PETSc.NullSpace().create(vectors=basis, comm=stiffness.comm))
    return stiffness
