"""Coulomb friction over the ranks: Tresca's fixed point with the distributed solve inside.

A step knows which contacts stick, and how large and along what the others rub: friction that is known is a load,
tangents that stick are ties, and what is left is a contact problem without friction
(`contactqp.solving.methods.inexact_active_set`). Its forces give the next bounds mu l_N, relaxed by Aitken's factor,
and the next states. Before the first step and after each, Newton's method on the combination of states, whose systems
have Coulomb's law in them (`contactqp.distributed.friction`), tries to end it: bounds need not settle to the
last digit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.certificate import ROUNDING_OF_ANSWERS
from contactqp.distributed.environment import petsc
from contactqp.distributed.friction_rows import FrictionRows, Iterate, States, states
from contactqp.distributed.iteration import DistributedIteration
from contactqp.distributed.problem import Bodies, DistributedAnswer, DistributedProblem, worst
from contactqp.distributed.rows import Rows
from contactqp.distributed.violations import violations
from contactqp.errors import NoEquilibrium, NotConverged
from contactqp.linalg.measures import ratio
from contactqp.model.arrays import Array, Vector
from contactqp.model.solution import FIGURES
from contactqp.solving.friction.iterate import RELAXATION, aitken
from contactqp.solving.methods import Settings
from contactqp.solving.methods.inexact_active_set import solve_by_iteration

# PETSc's GMRES on an operator that is a function.

# Vectors kept until GMRES starts anew.
RESTART = 60


def gmres(
    operator: Callable[[Vector], Vector], right: Vector, like: Any, reduction: float, most: int
) -> tuple[Vector, int]:
    """x with |right - A x| <= reduction |right|, or what `most` steps come to, and the steps taken. Collective.

    Parameters
    ----------
    operator : function
        A x of the part of a vector that this rank has. Collective.
    right : (n_here,) array
    like : PETSc.Mat
        K: it says which rank has which unknowns.
    """
    PETSc = petsc()
    matrix = PETSc.Mat().createPython(like.getSizes(), _Operator(operator), comm=like.comm)
    matrix.setUp()
    solver = PETSc.KSP().create(like.comm)
    solver.setOperators(matrix)
    solver.setType("gmres")
    solver.setGMRESRestart(min(RESTART, most))
    solver.getPC().setType("none")
    solver.setTolerances(rtol=reduction, atol=0.0, divtol=np.inf, max_it=most)
    into, given = like.createVecs()
    given.array[:] = right
    solver.solve(given, into)
    steps, found = int(solver.getIterationNumber()), np.array(into.array)
    for item in (solver, matrix, into, given):
        item.destroy()
    return found, steps


class _Operator:
    """A matrix as PETSc asks it."""

    def __init__(self, operator: Callable[[Vector], Vector]) -> None:
        self._operator = operator

    def mult(self, matrix: Any, x: Any, y: Any) -> None:
        """y = A x."""
        del matrix
        y.array[:] = self._operator(np.array(x.array_r))


# One combination of open, stick and slip over the ranks: a linear system, unsymmetric where something slides.
#
# With H the rows that are held (closed contacts, ties, tangents that stick), G = H + mu t'E_T at the normals of
# contacts that slide, and the turning of slip directions in space as a stiffness C of the tangents,
#
#     (K + E_T'C E_T) u + G'l = f + E_T'C o,    H u = h.
#
# GMRES goes along displacements M r that H admits and looks at what the forces on G leave of residuals,
#
#     P_G (K + E_T'C E_T) P_H M y = P_G r,    u = u_0 + P_H M y,
#
# P_H and P_G the projections of `contactqp.linalg.krylov`. Friction in proportion to l_N is in the system itself:
# nothing has to be iterated on but the combination, and in space the directions.

# Steps of GMRES on one combination.
STEPS = 600


class CombinationSystem:
    """The system of one combination. Everything is collective."""

    def __init__(self, rows: FrictionRows, chosen: States) -> None:
        way = rows.way
        self._rows, self._way, self._chosen = rows, way, chosen
        self._active = rows.held(chosen)
        held, limit = way.rows.entries[self._active], rows.limit[self._active]
        floating = way.floating
        if floating.count:
            floating = rows.sticking(chosen.stick)[0].floating
        self._held, self._pushed = (
            floating.kept_from(way.holding(entries, limit), chosen.closed)
            for entries in (held, _below(held, rows.pushing(chosen)[chosen.closed]))
        )
        self._turning: Rows | None = None
        if way.any(chosen.turning > 0):
            turned, self._origin = rows.turning(chosen)
            self._turning = way.rows.standing(turned)
        self._scale = np.sqrt(way.diagonal)

    def closed(self, u: Vector) -> Vector:
        """A displacement moved onto the limits of the held rows."""
        x = u.copy()
        self._held.close(x)
        return x

    def residual(self, x: Vector) -> Vector:
        """f + E_T'C o - (K + E_T'C E_T) x."""
        left = self._rows.problem.load - self._way.product(x)
        if self._turning is not None:
            left -= self._turning.forces(self._turning.lengths(x) - self._origin)
        return np.asarray(left)

    def unbalanced(self, residual: Vector) -> Vector:
        """What the forces on the rows leave of a residual."""
        return self._pushed.balanced(residual)

    def error(self, unbalanced: Vector) -> float:
        """|r'P_H M r|, about the square of the error in energy."""
        return abs(self._way.dot(unbalanced, self._along(unbalanced)))

    def improved(self, x: Vector, unbalanced: Vector, reduction: float) -> Vector:
        """x with what is unbalanced at it reduced by this factor, as far as GMRES comes."""
        scale = self._scale

        def operator(y: Vector) -> Vector:
            return np.asarray(self._pushed.balanced(self._stiffness(self._along(scale * y))) / scale)

        found, steps = gmres(operator, unbalanced / scale, self._rows.problem.stiffness, reduction, STEPS)
        self._way.krylov_iterations += steps
        return np.asarray(x + self._along(scale * found))

    def iterate(self, x: Vector) -> Iterate:
        """The forces that go with a displacement. Friction across t is that of Newton's method."""
        rows, chosen = self._rows, self._chosen
        force = np.zeros(len(rows.limit))
        force[self._active] = self._pushed.forces(self.residual(x))
        normal, tie, rub = np.split(force, [rows.m, rows.plain])
        rub = rub.reshape(rows.m, rows.width)
        along = (rows.mu * np.maximum(normal, 0.0))[:, None] * chosen.direction
        return Iterate(x, normal, rub + along + rows.across(x, chosen), tie)

    def _along(self, r: Vector) -> Vector:
        z = self._way.smooth(r)
        self._held.admit(z)
        return z

    def _stiffness(self, x: Vector) -> Vector:
        force = self._way.product(x)
        if self._turning is not None:
            force += self._turning.forces(self._turning.lengths(x))
        return force


