"""Solve Coulomb friction on bodies that are not factorised, in one process and on ranks, by Tresca's fixed point and
Newton.

A step of the fixed point (Laursen 2002, section 5.2) prescribes which contacts stick, and the friction of the others.
Prescribed friction is a load and sticking tangents are ties, so that a contact problem without friction remains
(`contactqp.solving.methods.inexact_active_set`). Its forces give the next bounds mu l_N, relaxed by Aitken's factor,
and the next states. The bounds need not converge to the last digit: before the first step and after each, Newton's
method on the combination of states (Alart and Curnier 1991) tries to finish. Its first combinations are solved with a
loose tolerance, the last one accurately.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from contactqp.errors import NoEquilibrium, NotConverged
from contactqp.linalg.contact_iteration import ContactIteration
from contactqp.linalg.iterated_states import (
    Combination,
    CombinationSystem,
    FrictionalAnswer,
    FrictionalLimits,
    FrictionRows,
    combination_of,
)
from contactqp.model.arrays import Array, Vector, tell
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.friction.local_form import RELAXATION, aitken
from contactqp.solving.methods import Settings
from contactqp.solving.methods.inexact_active_set import identified_by_iteration, solve_by_iteration

# A function that returns whether every figure of the certificate is at most this part of the tolerance.
Certifiable = Callable[[Answer, float], bool]
# The most combinations tried from one start.
MOST = 25
# The relative residual of GMRES for a combination that may not be the last, and for the first that recurs, whose slip
# directions may still turn in space.
LOOSE, SLIDING = 1e-2, 1e-3
# If the figures of an accurately solved answer are not small, the next tolerance is smaller by this factor, as
# directions of small slips converge later than displacements.
TIGHTER = 0.1
# The part of the tolerance that figures of an answer may reach.
FIGURE = 0.7
# A squared energy error up to this multiple of the residual where GMRES stagnates counts as rounding.
STUCK = 4.0


class FrictionNewton:
    """Newton's method on Coulomb's law, from one combination of open, stick and slip to the next.

    Early combinations are solved with a loose tolerance. One that recurs, in space with slip directions updated once
    more, is solved until the answer, with its friction projected onto Coulomb's law, is in equilibrium; it is accepted
    if every figure of the certificate is then small. All calls are collective over ranks.

    Parameters
    ----------
    rows : FrictionRows, problem and iteration
    tolerance : float, that of the certificate
    energy : float, the error in energy that the last combination is solved to, relative
    certifiable : function of an Answer and a tolerance, returns whether its figures pass
    end : float, the time at which the search ends, as `time.perf_counter` counts it
    """

    def __init__(
        self, rows: FrictionRows, tolerance: float, energy: float, certifiable: Certifiable, end: float
    ) -> None:
        self._rows, self._iteration, self._problem, self._end = rows, rows.iteration, rows.problem, end
        self._tolerance, self._energy, self._certifiable = tolerance, energy, certifiable

    def run(self, start: FrictionalAnswer) -> FrictionalAnswer | None:
        """Return the answer from a start, None where the combinations do not converge."""
        here, before, part = start, None, 1.0
        states: Combination | None = None
        seen: dict[object, int] = {}
        for number in range(1, MOST + 1):
            if self._iteration.any(time.perf_counter() > self._end):
                return None
            states = self._rows.coulomb(here, states)
            if not self._rows.sticking(states.stick)[0].supports(states.closed, self._problem.load):
                return None
            closed, stick = (self._iteration.count(flags) for flags in (states.closed, states.stick))
            tell(f"combination {number} of open, stick and slip: {closed} closed, {stick} of them stick")
            mark = self._iteration.mark(states.flags)
            again = mark == before
            seen[mark] = seen.get(mark, 0) + 1
            if seen[mark] > 2 and not again:
                return None  # the combinations form a cycle
            system = CombinationSystem(self._rows, states)
            x = system.closed(here.displacement)
            last = again and not (seen[mark] == 2 and self._iteration.any(states.turning > 0))
            if last:
                x = system.solved(x, part * self._tolerance, part * self._energy)
            else:
                x = system.improved(x, SLIDING if again else LOOSE)
            if self._iteration.any(~np.isfinite(x)):
                return None
            here, before = system.answer(x), mark
            if last:
                answer = self._rows.within_law(here, states)
                floor = STUCK * system.error_at(x)
                enough = system.enough(x, self._rows.residual(answer), self._tolerance, self._energy, floor)
                if enough and self.certifiable(answer):
                    return answer
                part *= TIGHTER if enough else 1.0
        return None

    def certifiable(self, answer: Answer) -> bool:
        """Return whether every figure of the certificate is small."""
        return self._certifiable(answer, FIGURE * self._tolerance)


# Bounds have converged if they change by less than this part of the largest.
BOUNDS_SETTLED = 5e-10
# The most steps, enough for contraction factors up to 0.9, as in one process.
MAX_STEPS = 100


@dataclass(frozen=True, eq=False)
class _Limits:
    """The contact problem of one step, with the sticking tangents as further ties."""

    load: Vector
    gap: Vector
    tie_value: Vector


def solve_friction_by_iteration(
    problem: FrictionalLimits,
    iteration: ContactIteration,
    settings: Settings,
    start: Answer | None,
    energy: float,
    certifiable: Certifiable,
) -> Candidate:
    """Return an answer with Coulomb friction, which the certificate is to judge. Collective.

    If the iteration does not converge or reaches a time limit, the last answer is returned and not claimed.

    Raises NotConverged: the steps ended before one of them had an answer; NoEquilibrium: the bodies are held neither
    without friction nor with all contacts stuck.

    Parameters
    ----------
    problem : a problem with friction
    iteration : the iteration on its rows, tangents included
    settings : `max_iter` counts contact problems without friction, `time_limit` is for all of them
    start : the answer of a problem with the same K and rows
    energy : the error in energy, relative to the energy of the displacement
    certifiable : function
        Whether all figures of an answer, but `balance`, which equilibrium implies, are at most a limit.
    """
    fixed_point = _FixedPoint(problem, iteration, settings, energy, certifiable)
    status = ""
    try:
        found, steps = fixed_point.run(start)
    except NotConverged as error:
        if fixed_point.last is None:
            raise
        found, steps, status = fixed_point.last, len(fixed_point.changes), str(error)
    return Candidate(
        found,
        iterations=steps,
        claimed=not status,
        status=status,
        history=tuple(fixed_point.changes),
    )


class _FixedPoint:
    """Tresca's fixed point; `changes` are the relative changes of the bounds in each step, `last` is the last
    answer.
    """

    def __init__(
        self,
        problem: FrictionalLimits,
        iteration: ContactIteration,
        settings: Settings,
        energy: float,
        certifiable: Certifiable,
    ) -> None:
        self._problem, self._iteration, self._energy = problem, iteration, energy
        self._rows = FrictionRows(problem, iteration)
        limit = settings.time_limit
        self._end = np.inf if limit is None else time.perf_counter() + limit
        self._settings = replace(settings, warm_start=None, max_iter=None)
        self._most = settings.max_iter or MAX_STEPS
        self._newton = FrictionNewton(self._rows, settings.tolerance, energy, certifiable, self._end)
        self.changes: list[float] = []
        self.last: FrictionalAnswer | None = None

    def run(self, start: Answer | None) -> tuple[FrictionalAnswer, int]:
        """Return the answer and the number of contact problems without friction that it took."""
        rows = self._rows
        if start is not None and start.friction_force is not None and self._iteration.any(start.normal_force > 0):
            here = FrictionalAnswer(start.displacement, start.normal_force, start.friction_force, start.tie_force)
            if (found := self._newton.run(here)) is not None:
                return found, 0
        here = self.last = self._first()
        bound = rows.bound(here.normal_force)
        relaxation, before = RELAXATION[1], None
        states: Combination | None = None
        for step in range(1, self._most + 1):
            if (found := self._newton.run(here)) is not None:
                return found, step
            if self._iteration.any(time.perf_counter() > self._end):
                raise self._not_converged("the time limit is reached")
            tell(f"friction bounds, step {step}")
            states = combination_of(rows.trial(here), bound, rows.stiffness, states)
            try:
                here = self.last = self._solved(states, bound[:, None] * states.direction)
            except NoEquilibrium as error:
                raise self._not_converged(f"the friction bounds of step {step} do not hold the bodies") from error
            missing = rows.bound(here.normal_force) - bound
            self.changes.append(self._change(missing, bound))
            if self.changes[-1] <= BOUNDS_SETTLED and self._newton.certifiable(
                settled := rows.within_law(here, states)
            ):
                return settled, step
            relaxation = aitken(relaxation, before, missing, self._iteration.dot)
            bound, before = np.maximum(bound + relaxation * missing, 0.0), missing
        raise self._not_converged(f"the friction bounds have not settled in {self._most} steps")

    def _first(self) -> FrictionalAnswer:
        """Return the answer without friction where that holds the bodies, else the one with all contacts stuck."""
        m, width = self._rows.m, self._rows.width
        nothing, everywhere = np.zeros((m, width)), np.ones(m, dtype=bool)
        try:
            return self._solved(Combination(~everywhere, ~everywhere, nothing, np.zeros(m)), nothing, roughly=True)
        except NoEquilibrium:
            stuck = Combination(everywhere, everywhere & (self._rows.friction > 0), nothing, np.zeros(m))
            return self._solved(stuck, nothing, roughly=True)

    def _solved(self, states: Combination, prescribed: Array, roughly: bool = False) -> FrictionalAnswer:
        """Return the answer where some contacts stick and the others have the prescribed friction (m, d-1).

        With `roughly` the set of closed contacts is determined, and forces to a few digits.
        """
        rows, m = self._rows, self._rows.m
        k = rows.plain - m
        iteration, limit = rows.sticking(states.stick)
        before = iteration.krylov_iterations
        tangential = np.concatenate([np.zeros(rows.plain), prescribed.ravel()])
        limits = _Limits(self._problem.load - self._iteration.forces(tangential), limit[:m], limit[m:])
        seconds = None if np.isinf(self._end) else max(self._end - time.perf_counter(), 0.0)
        settings = replace(self._settings, time_limit=seconds)
        candidate = identified_by_iteration(limits, iteration, settings) if roughly else None
        if candidate is None:
            candidate = solve_by_iteration(limits, iteration, settings, self._energy)
        self._iteration.krylov_iterations += iteration.krylov_iterations - before
        # Early answers may be inaccurate, as later steps refine them.
        if self.changes and not candidate.claimed:
            raise self._not_converged(candidate.status)
        found = candidate.answer
        tangential[rows.tangents(states.stick)] += found.tie_force[k:]
        friction = tangential[rows.plain :].reshape(m, rows.width)
        return FrictionalAnswer(found.displacement, found.normal_force, friction, found.tie_force[:k])

    def _change(self, missing: Vector, bound: Vector) -> float:
        size, largest = (float(np.max(abs(part), initial=0.0)) for part in (missing, bound))
        change, scale = self._iteration.largest(np.array([size, max(size, largest)]))
        return float(change / scale) if scale > 0 else 0.0

    def _not_converged(self, why: str) -> NotConverged:
        return NotConverged(f"tresca: {why}", tuple(self.changes))
