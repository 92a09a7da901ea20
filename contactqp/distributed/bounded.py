"""PETSc's own solvers of problems with bounds, for comparison: Newton's methods of SNES for variational inequalities
(Benson and Munson 2006) and TAO's trust-region method.

Contacts and ties become bounds on single unknowns by a change of unknowns u = T w. A row E_i with an unknown p that no
other row touches limits w_p = E_i u / E_ip alone:

    u_p = w_p - sum over j != p of (E_ij / E_ip) w_j,    u_j = w_j elsewhere,

so that 1/2 u'Ku - f'u over E_N u <= g, A u = b becomes 1/2 w'(T'KT)w - (T'f)'w over bounds on w, equal ones for a tie.
Parallel rows share their unknown. The residual r = f - K u is the force of the rows: (T'r)_p = r_p = E_ip l_i.

The solvers get the problem without units, K_jj = 1 and |f| = 1, because the zero tolerance of SNES
(``-snes_vi_zero_tolerance``, 1e-8) is an absolute length, by which open contacts could count as closed. PETSc's options
for them have the prefix ``contactqp_bounds_`` and override ours.

The reduced-space and the trust-region method solve on the unknowns that are not at a bound, whose number changes from
step to step. PETSc 3.18's GAMG fails there ("Cannot change local size of Amat after use"). MUMPS, BoomerAMG and
incomplete factors of blocks ("asm") are set up again each time, and work with all three methods.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.distributed.iteration import stacked_rows
from contactqp.distributed.preconditioner import AUTO, FACTORISED, MUMPS, failing_as_backend, refuse_failed_factors
from contactqp.distributed.problem import DistributedProblem, message_of_first
from contactqp.distributed.ranks import Product, aij_copy, petsc, temporary_options
from contactqp.distributed.rows import Rows
from contactqp.errors import NoEquilibrium, Unsupported, shown
from contactqp.model.arrays import Indices, Vector
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods import Settings

# The index for no unknown or no row.
NONE = -1


@dataclass(frozen=True, eq=False)
class BoundUnknowns:
    """The unknowns w of one problem. All methods and properties are collective.

    Attributes
    ----------
    problem : the problem in u
    rows : contacts, then ties
    pivot : (a,) array of int, the column of each row's unknown p; NONE for rows of zeros
    """

    problem: DistributedProblem
    rows: Rows
    pivot: Indices

    @cached_property
    def limit(self) -> Vector:
        """Return the bound (a,) of each row on its unknown w_p [length]."""
        return np.concatenate([self.problem.gap, self.problem.tie_value]) / self.coefficient

    @cached_property
    def coefficient(self) -> Vector:
        """Return E_ip (a,), 1 for rows of zeros."""
        found, rows = np.ones(len(self.pivot)), np.flatnonzero(self.pivot != NONE)
        found[rows] = np.asarray(self.rows.entries[rows, self.pivot[rows]]).ravel()
        return found

    @cached_property
    def tightest(self) -> tuple[Indices, Indices]:
        """Return the rows (t,) that limit each column from above and from below, NONE where there is none."""
        acting, tie = self.pivot != NONE, np.arange(len(self.limit)) >= self.problem.contacts
        sides = []
        for sign in (1.0, -1.0):
            rows = np.flatnonzero(acting & (tie | (sign * self.coefficient > 0)))
            last = np.lexsort((tie[rows], -sign * self.limit[rows]))  # the last of rows at one column is written last
            found = np.full(len(self.rows.touched), NONE)
            found[self.pivot[rows][last]] = rows[last]
            sides.append(found)
        return sides[0], sides[1]

    @cached_property
    def bounds(self) -> tuple[Vector, Vector]:
        """Return lower and upper bounds (n_here,) on w [length], infinite where there is none.

        Raises
        ------
        NoEquilibrium
            A lower bound is above its upper one.
        """
        upper, lower = (self._everywhere(row, self.limit[row]) for row in self.tightest)
        upper, lower = np.where(np.isnan(upper), np.inf, upper), np.where(np.isnan(lower), -np.inf, lower)
        with self.problem.ranks.raising_together():
            if np.any(lower > upper):
                name = self.problem.dof_name(int(np.argmax(lower > upper)))
                raise NoEquilibrium(f"the constraints conflict at {name}")
        return lower, upper

    def _everywhere(self, row: Indices, values: Vector) -> Vector:
        """Return values (t,) of the columns with a row as a distributed vector, NaN elsewhere."""
        there = row != NONE
        found = self.rows.assembled(np.where(there, values, 0.0))
        return np.where(self.rows.assembled(there.astype(float)) > 0, found, np.nan)

    @cached_property
    def change(self) -> Any:
        """Return T (n, n) as a PETSc.Mat, None if every row touches one unknown."""
        entries, ranks = self.rows.entries, self.problem.ranks
        length = np.diff(entries.indptr)
        first = [row for side in self.tightest for row in side[side != NONE] if length[row] > 1]
        if not ranks.any(len(first) > 0):
            return None
        PETSc, K = petsc(), self.problem.stiffness
        most = int(ranks.max(int(np.max(length, initial=1))))
        T = PETSc.Mat().createAIJ(size=K.getSizes(), nnz=(most, most), comm=K.comm)
        T.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        begin, end = K.getOwnershipRange()
        own = np.arange(begin, end, dtype=PETSc.IntType)
        T.setValuesCSR(np.arange(len(own) + 1, dtype=PETSc.IntType), own, np.ones(len(own)))
        T.assemble()
        for row in first:
            part = slice(entries.indptr[row], entries.indptr[row + 1])
            column, value = entries.indices[part], -entries.data[part] / self.coefficient[row]
            other = column != self.pivot[row]
            T.setValues(self.rows.touched[self.pivot[row]], self.rows.touched[column[other]], value[other])
        T.assemble()
        return T

    def stiffness(self) -> Any:
        """Return T'KT as a new PETSc.Mat."""
        K = aij_copy(self.problem.stiffness)
        return K if self.change is None else K.PtAP(self.change)

    def force(self, force: Vector) -> Vector:
        """Return the force T'f on the changed unknowns."""
        return force if self.change is None else Product(self.change, transposed=True)(force)

    def displacement(self, w: Vector) -> Vector:
        """Return u = T w."""
        return w if self.change is None else Product(self.change)(w)

    def unknowns(self, displacement: Vector) -> Vector:
        """Return w = T^-1 u, at each p the length of its row over E_ip."""
        length = self.rows.lengths(displacement) / self.coefficient
        above, below = self.tightest
        row = np.where(above != NONE, above, below)
        found = self._everywhere(row, length[row])
        return np.where(np.isnan(found), displacement, found)

    def forces(self, w: Vector, residual: Vector, diagonal: Vector) -> tuple[Vector, Vector]:
        """Return l (m_here,) and nu (k_here,) from T'(f - K u), with the diagonal of T'KT.

        A row has a force if r + K_pp (w - bound) > 0 (for an upper bound); of rows that share an unknown, the tightest.
        """
        force, r = np.zeros(len(self.pivot)), self.rows.at_touched(residual)
        stiffness, at = self.rows.at_touched(diagonal), self.rows.at_touched(w)
        for sign, row in zip((1.0, -1.0), self.tightest, strict=True):
            there = np.flatnonzero(row != NONE)
            rows = row[there]
            excess = r[there] + stiffness[there] * at[there] - stiffness[there] * self.limit[rows]
            presses = (sign * r[there] > 0) & (sign * excess > 0)
            force[rows[presses]] = r[there][presses] / self.coefficient[rows[presses]]
        return force[: self.problem.contacts], force[self.problem.contacts :]