def _below(rows: sp.csr_matrix, added: sp.csr_matrix) -> sp.csr_matrix:
    """Rows with others added to the first of them."""
    nothing = sp.csr_matrix((rows.shape[0] - added.shape[0], rows.shape[1]))
    return sp.csr_matrix(rows + sp.vstack([added, nothing]))


# Newton's method on Coulomb's law over the ranks: from one combination of open, stick and slip to the next.
#
# Early combinations are solved loosely. One that comes again is solved until the answer, its friction put onto
# Coulomb's law, is in equilibrium; it is the answer if every figure of the certificate is small then.

# Combinations tried from one start.
MOST = 25
# What GMRES leaves of a combination that may not be the last, and of one that came again, a round.
LOOSE, TIGHT = 1e-3, 1e-7
# Rounds of GMRES on a combination that came again, each on the residual anew.
ROUNDS = 4
# Of the tolerance, what the equilibrium and all figures of an answer may be.
EQUILIBRIUM, FIGURE = 0.3, 0.7
# What is left of the forces that meet at an unknown when their rounding is all that is left.
ROUNDING = 4 * np.finfo(float).eps
# An error in energy, squared, of so many times what GMRES could not take off is rounding too.
STUCK = 4.0


class FrictionNewton:
    """Everything is collective."""

    def __init__(self, rows: FrictionRows, tolerance: float, energy: float) -> None:
        self._rows, self._way, self._problem = rows, rows.way, rows.problem
        self._tolerance, self._energy = tolerance, energy

    def run(self, start: Iterate) -> Iterate | None:
        """The answer from a start, or None where the combinations lead nowhere."""
        here, before = start, None
        chosen: States | None = None
        seen: dict[object, int] = {}
        for _ in range(MOST):
            chosen = self._rows.coulomb(here, chosen)
            if not self._held(chosen):
                return None
            mark = self._way.mark(chosen.flags)
            again = mark == before
            seen[mark] = seen.get(mark, 0) + 1
            if seen[mark] > 2 and not again:
                return None  # round and round
            system = CombinationSystem(self._rows, chosen)
            x, error = self._solved(system, system.closed(here.displacement), again)
            if self._way.any(~np.isfinite(x)):
                return None
            here, before = system.iterate(x), mark
            if again:
                answer = self._rows.within(here, chosen)
                if self._balances(system, answer, STUCK * error) and self.holds(answer):
                    return answer
        return None

    def _held(self, chosen: States) -> bool:
        """Whether what is closed and what sticks holds every rigid motion that the load drives."""
        if not self._way.floating.count:
            return True
        floating = self._rows.sticking(chosen.stick)[0].floating
        return floating.holds(chosen.closed, self._problem.load)

    def _solved(self, system: CombinationSystem, x: Vector, tight: bool) -> tuple[Vector, float]:
        """The displacement, and the error in energy, squared, that is left of it."""
        left = system.unbalanced(system.residual(x))
        for _ in range(ROUNDS if tight else 1):
            if self._small(x, left, ROUNDING) or (tight and self._enough(system, x, left, 0.0)):
                break
            x = system.improved(x, left, TIGHT if tight else LOOSE)
            left = system.unbalanced(system.residual(x))
        return x, system.error(left)

    def _small(self, x: Vector, left: Vector, part: float) -> bool:
        sizes = self._way.product_sizes(x) + abs(self._problem.load)
        return not self._way.any(~(ratio(abs(left), sizes) <= part))

    def _enough(self, system: CombinationSystem, x: Vector, left: Vector, floor: float) -> bool:
        if not self._small(x, left, EQUILIBRIUM * self._tolerance):
            return False
        work = self._way.dot(x, self._way.product(x))
        return system.error(left) <= max(self._energy**2 * work, floor)

    def _balances(self, system: CombinationSystem, answer: Iterate, floor: float) -> bool:
        x = answer.displacement
        return self._enough(system, x, self._rows.outer(answer) - self._way.product(x), floor)

    def holds(self, answer: Iterate) -> bool:
        """Whether every figure of the certificate but `balance`, which equilibrium implies, is small."""
        problem = self._problem
        given = DistributedAnswer(answer.displacement, answer.normal, answer.rub, answer.tie)
        found = violations(problem, given, Bodies(problem.ranks, problem.body), ROUNDING_OF_ANSWERS * self._tolerance)
        figures = worst(problem.ranks, *(getattr(found, name) for name in FIGURES if name != "balance"))
        return all(figure <= FIGURE * self._tolerance for figure in figures)


