"""Compute load paths with Coulomb friction in steps, or from one exact event to the next.

A step starts from the contact positions of the previous one. Afterwards it is followed from event to event
(`friction_events`). If there is no continuation, the step has jumped to another equilibrium; if there are several, or
several equilibria at its end, the step has chosen one. Both are noted.

Penalty methods solve Coulomb's law for bodies with contact springs (`contactqp.solving.methods.penalty`); their path is
that of these bodies, in steps or by exact events. The history has the bodies without springs: each solution is the
method's answer to `solution.problem`, whose slip origins are the positions of the sliders at the previous instant, or
where they stick.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from contactqp.analysis.friction_events import ExactPath, Segment
from contactqp.analysis.friction_step import Anchors, PlaneStepper, SolveStepper, State, Stepper, between, step_to
from contactqp.analysis.history import Event, History, LazySolutions, contact_changes
from contactqp.certificate.certificate import holds
from contactqp.certificate.uniqueness import SEVERAL
from contactqp.errors import (
    ContactQPError,
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    Unsupported,
    shown,
)
from contactqp.linalg.condensation import condense
from contactqp.linalg.existence import refuse_driven_motion
from contactqp.linalg.iteration import contacts_are_many, iterated
from contactqp.model.arrays import Indices, Mask, Vector, one_blas_thread, refuse_late
from contactqp.model.coulomb import STICK
from contactqp.model.names import listed
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.friction.force_system import ForceSystem
from contactqp.solving.friction_runs import FrictionRun
from contactqp.solving.methods import Method, Settings, find, refuse_arguments, refuse_unsupported
from contactqp.solving.methods.augmented_lagrangian import default_penalty
from contactqp.solving.methods.penalty import with_contact_springs, without_contact_springs

# Arguments of `solve`, and their values unless stated.
DEFAULTS: dict[str, Any] = dict(tolerance=1e-9, condense="auto", polish=True, time_limit=None, max_iter=None)
ARGUMENTS = tuple(DEFAULTS)
PREFIX = "follow_path: "
# Operations (about a second) for following steps again for notes, unless the steps took more.
BUDGET = 1e9
# Operations of an event: in any case, per square of the rows of contacts and ties, per entry of the stiffness for
# condensing loads, and for refining answers.
CALL, PER_SQUARE, PER_UNKNOWN, PER_ENTRY = 2e6, 50.0, 20.0, 200.0
# The largest ratio of contact springs to the stiffness of the bodies, with which rates have five digits.
STIFFEST = 1e6


def follow_with_friction(
    problem: ContactProblem, corners: Sequence[Vector], count: int, exactly: bool, method: str, options: dict[str, Any]
) -> History:
    """Follow the legs from corner to corner, each in `count` steps and, with `exactly`, at every event.

    Raises Unsupported: exact events with two tangents per contact, and the cases of `FrictionSteps`.

    Parameters
    ----------
    problem : a problem with tangential rows
    corners : sequence of (n,) arrays, the loads at the corners of the path, the start included [force]
    count : steps of each leg
    exactly : whether every event is found exactly, and added as an instant
    method, options : str, dict, as for `solve`
    """
    if exactly and problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
        raise Unsupported(
            "follow_path(events='exact'): two tangential rows a contact: slip turns within a leg; give steps instead"
        )
    steps = FrictionSteps(problem, method, options)
    if exactly:
        with one_blas_thread(problem):
            return _between_events(problem, corners, count, steps[0])
    times = [0.0]

    def history() -> History:
        return History(steps, times, lambda: steps.changes(times), notes=lambda: steps.notes(times))

    try:
        for leg, (start, end) in enumerate(pairwise(corners)):
            steps.turn(start, end)
            for i in range(count):
                refuse_late(f"the step to t = {leg + (i + 1) / count:.6g}")
                steps.go_to((i + 1) / count)
                times.append(leg + (i + 1) / count)
    except ContactQPError as error:
        error.history = history()
        raise
    return history()


def _between_events(problem: ContactProblem, corners: Sequence[Vector], count: int, first: Solution) -> History:
    path, instants, times = ExactPath(problem, first), _Instants(first), [0.0]
    jump = path.jump_at_start()
    if jump:
        raise Unsupported(f"follow_path(events='exact'): {jump}: it would jump; give steps")
    events: list[Event] = []
    history = partial(History, instants, times, lambda: events, linear=True)
    for leg, (start, end) in enumerate(pairwise(corners)):
        ended = _ended(path, problem, start, end, leg)
        events.extend(replace(event, time=leg + event.time) for event in path.events)
        reached = path.segments[-1].end if path.segments else 0.0
        fractions = {(i + 1) / count for i in range(count)} | {segment.end for segment in path.segments}
        for fraction in sorted(one for one in fractions if one <= reached):
            here = [segment for segment in path.segments if segment.start <= fraction <= segment.end]
            load = end if fraction == 1 else start + fraction * (end - start)
            instants.add(path, problem.replace(load=load), fraction, here)
            times.append(leg + fraction)
        if ended is not None:
            ended.history = history()
            raise ended
    return history()


def _ended(path: ExactPath, problem: ContactProblem, start: Vector, end: Vector, leg: int) -> ContactQPError | None:
    """Follow one leg, and return the error that ended the path, if any.

    If no continuation was found, nonexistence of an equilibrium at the end of the leg may be proven.
    """
    try:
        path.leg(start, end, leg)
    except (NotConverged, NoEquilibrium, Unsupported) as error:
        try:
            refuse_driven_motion(problem.replace(load=end), condense(problem).rigid)
        except NoEquilibrium as driven:
            lost = "follow_path:" if isinstance(error, Unsupported) else f"{error};"
            return NoEquilibrium(f"{lost} at t = {leg + 1}: {driven}", driven.proof)
        return error
    except ContactQPError as error:
        return error
    return None


class _Instants(LazySolutions):
    """The solutions at instants of a piecewise linear path, each certified at first access."""

    def __init__(self, first: Solution) -> None:
        super().__init__([first])
        self._displacement = first.displacement

    def add(self, path: ExactPath, problem: ContactProblem, fraction: float, segments: Sequence[Segment]) -> None:
        """Append the answer to the problem's load in a segment, with slip from the previous instant.

        At an event two segments meet: the slip is that of the first, and signs decide in which one the rounded load is.
        """
        past = segments[0]
        before = np.asarray(problem.tangent @ self._displacement) if problem.tangent is not None else past.anchor
        here = problem.replace(slip_origin=np.where(past.status == STICK, past.anchor, before))
        for segment in segments:
            answer = path.at(problem.load, fraction, segment)
            if holds(here, answer):
                break
        self.append(FrictionRun(here, answer, "exact events", iterations=0))
        self._displacement = answer.displacement


class FrictionSteps(LazySolutions):
    """The solutions at the steps of a path, each refined, expanded and certified at first access.

    `Solution.slip` is the slip of one step, from the contact's position at the previous step or where it closed within
    the step; this is the slip origin of the solution's problem. Contacts open at the end of a step have no anchor, and
    their slip origin, the previous E_T u, has no meaning.
    """

    _before: State
    _anchors: Anchors

    def __init__(self, problem: ContactProblem, method: str, options: dict[str, Any]) -> None:
        if problem.slip_origin is None:
            raise ValueError("a path with friction of a problem without tangential rows")
        super().__init__()
        self._problem = problem
        self._stepper = _stepper(problem, method, options)
        self._leg = -1
        self._states: list[tuple[Mask, Mask]] = []
        self._early: dict[int, Indices] = {}  # contacts, by step number
        nothing = np.zeros(problem.dimension)
        self._stepper.turn(nothing, nothing)
        origin = problem.slip_origin
        with one_blas_thread(problem):
            state = self._stepper.solve(1.0, origin, np.zeros(problem.contacts, dtype=bool))
        # A closed contact without force is at the given slip origin.
        at_rest = state.touching & ~state.pushes
        self._keep(state, Anchors(np.where(at_rest[:, None], origin, state.settled), state.touching))

    def turn(self, start: Vector, end: Vector) -> None:
        """Begin the leg from one corner of the load to the next."""
        self._stepper.turn(start, end)
        self._corners = start, end
        self._leg += 1
        self._before = replace(self._before, fraction=0.0)

    def go_to(self, fraction: float) -> None:
        """Add a step to the load at a fraction of the leg.

        Raises NoEquilibrium, SeveralEquilibria, NotConverged as `solve`, with the pseudo-time.
        """
        try:
            with one_blas_thread(self._problem):
                state = step_to(fraction, self._before, self._anchors, self._stepper.solve, self._refuse_driven)
                self._keep(state, Anchors(state.settled, state.touching))
        except NoEquilibrium as error:
            message = f"follow_path: at t = {self._leg + fraction:.6g}: {error}"
            raise NoEquilibrium(message, error.proof) from error
        except SeveralEquilibria as error:
            raise SeveralEquilibria(f"follow_path: at t = {self._leg + fraction:.6g}: {error}") from error
        except NotConverged as error:
            message = f"follow_path: at t = {self._leg + fraction:.6g}: {error}"
            raise NotConverged(message, error.history, error.solution) from error
        except NotCertified as error:
            message = f"follow_path: at t = {self._leg + fraction:.6g}: {error}"
            raise NotCertified(message, error.solution) from error

    def _refuse_driven(self, fraction: float) -> None:
        """Raise NoEquilibrium if the load drives a motion that contacts do not resist, for any slip origins."""
        if not (iterated(self._problem) or contacts_are_many(self._problem)):
            problem = self._problem.replace(load=between(*self._corners, fraction))
            refuse_driven_motion(problem, condense(problem).rigid)

    def _keep(self, state: State, anchors: Anchors) -> None:
        if (early := np.flatnonzero(state.early & state.pushes)).size:
            self._early[len(self)] = early
        self._before = state = self._stepper.accept(state)
        self._anchors = anchors
        self.append(state.step)
        self._states.append((state.pushes, state.slides))

    def changes(self, times: Sequence[float]) -> Iterator[Event]:
        """Return every change of contact state, at the first step after it."""
        return contact_changes(self._states, times, self._problem.contact_name)

    def notes(self, times: Sequence[float]) -> Iterator[str]:
        """Return the notes of steps: contacts with assumed anchors, and those of `step_notes`."""
        for i, contacts in self._early.items():
            names = listed([self._problem.contact_name(int(k)) for k in contacts])
            yield (
                f"step to t = {times[i]:.12g}: no answer was found under the load at which contacts close ({names}), "
                "and where they slip from is a guess, at most a step away: compare with smaller steps"
            )
        yield from step_notes(self._problem, self, times)


def refuse_options(problem: ContactProblem, chosen: Method, options: dict[str, Any]) -> None:
    """Raise InvalidProblem for options that `solve` refuses, and for a warm start, which the path provides."""
    algorithm = options.get("algorithm")
    if algorithm is not None and not isinstance(algorithm, str):
        raise InvalidProblem(f"algorithm: expected a name, got {shown(algorithm)}")
    if algorithm == "associated":
        raise Unsupported("associated: it is not a step of Coulomb friction, and a path would carry its dilation along")
    if "warm_start" in options:
        raise InvalidProblem("warm_start: a path starts each step from the one before")
    known = {name: options[name] for name in ARGUMENTS if name in options}
    refuse_arguments(**(DEFAULTS | known))
    others = {name: value for name, value in options.items() if name not in (*ARGUMENTS, "algorithm")}
    refuse_unsupported(problem, chosen, Settings(options=others), options.get("algorithm"))


def _stepper(problem: ContactProblem, method: str, options: dict[str, Any]) -> Stepper:
    """Return Newton's method on the contact unknowns in the plane, unless options, method or size require `solve`."""
    chosen = find(method)
    if not chosen.exact or not chosen.semidefinite:
        raise Unsupported(f"{chosen.name}: a path with Coulomb friction takes an exact convex method; try active-set")
    refuse_options(problem, chosen, options)
    limited = options.get("max_iter") is not None or options.get("time_limit") is not None
    in_plane = problem.slip_origin is not None and problem.slip_origin.shape[1] == 1
    whole = iterated(problem) or contacts_are_many(problem)
    own = chosen.solve_friction is not None  # in systems of stick and slip
    if in_plane and not (whole or limited or own) and options.get("algorithm") in (None, "newton"):
        return PlaneStepper(problem, method, {**options, "algorithm": None})
    return SolveStepper(problem, method, options)