def bound_unknowns(problem: DistributedProblem, method: str) -> BoundUnknowns:
    """Return unknowns on which every contact and tie is a bound. Collective.

    Raises Unsupported: a contact or tie shares all its unknowns with other rows; the first one is named.
    """
    rows = stacked_rows([problem.normal, problem.tie], problem.stiffness)
    rows.entries.eliminate_zeros()
    entries, ranks = rows.entries, problem.ranks
    leader = _first_along_direction(entries)
    leads = leader == np.arange(len(leader))
    row = np.repeat(np.arange(len(leader)), np.diff(entries.indptr))
    times = np.bincount(entries.indices[leads[row]], minlength=len(rows.touched)).astype(float)
    private = (rows.at_touched(rows.assembled(times)) == 1)[entries.indices]
    size = np.where(private, abs(entries.data), 0.0)
    last = np.lexsort((-entries.indices, size))  # the largest is kept, of equals the first
    pivot = np.full(len(leader), NONE)
    pivot[row[last]] = np.where(private[last], entries.indices[last], NONE)
    lost = (pivot == NONE) & (np.diff(entries.indptr) > 0)
    pivot = pivot[leader]
    m = problem.contacts
    name = message_of_first(ranks, lost[:m], problem.contact_number, problem.contact_name) or message_of_first(
        ranks, lost[m:], problem.tie_number, problem.tie_name
    )
    if name is not None:
        raise Unsupported(
            f"{method} takes bounds on single unknowns; {name} limits several, and others limit each of them"
        )
    return BoundUnknowns(problem, rows, pivot)


