"""Evaluate the quantities that the claims of a case ask for, on a solution at one instant of its path or motion.

`READERS` has a function for each name in `contactqp.scene.claims.QUANTITIES`; quantities of elements are evaluated by
the classes of the elements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import groupby
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from contactqp.analysis import is_motion
from contactqp.analysis.history import Energies, Event, History
from contactqp.analysis.large.deformation import LargeHistory, LargeSolution, LimitPoint, Snap
from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.uniqueness import proves_friction
from contactqp.elements.obstacle import tangent_frames
from contactqp.errors import SceneError
from contactqp.model.arrays import Array
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.scene import building
from contactqp.scene.building import ExactProblem, NodeModel
from contactqp.scene.claims import Claim, uniqueness_in_words
from contactqp.scene.geometry import obstacle
from contactqp.scene.schema import SceneData

if TYPE_CHECKING:
    from contactqp.analysis.motion.motion_history import MotionHistory

# Gaps below this part of the largest gap or displacement are rounding errors of zero.
ROUNDING_OF_GAPS = 1e-12


@dataclass(frozen=True, eq=False)
class Instant:
    """A pseudo-time of the path, or without a path the factor on all loads; `step` is its index in the history.

    In a motion, whose loads are constant, `time` is 1 and `step` identifies the instant.
    """

    time: Fraction = Fraction(1)
    history: History | None = None
    step: int | None = None

    @property
    def events(self) -> Sequence[Event]:
        """Return all changes of contact along the path."""
        return () if self.history is None else self.history.events

    def energies(self, claim: Claim) -> Energies:
        """Return the energies since the start of the path.

        Raises
        ------
        SceneError
            The path has no step here.
        """
        if self.history is None or self.step is None:
            raise SceneError(f"{claim}: expected a step of the load path")
        return self.history.energies[self.step]

    def event(self, claim: Claim, contacts: Sequence[int]) -> Event:
        """Return the event that the claim names, among those of the problem's contacts that form one contact of the
        scene.

        Raises
        ------
        SceneError
            The path or motion has fewer; several contacts of a side slip or stick one by one.
        """
        if len(contacts) > 1 and claim.event in ("stick", "slip"):
            raise SceneError(f"{claim}: expected 'closed' or 'opened': the nodes of a side slip and stick one by one")
        events = list(_of_group(self.events, contacts)) if len(contacts) > 1 else self._of_one(contacts)
        found = [event for event in events if event.kind == claim.event]
        number = abs(claim.occurrence)
        if len(found) < number:
            what = {"closed": "close", "opened": "open", "stick": "stick", "slip": "slip"}[str(claim.event)]
            times = "" if number == 1 else f" {number} times"
            where = "in the motion" if is_motion(self.history) else "on the load path"
            seen = ", ".join(f"{e.kind} at {e.time:.6g}" for e in events) or "none"
            raise SceneError(f"{claim}: expected contact {claim.at!r} to {what}{times} {where}; its events: {seen}")
        return found[claim.occurrence - (claim.occurrence > 0)]

    def _of_one(self, contacts: Sequence[int]) -> list[Event]:
        return [event for event in self.events if event.contact in contacts]

    def impulses(self) -> Array:
        """Return the impulse of each normal force since the start of the motion, (m,) [force * time]."""
        motion = self.motion
        force, weight = motion.normal_forces[: (self.step or 0) + 1], motion.motion.scheme.contact_weight()
        acting = weight * force[1:] + (1 - weight) * force[:-1]
        return np.asarray(motion.motion.scheme.body.step * acting.sum(axis=0))

    @property
    def motion(self) -> MotionHistory:
        """Return the history as that of a motion."""
        history = self.history
        assert is_motion(history)  # the check of the scene ensures it
        return history

    @property
    def velocity(self) -> Any:
        """Return the velocities of the free unknowns, (n,) [length / time]."""
        return self.motion.motion.states[self.step or 0].velocity


def _of_group(events: Sequence[Event], contacts: Sequence[int]) -> Iterator[Event]:
    """Yield an event when the first of several contacts closes, and when the last of them opens."""
    members, closed = set(map(int, contacts)), set[int]()
    for time, together in groupby(events, lambda event: event.time):
        was = bool(closed)
        for event in together:
            if event.contact in members and event.kind in ("closed", "opened"):
                (closed.add if event.kind == "closed" else closed.discard)(event.contact)
        if bool(closed) != was:
            yield Event("closed" if closed else "opened", contacts[0], time)


def with_bounds(history: History) -> Solution:
    """Return the last solution of a history; with friction it is certified anew with error bounds, where these cost
    less than the solve.

    The steps of a motion keep the certificates of the problems that the scheme solved.
    """
    last = history[-1]
    problem, given = last.problem, last.certificate
    done = given.proven or not given.passed or is_motion(history)
    if done or type(problem) is not ContactProblem or not proves_friction(problem):
        return last
    proven = certificate_of(problem, last.answer, given.tolerance, given.error_tolerance, prove_friction=True)
    notes = tuple(dict.fromkeys((*given.notes, *proven.notes)))
    return replace(last, certificate=replace(proven, notes=notes)) if proven.proven else last


@dataclass(frozen=True, eq=False)
class Answer:
    """A scene's solution at one instant, and its load path if it has one."""

    model: NodeModel
    solution: Solution
    instant: Instant

    @property
    def scene(self) -> SceneData:
        """Return the scene that was solved."""
        return self.model.scene

    @property
    def exact(self) -> ExactProblem:
        """Return the exact numbers of the problem that was solved."""
        return self.model.exact

    def value_of(self, claim: Claim) -> Any:
        """Return the claim's quantity in the scene's units: a number, words, or the numbers of a matrix row by row."""
        measure = claim.measure
        if claim.with_respect_to is not None:
            return READERS[claim.quantity](claim, replace(self, solution=cast(Solution, _Rates(claim, self))))
        if measure.read is None:
            return READERS[claim.quantity](claim, self)
        return measure.read(self.scene.element(str(measure.at), str(claim.at)), self)

    def displacement(self, unknown: str) -> float:
        """Return the displacement or rotation of any unknown; 0 where it is fixed."""
        if unknown in self.exact.unknowns.fixed:
            return 0.0
        return float(self.solution.displacement[self.exact.unknowns.free.index(unknown)])

    def of_node(self, node: str) -> np.ndarray[Any, Any]:
        """Return the displacement of a node, (dimension,) [length]."""
        return np.array([self.displacement(name) for name in self.scene.displacements(node)])

    def bar_force_now(self, name: str) -> float:
        """Return the true axial force of a bar at large displacements, positive in tension [force]."""
        from contactqp.scene.moving import DeformableModel

        return DeformableModel(self.model).bar_force(name, self.solution.displacement)


