"""The equilibria that a step of a load path with friction asks for: on the contact unknowns, or by `solve`."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from contactqp.analysis.anchoring import State
from contactqp.certificate.figures import balance
from contactqp.certificate.subset_bounds import first_candidates
from contactqp.errors import NoEquilibrium, NotConverged
from contactqp.linalg.condensation import condense
from contactqp.linalg.friction_states import OPEN, STICK, Status
from contactqp.linalg.iteration import iterated
from contactqp.linalg.measures import own_compliance
from contactqp.linalg.stages import METHOD, POLISH, stage
from contactqp.linalg.threads import one_blas_thread
from contactqp.model.arrays import Array, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Solution
from contactqp.solving.friction.force_system import CombinationAnswer, ForceSystem, Lengths
from contactqp.solving.friction.newton import combination_of, search
from contactqp.solving.friction_runs import run_on_combination
from contactqp.solving.runs import Meter
from contactqp.solving.solve import solve

# A gap of this part of the lengths that meet is rounding.
TOUCHING = 1e-12
# Gaps of contacts that are held open are widened by this factor where a solver cannot leave a contact out.
WIDENED = 1e3
# A load of which this part is left on a body that nothing holds drives it.
DRIVEN = 1e-6
# Displacements that differ by this part of the largest are one.
SAME = 1e-8


class Stepper(Protocol):
    """Equilibria along one leg after the other."""

    def turn(self, start: Vector, end: Vector) -> None:
        """Set out from one corner to the next."""

    def solve(self, fraction: float, origin: Array, held_open: Mask) -> State:
        """The equilibrium at a fraction of the leg with slips from `origin` (m, d-1)."""

    def accept(self, state: State) -> State:
        """The state as a step of the path; the next solve starts from it."""


@dataclass(frozen=True, eq=False)
class LightStep:
    """An answer on the contact unknowns that nobody has looked at."""

    problem: ContactProblem  # with the load and the slip origin of the step
    system: ForceSystem
    lengths: Lengths
    found: CombinationAnswer
    combinations: int
    seconds: float
    meter: Meter

    def finish(self) -> Solution:
        """Refine, expand and certify.

        Raises
        ------
        NotCertified
            The certificate refuses the answer.
        """
        started = time.perf_counter()
        with self.problem.lock, one_blas_thread(self.problem), stage(POLISH):
            run = run_on_combination(self.problem, self.system, self.lengths, self.found, self.combinations, self.meter)
        run.seconds = self.seconds + time.perf_counter() - started
        return run.finish()


@dataclass(frozen=True, eq=False)
class SolvedStep:
    """A solution that is certified already."""

    solution: Solution

    def finish(self) -> Solution:
        """The solution."""
        return self.solution


class PlaneStepper:
    """In the plane: Newton's method on the condensed unknowns; its factors serve all steps.

    Where Newton fails, what `solve` falls back to.
    """

    def __init__(self, problem: ContactProblem, method: str, options: dict[str, Any]) -> None:
        self._problem = problem
        self._otherwise = SolveStepper(problem, method, options)
        self._meter = Meter(problem)  # of the step to come: the first one pays for the factorisation
        with self._meter.running():
            self._way = condense(problem)
        self._system = ForceSystem(problem, self._way)
        self._status: Status = np.where(problem.gap > 0, OPEN, STICK).astype(np.int8)

    def turn(self, start: Vector, end: Vector) -> None:
        """Set out from one corner to the next."""
        self._leg = start, end
        self._otherwise.turn(start, end)
        self._reduced = self._way.reduce_load(start)[0].copy(), self._way.reduce_load(end)[0].copy()

    def solve(self, fraction: float, origin: Array, held_open: Mask) -> State:
        """The equilibrium at a fraction of the leg with slips from `origin` (m, 1)."""
        started = time.perf_counter()
        start, end = self._reduced
        problem = self._problem.replace(load=_between(*self._leg, fraction), slip_origin=origin)
        lengths = self._system.lengths(problem, _between(start, end, fraction))
        try:
            with stage(METHOD):
                found, combinations = search(self._system, lengths, self._status, held_open)
        except NotConverged:
            return self._otherwise.solve(fraction, origin, held_open)
        spent = time.perf_counter() - started
        step = LightStep(problem, self._system, lengths, found, combinations, spent, self._meter)
        return self._state(step, fraction, origin, held_open)

    def accept(self, state: State) -> State:
        """The state as a step of the path; the next solve starts from its combination."""
        self._meter = Meter(self._problem)
        if not isinstance(state.step, LightStep):
            state = self._otherwise.accept(state)
        step = state.step
        if isinstance(step, LightStep):
            self._status = step.found.status
        else:
            solution = step.finish()
            self._status = combination_of(solution.problem, solution)
        return state

    def _state(self, step: LightStep, fraction: float, origin: Array, held_open: Mask) -> State:
        rows, found = self._system.rows, step.found
        status, gap = found.status, found.gap * rows.normal_length
        m = len(status)
        lengths = (step.lengths.free[: 2 * m], step.lengths.target[: 2 * m], found.gap, found.slip)
        rounding = TOUCHING * max(float(np.max(abs(part), initial=0.0)) for part in lengths)
        position = origin[:, 0] + found.slip * rows.tangent_length
        pushes = found.normal > TOUCHING * step.lengths.size
        return State(
            fraction=fraction,
            gap=gap,
            position=position[:, None],
            pushes=pushes,
            slides=pushes & (abs(found.slip) > rounding) & (self._system.coefficient > 0),
            touching=(status != OPEN) | (abs(found.gap) <= rounding),
            overlap=held_open & (found.gap < -rounding),
            step=step,
        )


class SolveStepper:
    """Step by step with `solve`: two tangential directions a contact, bodies that are not factorised, a method or an
    algorithm of the caller's."""

    def __init__(self, problem: ContactProblem, method: str, options: dict[str, Any]) -> None:
        self._problem, self._method, self._options = problem, method, options
        self._before: Solution | None = None

    def turn(self, start: Vector, end: Vector) -> None:
        """Set out from one corner to the next."""
        self._leg = start, end

    def solve(self, fraction: float, origin: Array, held_open: Mask) -> State:
        """The equilibrium at a fraction of the leg with slips from `origin` (m, d-1)."""
        problem = self._problem.replace(load=_between(*self._leg, fraction), slip_origin=origin)
        if np.all(held_open):
            _refuse_driven(problem)
        solution = self._solved(_widened(problem, held_open), self._before)
        if np.any(solution.normal_force[held_open] > 0):
            raise NoEquilibrium("a contact that is held open closes")
        return _state_of(problem, solution, fraction, held_open)

    def accept(self, state: State) -> State:
        """The state as a step of the path, its gaps as they are; the next solve starts from it.

        Raises
        ------
        NotConverged
            Contacts that do not reach their obstacle make a difference: there are several equilibria.
        """
        self._before = found = state.step.finish()
        gap = self._problem.gap
        if np.array_equal(found.problem.gap, gap):
            return state
        self._before = solution = self._solved(found.problem.replace(gap=gap), found)
        size = np.max(abs(found.displacement), initial=0.0)
        if np.max(abs(solution.displacement - found.displacement), initial=0.0) > SAME * size:
            raise NotConverged("contacts that need not close may: several equilibria, and one was asked for")
        return replace(state, step=SolvedStep(solution))

    def _solved(self, problem: ContactProblem, start: Solution | None) -> Solution:
        return solve(problem, self._method, warm_start=start, **self._options)


