"""Coulomb friction over the ranks: Tresca's fixed point with the distributed solve inside.

A step of the fixed point prescribes which contacts stick, and the friction of the others: prescribed friction is a
load, tangents that stick are ties, and what remains is a contact problem without friction
(`contactqp.solving.methods.inexact_active_set`). Its forces give the next bounds mu l_N, relaxed by Aitken's factor,
and the next states. Bounds need not settle to the last digit: before the first step and after each, Newton's method on
the combination of states, whose systems contain Coulomb's law, tries to end the iteration.
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
from contactqp.distributed.iteration import (
    Combination,
    DistributedIteration,
    FrictionalAnswer,
    FrictionRows,
    combination_of,
)
from contactqp.distributed.problem import Bodies, DistributedProblem, largest_over_ranks
from contactqp.distributed.violations import outer_resultant, violations
from contactqp.errors import NoEquilibrium, NotConverged
from contactqp.linalg.measures import ratio
from contactqp.model.arrays import Array, Vector
from contactqp.model.solution import FIGURES, Answer, Candidate
from contactqp.solving.friction.iterate import RELAXATION, aitken
from contactqp.solving.methods import Settings
from contactqp.solving.methods.inexact_active_set import solve_by_iteration

# Vectors that GMRES keeps until it starts anew.
RESTART = 60


def gmres(
    operator: Callable[[Vector], Vector], right: Vector, like: Any, reduction: float, most: int
) -> tuple[Vector, int]:
    """Solve A x = right by PETSc's GMRES, with A a function. Collective.

    Parameters
    ----------
    operator : function
        Returns A x of this rank's part x of a vector. Collective.
    right : (n_here,) array
        The right-hand side.
    like : PETSc.Mat
        A matrix whose unknowns are distributed as those of A: K.
    reduction : float
        It ends where |right - A x| <= reduction |right|.
    most : int
        It ends after this many steps.

    Returns
    -------
    x : (n_here,) array
        The last iterate.
    steps : int
        The steps taken.
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
    """A function as the context of a matrix of PETSc's type "python"."""

    def __init__(self, operator: Callable[[Vector], Vector]) -> None:
        self._operator = operator

    def mult(self, matrix: Any, x: Any, y: Any) -> None:
        """Write A x to y."""
        del matrix
        y.array[:] = self._operator(np.array(x.array_r))


# Steps of GMRES on one combination.
STEPS = 600