def _first_along_direction(entries: sp.csr_matrix) -> Indices:
    """Return for each row the first row along the same direction."""
    first: dict[bytes, int] = {}
    leader = np.arange(entries.shape[0])
    for i in leader:
        part = slice(entries.indptr[i], entries.indptr[i + 1])
        order = np.argsort(entries.indices[part])
        value = entries.data[part][order]
        # The row over its largest entry; quotients of a row and its negative are equal to the last digit.
        scaled = value / value[np.argmax(abs(value))] if len(value) else value
        leader[i] = first.setdefault(entries.indices[part][order].tobytes() + scaled.tobytes(), i)
    return leader


# Types of SNES, and "tao-" with a type of TAO.
NEWTON, TRUST_REGION = ("vinewtonrsls", "vinewtonssls"), ("tao-bntr",)
METHODS = (*NEWTON, *TRUST_REGION)
PREFIX = "contactqp_bounds_"
# This method overwrites the given matrix by D_a + D_b B, which is not symmetric, in each step.
CHANGES_MATRIX = ("vinewtonssls",)
# Options of the solvers of symmetric linear systems; UNSYMMETRIC has those of unsymmetric ones.
SOLVERS: dict[str, dict[str, Any]] = {
    "mumps": {"ksp_type": "preonly", **MUMPS},
    "hypre": {"ksp_type": "cg", "pc_type": "hypre", "pc_hypre_boomeramg_strong_threshold": 0.5},
    "asm": {"ksp_type": "cg", "pc_type": "bjacobi", "sub_pc_type": "icc"},
}
UNSYMMETRIC: dict[str, dict[str, Any]] = {
    "mumps": {"pc_type": "lu"},
    "hypre": {"ksp_type": "gmres"},
    "asm": {"ksp_type": "gmres", "pc_type": "asm", "sub_pc_type": "ilu"},
}
# Linear systems are solved to INNER times the tolerance, and the problem to OUTER times, as equilibrium is judged at
# each unknown but the residual of solvers is a norm over all.
INNER, OUTER = 1e-2, 1e-3
# SNES and TAO end with this reason if the residual of a right answer is rounding only.
NO_DECREASE = -6
STEPS, INNER_STEPS = 200, 10_000


def solve_bounded(problem: DistributedProblem, method: str, solver: str, settings: Settings) -> Candidate:
    """Solve a problem by one of METHODS and return its candidate. Collective.

    Raises Unsupported: a contact or tie that shares all its unknowns with other rows, friction, a solver that cannot
    change its unknowns; NoEquilibrium: bounds conflict; BackendFailed: PETSc or MUMPS failed.

    Parameters
    ----------
    problem : a problem without friction
    method : one of METHODS
    solver : one of SOLVERS, or "auto"
    settings : the tolerance, the most steps and a warm start
    """
    if problem.frictional:
        raise Unsupported(f"{method}: friction is not a bound on unknowns; active-set takes it")
    inner = inner_solver(method, solver, problem.dimension)
    scaled = _Scaled(bound_unknowns(problem, method), settings.warm_start)
    run = _newton if method in NEWTON else _trust_region
    with failing_as_backend(method), temporary_options(PREFIX, _options(method, inner, settings)):
        ended = run(scaled, method, settings)
    ksp, reasons = ended.getKSP(), petsc().KSP.ConvergedReason
    if ksp.getConvergedReason() in (reasons.DIVERGED_PCSETUP_FAILED, reasons.DIVERGED_NANORINF):
        refuse_failed_factors(ksp.getPC())  # CG in a trust region would continue with the infinities of failed factors
    return scaled.candidate(int(ended.getIterationNumber()), int(ended.getConvergedReason()))


def inner_solver(method: str, solver: str, dimension: int) -> str:
    """Return the name of the solver of linear systems, with "auto" resolved by the number of unknowns.

    Raises Unsupported: the solver does not exist, or this PETSc was built without it.
    """
    has = petsc().Sys.hasExternalPackage
    if solver == AUTO:
        preferred = "mumps" if dimension <= FACTORISED and has("mumps") else "hypre"
        return preferred if has(preferred) else "asm"
    if solver not in SOLVERS:
        raise Unsupported(f"{method}: solver: expected {AUTO}, {', '.join(SOLVERS)}, got {shown(solver)}")
    if solver != "asm" and not has(solver):
        raise Unsupported(f"solver: this PETSc was built without {solver}")
    return solver


