"""Coulomb friction over the ranks: Tresca's fixed point with the distributed solve inside.

A step knows which contacts stick, and how large and along what the others rub: friction that is known is a load,
tangents that stick are ties, and what is left is a contact problem without friction
(`contactqp.solving.methods.inexact_active_set`). Its forces give the next bounds mu l_N, relaxed by Aitken's factor,
and the next states. Before the first step and after each, Newton's method on the combination of states, whose systems
have Coulomb's law in them (`contactqp.distributed.friction_system`), tries to end it: bounds need not settle to the
last digit.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from contactqp.distributed.answer import DistributedAnswer
from contactqp.distributed.friction_newton import FrictionNewton
from contactqp.distributed.friction_rows import FrictionRows
from contactqp.distributed.friction_states import Iterate, States, states
from contactqp.distributed.iteration import DistributedIteration
from contactqp.distributed.problem import DistributedProblem
from contactqp.errors import NoEquilibrium, NotConverged
from contactqp.model.arrays import Array, Vector
from contactqp.solving.friction.iterate import RELAXATION, aitken
from contactqp.solving.methods import Settings
from contactqp.solving.methods.inexact_active_set import solve_by_iteration

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