# Bounds that change by less than this part of the largest may have come to the answer.
SETTLED = 5e-10
# Enough for contractions up to 0.9, as in one process; what is slower is not getting there.
MAX_STEPS = 100


@dataclass(frozen=True, eq=False)
class FrictionFound:
    """An answer that holds, and what it took."""

    answer: DistributedAnswer
    steps: int  # contact problems without friction
    changes: tuple[float, ...]  # of the bounds, relative, one a step


@dataclass(frozen=True, eq=False)
class _Limits:
    """A contact problem whose ties are those of the problem and the tangents that stick."""

    load: Vector
    gap: Vector
    tie_value: Vector


def solve_friction(
    problem: DistributedProblem,
    way: DistributedIteration,
    settings: Settings,
    start: DistributedAnswer | None,
    energy: float,
) -> FrictionFound:
    """Coulomb's answer, as far as the steps tell; the certificate judges it. Collective.

    Parameters
    ----------
    problem : DistributedProblem
        With friction.
    way : DistributedIteration
        With tangents.
    settings : Settings
        `max_iter` counts contact problems without friction, `time_limit` is for all of them.
    start : DistributedAnswer, optional
        Of a problem with the same K and rows.
    energy : float
        The error in energy, of the energy of the displacement.

    Raises
    ------
    NotConverged
        The bounds have not settled, or a bound on the way does not hold the bodies; the history has their changes.
    NoEquilibrium
        The bodies are held neither without friction nor with all contacts stuck.
    """
    return _FixedPoint(problem, way, settings, energy).run(start)


