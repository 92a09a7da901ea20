"""Load paths with Coulomb friction from one exact event to the next, jumps, and the paths of penalty methods."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from contactqp.analysis.friction_events import ExactPath, Segment
from contactqp.analysis.friction_stepping import FrictionSteps, refuse_options
from contactqp.analysis.history import Event, History, LazySolutions
from contactqp.certificate.figures import holds
from contactqp.certificate.subset_bounds import first_candidates
from contactqp.certificate.uniqueness import SEVERAL
from contactqp.errors import NoEquilibrium, NotConverged, SeveralEquilibria, Unsupported
from contactqp.linalg.condensation import condense
from contactqp.linalg.friction_states import STICK
from contactqp.linalg.runtime import one_blas_thread
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.friction.contact_springs import with_contact_springs, without_contact_springs
from contactqp.solving.friction.force_system import ForceSystem
from contactqp.solving.friction_runs import FrictionRun
from contactqp.solving.methods import Method
from contactqp.solving.methods.augmented_lagrangian import default_penalty

# Where the steps of a load path with friction jump: no way leads continuously through the step, or several do.
#
# From the state at its start a step is followed again from event to event (`friction_events`). Where that finds no
# continuation the step has jumped to an equilibrium beyond; where it finds several, or several equilibria exist at the
# end of the step, the step has chosen one.

SAID_BEFORE = "follow_path: "


def step_notes(problem: ContactProblem, steps: Sequence[Solution], times: Sequence[float]) -> Iterator[str]:
    """One text for every step that jumps or chooses, and one for every run of steps with several equilibria."""
    reason = _not_followed(problem)
    if reason:
        yield f"whether steps jump was not examined: {reason}"
    else:
        with problem.lock, one_blas_thread(problem):
            system = ForceSystem(problem, condense(problem))
            for i in range(len(steps) - 1):
                found = _through(problem, system, steps[i], steps[i + 1], (times[i], times[i + 1]))
                if found:
                    yield f"step to t = {times[i + 1]:.12g}: {found}"
    yield from _several(steps, times)


def _not_followed(problem: ContactProblem) -> str:
    if problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
        return "two tangential rows a contact"
    return "too many contacts" if first_candidates(problem) is not None else ""


def _through(
    problem: ContactProblem, system: ForceSystem, before: Solution, now: Solution, times: tuple[float, float]
) -> str:
    """What stops the way through one step, or nothing."""
    start, end = times
    path = ExactPath(problem, before, system)
    jump = path.jump_at_start() if start == 0 else ""
    if jump:
        return f"it jumps; {jump}"
    try:
        path.leg(before.problem.load, now.problem.load, start, end - start)
    except NoEquilibrium as error:
        return f"it jumps; {str(error).removeprefix(SAID_BEFORE)}"
    except SeveralEquilibria as error:
        return f"it chooses; {str(error).removeprefix(SAID_BEFORE)}"
    except NotConverged as error:
        return f"whether it jumps was not found out; {str(error).removeprefix(SAID_BEFORE)}"
    return ""


def _several(steps: Sequence[Solution], times: Sequence[float]) -> Iterator[str]:
    """Runs of steps at whose loads the certificate knows of other equilibria."""
    known = [i > 0 and SEVERAL in solution.certificate.uniqueness for i, solution in enumerate(steps)]
    for several, run in groupby(range(len(known)), key=known.__getitem__):
        places = list(run)
        if several:
            first, last = times[places[0]], times[places[-1]]
            when = f"t = {first:.12g}" if first == last else f"t = {first:.12g} to {last:.12g}"
            yield f"{when}: several equilibria exist at this load, and a step takes one of them"


def follow_with_friction(
    problem: ContactProblem, corners: Sequence[Vector], count: int, exactly: bool, method: str, options: dict[str, Any]
) -> History:
    """The legs from corner to corner, in so many steps each and, if exactly, at every event.

    Raises
    ------
    Unsupported
        Exact events with two tangential directions a contact, and what `FrictionSteps` cannot do.
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
    for leg, (start, end) in enumerate(pairwise(corners)):
        steps.turn(start, end)
        for i in range(count):
            steps.go_to((i + 1) / count)
            times.append(leg + (i + 1) / count)
    return History(steps, times, lambda: steps.changes(times), notes=lambda: step_notes(problem, steps, times))


