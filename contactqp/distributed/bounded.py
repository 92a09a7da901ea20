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

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import given, held_in_rows, petsc
from contactqp.distributed.iteration import stacked
from contactqp.distributed.preconditioner import AUTO, FACTORISED, MUMPS
from contactqp.distributed.problem import DistributedProblem, said_of_first
from contactqp.distributed.rows import Rows
from contactqp.errors import BackendFailed, NoEquilibrium, Unsupported
from contactqp.model.arrays import Vector
from contactqp.model.solution import Candidate
from contactqp.solving.methods import Settings

# Contacts and ties as bounds on single unknowns, by a change of unknowns u = T w.
#
# A row E_i that has an unknown p of its own, one that no other row touches, limits w_p = E_i u / E_ip alone:
#
#     u_p = w_p - sum over j != p of (E_ij / E_ip) w_j,    u_j = w_j elsewhere,
#
# so that 1/2 u'Ku - f'u over E_N u <= g, A u = b becomes 1/2 w'(T'KT)w - (T'f)'w over bounds on w, those of a tie
# equal. Rows along one direction share their unknown. What is left of r = f - K u is the rows' force: (T'r)_p = r_p =
# E_ip l_i.

Places = NDArray[np.intp]
NONE = -1


@dataclass(frozen=True, eq=False)
class BoundUnknowns:
    """The unknowns w of one problem. Everything is collective.

    Attributes
    ----------
    rows : Rows
        Contacts, then ties.
    pivot : (a,) array of int
        The column of each row's unknown p; NONE of rows that touch nothing.
    """

    problem: DistributedProblem
    rows: Rows
    pivot: Places

    @cached_property
    def _acting(self) -> Places:
        return np.flatnonzero(self.pivot != NONE)

    @cached_property
    def _entry(self) -> Vector:
        """(a,) E_ip; 1 of rows that touch nothing."""
        found, rows = np.ones(len(self.pivot)), self._acting
        found[rows] = np.asarray(self.rows.entries[rows, self.pivot[rows]]).ravel()
        return found

    @cached_property
    def _tightest(self) -> tuple[Places, Places]:
        """The row that limits each column from above, and the one that does from below; NONE where none does."""
        limit = np.concatenate([self.problem.gap, self.problem.tie_value]) / self._entry
        tie = np.arange(len(limit)) >= self.problem.contacts
        sides = []
        for sign in (1.0, -1.0):
            rows = self._acting[(tie | (sign * self._entry > 0))[self._acting]]
            last = np.lexsort((tie[rows], -sign * limit[rows]))  # of rows that write to one column the last one stays
            found = np.full(len(self.rows.touched), NONE)
            found[self.pivot[rows][last]] = rows[last]
            sides.append(found)
        return sides[0], sides[1]

    @cached_property
    def limits(self) -> tuple[Vector, Vector]:
        """Lower and upper bounds (n_here,) [length], infinite where nothing limits.

        Raises
        ------
        NoEquilibrium
            A lower bound is above its upper one.
        """
        limit = np.concatenate([self.problem.gap, self.problem.tie_value]) / self._entry
        upper, lower = (self._everywhere(row, limit[row]) for row in self._tightest)
        upper, lower = np.where(np.isnan(upper), np.inf, upper), np.where(np.isnan(lower), -np.inf, lower)
        with self.problem.ranks.together():
            if np.any(lower > upper):
                name = self.problem.dof_name(int(np.argmax(lower > upper)))
                raise NoEquilibrium(f"the constraints conflict at {name}")
        return lower, upper

    def _everywhere(self, row: Places, values: Vector) -> Vector:
        """Values (t,) of the columns that have a row, as a vector of all unknowns; NaN elsewhere."""
        there = row != NONE
        found = self.rows.spread(np.where(there, values, 0.0))
        return np.where(self.rows.spread(there.astype(float)) > 0, found, np.nan)

    @cached_property
    def change(self) -> Any:
        """T (n, n) as a PETSc.Mat; None where every row touches one unknown."""
        entries, ranks = self.rows.entries, self.problem.ranks
        length = np.diff(entries.indptr)
        first = [row for side in self._tightest for row in side[side != NONE] if length[row] > 1]
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
            column, value = entries.indices[part], -entries.data[part] / self._entry[row]
            other = column != self.pivot[row]
            T.setValues(self.rows.touched[self.pivot[row]], self.rows.touched[column[other]], value[other])
        T.assemble()
        return T

    def stiffness(self) -> Any:
        """T'KT, a PETSc.Mat of its own."""
        K = held_in_rows(self.problem.stiffness)
        return K if self.change is None else K.PtAP(self.change)

    def force(self, force: Vector) -> Vector:
        """T'f."""
        return force if self.change is None else self._product(self.change.multTranspose, force)

    def displacement(self, w: Vector) -> Vector:
        """u = T w."""
        return w if self.change is None else self._product(self.change.mult, w)

    def _product(self, product: Any, values: Vector) -> Vector:
        at, into = self.problem.stiffness.createVecs()
        at.array[:] = values
        product(at, into)
        return np.array(into.array)

    def unknowns(self, displacement: Vector) -> Vector:
        """w = T^-1 u: at each p the length of its row, over E_ip."""
        length = self.rows.lengths(displacement) / self._entry
        above, below = self._tightest
        row = np.where(above != NONE, above, below)
        found = self._everywhere(row, length[row])
        return np.where(np.isnan(found), displacement, found)

    def forces(self, w: Vector, residual: Vector, diagonal: Vector) -> tuple[Vector, Vector]:
        """l (m_here,) and nu (k_here,) from T'(f - K u), with the diagonal of T'KT.

        A row presses where its force and its gap say so together, r + K_pp (w - bound) > 0 from above; of rows that
        share an unknown the tightest does.
        """
        force, at = np.zeros(len(self.pivot)), self.rows.near(residual)
        stretch = self.rows.near(diagonal) * self.rows.near(w)
        stiffness, limit = self.rows.near(diagonal), np.concatenate([self.problem.gap, self.problem.tie_value])
        for sign, row in zip((1.0, -1.0), self._tightest, strict=True):
            there = np.flatnonzero(row != NONE)
            rows, r = row[there], at[there]
            excess = r + stretch[there] - stiffness[there] * limit[rows] / self._entry[rows]
            presses = (sign * r > 0) & (sign * excess > 0)
            force[rows[presses]] = r[presses] / self._entry[rows[presses]]
        return force[: self.problem.contacts], force[self.problem.contacts :]


