"""A load path with Coulomb friction in steps on the ranks of MPI, contacts anchored as in one process.

What a step needs to know of the contacts before it (`contactqp.analysis.friction_step`) is whole on every rank: as
many numbers as there are contacts. All ranks decide alike then.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from contactqp.analysis.friction_step import SAME, TOUCHING, WIDENED, Anchors, SolvedStep, State, step_to
from contactqp.analysis.history import Energies, Event, contact_changes
from contactqp.distributed.problem import DistributedProblem, DistributedSolution
from contactqp.distributed.solving import solve_distributed
from contactqp.distributed.violations import row_sizes
from contactqp.errors import NoEquilibrium, NotConverged
from contactqp.model.arrays import Array, Mask, Vector


def follow_rubbing(
    problem: DistributedProblem, loads: Iterable[Vector], method: str, **options: Any
) -> Iterator[DistributedSolution]:
    """The solution under each load (n_here,), slips counted from where contacts were before or closed. Collective.

    The problem of each has the slip origins of its step, as `contactqp.follow_path` tells them.
    """
    stepper = _Stepper(problem, method, options)
    whole = problem.whole(_origin(problem), problem.contact_number)
    anchors, state = Anchors(whole, np.zeros(len(whole), dtype=bool)), None
    for load in loads:
        if state is None:
            stepper.turn(load, load)
            state = stepper.solve(1.0, whole, np.zeros(len(whole), dtype=bool))
            # A contact that is closed and carries nothing is where the problem anchored it.
            at_rest = state.touching & ~state.pushes
            anchors = Anchors(np.where(at_rest[:, None], whole, state.position), state.touching)
            stepper.accept(state)
        else:
            stepper.turn(stepper.load, load)
            state = stepper.accept(step_to(1.0, replace(state, fraction=0.0), anchors, stepper.solve))
            anchors = Anchors(state.position, state.touching)
        yield stepper.before


class _Stepper:
    """As `contactqp.analysis.friction_step.SolveStepper`; everything is collective."""

    before: DistributedSolution

    def __init__(self, problem: DistributedProblem, method: str, options: dict[str, Any]) -> None:
        self._problem, self._method, self._options = problem, method, options
        self._known: DistributedSolution | None = None
        self._farthest = WIDENED * float(problem.ranks.max(float(np.max(abs(problem.gap), initial=0.0))))

    def turn(self, start: Vector, load: Vector) -> None:
        """Set out from one load to the next."""
        self._start, self.load = start, load

    def solve(self, fraction: float, origin: Array, held_open: Mask) -> State:
        """The equilibrium at a fraction of the way from slip origins (m, d-1) of all ranks, contacts held open."""
        problem, here = self._problem, self._problem.contact_number
        load = self.load if fraction == 1 else self._start + fraction * (self.load - self._start)
        far = np.where(held_open[here], WIDENED * abs(problem.gap) + self._farthest, 0.0)
        at = replace(problem, load=load, slip_origin=origin[here], gap=problem.gap + far)
        solution = self._solved(at, self._known)
        if problem.ranks.any(solution.answer.normal_force[held_open[here]] > 0):
            raise NoEquilibrium("a contact that is held open closes")
        return self._state(solution, fraction, held_open)

    def accept(self, state: State) -> State:
        """The state as a step of the path, its gaps as they are; the next solve starts from it.

        Raises
        ------
        NotConverged
            Contacts that do not reach their obstacle make a difference: there are several equilibria.
        """
        found: Any = state.step.finish()
        ranks = self._problem.ranks
        if ranks.any(found.problem.gap != self._problem.gap):
            wide = found.answer.displacement
            found = self._solved(replace(found.problem, gap=self._problem.gap), found)
            moved = np.array([np.max(abs(part), initial=0.0) for part in (found.answer.displacement - wide, wide)])
            change, size = ranks.max(moved)
            if change > SAME * size:
                raise NotConverged("contacts that need not close may: several equilibria, and one was asked for")
        self.before = self._known = found
        return state

    def _solved(self, problem: DistributedProblem, start: DistributedSolution | None) -> DistributedSolution:
        known = None if start is None else start.answer
        return solve_distributed(problem, self._method, warm_start=known, **self._options)

    def _state(self, solution: DistributedSolution, fraction: float, held_open: Mask) -> State:
        """What the next step needs of a solution; gaps are those of the problem."""
        problem, u = self._problem, solution.answer.displacement
        rows: Any = problem.tangent
        largest = float(problem.ranks.max(float(np.max(np.sqrt(problem.metric) * abs(u), initial=0.0))))
        lengths = abs(problem.normal.entries) @ problem.normal.near(abs(u)) + abs(problem.gap)
        rounding = TOUCHING * (lengths + np.sqrt(row_sizes(problem, problem.normal).compliance) * largest)
        gap = problem.gap - problem.normal.lengths(u)
        position = rows.lengths(u).reshape(_origin(problem).shape)
        gap, rounding, position = (self._whole(part) for part in (gap, rounding, position))
        pushes = self._whole(solution.answer.normal_force) > 0
        step: Any = solution
        return State(
            fraction=fraction,
            gap=gap,
            position=position,
            pushes=pushes,
            slides=pushes & (self._whole(solution.status) == "slip"),
            touching=pushes | (gap <= rounding),
            overlap=held_open & (gap < -rounding),
            step=SolvedStep(step),
        )

    def _whole(self, values: Any) -> Any:
        return self._problem.whole(values, self._problem.contact_number)


def changes_of_rubbing(
    solutions: Sequence[DistributedSolution], times: Sequence[float], names: Sequence[str]
) -> Iterator[Event]:
    """Every change of state, at the first step that shows it. Collective."""
    known = [(one.normal_force > 0, (one.normal_force > 0) & (one.contact_status == "slip")) for one in solutions]
    return contact_changes(known, times, names.__getitem__)


def energies_of_rubbing(solutions: Sequence[DistributedSolution]) -> Iterator[Energies]:
    """As `contactqp.History.energies` has them of steps with friction. Collective."""
    work = dissipated = 0.0
    before: Vector | None = None
    for now in solutions:
        problem, u = now.problem, now.answer.displacement
        dot, moved = problem.ranks.dot, np.zeros_like(u) if before is None else u - before
        work += dot(problem.load - problem.product(moved) / 2, moved)
        rows, rubbed = problem.tangent, now.answer.friction_force
        if before is not None and rows is not None and rubbed is not None:
            dissipated += dot(rubbed.ravel(), rows.lengths(u) - _origin(problem).ravel())
        before = u
        yield Energies(dot(u, problem.product(u)) / 2, kinetic=0.0, work=work, dissipated=dissipated)


def _origin(problem: DistributedProblem) -> Array:
    """(m_here, d-1)."""
    if problem.slip_origin is None:
        raise ValueError("a path with friction of a problem without tangential rows")
    return problem.slip_origin