class _Rates:
    """The derivatives of a solution with respect to the parameter of a claim, under the names of the quantities."""

    def __init__(self, claim: Claim, answer: Answer) -> None:
        self._claim, self._solution = claim, answer.solution
        self._by = "load" if claim.with_respect_to == "load factor" else str(claim.with_respect_to)
        if claim.with_respect_to == "load factor":
            self._direction = _whole_load(answer.model)
            return
        names = answer.exact.unknowns.free if self._by == "load" else [item.name for item in answer.scene.contacts]
        self._direction = np.array([float(name == claim.of) for name in names])

    def __getattr__(self, name: str) -> Any:
        found = self._solution.derivative(name, self._by, self._direction)
        if found.value is None:
            raise SceneError(f"{self._claim}: expected a derivative, and there is none: {found.reason}")
        return found.value


def _whole_load(model: NodeModel) -> Array:
    """Return the derivative of the loads with respect to the load factor, (n,) [force]."""
    return np.asarray(model.load_at(Fraction(1)) - model.load_at(Fraction(0)))


def _next_event(claim: Claim, answer: Answer) -> float:
    found = answer.solution.derivative("gap", "load", _whole_load(answer.model))
    if found.reach is None:
        why = found.reason or "the answer is not linear in the load"
        raise SceneError(f"{claim}: expected a next event, and none is known: {why}")
    return float(answer.instant.time) + float(found.reach[1])


def friction_along_axes(model: NodeModel, solution: Solution) -> Array:
    """Return lambda_T of each contact along the axes, (m, d) [force].

    At large deformations the tangents are those of the displaced node.
    """
    force = solution.friction_force
    if not isinstance(solution, LargeSolution) or force is None or solution.position is None:
        return model.along_axes(force)
    vectors = np.zeros(solution.position.shape)
    for i, contact in enumerate(model.scene.contacts):
        normals = obstacle(model.scene, str(contact.obstacle)).normals(solution.position[i : i + 1])
        vectors[i] = force[i] @ tangent_frames(np.asarray(normals, dtype=float))[0]
    return vectors


