"""Compute one step of a load path with friction, with slip from each contact's previous position, or where it closed.

A contact that was closed before the step is anchored at its previous E_T u. One that closes within the step is anchored
at its E_T u at the fraction of the step at which its gap reaches zero: contacts without an anchor are held open, and if
they overlap at the end of the step, the first load at which one of them touches is computed. Gaps are linear while no
contact changes its state, so that the secant method finds that load exactly.

The equilibria of a step come from Newton's method on the condensed contact unknowns (`PlaneStepper`), or from `solve`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Protocol

import numpy as np

from contactqp.analysis.history import Unfinished
from contactqp.errors import ContactQPError, NoEquilibrium, NotCertified, NotConverged, SeveralEquilibria
from contactqp.linalg.condensation import condense
from contactqp.linalg.existence import driven_motion
from contactqp.linalg.iteration import contacts_are_many, iterated
from contactqp.linalg.measures import own_compliance, row_sizes
from contactqp.model.arrays import EPS, METHOD, POLISH, Array, Mask, Vector, one_blas_thread, stage
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.friction.force_system import CombinationAnswer, ForceSystem, Lengths
from contactqp.solving.friction.newton import combination_of, search
from contactqp.solving.friction_runs import run_on_combination
from contactqp.solving.runs import Meter
from contactqp.solving.solve import solve

# The most loads tried for one closing; bisection is used if the secant does not reduce its bracket.
MOST_LOADS = 60
# The relative bracket below which the contact jumps without touching at any load.
JUMP = 1e-13
# The most loads of one step without an answer before the search for closings ends, as failures are much slower than
# answers.
MOST_FAILED = 2
# The most halvings of a step towards a load that is carried without the closing contacts.
HALVINGS = 30
# Gaps below this part of the lengths at the contact are rounding.
GAP_ROUNDING = 1e-12
# Slips below this part of the lengths at the contact are rounding.
STILL = EPS
# The factor by which gaps of contacts held open are widened if a solver cannot omit contacts, repeatedly if one still
# closes, and the most repetitions.
WIDENED = 1e3
WIDENINGS = 3
# Displacements that differ by less than this part of the largest are equal.
SAME_DISPLACEMENT = 1e-8
# Positions are refined if contacts would move so many times as far without their forces, by cancellation.
CANCELS = 100.0


@dataclass(frozen=True, eq=False)
class State:
    """The data of an equilibrium along a path on which the next step depends."""

    fraction: float  # fraction of the leg
    gap: Vector  # (m,) g - E_N u [length]; negative at contacts that were held open and overlap
    position: Array  # (m, d-1) E_T u [length]
    pushes: Mask  # (m,) contacts with a force
    slides: Mask  # (m,) those that slip
    touching: Mask  # (m,) closed, or with a gap of rounding size
    overlap: Mask  # (m,) held open, with an overlap beyond rounding
    step: Unfinished
    cancelled: bool = False  # whether the positions lost digits
    origin: Array | float = 0.0  # (m, d-1) slip origins [length]
    still: Array | float = 0.0  # (m, d-1) the rounding of slips [length]
    early: Mask | bool = False  # (m,) with assumed anchors, since no answer was found where they close

    @cached_property
    def settled(self) -> Array:
        """Return the positions (m, d-1) [length] as the next slip origins, from the refined answer if digits are lost.

        Slips of rounding size are omitted, as otherwise all contacts that share a motion would slip.
        """
        reached = self._reached
        return np.where(abs(reached - self.origin) <= self.still, self.origin, reached)

    @property
    def _reached(self) -> Array:
        if not self.cancelled:
            return self.position
        try:
            solution = self.step.finish()
        except ContactQPError:  # raised again by the step when it is finished
            return self.position
        tangent: Any = solution.problem.tangent
        return np.asarray((tangent @ solution.displacement).reshape(self.position.shape))


# The equilibrium at a fraction of the leg, from slip origins (m, d-1), with contacts held open.
Solve = Callable[[float, Array, Mask], State]


@dataclass(frozen=True, eq=False)
class Anchors:
    """The tangential positions of the contacts at the end of a step."""

    position: Array  # (m, d-1) E_T u
    anchored: Mask  # (m,)


class _Attempts:
    """The equilibria of one step from fixed slip origins, and the number of loads without an answer."""

    def __init__(self, solve: Solve) -> None:
        self._solve, self.failed = solve, 0

    def __call__(self, fraction: float, *, origin: Array, held_open: Mask) -> State | None:
        """Return the state, None if no equilibrium without these contacts was found."""
        if self.failed >= MOST_FAILED:
            return None
        try:
            return self._solve(fraction, origin, held_open)
        except (NoEquilibrium, SeveralEquilibria):
            return None
        except (NotConverged, NotCertified):
            self.failed += 1
            return None


def step_to(
    fraction: float, before: State, anchors: Anchors, solve: Solve, refuse: Callable[[float], None] = lambda _: None
) -> State:
    """Return the state at a fraction of the leg, with contacts that close within the step anchored where they close.

    If too many loads within the step have no answer, the remaining contacts are anchored `early`.
    Raises NoEquilibrium, SeveralEquilibria, NotConverged: from the solution at the end of the step with all contacts
    anchored.

    Parameters
    ----------
    fraction : the end of the step, as a part of the leg
    before : the state at its start
    anchors : the tangential positions there, and which contacts are anchored
    solve : function, the equilibrium at a fraction, from slip origins, with contacts that are kept open
    refuse : function of a fraction, raises NoEquilibrium where no contacts, wherever they slip from, hold its load
    """
    origin, anchored = anchors.position.copy(), anchors.anchored.copy()
    low, attempt, early = before, _Attempts(solve), np.zeros_like(anchored)
    while True:
        if np.all(anchored):
            return replace(solve(fraction, origin, ~anchored), early=early)
        high = attempt(fraction, origin=origin, held_open=~anchored)
        if high is None:
            refuse(fraction)
        elif not np.any(high.overlap):
            return replace(high, early=early)
        touched = _first_touch(low, high, fraction, partial(attempt, origin=origin, held_open=~anchored))
        if touched is not None:
            closing = ~anchored & (touched.touching | touched.overlap)
            origin[closing] = touched.settled[closing]
            anchored, early, low = anchored | closing, early | (closing & touched.early), touched
        if touched is None or attempt.failed >= MOST_FAILED:
            # Contacts of bodies that move freely until stopped are anchored at the start of the step.
            early |= ~anchored & (attempt.failed >= MOST_FAILED)
            anchored[:] = True


def _first_touch(
    low: State, high: State | None, fraction: float, solve: Callable[[float], State | None]
) -> State | None:
    """Return the first state after `low` in which a contact without anchor touches, None for a free motion."""
    if high is None:
        low, high = _furthest(low, fraction, solve)
        if high is None:
            return None
    same_side, last_over = 0, None
    for _ in range(MOST_LOADS):
        at = _secant(low, high) if same_side < 2 else 0.0
        if not low.fraction < at < high.fraction:
            at = (low.fraction + high.fraction) / 2
        if high.fraction - low.fraction <= JUMP:
            return high
        here = solve(at)
        if here is None:
            return replace(high, early=high.overlap)
        held = high.gap < 0
        if not np.any(here.overlap) and np.any(here.touching & held):
            return here
        over = bool(np.any(here.overlap))
        same_side = same_side + 1 if over == last_over else 0
        last_over, (low, high) = over, (low, here) if over else (here, high)
    return replace(high, early=high.overlap)


def _secant(low: State, high: State) -> float:
    """Return the fraction at which the first of the gaps negative at `high` vanishes by linear interpolation."""
    falls = high.overlap & (low.gap > high.gap)
    if not np.any(falls):
        return (low.fraction + high.fraction) / 2
    part = np.maximum(low.gap[falls], 0.0) / (np.maximum(low.gap[falls], 0.0) - high.gap[falls])
    return float(low.fraction + np.min(part) * (high.fraction - low.fraction))


def _furthest(low: State, fraction: float, solve: Callable[[float], State | None]) -> tuple[State, State | None]:
    """Return states without and with overlap between `low` and a fraction without equilibrium."""
    beyond, least = fraction, low.fraction + 2.0**-HALVINGS * (fraction - low.fraction)
    for halvings in range(HALVINGS + 1):
        at = (low.fraction + beyond) / 2 if halvings else least  # a motion driven by the smallest load is driven by all
        here = solve(at)
        if here is None and not halvings:
            return low, None
        if here is None:
            beyond = at
        elif np.any(here.overlap):
            return low, here
        else:
            low = here
    return low, None


class Stepper(Protocol):
    """The interface for computing equilibria along the legs of a path."""

    def turn(self, start: Vector, end: Vector) -> None:
        """Begin the leg from one corner of the load to the next."""

    def solve(self, fraction: float, origin: Array, held_open: Mask) -> State:
        """Return the equilibrium at a fraction of the leg with slips from `origin` (m, d-1)."""

    def accept(self, state: State) -> State:
        """Return the state as a step of the path; the next solve starts from it."""


@dataclass(frozen=True, eq=False)
class UncertifiedStep:
    """An answer on the contact unknowns before refinement and certification."""

    problem: ContactProblem  # with the load and the slip origin of the step
    system: ForceSystem
    lengths: Lengths
    found: CombinationAnswer
    combinations: int
    seconds: float
    meter: Meter

    def finish(self) -> Solution:
        """Refine, expand and certify the answer once; raise NotCertified if the certificate refuses it."""
        return self._finished

    @cached_property
    def _finished(self) -> Solution:
        started = time.perf_counter()
        with self.problem._lock, one_blas_thread(self.problem), stage(POLISH):
            run = run_on_combination(self.problem, self.system, self.lengths, self.found, self.combinations, self.meter)
        run.seconds = self.seconds + time.perf_counter() - started
        return run.finish()


@dataclass(frozen=True, eq=False)
class SolvedStep:
    """A certified solution."""

    solution: Solution

    def finish(self) -> Solution:
        """Return the solution."""
        return self.solution


class PlaneStepper:
    """Newton's method on the condensed unknowns of a plane problem, with one factorisation for all steps.

    If it fails, the fallbacks of `solve` are used.
    """

    def __init__(self, problem: ContactProblem, method: str, options: dict[str, Any]) -> None:
        self._problem = problem
        self._otherwise = SolveStepper(problem, method, options)
        self._meter = Meter(problem)  # of the next step; the first one includes the factorisation
        with self._meter.running():
            self._condensation = condense(problem)
        self._system = ForceSystem(problem, self._condensation)
        self._status: Status = np.where(problem.gap > 0, OPEN, STICK).astype(np.int8)

    def turn(self, start: Vector, end: Vector) -> None:
        """Begin the leg from one corner of the load to the next."""
        self._leg = start, end
        self._otherwise.turn(start, end)
        self._reduced = self._condensation.reduce_load(start)[0].copy(), self._condensation.reduce_load(end)[0].copy()

    def solve(self, fraction: float, origin: Array, held_open: Mask) -> State:
        """Return the equilibrium at a fraction of the leg with slips from `origin` (m, 1)."""
        started = time.perf_counter()
        start, end = self._reduced
        problem = self._problem.replace(load=between(*self._leg, fraction), slip_origin=origin)
        lengths = self._system.lengths(problem, between(start, end, fraction))
        try:
            with stage(METHOD):
                found, combinations = search(self._system, lengths, self._status, held_open)
        except NotConverged:
            return self._otherwise.solve(fraction, origin, held_open)
        spent = time.perf_counter() - started
        step = UncertifiedStep(problem, self._system, lengths, found, combinations, spent, self._meter)
        return self._state(step, fraction, origin, held_open)

    def accept(self, state: State) -> State:
        """Return the state as a step of the path; the next solve starts from its combination of states.

        Contacts that touch without force start as sticking, as bodies may be held by them only, and a gap of rounding
        size would leave these without an equilibrium.
        """
        self._meter = Meter(self._problem)
        if not isinstance(state.step, UncertifiedStep):
            state = self._otherwise.accept(state)
        step = state.step
        if isinstance(step, UncertifiedStep):
            self._status = step.found.status
        else:
            solution = step.finish()
            self._status = combination_of(solution.problem, solution.answer)
        self._status = np.where((self._status == OPEN) & state.touching, STICK, self._status).astype(np.int8)
        return state

    def _state(self, step: UncertifiedStep, fraction: float, origin: Array, held_open: Mask) -> State:
        rows, found = self._system.rows, step.found
        status, gap = found.status, found.gap * rows.normal_length
        m = len(status)
        lengths = (step.lengths.free[: 2 * m], step.lengths.target[: 2 * m], found.gap, found.slip)
        rounding = GAP_ROUNDING * max(float(np.max(abs(part), initial=0.0)) for part in lengths)
        position = origin[:, 0] + found.slip * rows.tangent_length
        pushes = found.normal > GAP_ROUNDING * step.lengths.felt(status)
        moved = abs(step.lengths.target[: 2 * m] + np.concatenate([-found.gap, found.slip]))
        most = float(np.max(moved[np.isfinite(moved)], initial=0.0))
        return State(
            fraction=fraction,
            gap=gap,
            position=position[:, None],
            pushes=pushes,
            slides=pushes & (abs(found.slip) > rounding) & (self._system.coefficient > 0),
            touching=(status != OPEN) | (abs(found.gap) <= rounding),
            overlap=held_open & (found.gap < -rounding),
            step=step,
            origin=origin,
            still=(STILL / GAP_ROUNDING * rounding * rows.tangent_length)[:, None],
            cancelled=bool(np.max(abs(lengths[0]), initial=0.0) > CANCELS * most),
        )


class SolveStepper:
    """Equilibria by `solve`, for two tangents per contact, unfactorised bodies, and chosen methods or algorithms."""

    def __init__(self, problem: ContactProblem, method: str, options: dict[str, Any]) -> None:
        self._problem, self._method, self._options = problem, method, options
        self._before: Solution | None = None
        self._steps: tuple[tuple[float, Solution], ...] = ()  # the last two solutions of this leg, with their fractions

    def turn(self, start: Vector, end: Vector) -> None:
        """Begin the leg from one corner of the load to the next."""
        self._leg, self._steps, self._driven = (start, end), (), False

    def solve(self, fraction: float, origin: Array, held_open: Mask) -> State:
        """Return the equilibrium at a fraction of the leg with slips from `origin` (m, d-1)."""
        problem = self._problem.replace(load=between(*self._leg, fraction), slip_origin=origin)
        if np.all(held_open):
            self._driven = self._driven or _drives(problem, held_open)
            if self._driven:
                self._driven = not np.any(self._leg[0])  # then all loads of the leg are proportional
                raise NoEquilibrium("the load drives a body whose contacts are held open")
        if np.any(held_open) and self._stay_open(fraction, held_open):
            found = self._as_stated(problem, fraction, held_open)
            if found is not None:
                return found
        for widened in _widened(problem, held_open):
            solution = self._solved(widened, self._predicted(fraction))
            if not np.any(solution.normal_force[held_open] > 0):
                return _state_of(problem, solution, fraction, held_open)
            if _drives(problem, held_open):  # limited by the gaps
                raise NotConverged("the load drives a body to contacts that are held open")
        raise NoEquilibrium("a contact that is held open closes")

    def accept(self, state: State) -> State:
        """Return the state as a step of the path, with the gaps of the problem; the next solve starts from it.

        Raises NotConverged: the result depends on contacts that do not reach their obstacle; there are several
        equilibria.
        """
        self._before = found = state.step.finish()
        gap = self._problem.gap
        if np.array_equal(found.problem.gap, gap):
            self._steps = (*self._steps[-1:], (state.fraction, found))
            return state
        self._before = solution = self._solved(found.problem.replace(gap=gap), found)
        size = np.max(abs(found.displacement), initial=0.0)
        if np.max(abs(solution.displacement - found.displacement), initial=0.0) > SAME_DISPLACEMENT * size:
            raise NotConverged("contacts that need not close may: several equilibria, and one was asked for")
        return replace(state, step=SolvedStep(solution))

    def _stay_open(self, fraction: float, held_open: Mask) -> bool:
        """Return whether contacts keep a gap by linear extrapolation from the last two steps of the leg, if there are
        two.

        Then the problem is solved with its actual gaps, which saves a second solution in `accept`.
        """
        if len(self._steps) < 2:
            return True
        (first, earlier), (second, before) = self._steps
        reachable = held_open & np.isfinite(self._problem.gap)
        gap, moved = before.gap[reachable], before.gap[reachable] - earlier.gap[reachable]
        return bool(np.all(gap + (fraction - second) / (second - first) * moved > 0))

    def _as_stated(self, problem: ContactProblem, fraction: float, held_open: Mask) -> State | None:
        """Return the equilibrium with the gaps of the problem, None if contacts held open close."""
        try:
            solution = self._solved(problem, self._predicted(fraction))
        except (NoEquilibrium, SeveralEquilibria, NotConverged, NotCertified):
            return None
        pushed, dragged = solution.normal_force[held_open], solution.friction_force
        closes = np.any(pushed > 0) or (dragged is not None and np.any(dragged[held_open]))
        return None if closes else _state_of(problem, solution, fraction, held_open)

    def _predicted(self, fraction: float) -> Solution | None:
        """Return the last step with forces extrapolated linearly from the last two steps of the leg."""
        if len(self._steps) < 2:
            return self._before
        (first, earlier), (second, before) = self._steps
        ahead = (fraction - second) / (second - first)
        now, then = before.answer, earlier.answer
        changed = replace(now, normal_force=now.normal_force + ahead * (now.normal_force - then.normal_force))
        if now.friction_force is not None and then.friction_force is not None:
            friction = now.friction_force + ahead * (now.friction_force - then.friction_force)
            changed = replace(changed, friction_force=friction)
        return replace(before, answer=changed)

    def _solved(self, problem: ContactProblem, start: Solution | None) -> Solution:
        return solve(problem, self._method, warm_start=start, **self._options)


def between(start: Vector, end: Vector, fraction: float) -> Vector:
    """Return the load at a fraction of a leg."""
    return end if fraction == 1 else start + fraction * (end - start)


def _drives(problem: ContactProblem, held_open: Mask) -> bool:
    """Return whether the load drives a body held by no other contacts, which would move until one of these closes."""
    if iterated(problem) or contacts_are_many(problem):
        return False
    others = problem.with_contacts(np.flatnonzero(~held_open))
    return driven_motion(others, condense(problem).rigid) is not None


def _widened(problem: ContactProblem, held_open: Mask) -> Iterator[ContactProblem]:
    """Yield the problem with these contacts far away, at increasing distances."""
    if not np.any(held_open):
        yield problem
        return
    pulled = float(np.max(problem.own_scale * problem.load_size, initial=0.0))
    finite = np.where(np.isfinite(problem.gap), abs(problem.gap), 0.0)
    far = widening(finite, float(np.max(finite)), own_compliance(problem, problem.normal), pulled)
    for k in range(WIDENINGS):
        yield problem.replace(gap=np.where(held_open, problem.gap + far * WIDENED**k, problem.gap))


def widening(gap: Vector, largest: float, compliance: Vector, pulled: float) -> Vector:
    """Return the first widening of gaps (m,): 1e3 (|g| + max |g| + |E_i D| max_j D_j |f_j|) [length].

    The displacement by the load is included, as gaps may all be zero and open contacts may close again.

    Parameters
    ----------
    gap : (m,) array, |g| [length]
    largest : float, the largest of all |g| [length]
    compliance : (m,) array, |E_i D|^2, D = 1/sqrt(K_jj) [length / force]
    pulled : float, max_j D_j |f_j| [square root of energy]
    """
    return WIDENED * (gap + largest + np.sqrt(compliance) * pulled)


def _state_of(problem: ContactProblem, solution: Solution, fraction: float, held_open: Mask) -> State:
    """Return the state of a solution, with the gaps of the problem."""
    if problem.tangent is None or problem.slip_origin is None:
        raise ValueError("a path with friction of a problem without tangential rows")
    u = solution.displacement
    gap = problem.gap - problem.normal @ u
    largest = float(np.max(np.sqrt(problem.diagonal) * abs(u), initial=0.0))
    nearby = np.sqrt(own_compliance(problem, problem.normal)) * largest
    rounding = GAP_ROUNDING * (row_sizes(problem, problem.normal).lengths(abs(u)) + abs(problem.gap) + nearby)
    along = row_sizes(problem, problem.tangent).lengths(abs(u))
    still = STILL * (along + np.sqrt(own_compliance(problem, problem.tangent)) * largest)
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
        origin=problem.slip_origin,
        still=still.reshape(problem.slip_origin.shape),
    )
