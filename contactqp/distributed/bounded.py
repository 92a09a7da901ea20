"""PETSc's own solvers of problems with bounds, for comparison: Newton's methods of SNES for variational inequalities
(Benson and Munson 2006) and TAO's trust-region method.

They see the problem without units, K_jj = 1 and |f| = 1: what SNES calls zero (``-snes_vi_zero_tolerance``, 1e-8) is an
absolute length, in which a contact counts as closed that is not. Their options of PETSc's have the prefix
``contactqp_bounds_`` and come after ours.

The reduced-space and the trust-region method solve on the unknowns that are not at a bound, whose number changes from
step to step. PETSc 3.18's GAMG fails there ("Cannot change local size of Amat after use"). MUMPS, BoomerAMG and
incomplete factors of blocks ("asm") are made anew each time, and work with all three methods.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.distributed.bound_unknowns import BoundUnknowns, bound_unknowns
from contactqp.distributed.environment import petsc
from contactqp.distributed.options import given
from contactqp.distributed.preconditioner import AUTO, FACTORISED
from contactqp.distributed.problem import DistributedProblem
from contactqp.errors import BackendFailed, Unsupported
from contactqp.model.arrays import Vector
from contactqp.model.solution import Candidate
from contactqp.solving.methods import Settings

# Names of methods, and PETSc's of their types.
NEWTON = {"vinewtonrsls": "vinewtonrsls", "vinewtonssls": "vinewtonssls"}
PREFIX = "contactqp_bounds_"
TRUST_REGION = {"tao-bntr": "bntr"}
METHODS = (*NEWTON, *TRUST_REGION)
# It writes D_a + D_b B, which is not symmetric, over the matrix that it is given, in each step.
CHANGES_MATRIX = ("vinewtonssls",)
# What solves their linear systems, for symmetric ones; UNSYMMETRIC has what the semismooth method's need.
SOLVERS: dict[str, dict[str, Any]] = {
    "mumps": {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"},
    "hypre": {"ksp_type": "cg", "pc_type": "hypre", "pc_hypre_boomeramg_strong_threshold": 0.5},
    "asm": {"ksp_type": "cg", "pc_type": "bjacobi", "sub_pc_type": "icc"},
}
UNSYMMETRIC: dict[str, dict[str, Any]] = {
    "mumps": {"pc_type": "lu"},
    "hypre": {"ksp_type": "gmres"},
    "asm": {"ksp_type": "gmres", "pc_type": "asm", "sub_pc_type": "ilu"},
}
# Linear systems are solved to this part of the tolerance, and the problem to that: equilibrium is judged at each
# unknown, theirs is a norm over all.
INNER, OUTER = 1e-2, 1e-3
# SNES and TAO both end with this where the residual of a right answer is all rounding.
NO_DECREASE = -6
STEPS, INNER_STEPS = 200, 10_000


def solve_bounded(problem: DistributedProblem, method: str, solver: str, settings: Settings) -> Candidate:
    """The answer of one of METHODS. Collective.

    Raises
    ------
    Unsupported
        A contact or tie that is no bound on an unknown of its own, friction, a solver that cannot follow the sets.
    NoEquilibrium
        Bounds conflict.
    BackendFailed
        PETSc gave up.
    """
    if problem.frictional:
        raise Unsupported(f"{method}: friction is no bound on unknowns; active-set takes it")
    inner = inner_solver(method, solver, problem.dimension)
    scaled = _Scaled(bound_unknowns(problem, method), settings.warm_start)
    run = _newton if method in NEWTON else _trust_region
    options = _options(method, inner, settings)
    try:
        with given(PREFIX, options):
            y, steps, reason = run(scaled, method, settings)
    except petsc().Error as error:
        raise BackendFailed(f"PETSc's {method} failed: {str(error).splitlines()[-1]}") from error
    return scaled.candidate(y, steps, reason)


def inner_solver(method: str, solver: str, dimension: int) -> str:
    """What solves the linear systems, "auto" resolved.

    Raises
    ------
    Unsupported
        It cannot, or this PETSc has it not.
    """
    has = petsc().Sys.hasExternalPackage
    if solver == AUTO:
        few = "mumps" if dimension <= FACTORISED and has("mumps") else "hypre"
        return few if has(few) else "asm"
    if solver not in SOLVERS:
        raise Unsupported(f"{method}: solver: expected {AUTO}, {', '.join(SOLVERS)}, got {solver!r}")
    if solver != "asm" and not has(solver):
        raise Unsupported(f"solver: this PETSc was built without {solver}")
    return solver


class _Scaled:
    """min 1/2 y'By - b'y over lower <= y <= upper, with w = length D^-1/2 y and D the diagonal of T'KT.

    The length makes b and the bounds 1 at most. Making it is collective, and so is `candidate`.
    """

    def __init__(self, bounds: BoundUnknowns, warm_start: Candidate | None) -> None:
        problem = bounds.problem
        ranks, self._bounds = problem.ranks, bounds
        self.B = bounds.stiffness()
        diagonal = np.array(self.B.getDiagonal().array)
        largest = ranks.max(float(np.max(diagonal, initial=0.0))) or 1.0
        self._diagonal = np.where(diagonal > 0, diagonal, largest)
        stretch = np.sqrt(self._diagonal)
        scale = self._vector(1 / stretch)
        self.B.diagonalScale(scale, scale)
        push = bounds.force(problem.load) / stretch
        lower, upper = (stretch * limit for limit in bounds.limits)
        finite = max(np.max(abs(limit[np.isfinite(limit)]), initial=0.0) for limit in (lower, upper))
        length = max(np.sqrt(ranks.dot(push, push)), ranks.max(float(finite))) or 1.0
        self._unit = length / stretch
        far = petsc().INFINITY
        self.lower = self._vector(np.maximum(lower / length, -far))
        self.upper = self._vector(np.minimum(upper / length, far))
        self.push = self._vector(push / length)
        start = np.zeros(len(push))
        if warm_start is not None:
            start = bounds.unknowns(warm_start.displacement) / self._unit
        self.start = self._vector(np.clip(start, self.lower.array, self.upper.array))

    def _vector(self, values: Vector) -> Any:
        v = self.B.createVecRight()
        v.array[:] = values
        return v

    def gradient(self, y: Any, out: Any) -> None:
        """B y - b."""
        self.B.mult(y, out)
        out.axpy(-1.0, self.push)

    def candidate(self, y: Any, steps: int, reason: int) -> Candidate:
        """What was found, in the problem's unknowns; the certificate tells where PETSc ended at rounding."""
        claimed = reason > 0 or reason == NO_DECREASE
        bounds, w = self._bounds, self._unit * y.array
        displacement = bounds.displacement(w)
        residual = bounds.force(bounds.problem.load - bounds.problem.product(displacement))
        forces = bounds.forces(w, residual, self._diagonal)
        return Candidate(displacement, *forces, iterations=steps, claimed=claimed, status=f"PETSc's reason {reason}")