class _FixedPoint:
    def __init__(
        self, problem: DistributedProblem, way: DistributedIteration, settings: Settings, energy: float
    ) -> None:
        self._problem, self._way, self._energy = problem, way, energy
        self._rows = FrictionRows(problem, way)
        limit = settings.time_limit
        self._end = np.inf if limit is None else time.perf_counter() + limit
        self._settings = replace(settings, warm_start=None, max_iter=None)
        self._most = settings.max_iter or MAX_STEPS
        self._newton = FrictionNewton(self._rows, settings.tolerance, energy)
        self._changes: list[float] = []

    def run(self, start: DistributedAnswer | None) -> FrictionFound:
        rows = self._rows
        if start is not None and (known := self._from(start)) is not None:
            found = self._newton.run(known)
            if found is not None:
                return self._found(found, 0)
        here = self._first()
        bound = rows.mu * np.maximum(here.normal, 0.0)
        relaxation, before = RELAXATION[1], None
        chosen: States | None = None
        for step in range(1, self._most + 1):
            found = self._newton.run(here)
            if found is not None:
                return self._found(found, step)
            self._refuse_late()
            chosen = states(rows.trial(here), bound, rows.stiffness, chosen)
            here = self._step(chosen, bound, step)
            missing = rows.mu * np.maximum(here.normal, 0.0) - bound
            self._changes.append(self._change(missing, bound))
            if self._changes[-1] <= SETTLED and self._newton.holds(settled := rows.within(here, chosen)):
                return self._found(settled, step)
            relaxation = aitken(relaxation, before, missing, self._way.dot)
            bound, before = np.maximum(bound + relaxation * missing, 0.0), missing
        raise self._not_converged(f"the friction bounds have not settled in {self._most} steps")

    def _from(self, start: DistributedAnswer) -> Iterate | None:
        """A known answer to begin with, unless nothing touches in it."""
        if start.friction_force is None or not self._way.any(start.normal_force > 0):
            return None
        return Iterate(start.displacement, start.normal_force, start.friction_force, start.tie_force)

    def _first(self) -> Iterate:
        """The answer without friction or, where that holds the bodies, the one with all contacts stuck."""
        m, width = self._rows.m, self._rows.width
        nothing, everywhere = np.zeros((m, width)), np.ones(m, dtype=bool)
        try:
            return self._solved(States(~everywhere, ~everywhere, nothing, np.zeros(m)), nothing)
        except NoEquilibrium:
            stuck = States(everywhere, everywhere & (self._rows.mu > 0), nothing, np.zeros(m))
            return self._solved(stuck, nothing)

    def _step(self, chosen: States, bound: Vector, step: int) -> Iterate:
        try:
            return self._solved(chosen, bound[:, None] * chosen.direction)
        except NoEquilibrium as error:
            raise self._not_converged(f"the friction bounds of step {step} do not hold the bodies") from error

    def _solved(self, chosen: States, rub: Array) -> Iterate:
        """The answer without friction but for what sticks and the known rubbing (m, d-1)."""
        rows, m, k = self._rows, self._rows.m, self._problem.ties
        way, limit = rows.sticking(chosen.stick)
        before = way.krylov_iterations
        load = self._problem.load - rows.load_of(rub)
        limits = _Limits(load, limit[:m], limit[m:])
        settings = replace(self._settings, time_limit=None if np.isinf(self._end) else self._left())
        candidate = solve_by_iteration(limits, way, settings, self._energy)
        self._way.krylov_iterations += way.krylov_iterations - before
        # What the first answers have not settled, later steps do.
        if self._changes and not candidate.claimed:
            raise self._not_converged(candidate.status)
        whole = np.zeros(len(rows.limit))
        whole[rows.tangents(chosen.stick)] = candidate.tie_force[k:]
        friction = rub + whole[rows.plain :].reshape(m, rows.width)
        return Iterate(candidate.displacement, candidate.normal_force, friction, candidate.tie_force[:k])

    def _change(self, missing: Vector, bound: Vector) -> float:
        size, largest = (float(np.max(abs(part), initial=0.0)) for part in (missing, bound))
        change, scale = self._problem.ranks.max(np.array([size, max(size, largest)]))
        return float(change / scale) if scale > 0 else 0.0

    def _left(self) -> float:
        return max(self._end - time.perf_counter(), 0.0)

    def _refuse_late(self) -> None:
        if self._way.any(time.perf_counter() > self._end):
            raise self._not_converged("the time limit is reached")

    def _not_converged(self, why: str) -> NotConverged:
        return NotConverged(f"tresca: {why}", tuple(self._changes))

    def _found(self, found: Iterate, steps: int) -> FrictionFound:
        answer = DistributedAnswer(found.displacement, found.normal, found.rub, found.tie)
        return FrictionFound(answer, steps, tuple(self._changes))