def _contact(claim: Claim, answer: Answer) -> int:
    return next(i for i, contact in enumerate(answer.scene.contacts) if contact.name == claim.at)


def _tie_force(claim: Claim, answer: Answer) -> float:
    names = [tie.name for tie in answer.scene.ties]
    return float(answer.solution.tie_force[names.index(str(claim.at))])


def _reaction(claim: Claim, answer: Answer) -> float:
    """Return the force of the support on the body at a fixed unknown, r = K u + E_N' l_N + E_T' l_T + A' nu - f."""
    at, exact, solution = str(claim.at), answer.exact, answer.solution
    if isinstance(solution, LargeSolution):
        from contactqp.scene.moving import DeformableModel

        return float(DeformableModel(answer.model).support_forces(solution)[exact.unknowns.place[at]])
    stiffness = sum(float(k) * answer.displacement(j) for (i, j), k in exact.stiffness.items() if i == at)
    rows = [*(contact.normal for contact in exact.contacts), *(tie.row for tie in exact.ties)]
    forces = [*solution.normal_force, *solution.tie_force]
    if solution.friction_force is not None:
        rows += [row for contact in exact.contacts for row in contact.tangent]
        forces += [*solution.friction_force.ravel()]
    constraints = sum(float(row.get(at, 0)) * float(force) for row, force in zip(rows, forces, strict=True))
    return stiffness + constraints - float(answer.model.exact_load_at(answer.instant.time).get(at, 0))


def _closing(claim: Claim, answer: Answer) -> float:
    """Return the load factor at which the contact first closes."""
    return _event_time(claim.model_copy(update={"event": "closed"}), answer)


def _closing_load(claim: Claim, answer: Answer) -> float:
    return _closing(claim, answer) * float(answer.exact.load.get(str(claim.along), 0))


def _event_time(claim: Claim, answer: Answer) -> float:
    return float(answer.instant.event(claim, [_contact(claim, answer)]).time)


def _event_load(claim: Claim, answer: Answer) -> float:
    time = Fraction(_event_time(claim, answer))
    return float(answer.model.exact_load_at(time).get(str(claim.along), 0))


def _events(claim: Claim, answer: Answer) -> int:
    return sum(event.contact == _contact(claim, answer) for event in answer.instant.events)


def _along_axis(claim: Claim, answer: Answer, values: Any) -> float:
    axis = answer.scene.axes.index(str(claim.along))
    return float(values[_contact(claim, answer), axis])


def _velocity(claim: Claim, answer: Answer) -> float:
    return float(answer.instant.velocity[answer.exact.unknowns.free.index(str(claim.at))])


def _columns(claim: Claim, answer: Answer) -> tuple[str, ...]:
    return claim.unknowns or answer.exact.unknowns.free


def _momentum(claim: Claim, answer: Any) -> float:
    from contactqp.scene.moving import momentum

    instant = answer.instant
    return momentum(answer.model, instant.motion, instant.velocity, str(claim.along), claim.at)


# Quantities that are evaluated alike in scenes of nodes and of bodies.
OF_BOTH: Mapping[str, Callable[[Claim, Any], Any]] = {
    "elastic energy": lambda claim, answer: answer.instant.energies(claim).elastic,
    "work of the loads": lambda claim, answer: answer.instant.energies(claim).work,
    "dissipated energy": lambda claim, answer: answer.instant.energies(claim).dissipated,
    "free motions": lambda _, answer: float(len(answer.solution.free_motions)),
    "uniqueness": lambda _, answer: uniqueness_in_words(answer.solution.certificate.uniqueness),
    "kinetic energy": lambda claim, answer: answer.instant.energies(claim).kinetic,
    "total energy": lambda claim, answer: answer.instant.energies(claim).total,
    "impact energy": lambda claim, answer: answer.instant.energies(claim).impact,
    "energy drift": lambda claim, answer: answer.instant.energies(claim).drift,
    "total momentum": _momentum,
    "momentum": _momentum,
}
Point = TypeVar("Point", LimitPoint, Snap)


def _history(answer: Answer) -> LargeHistory:
    history = answer.instant.history
    assert isinstance(history, LargeHistory)  # the check of the scene ensures it
    return history