class CombinationSystem:
    """The linear system of one combination of open, stick and slip, unsymmetric where something slides.

    With H the constrained rows (closed contacts, ties, tangents that stick), G = H + mu t'E_T at the normals of
    contacts that slide, and the turning of slip directions in space as a stiffness C of the tangents,

        (K + E_T'C E_T) u + G'l = f + E_T'C o,    H u = h.

    GMRES goes along displacements M r that H admits and looks at what the forces on G leave of residuals,

        P_G (K + E_T'C E_T) P_H M y = P_G r,    u = u_0 + P_H M y,

    where P_H and P_G are the projections of `contactqp.linalg.krylov`. Friction in proportion to l_N is in the system
    itself: nothing is iterated on but the combination, and in space the directions. Everything is collective.
    """

    def __init__(self, rows: FrictionRows, states: Combination) -> None:
        iteration = rows.iteration
        self._rows, self._iteration, self._states = rows, iteration, states
        self._active = rows.constrained(states)
        H, limit = iteration.rows.entries[self._active], rows.limit[self._active]
        sliding = rows.sliding(states)[states.closed]
        G = H + sp.vstack([sliding, sp.csr_matrix((H.shape[0] - sliding.shape[0], H.shape[1]))])
        floating = iteration.floating
        if floating.count:
            floating = rows.sticking(states.stick)[0].floating
        self._on_h, self._on_g = (
            floating.projections(iteration.constrained(sp.csr_matrix(entries), limit), states.closed)
            for entries in (H, G)
        )
        self._turning: Any = None
        if iteration.any(states.turning > 0):
            turned, self._origin = rows.turning(states)
            self._turning = iteration.rows.with_entries(turned)
        self._scale = np.sqrt(iteration.diagonal)

    def closed(self, u: Vector) -> Vector:
        """Return a displacement moved onto the limits of the constrained rows."""
        x = u.copy()
        self._on_h.close(x)
        return x

    def unbalanced(self, x: Vector) -> Vector:
        """Return what the forces on G leave of the residual at a displacement."""
        return self._on_g.balanced(self._residual(x))

    def _residual(self, x: Vector) -> Vector:
        """Return f + E_T'C o - (K + E_T'C E_T) x."""
        residual = self._rows.problem.load - self._iteration.product(x)
        if self._turning is not None:
            residual -= self._turning.forces(self._turning.lengths(x) - self._origin)
        return np.asarray(residual)

    def error(self, unbalanced: Vector) -> float:
        """Return |r'P_H M r|, about the square of the error in energy."""
        return abs(self._iteration.dot(unbalanced, self._along(unbalanced)))

    def improved(self, x: Vector, unbalanced: Vector, reduction: float) -> Vector:
        """Return x after GMRES has reduced what is unbalanced at it by this factor, or as far as it comes."""
        scale = self._scale

        def operator(y: Vector) -> Vector:
            return np.asarray(self._on_g.balanced(self._stiffness(self._along(scale * y))) / scale)

        found, steps = gmres(operator, unbalanced / scale, self._rows.problem.stiffness, reduction, STEPS)
        self._iteration.krylov_iterations += steps
        return np.asarray(x + self._along(scale * found))

    def answer(self, x: Vector) -> FrictionalAnswer:
        """Return a displacement with its forces; friction across t is that of Newton's method."""
        rows, states = self._rows, self._states
        force = np.zeros(len(rows.limit))
        force[self._active] = self._on_g.forces(self._residual(x))
        normal, tie, friction = np.split(force, [rows.m, rows.plain])
        sliding = rows.bound(normal)[:, None] * states.direction
        friction = friction.reshape(rows.m, rows.width) + sliding + rows.turned_friction(x, states)
        return FrictionalAnswer(x, normal, friction, tie)

    def _along(self, r: Vector) -> Vector:
        """Return P_H M r."""
        z = self._iteration.smooth(r)
        self._on_h.admit(z)
        return z

    def _stiffness(self, x: Vector) -> Vector:
        force = self._iteration.product(x)
        if self._turning is not None:
            force += self._turning.forces(self._turning.lengths(x))
        return force


# Combinations tried from one start.
MOST = 25
# The parts to which GMRES reduces what is unbalanced: of a combination that may not be the last, and of one that came
# again, in each round.
LOOSE, TIGHT = 1e-3, 1e-7
# Rounds of GMRES on a combination that came again, each on the residual anew.
ROUNDS = 4
# The parts of the tolerance that equilibrium and all figures of an answer may reach.
EQUILIBRIUM, FIGURE = 0.3, 0.7
# The part of the forces that meet at an unknown that is rounding.
ROUNDING = 4 * np.finfo(float).eps
# An error in energy, squared, of so many times what GMRES could not reduce is rounding too.
STUCK = 4.0