class _Scaled:
    """The problem min 1/2 y'By - b'y over lower <= y <= upper, with w = length D^-1/2 y and D the diagonal of T'KT.

    The length is chosen so that b and the bounds are at most 1. The constructor and all methods are collective.
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
        load = bounds.force(problem.load) / stretch
        lower, upper = (stretch * limit for limit in bounds.bounds)
        finite = max(np.max(abs(limit[np.isfinite(limit)]), initial=0.0) for limit in (lower, upper))
        length = max(np.sqrt(ranks.dot(load, load)), ranks.max(float(finite))) or 1.0
        self._unit = length / stretch
        far = petsc().INFINITY
        self.lower = self._vector(np.maximum(lower / length, -far))
        self.upper = self._vector(np.minimum(upper / length, far))
        self.load = self._vector(load / length)
        start = np.zeros(len(load))
        if warm_start is not None:
            start = bounds.unknowns(warm_start.answer.displacement) / self._unit
        self.y = self._vector(np.clip(start, self.lower.array, self.upper.array))  # start, later answer

    def _vector(self, values: Vector) -> Any:
        v = self.B.createVecRight()
        v.array[:] = values
        return v

    def candidate(self, steps: int, reason: int) -> Candidate:
        """Return PETSc's answer in the problem's unknowns.

        An answer at which PETSc ended by rounding counts as converged; the certificate judges it.
        """
        claimed = reason > 0 or reason == NO_DECREASE
        bounds, w = self._bounds, self._unit * self.y.array
        displacement = bounds.displacement(w)
        residual = bounds.force(bounds.problem.load - bounds.problem.product(displacement))
        normal, tie = bounds.forces(w, residual, self._diagonal)
        answer = Answer(displacement, normal, None, tie)
        return Candidate(answer, iterations=steps, claimed=claimed, status=f"PETSc's reason {reason}")


def _newton(problem: _Scaled, method: str, settings: Settings) -> Any:
    snes = petsc().SNES().create(problem.B.comm)

    def gradient(_: Any, at: Any, out: Any) -> None:
        problem.B.mult(at, out)
        out.axpy(-1.0, problem.load)

    snes.setOptionsPrefix(PREFIX)
    snes.setType(method)
    snes.setFunction(gradient, problem.y.duplicate())
    if method in CHANGES_MATRIX:
        snes.setJacobian(lambda _snes, _at, J, _P: problem.B.copy(J), problem.B.duplicate(copy=True))
    else:
        snes.setJacobian(lambda *_: None, problem.B)
    snes.setVariableBounds(problem.lower, problem.upper)
    snes.setTolerances(rtol=0.0, atol=OUTER * settings.tolerance, stol=0.0, max_it=settings.max_iter or STEPS)
    snes.setFromOptions()
    snes.solve(None, problem.y)
    return snes


def _trust_region(problem: _Scaled, method: str, settings: Settings) -> Any:
    tao = petsc().TAO().create(problem.B.comm)

    def objective(_: Any, at: Any, gradient: Any) -> float:
        problem.B.mult(at, gradient)
        energy = 0.5 * at.dot(gradient) - problem.load.dot(at)
        gradient.axpy(-1.0, problem.load)
        return float(energy)

    tao.setOptionsPrefix(PREFIX)
    tao.setType(method.removeprefix("tao-"))
    tao.setObjectiveGradient(objective, problem.y.duplicate())
    tao.setHessian(lambda *_: None, problem.B)
    tao.setVariableBounds((problem.lower, problem.upper))
    tao.setTolerances(gatol=OUTER * settings.tolerance, grtol=0.0, gttol=0.0)
    tao.setMaximumIterations(settings.max_iter or STEPS)
    tao.setFromOptions()
    tao.solve(problem.y)
    return tao


def _options(method: str, solver: str, settings: Settings) -> dict[str, Any]:
    """Return the default options of the method and of its linear solver. Bounds are met exactly, so their tolerance is
    zero.
    """
    inner = {"ksp_rtol": INNER * settings.tolerance, "ksp_max_it": INNER_STEPS, **SOLVERS[solver]}
    if method in CHANGES_MATRIX:
        inner |= UNSYMMETRIC[solver]
    if method in TRUST_REGION:
        inner["ksp_type"] = "stcg"  # within a trust region
        return {f"tao_bnk_{name}": value for name, value in inner.items()}
    return {"snes_vi_zero_tolerance": 0.0, **inner}