def _between(start: Vector, end: Vector, fraction: float) -> Vector:
    return end if fraction == 1 else start + fraction * (end - start)


def _refuse_driven(problem: ContactProblem) -> None:
    """Raise where the load drives a body that no contact is to hold: it would move until one does."""
    if problem.ties or iterated(problem) or first_candidates(problem) is not None:
        return
    nothing = Answer(np.zeros(problem.dimension), np.zeros(problem.contacts), None, np.zeros(0))
    if balance(problem, nothing, condense(problem).rigid) > DRIVEN:
        raise NoEquilibrium("the load drives a body whose contacts are held open")


def _widened(problem: ContactProblem, held_open: Mask) -> ContactProblem:
    """With contacts so far away that they cannot close."""
    if not np.any(held_open):
        return problem
    far = WIDENED * (abs(problem.gap) + float(np.max(abs(problem.gap))))
    return problem.replace(gap=np.where(held_open, problem.gap + far, problem.gap))


def _state_of(problem: ContactProblem, solution: Solution, fraction: float, held_open: Mask) -> State:
    """What the next step needs of a solution; gaps are those of the problem."""
    if problem.tangent is None or problem.slip_origin is None:
        raise ValueError("a path with friction of a problem without tangential rows")
    u = solution.displacement
    gap = problem.gap - problem.normal @ u
    largest = float(np.max(np.sqrt(problem.diagonal) * abs(u), initial=0.0))
    nearby = np.sqrt(own_compliance(problem, problem.normal)) * largest
    rounding = TOUCHING * (abs(problem.normal) @ abs(u) + abs(problem.gap) + nearby)
    pushes = solution.normal_force > 0
    return State(
        fraction=fraction,
        gap=np.asarray(gap),
        position=np.asarray((problem.tangent @ u).reshape(problem.slip_origin.shape)),
        pushes=pushes,
        slides=pushes & (solution.contact_status == "slip"),
        touching=pushes | (gap <= rounding),
        overlap=held_open & (gap < -rounding),
        step=SolvedStep(solution),
    )