def bound_unknowns(problem: DistributedProblem, method: str) -> BoundUnknowns:
    """The unknowns that every contact and tie is a bound on. Collective.

    Raises
    ------
    Unsupported
        A contact or tie has no unknown of its own; the first one is named.
    """
    rows = stacked([problem.normal, problem.tie], problem.stiffness)
    rows.entries.eliminate_zeros()
    entries, ranks = rows.entries, problem.ranks
    leader = _leaders(entries)
    leads = leader == np.arange(len(leader))
    row = np.repeat(np.arange(len(leader)), np.diff(entries.indptr))
    often = np.bincount(entries.indices[leads[row]], minlength=len(rows.touched)).astype(float)
    private = (rows.near(rows.spread(often)) == 1)[entries.indices]
    size = np.where(private, abs(entries.data), 0.0)
    last = np.lexsort((-entries.indices, size))  # the largest, and of equals the first, is written last
    pivot = np.full(len(leader), NONE)
    pivot[row[last]] = np.where(private[last], entries.indices[last], NONE)
    lost = (pivot == NONE) & (np.diff(entries.indptr) > 0)
    pivot = pivot[leader]
    m = problem.contacts
    named = said_of_first(ranks, lost[:m], problem.contact_number, problem.contact_name) or said_of_first(
        ranks, lost[m:], problem.tie_number, problem.tie_name
    )
    if named is not None:
        raise Unsupported(
            f"{method} takes bounds on single unknowns; {named} limits several, and others limit each of them"
        )
    return BoundUnknowns(problem, rows, pivot)


def _leaders(entries: sp.csr_matrix) -> Places:
    """The first row along the direction of each row."""
    first: dict[bytes, int] = {}
    leader = np.arange(entries.shape[0])
    for i in leader:
        part = slice(entries.indptr[i], entries.indptr[i + 1])
        order = np.argsort(entries.indices[part])
        value = entries.data[part][order]
        # The row over its largest entry; of one and its opposite the quotients are equal to the last digit.
        scaled = value / value[np.argmax(abs(value))] if len(value) else value
        leader[i] = first.setdefault(entries.indices[part][order].tobytes() + scaled.tobytes(), i)
    return leader


# Names of methods, and PETSc's of their types.
NEWTON = {"vinewtonrsls": "vinewtonrsls", "vinewtonssls": "vinewtonssls"}
PREFIX = "contactqp_bounds_"
TRUST_REGION = {"tao-bntr": "bntr"}
METHODS = (*NEWTON, *TRUST_REGION)
# It writes D_a + D_b B, which is not symmetric, over the matrix that it is given, in each step.
CHANGES_MATRIX = ("vinewtonssls",)
# What solves their linear systems, for symmetric ones; UNSYMMETRIC has what the semismooth method's need.
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