def step_notes(problem: ContactProblem, steps: Sequence[Solution], times: Sequence[float]) -> Iterator[str]:
    """Return a note for every step that jumps or chooses, and for every series of steps with several equilibria.

    Steps are followed in doubles, and in extended precision if this fails or loses the signs of contacts. This takes at
    most `BUDGET` operations, or as many as the steps; a note has the step where it stopped.
    """
    reason = _not_followed(problem)
    if reason:
        yield f"whether steps jump was not examined: {reason}"
    else:
        with problem._lock, one_blas_thread(problem):
            system = ForceSystem(problem, condense(problem))
            in_doubles, exact = _operations_of_an_event(problem, system)
            allowed, spent = max(BUDGET, len(steps) * exact), 0.0
            for i in range(len(steps) - 1):
                if spent >= allowed:
                    yield (
                        f"whether steps after t = {times[i]:.12g} jump was not examined after {allowed:.3g} "
                        "operations: events='exact' follows them"
                    )
                    break
                step = steps[i], steps[i + 1], (times[i], times[i + 1])
                path, found = _through(problem, system, *step, refined=False)
                spent += in_doubles * (len(path.segments) + 1)
                if found or not path.keeps_signs():
                    path, found = _through(problem, system, *step, refined=True)
                    spent += exact * (len(path.segments) + 1)
                if found:
                    yield f"step to t = {times[i + 1]:.12g}: {found}"
    yield from _several(steps, times)