def _newton(problem: _Scaled, method: str, settings: Settings) -> tuple[Any, int, int]:
    snes, y = petsc().SNES().create(problem.B.comm), problem.start
    snes.setOptionsPrefix(PREFIX)
    snes.setType(NEWTON[method])
    snes.setFunction(lambda _, at, out: problem.gradient(at, out), y.duplicate())
    if method in CHANGES_MATRIX:
        snes.setJacobian(lambda _snes, _at, J, _P: problem.B.copy(J), problem.B.duplicate(copy=True))
    else:
        snes.setJacobian(lambda *_: None, problem.B)
    snes.setVariableBounds(problem.lower, problem.upper)
    snes.setTolerances(rtol=0.0, atol=OUTER * settings.tolerance, stol=0.0, max_it=settings.max_iter or STEPS)
    snes.setFromOptions()
    snes.solve(None, y)
    return y, int(snes.getIterationNumber()), int(snes.getConvergedReason())


def _trust_region(problem: _Scaled, method: str, settings: Settings) -> tuple[Any, int, int]:
    tao, y = petsc().TAO().create(problem.B.comm), problem.start

    def objective(_: Any, at: Any, gradient: Any) -> float:
        problem.B.mult(at, gradient)
        energy = 0.5 * at.dot(gradient) - problem.push.dot(at)
        gradient.axpy(-1.0, problem.push)
        return float(energy)

    tao.setOptionsPrefix(PREFIX)
    tao.setType(TRUST_REGION[method])
    tao.setObjectiveGradient(objective, y.duplicate())
    tao.setHessian(lambda *_: None, problem.B)
    tao.setVariableBounds((problem.lower, problem.upper))
    tao.setTolerances(gatol=OUTER * settings.tolerance, grtol=0.0, gttol=0.0)
    tao.setMaximumIterations(settings.max_iter or STEPS)
    tao.setFromOptions()
    tao.solve(y)
    return y, int(tao.getIterationNumber()), int(tao.getConvergedReason())


def _options(method: str, solver: str, settings: Settings) -> dict[str, Any]:
    """Ours, of the inner solver and of what SNES calls zero: bounds are met exactly, so nothing else is."""
    inner = {"ksp_rtol": INNER * settings.tolerance, "ksp_max_it": INNER_STEPS, **SOLVERS[solver]}
    if method in CHANGES_MATRIX:
        inner |= UNSYMMETRIC[solver]
    if method in TRUST_REGION:
        inner["ksp_type"] = "stcg"  # within a trust region
        return {f"tao_bnk_{name}": value for name, value in inner.items()}
    return {"snes_vi_zero_tolerance": 0.0, **inner}