class FrictionNewton:
    """Newton's method on Coulomb's law, from one combination of open, stick and slip to the next.

    Early combinations are solved loosely. One that comes again is solved until the answer, its friction put onto
    Coulomb's law, is in equilibrium; it is the answer if every figure of the certificate is small then. Everything is
    collective.
    """

    def __init__(self, rows: FrictionRows, tolerance: float, energy: float) -> None:
        self._rows, self._iteration, self._problem = rows, rows.iteration, rows.problem
        self._tolerance, self._energy = tolerance, energy

    def run(self, start: FrictionalAnswer) -> FrictionalAnswer | None:
        """Return the answer from a start, or None where the combinations lead nowhere."""
        here, before = start, None
        states: Combination | None = None
        seen: dict[object, int] = {}
        for _ in range(MOST):
            states = self._rows.coulomb(here, states)
            if not self._supports(states):
                return None
            mark = self._iteration.mark(states.flags)
            again = mark == before
            seen[mark] = seen.get(mark, 0) + 1
            if seen[mark] > 2 and not again:
                return None  # the combinations form a cycle
            system = CombinationSystem(self._rows, states)
            x, error = self._solved(system, system.closed(here.displacement), again)
            if self._iteration.any(~np.isfinite(x)):
                return None
            here, before = system.answer(x), mark
            if again:
                answer = self._rows.within_law(here, states)
                residual = outer_resultant(self._problem, answer) - self._iteration.product(x)
                if self._enough(system, x, residual, STUCK * error) and self.certifiable(answer):
                    return answer
        return None

    def _supports(self, states: Combination) -> bool:
        """Return whether what is closed and what sticks holds every rigid motion that the load drives."""
        if not self._iteration.floating.count:
            return True
        floating = self._rows.sticking(states.stick)[0].floating
        return floating.holds(states.closed, self._problem.load)

    def _solved(self, system: CombinationSystem, x: Vector, tight: bool) -> tuple[Vector, float]:
        """Return the displacement, and the square of the error in energy that remains."""
        unbalanced = system.unbalanced(x)
        for _ in range(ROUNDS if tight else 1):
            if self._small(x, unbalanced, ROUNDING) or (tight and self._enough(system, x, unbalanced, 0.0)):
                break
            x = system.improved(x, unbalanced, TIGHT if tight else LOOSE)
            unbalanced = system.unbalanced(x)
        return x, system.error(unbalanced)

    def _small(self, x: Vector, residual: Vector, part: float) -> bool:
        sizes = self._iteration.product_sizes(x) + abs(self._problem.load)
        return not self._iteration.any(~(ratio(abs(residual), sizes) <= part))

    def _enough(self, system: CombinationSystem, x: Vector, residual: Vector, floor: float) -> bool:
        """Return whether a residual is small at every unknown, and in energy small or below the floor."""
        if not self._small(x, residual, EQUILIBRIUM * self._tolerance):
            return False
        work = self._iteration.dot(x, self._iteration.product(x))
        return system.error(residual) <= max(self._energy**2 * work, floor)

    def certifiable(self, answer: Answer) -> bool:
        """Return whether every figure of the certificate but `balance`, which equilibrium implies, is small."""
        problem = self._problem
        found = violations(problem, answer, Bodies(problem.ranks, problem.body), ROUNDING_OF_ANSWERS * self._tolerance)
        figures = largest_over_ranks(problem.ranks, *(getattr(found, name) for name in FIGURES if name != "balance"))
        return all(figure <= FIGURE * self._tolerance for figure in figures)


# Bounds that change by less than this part of the largest may have come to the answer.
SETTLED = 5e-10
# Enough steps for contractions up to 0.9, as in one process; a slower iteration does not converge.
MAX_STEPS = 100


@dataclass(frozen=True, eq=False)
class _Limits:
    """A contact problem whose ties are those of the problem and the tangents that stick."""

    load: Vector
    gap: Vector
    tie_value: Vector


def solve_friction(
    problem: DistributedProblem,
    iteration: DistributedIteration,
    settings: Settings,
    start: Answer | None,
    energy: float,
) -> Candidate:
    """Return the answer of Coulomb's law as far as the steps can tell; the certificate judges it. Collective.

    Parameters
    ----------
    problem : DistributedProblem
        A problem with friction.
    iteration : DistributedIteration
        The iteration on its rows, tangents included.
    settings : Settings
        `max_iter` counts contact problems without friction, `time_limit` is for all of them.
    start : Answer, optional
        The answer of a problem with the same K and rows.
    energy : float
        The error in energy, relative to the energy of the displacement.

    Raises
    ------
    NotConverged
        The bounds have not settled, or those of a step do not hold the bodies; the history has their changes.
    NoEquilibrium
        The bodies are held neither without friction nor with all contacts stuck.
    """
    fixed_point = _FixedPoint(problem, iteration, settings, energy)
    found, steps = fixed_point.run(start)
    return Candidate(
        found.displacement,
        found.normal_force,
        found.tie_force,
        iterations=steps,
        history=tuple(fixed_point.changes),
        friction_force=found.friction_force,
    )