def _operations_of_an_event(problem: ContactProblem, system: ForceSystem) -> tuple[float, float]:
    """Return the operations of following a path to its next event, in doubles and in extended precision."""
    rows, entries = float(len(system.slope)), float(problem.stiffness_rows.nnz)
    in_doubles = CALL + PER_SQUARE * rows**2 + rows**3 + PER_UNKNOWN * entries
    return in_doubles, in_doubles + CALL + 2 * PER_ENTRY * entries


def _not_followed(problem: ContactProblem) -> str:
    if problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
        return "two tangential rows a contact"
    return "too many contacts" if contacts_are_many(problem) else ""


def _through(
    problem: ContactProblem,
    system: ForceSystem,
    before: Solution,
    now: Solution,
    times: tuple[float, float],
    refined: bool,
) -> tuple[ExactPath, str]:
    """Return the path through one step, and in words why it ended, or ''."""
    start, end = times
    path = ExactPath(problem, before, system, refined)
    jump = path.jump_at_start() if start == 0 else ""
    if jump:
        return path, f"it jumps; {jump}"
    try:
        path.leg(before.problem.load, now.problem.load, start, end - start)
    except NoEquilibrium as error:
        return path, f"it jumps; {str(error).removeprefix(PREFIX)}"
    except SeveralEquilibria as error:
        return path, f"it chooses; {str(error).removeprefix(PREFIX)}"
    except NotConverged as error:
        return path, f"whether it jumps was not found out; {str(error).removeprefix(PREFIX)}"
    except Unsupported:
        return path, "it jumps; the load moves a body that nothing holds"
    return path, ""