def _solution(answer: Answer) -> LargeSolution:
    assert isinstance(answer.solution, LargeSolution)
    return answer.solution


def _load(claim: Claim, answer: Answer, load_factor: float) -> float:
    return float(answer.model.exact_load_at(Fraction(load_factor)).get(str(claim.at), 0))


def _limit(claim: Claim, answer: Answer) -> LimitPoint:
    points = _history(answer).limit_points
    return _numbered(claim, points, "limit points", [f"{p.kind} at {p.load_factor:.6g}" for p in points])


def _snap(claim: Claim, answer: Answer) -> Snap:
    snaps = _history(answer).snaps
    return _numbered(claim, snaps, "snap-throughs", [f"one at {snap.high:.6g}" for snap in snaps])


def _numbered(claim: Claim, points: Sequence[Point], what: str, found: Sequence[str]) -> Point:
    """Return the point that the claim counts to, from 1 or from the end.

    Raises SceneError: the path has fewer.
    """
    if len(points) < abs(claim.occurrence):
        raise SceneError(
            f"{claim}: expected {abs(claim.occurrence)} {what} or more on the path, got {', '.join(found) or 'none'}"
        )
    return points[claim.occurrence - (claim.occurrence > 0)]


def _limit_displacement(claim: Claim, answer: Answer) -> float:
    place = answer.exact.unknowns.free.index(str(claim.at))
    return float(_limit(claim, answer).displacement[place])


OF_LARGE: Mapping[str, Callable[[Claim, Any], float]] = {
    "load factor": lambda _, answer: _solution(answer).load_factor,
    "load": lambda claim, answer: _load(claim, answer, _solution(answer).load_factor),
    "limit load factor": lambda claim, answer: _limit(claim, answer).load_factor,
    "limit load": lambda claim, answer: _load(claim, answer, _limit(claim, answer).load_factor),
    "limit displacement": _limit_displacement,
    "limit points": lambda _, answer: len(_history(answer).limit_points),
    "snap-through load factor": lambda claim, answer: _snap(claim, answer).high,
    "snap-through load": lambda claim, answer: _load(claim, answer, _snap(claim, answer).high),
    "snap-throughs": lambda _, answer: len(_history(answer).snaps),
}
READERS: dict[str, Callable[[Claim, Answer], Any]] = {
    "displacement": lambda claim, answer: answer.displacement(str(claim.at)),
    "normal force": lambda claim, answer: float(answer.solution.normal_force[_contact(claim, answer)]),
    "total normal force": lambda _, answer: float(answer.solution.normal_force.sum()),
    "gap": lambda claim, answer: float(answer.solution.gap[_contact(claim, answer)]),
    "status": lambda claim, answer: str(answer.solution.contact_status[_contact(claim, answer)]),
    "friction force": lambda claim, answer: _along_axis(
        claim, answer, friction_along_axes(answer.model, answer.solution)
    ),
    "slip": lambda claim, answer: _along_axis(claim, answer, answer.model.along_axes(answer.solution.slip)),
    "tie force": _tie_force,
    "reaction": _reaction,
    "energy": lambda _, answer: answer.solution.energy,
    **OF_BOTH,
    **OF_LARGE,
    "velocity": _velocity,
    "contact impulse": lambda claim, answer: float(answer.instant.impulses()[_contact(claim, answer)]),
    "closing load factor": _closing,
    "next event load factor": _next_event,
    "closing load": _closing_load,
    "event time": _event_time,
    "event load": _event_load,
    "events": _events,
    "stiffness": lambda claim, answer: answer.exact.stiffness.get((str(claim.at), str(claim.along)), Fraction(0)),
    "tie matrix": lambda claim, answer: building.tie_matrix(answer.exact, _columns(claim, answer)),
    "tie rank": lambda _, answer: building.rank(answer.exact),
    "reduced stiffness": lambda claim, answer: building.reduced_stiffness(answer.exact, _columns(claim, answer)),
    "reduced load": lambda claim, answer: building.reduced_load(answer.exact, _columns(claim, answer)),
}


def clean_gaps(solution: Solution) -> Array:
    """Return the gaps (m,), with 0 for those that are rounding errors relative to the largest gap or displacement."""
    size = max(float(np.max(abs(values), initial=0.0)) for values in (solution.gap, solution.displacement))
    return np.where(abs(solution.gap) > ROUNDING_OF_GAPS * size, solution.gap, 0.0)