class _FixedPoint:
    """Tresca's fixed point; `changes` are those of the bounds in each step, relative."""

    def __init__(
        self, problem: DistributedProblem, iteration: DistributedIteration, settings: Settings, energy: float
    ) -> None:
        self._problem, self._iteration, self._energy = problem, iteration, energy
        self._rows = FrictionRows(problem, iteration)
        limit = settings.time_limit
        self._end = np.inf if limit is None else time.perf_counter() + limit
        self._settings = replace(settings, warm_start=None, max_iter=None)
        self._most = settings.max_iter or MAX_STEPS
        self._newton = FrictionNewton(self._rows, settings.tolerance, energy)
        self.changes: list[float] = []

    def run(self, start: Answer | None) -> tuple[FrictionalAnswer, int]:
        """Return the answer and the number of contact problems without friction that it took."""
        rows = self._rows
        if start is not None and start.friction_force is not None and self._iteration.any(start.normal_force > 0):
            here = FrictionalAnswer(start.displacement, start.normal_force, start.friction_force, start.tie_force)
            if (found := self._newton.run(here)) is not None:
                return found, 0
        here = self._first()
        bound = rows.bound(here.normal_force)
        relaxation, before = RELAXATION[1], None
        states: Combination | None = None
        for step in range(1, self._most + 1):
            if (found := self._newton.run(here)) is not None:
                return found, step
            if self._iteration.any(time.perf_counter() > self._end):
                raise self._not_converged("the time limit is reached")
            states = combination_of(rows.trial(here), bound, rows.stiffness, states)
            try:
                here = self._solved(states, bound[:, None] * states.direction)
            except NoEquilibrium as error:
                raise self._not_converged(f"the friction bounds of step {step} do not hold the bodies") from error
            missing = rows.bound(here.normal_force) - bound
            self.changes.append(self._change(missing, bound))
            if self.changes[-1] <= SETTLED and self._newton.certifiable(settled := rows.within_law(here, states)):
                return settled, step
            relaxation = aitken(relaxation, before, missing, self._iteration.dot)
            bound, before = np.maximum(bound + relaxation * missing, 0.0), missing
        raise self._not_converged(f"the friction bounds have not settled in {self._most} steps")

    def _first(self) -> FrictionalAnswer:
        """Return the answer without friction where that holds the bodies, else the one with all contacts stuck."""
        m, width = self._rows.m, self._rows.width
        nothing, everywhere = np.zeros((m, width)), np.ones(m, dtype=bool)
        try:
            return self._solved(Combination(~everywhere, ~everywhere, nothing, np.zeros(m)), nothing)
        except NoEquilibrium:
            stuck = Combination(everywhere, everywhere & (self._rows.friction > 0), nothing, np.zeros(m))
            return self._solved(stuck, nothing)

    def _solved(self, states: Combination, prescribed: Array) -> FrictionalAnswer:
        """Return the answer where some contacts stick and the others have the prescribed friction (m, d-1)."""
        rows, m, k = self._rows, self._rows.m, self._problem.ties
        iteration, limit = rows.sticking(states.stick)
        before = iteration.krylov_iterations
        tangential = np.concatenate([np.zeros(rows.plain), prescribed.ravel()])
        limits = _Limits(self._problem.load - self._iteration.forces(tangential), limit[:m], limit[m:])
        seconds = None if np.isinf(self._end) else max(self._end - time.perf_counter(), 0.0)
        candidate = solve_by_iteration(limits, iteration, replace(self._settings, time_limit=seconds), self._energy)
        self._iteration.krylov_iterations += iteration.krylov_iterations - before
        # What the first answers have not settled, later steps do.
        if self.changes and not candidate.claimed:
            raise self._not_converged(candidate.status)
        tangential[rows.tangents(states.stick)] += candidate.tie_force[k:]
        friction = tangential[rows.plain :].reshape(m, rows.width)
        return FrictionalAnswer(candidate.displacement, candidate.normal_force, friction, candidate.tie_force[:k])

    def _change(self, missing: Vector, bound: Vector) -> float:
        size, largest = (float(np.max(abs(part), initial=0.0)) for part in (missing, bound))
        change, scale = self._problem.ranks.max(np.array([size, max(size, largest)]))
        return float(change / scale) if scale > 0 else 0.0

    def _not_converged(self, why: str) -> NotConverged:
        return NotConverged(f"tresca: {why}", tuple(self.changes))