def _several(steps: Sequence[Solution], times: Sequence[float]) -> Iterator[str]:
    """Return the series of steps at whose loads the certificate finds other equilibria."""
    known = [i > 0 and SEVERAL in solution.certificate.uniqueness for i, solution in enumerate(steps)]
    for several, run in groupby(range(len(known)), key=known.__getitem__):
        places = list(run)
        if several:
            first, last = times[places[0]], times[places[-1]]
            when = f"t = {first:.12g}" if first == last else f"t = {first:.12g} to {last:.12g}"
            yield f"{when}: several equilibria exist at this load, and a step takes one of them"


def follow_on_springs(
    problem: ContactProblem,
    corners: Sequence[Vector],
    count: int,
    exactly: bool,
    chosen: Method,
    options: dict[str, Any],
) -> History:
    """Follow a path like `follow_with_friction` by a method with contact springs (`springs` has their options).

    Raises InvalidProblem: a stiffness is missing, or not positive and finite; Unsupported: a stiffness is so far above
    that of the bodies that rounding hides the signs of rates.

    Parameters
    ----------
    problem, corners, count, exactly
        As for `follow_with_friction`.
    chosen : a method whose `springs` names its stiffnesses
    options : dict, its options, these stiffnesses among them
    """
    refuse_options(problem, chosen, options)
    if chosen.springs is None:
        raise ValueError(f"{chosen.name} has no contact springs")
    beta, beta_T = (options.get(name) for name in chosen.springs)
    others = {name: value for name, value in options.items() if name not in (*chosen.options, "algorithm")}
    springs = with_contact_springs(problem, np.asarray(beta), beta_T)
    for option, stiffness in zip(chosen.springs, (beta, beta_T), strict=True):
        if stiffness is not None:
            _refuse_rigid(problem, chosen.name, stiffness, option)
    loads = [np.concatenate([load, np.zeros(springs.dimension - problem.dimension)]) for load in corners]

    def of_bodies(whole: History) -> History:
        bodies = LazySolutions(_WithoutSprings(problem, whole, i, chosen.name) for i in range(len(whole)))
        times = whole.times.tolist()
        return History(bodies, times, lambda: whole.events, energies=lambda: whole.energies, notes=lambda: whole.notes)

    try:
        return of_bodies(follow_with_friction(springs, loads, count, exactly, "active-set", others))
    except ContactQPError as error:
        if isinstance(error.history, History):
            error.history = of_bodies(error.history)
        raise