def _between_events(problem: ContactProblem, corners: Sequence[Vector], count: int, first: Solution) -> History:
    path, instants, times = ExactPath(problem, first), _Instants(first), [0.0]
    jump = path.jump_at_start()
    if jump:
        raise Unsupported(f"follow_path(events='exact'): {jump}: it would jump; give steps")
    events: list[Event] = []
    for leg, (start, end) in enumerate(pairwise(corners)):
        found, segments = path.leg(start, end, leg)
        events += [replace(event, time=leg + event.time) for event in found]
        fractions = sorted({(i + 1) / count for i in range(count)} | {segment.end for segment in segments})
        for fraction in fractions:
            here = [segment for segment in segments if segment.start <= fraction <= segment.end]
            load = end if fraction == 1 else start + fraction * (end - start)
            instants.add(path, problem.replace(load=load), fraction, here)
            times.append(leg + fraction)
    return History(instants, times, lambda: events, linear=True)


class _Instants(LazySolutions):
    """Solutions at instants between which all is linear, certified when they are looked at."""

    def __init__(self, first: Solution) -> None:
        super().__init__([first])
        self._displacement = first.displacement

    def add(self, path: ExactPath, problem: ContactProblem, fraction: float, segments: Sequence[Segment]) -> None:
        """The answer to the problem's load in a segment; its slip counts from the instant before.

        At an event two segments meet: the slip is that of the first, and which of them the load, rounded, is in is
        seen by the signs.
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


# Load paths of the penalty methods with Coulomb friction: the path of the bodies on contact springs, and its sliders.
#
# A method that gives contacts a stiffness solves Coulomb's law of bodies with springs at their contacts
# (`contactqp.solving.friction.contact_springs`): its path is theirs, in steps or from one exact event to the next. The
# history shows the bodies: a solution is what the method itself makes of `solution.problem`, whose slip origin is where
# the sliders were at the instant before, or where they stick.

# Contact springs of this many times the stiffness that the bodies show there: rates keep five digits.
STIFFEST = 1e6


def follow_on_springs(
    problem: ContactProblem,
    corners: Sequence[Vector],
    count: int,
    exactly: bool,
    chosen: Method,
    options: dict[str, Any],
) -> History:
    """As `follow_with_friction`, of a method whose `springs` names the stiffnesses of its contacts.

    Raises
    ------
    InvalidProblem
        A stiffness is missing, or not positive and finite.
    Unsupported
        A stiffness is so far above that of the bodies that rounding hides whether a contact goes on.
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
    whole = follow_with_friction(springs, loads, count, exactly, "active-set", others)
    bodies = LazySolutions(_WithoutSprings(problem, whole, i, chosen.name) for i in range(len(whole)))
    times = whole.times.tolist()
    return History(bodies, times, lambda: whole.events, energies=lambda: whole.energies, notes=lambda: whole.notes)


def _refuse_rigid(problem: ContactProblem, name: str, stiffness: Any, option: str) -> None:
    """Rates of forces are differences of motions times the stiffness, and signs of rates are what a path goes by."""
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
    """The bodies at one instant, without the springs with which they were followed."""

    problem: ContactProblem
    on_springs: Sequence[Solution]
    instant: int
    name: str  # of the method

    def finish(self) -> Solution:
        """What the method itself makes of the instant, certified."""
        on_springs, n = self.on_springs[self.instant], self.problem.dimension
        whole = on_springs.problem
        with self.problem.lock, one_blas_thread(self.problem):
            own = self.problem.replace(load=whole.load[:n], slip_origin=whole.slip_origin)
            return without_contact_springs(own, on_springs, self.name)