def _refuse_rigid(problem: ContactProblem, name: str, stiffness: Any, option: str) -> None:
    """Raise Unsupported for springs too stiff: rates of forces are small differences of motions times the stiffness."""
    own = default_penalty(problem, problem.normal, 1.0)
    ratio = np.broadcast_to(np.asarray(stiffness, dtype=float), own.shape) / own
    if np.any(ratio > STIFFEST):
        i = int(np.argmax(ratio))
        raise Unsupported(
            f"{name}: {option} of {problem.contact_name(i)} is {ratio[i]:.1g} times the stiffness of the bodies there: "
            f"on a path with friction at most {STIFFEST:.0e}; rigid contact is method='active-set'"
        )


@dataclass(frozen=True, eq=False)
class _WithoutSprings:
    """One instant of the bodies without springs."""

    problem: ContactProblem
    on_springs: Sequence[Solution]
    instant: int
    name: str  # the options of the method

    def finish(self) -> Solution:
        """Return the method's certified answer at the instant."""
        on_springs, n = self.on_springs[self.instant], self.problem.dimension
        whole = on_springs.problem
        with self.problem._lock, one_blas_thread(self.problem):
            own = self.problem.replace(load=whole.load[:n], slip_origin=whole.slip_origin)
            return without_contact_springs(own, on_springs, self.name)
