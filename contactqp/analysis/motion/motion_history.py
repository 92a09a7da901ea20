"""Define the history of a motion: states at equal steps, energies, events, and solutions certified at first access."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from contactqp.analysis.history import Energies, Event, History, LazySolutions, contact_changes
from contactqp.analysis.motion.schemes.scheme import Scheme, State
from contactqp.analysis.motion.step_contact import AT_REST, StepProblem, StepResult
from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.figures import contact_status
from contactqp.certificate.uniqueness import proves_friction
from contactqp.errors import ContactQPError, Unsupported, counted
from contactqp.model.arguments import checks
from contactqp.model.arrays import EPS, Array, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.solution import Answer, Certificate, Solution
from contactqp.model.summary import wrapped
from contactqp.solving.solve import solve

# Steps whose energies are computed at once.
BLOCK = 256
# The relative rounding of slips, and of penetrations.
SLIPS = PENETRATES = 1e-9
# The relative difference of a state from its scheme's result, in addition to the rounding of displacements.
SAME, ROUNDED = 1e-9, 64 * EPS
# An energy gain above this part of the initial and supplied energy is noted; central differences, which preserve
# energy on average, fluctuate by a few thousandths.
GROWS = 0.05
# Schemes without energy gain at impacts, as alternatives.
KEEP_ENERGY = ("modified-mass", "moreau-jean")
# Schemes without mass at contacts, so that there are no impulses.
WITHOUT_MASS = ("modified-mass", "modified-mass-central")


@dataclass(frozen=True, eq=False, repr=False)
class Moving(Solution):
    """One instant of a motion.

    `displacement`, `normal_force`, `gap`, `slip` (since the previous step) are those of the bodies; forces are those of
    the previous step, in Moreau's and Jean's scheme impulses over the time step. `certificate` judges `step_problem`,
    the scheme's contact problem of the step with the answer `step_unknown`. If this is a velocity, or a mean of
    displacements, `gap` may be negative, and `certificate.notes` has the amount.
    """

    velocity: Vector = field(default_factory=lambda: np.zeros(0))  # (n,) [length / time]
    time: float = 0.0
    step_problem: ContactProblem | None = field(default=None, repr=False)
    step_unknown: Vector = field(default_factory=lambda: np.zeros(0), repr=False)


@checks
class MotionHistory(History):
    """A `History` of a motion, including the start; `times` are in the user's unit of time, that of the time step."""

    time_label = "time [as time_step]"

    def __init__(
        self,
        motion: Motion,
        notes: Callable[[], Sequence[str]],
        resume: Callable[[list[State], float], MotionHistory],
    ) -> None:
        super().__init__(
            LazySolutions(_Instant(motion, k) for k in range(len(motion.states))),
            [motion.time(k) for k in range(len(motion.states))],
            lambda: events(motion),
            energies=lambda: energies(motion),
            notes=notes,
        )
        self.motion = replace(motion, states=list(motion.states))
        self._resume = resume

    def resume(self, duration: float) -> MotionHistory:
        """Continue this motion with the same scheme, step and factorisation, and return the longer motion.

        Raises
        ------
        Unsupported
            The history was pickled.
        InvalidProblem, NotConverged
            As `impact`.
        """
        longer = self._resume(self.motion.states, duration)
        longer.time_label = self.time_label
        return longer

    def __copy__(self) -> MotionHistory:
        """Return the same motion with shared states and finished solutions."""
        twin = MotionHistory(self.motion, partial(tuple, self.notes), self._resume)
        twin._solutions, twin.time_label = self._solutions, self.time_label
        return twin

    def __deepcopy__(self, memo: dict[int, Any]) -> MotionHistory:
        return self.__copy__()

    def __getstate__(self) -> dict[str, Any]:
        """Return the pickled data: all instants finished, with their loads. A pickled motion cannot be resumed."""
        return super().__getstate__() | dict(_resume=_refuse_to_go_on)

    def summary(self) -> str:
        """Return `History.summary` with the remark that the force of an impact depends on the step."""
        sentences = wrapped(*(f"note: {text}" for text in _notes_on_impulses(self.motion)))
        return "\n".join([super().summary(), *sentences])

    @property
    def displacements(self) -> Array:
        """Return the displacements (steps, n) [length]."""
        return read_only(np.array([state.displacement for state in self.motion.states]))

    @property
    def velocities(self) -> Array:
        """Return the velocities (steps, n) [length / time]; of central differences those half a step earlier, except at
        the start.
        """
        return read_only(np.array([state.velocity for state in self.motion.states]))

    @property
    def problem(self) -> ContactProblem:
        """Return the problem of the moving bodies, without inertia."""
        return self.motion.scheme.body.problem

    @property
    def normal_forces(self) -> Array:
        """Return the normal forces (steps, m) [force], positive in compression."""
        return read_only(np.array([state.normal_force for state in self.motion.states]))

    @property
    def friction_forces(self) -> Array | None:
        """Return the friction forces (steps, m, d-1) [force], or None without friction."""
        problem = self.motion.scheme.body.problem
        if not problem.frictional or problem.slip_origin is None:
            return None
        shape = (len(self.motion.states), *problem.slip_origin.shape)
        return read_only(np.array([state.friction_force for state in self.motion.states])).reshape(shape)

    @property
    def tie_forces(self) -> Array:
        """Return the tie forces (steps, k) [force]."""
        return read_only(np.array([state.tie_force for state in self.motion.states]))


def _refuse_to_go_on(*_: Any) -> Any:
    raise Unsupported("a motion that was pickled cannot be resumed: its load and factors are where it was made")


@dataclass(frozen=True, eq=False)
class _Instant:
    """One state, converted to a solution and certified at first access."""

    motion: Motion
    number: int

    def finish(self) -> Solution:
        return _solution_at(self.motion, self.number)


def _solution_at(motion: Motion, k: int) -> Moving:
    """Return instant k with the certificate of the step that ended there; the start is certified as given."""
    body, state = motion.scheme.body, motion.states[k]
    problem = body.problem.replace(load=motion.load(motion.time(k)))
    before = motion.states[max(k - 1, 0)].displacement
    if problem.slip_origin is not None and problem.tangent is not None:
        problem = problem.replace(slip_origin=problem.tangent @ before)
    step, found = _step_problem(motion, k)
    dragged = None if step.slip_origin is None else _shaped(found.friction, step)
    answer = Answer(found.unknown, found.normal, dragged, found.tie)
    certificate = certificate_of(step, answer, prove_friction=proves_friction(step))
    if k and not certificate.passed:
        certificate = _of_nearest_answer(motion, k, step, found) or certificate
    status = contact_status(step, certificate)
    strangers = tuple(_not_of_step(motion, k))
    if strangers:
        certificate = replace(certificate, passed=False, failures=(*certificate.failures, *strangers))
    deepest = _deepest(problem, [state.displacement])
    if deepest is not None:
        note = f"judged is the problem that {motion.scheme.name} posed for this step; {_penetrates(motion, deepest)}"
        certificate = replace(certificate, notes=(*certificate.notes, note))
    force = np.zeros(problem.contacts)
    force[: len(state.normal_force)] = state.normal_force
    friction = None if problem.slip_origin is None else _shaped(state.friction_force, problem)
    return Moving(
        problem=problem,
        answer=Answer(state.displacement, force, friction, state.tie_force),
        contact_status=status if len(status) == problem.contacts else np.where(force > 0, "closed", "open"),
        free_motions=(),
        certificate=certificate,
        method=f"{motion.scheme.name} with {motion.method}",
        seconds=motion.seconds[0],
        certify_seconds=0.0,
        work=motion.work(),
        velocity=state.velocity,
        time=motion.time(k),
        step_problem=step,
        step_unknown=found.unknown,
    )


def _of_nearest_answer(motion: Motion, k: int, step: ContactProblem, found: StepResult) -> Certificate | None:
    """Return the certificate of the right answer to a step if the computed one equals it up to rounding, else None.

    If bodies come to rest under loads balanced by contacts and ties, the rounding of these forces is as large as the
    remaining motion. An answer x equals x* if D |S (x - x*)| is at most AT_REST times the largest D F, with F the size
    of forces at an unknown, S the stiffness of the step and D = 1/sqrt(S_jj).
    """
    try:
        answer = solve(step)
    except ContactQPError:
        return None
    posed, _ = motion.posed(k)
    forces = [(step.normal, found.normal, answer.normal_force), (step.tie, found.tie, answer.tie_force)]
    if answer.friction_force is not None:
        forces.append((step.tangent, found.friction, answer.friction_force.ravel()))
    meeting = abs(posed.load) + step.stiffness_sizes @ abs(found.increment)
    meeting += sum(abs(rows).T @ abs(right) for rows, _, right in forces)
    largest = max(float(np.max(abs(right), initial=0.0)) for _, _, right in forces)
    same = all(np.all(abs(given - right) <= SAME * largest) for _, given, right in forces)
    apart = abs(step.stiffness_rows @ (found.unknown - answer.displacement))
    limit = AT_REST * np.max(step.own_scale * meeting, initial=0.0)
    return answer.certificate if same and np.all(step.own_scale * apart <= limit) else None


def _not_of_step(motion: Motion, k: int) -> Iterator[str]:
    """Yield the quantities of instant k that differ from the scheme's result for the certified answer of the step."""
    if k == 0:
        return
    scheme, before, state = motion.scheme, motion.states[k - 1], motion.states[k]
    made, h, problem = scheme.accept(before, scheme.answered(before, state)), scheme.body.step, scheme.body.problem
    moved = abs(state.displacement) + abs(before.displacement)
    fast = abs(state.velocity) + abs(before.velocity)
    pushes = np.full(len(state.normal_force), np.max(abs(made.normal_force), initial=0.0))
    for name, size, named in (
        ("displacement", SAME * moved + SAME * h * fast, problem.dof_name),
        ("velocity", SAME * fast + ROUNDED / h * moved, problem.dof_name),
        ("normal_force", SAME * pushes, problem.contact_name),
    ):
        found, expected = getattr(state, name), getattr(made, name)
        off = np.flatnonzero(~(abs(found - expected) <= size))
        if len(off):
            i = int(off[0])
            what = f"{name.replace('_', ' ')} of {named(i)}"
            yield f"{what}: {found[i]:.6g}, but {scheme.name} makes {expected[i]:.6g} of the answer of its step"


def notes_on_motion(motion: Motion) -> Iterator[str]:
    """Yield the notes on a whole motion: of its scheme, on penetration, and on energy gain."""
    yield from motion.scheme.notes(motion.states)
    yield from _notes_on_penetration(motion)
    yield from _notes_on_energy(motion)


def _notes_on_energy(motion: Motion) -> Iterator[str]:
    """Yield a note on the largest energy gain beyond initial energy and work of loads."""
    found = list(energies(motion))
    total, work, dissipated = np.array([(one.total, one.work, one.dissipated) for one in found]).T
    put_in = total[0] + np.maximum.accumulate(work)
    with np.errstate(invalid="ignore"):
        grown = np.flatnonzero(~(total - total[0] - work + dissipated <= GROWS * put_in))
    if not len(grown):
        return
    first, most = int(grown[0]), int(np.argmax(np.where(np.isfinite(total), total, np.inf)))
    problem = motion.scheme.body.problem
    unit = f" {problem.units.force} {problem.units.length}" if problem.units.force else ""
    cure = "take shorter steps"
    if motion.scheme.name not in KEEP_ENERGY:
        cure = f"the scheme {motion.scheme.name!r} makes it: take {' or '.join(map(repr, KEEP_ENERGY))}"
    yield (
        f"the energy grows beyond what the loads put in, from time {motion.time(first):.6g} on: it reaches "
        f"{total[most]:.6g}{unit} at {motion.time(most):.6g}, of {put_in[most]:.6g}{unit} that were there or put in; "
        f"{cure}"
    )


def _notes_on_penetration(motion: Motion) -> Iterator[str]:
    """Yield a note on the largest penetration of a scheme that does not enforce gaps at every instant."""
    problem = motion.scheme.body.problem
    deepest = _deepest(problem, [state.displacement for state in motion.states])
    if deepest is not None:
        place = f"step {deepest[0]}, at {motion.time(deepest[0]):.6g}"
        yield f"deepest at {place}: {_penetrates(motion, deepest)}"


def _notes_on_impulses(motion: Motion) -> Iterator[str]:
    """Yield a note on the largest contact force if a contact closes with it and the scheme has no contact springs."""
    forces = np.array([state.normal_force for state in motion.states])
    if motion.scheme.springs is not None or motion.scheme.name in WITHOUT_MASS or not forces.size:
        return
    step, contact = np.unravel_index(int(np.argmax(forces)), forces.shape)
    if step == 0 or not forces[step, contact] > 0 or forces[step - 1, contact] > 0:
        return
    units = motion.scheme.body.problem.units
    unit, impulse = (f" {units.force}", f" {units.force}*time") if units.force else ("", "")
    lasted = motion.time(int(step)) - motion.time(int(step) - 1)
    yield (
        f"the largest contact force, {forces[step, contact]:.6g}{unit}, is an impulse over one step: "
        f"{forces[step, contact] * lasted:.6g}{impulse}; shorter steps make the force larger, and not the impulse"
    )


def _deepest(problem: ContactProblem, displacements: Sequence[Vector]) -> tuple[int, int, float] | None:
    """Return the step, the contact and the depth of the deepest penetration of (n,) each; None if there is none."""
    if not problem.contacts:
        return None
    rows, u = problem.normal, np.array(displacements[:1]).T
    if len(displacements) > 1:
        touched = np.unique(rows.indices)  # the others would only need memory
        rows, u = rows[:, touched], np.array([one[touched] for one in displacements]).T
    limit = np.where(np.isfinite(problem.gap), abs(problem.gap), 0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable motion
        depth, size = (rows @ u).T - problem.gap, (abs(rows) @ abs(u)).T + limit
        depth = np.where(depth > PENETRATES * size, depth, 0.0)
    step, contact = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return (int(step), int(contact), float(depth[step, contact])) if depth[step, contact] > 0 else None


def _penetrates(motion: Motion, deepest: tuple[int, int, float]) -> str:
    problem = motion.scheme.body.problem
    unit = f" {problem.units.length}" if problem.units.length else ""
    why = "as the scheme allows; shorter steps make it less" if motion.scheme.springs is None else "as its springs do"
    return f"the displacement penetrates {problem.contact_name(deepest[1])} by {deepest[2]:.6g}{unit}, {why}"


def _shaped(friction: Vector, problem: ContactProblem) -> Array:
    assert problem.slip_origin is not None
    return friction.reshape(problem.slip_origin.shape) if len(friction) else np.zeros_like(problem.slip_origin)


def _step_problem(motion: Motion, k: int) -> tuple[ContactProblem, StepResult]:
    """Return the problem of the step that ends at k, with open gaps of contacts that it may not close."""
    template = motion.scheme.templates[-1]
    m, ties = template.contacts, template.ties
    tangential = 0 if template.slip_origin is None else template.slip_origin.size
    if k == 0:
        x = motion.states[0].displacement
        found = StepResult(x, np.zeros(m), np.zeros(tangential), np.zeros(ties), x)
        gap, origin = motion.scheme.body.problem.gap[:m], motion.scheme.body.slip_from(x)
        posed = StepProblem(template.stiffness_rows @ x, gap, None, origin, template.tie @ x)
    else:
        posed, found = motion.posed(k)
    gap = posed.gap
    if posed.closable is not None:
        reach = template.normal @ found.unknown
        gap = np.where(posed.closable, gap, np.maximum(reach, 0.0) + abs(reach))
    step = template.replace(
        load=posed.load, gap=gap, tie_value=np.zeros(ties) if posed.tie_value is None else posed.tie_value
    )
    if tangential:
        unmoved = posed.slip_origin is None or not len(posed.slip_origin)
        step = step.replace(slip_origin=np.zeros(tangential) if unmoved else posed.slip_origin)
    if posed.base is not None:
        load, size = posed.load + template.stiffness_rows @ posed.base, abs(posed.load)
        step = step._with_load_sum(load, size + template.stiffness_sizes @ abs(posed.base))
    return step, found


def events(motion: Motion) -> Iterator[Event]:
    """Return the events of contacts that close or open and, with friction, slip or stick."""
    problem = motion.scheme.body.problem

    def states() -> Iterator[tuple[Mask, Mask]]:
        for start in motion.states[:1]:
            yield start.normal_force > 0, np.zeros(problem.contacts, dtype=bool)
        for before, now in pairwise(motion.states):
            yield now.normal_force > 0, _slips(motion, before, now) & (now.normal_force > 0)

    return contact_changes(states(), map(motion.time, range(len(motion.states))), problem.contact_name)


def _slips(motion: Motion, before: State, now: State) -> Mask:
    body, problem = motion.scheme.body, motion.scheme.body.problem
    if not problem.frictional or problem.friction is None:
        return np.zeros(problem.contacts, dtype=bool)
    moved = now.displacement - before.displacement
    size = np.linalg.norm(now.friction_force.reshape(problem.contacts, -1), axis=1)
    slip = np.max(abs(body.tangent @ moved).reshape(problem.contacts, -1), axis=1)
    at_cone = size >= (1 - SLIPS) * problem.friction * now.normal_force
    return np.asarray(at_cone & (slip > SLIPS * np.max(abs(body.tangent) @ abs(moved))))


def energies(motion: Motion) -> Iterator[Energies]:
    """Return the energies of every state, computed a block at a time.

    The impact loss is the work of normal forces along the contact motion of the scheme. For a scheme that preserves
    energy without contact, any further change of energy in a step with contact forces is attributed to the impact.
    """
    scheme, states = motion.scheme, motion.states
    first: float | None = None
    sums = np.zeros(3)  # work, impact, friction
    for start in range(0, len(states), BLOCK):
        begin = max(start - 1, 0)
        block = states[begin : start + BLOCK]
        around = states[max(begin - 1, 0) : start + BLOCK + 1]
        loads = np.array([motion.load(motion.time(k)) for k in range(begin, begin + len(block))])
        stored = _stored(motion, block, loads)
        if first is None:
            first = float(stored[:, 0].sum())
            yield Energies(float(stored[0, 0]), float(stored[1, 0]), 0.0, 0.0)
        gain = np.diff(stored.sum(axis=0))
        done = _done(motion, block, loads)
        if scheme.keeps_energy:
            touching = np.any(np.array([s.normal_force for s in around]) > 0, axis=1)
            near = np.convolve(touching, np.ones(3), "same") > 0  # a predictor acts one step before its force
            near = near[len(states[max(begin - 1, 0) : begin]) :][: len(block)]
            acting = near[1:] | near[:-1]
            done[1] = np.where(acting, done[0] - done[2] - gain, done[1])
        for i in range(len(gain)):
            sums += done[:, i]
            elastic, kinetic = stored[:, i + 1].tolist()
            work, impact, friction = sums.tolist()
            drift = elastic + kinetic - first - work + impact + friction
            yield Energies(elastic, kinetic, work, friction, impact, drift)


def _stored(motion: Motion, block: list[State], loads: Array) -> Array:
    """Return elastic and kinetic energy, (2, states)."""
    scheme, body = motion.scheme, motion.scheme.body
    u, v = np.array([s.displacement for s in block]), np.array([s.velocity for s in block])
    elastic = np.einsum("ij,ij->i", u, (body.stiffness @ u.T).T) / 2
    if scheme.springs is not None:
        elastic += np.sum(np.array([s.normal_force for s in block]) ** 2, axis=1) / (2 * scheme.springs)
    kinetic = scheme.kinetic(u, v, loads)
    if block[0] is motion.states[0]:
        kinetic[0] = v[0] @ (body.mass @ v[0]) / 2  # a constant load
    return np.array([elastic, kinetic])


def _done(motion: Motion, block: list[State], loads: Array) -> Array:
    """Return the work of the loads, of normal forces and of friction in each step, (3, steps)."""
    scheme, problem = motion.scheme, motion.scheme.body.problem
    u, v = np.array([s.displacement for s in block]), np.array([s.velocity for s in block])
    motions, weight = scheme.contact_motion(u, v), scheme.contact_weight()

    def along(force: Vector, rows: Any) -> Vector:
        share = np.repeat(weight, force.shape[1] // max(len(weight), 1))
        acting = share * force[1:] + (1 - share) * force[:-1]
        return np.asarray(np.einsum("ij,ij->i", acting, (rows @ motions.T).T))

    work = np.einsum("ij,ij->i", (loads[1:] + loads[:-1]) / 2, np.diff(u, axis=0))
    taken = dissipated = np.zeros(len(motions))
    if scheme.springs is None:
        taken = along(np.array([s.normal_force for s in block]), problem.normal)
    if problem.frictional:
        dissipated = along(np.array([s.friction_force for s in block]), scheme.body.tangent)
    return np.array([work, taken, dissipated])


@dataclass(frozen=True, eq=False)
class TabulatedLoad(ReadOnly):
    """The values of a load at the instants of a motion."""

    times: tuple[float, ...]
    loads: Array

    def __call__(self, instant: float) -> Vector:
        return np.asarray(self.loads[self.times.index(instant)])


@dataclass(frozen=True, eq=False)
class Motion:
    """The states of a motion, and the scheme that made them."""

    scheme: Scheme
    states: list[State]
    load: Callable[[float], Vector]
    start: float  # time of the first state
    method: str
    seconds: list[float]  # one number for all steps
    work: Callable[[], Any]  # work so far

    def __repr__(self) -> str:
        body, states = self.scheme.body, counted("state", len(self.states))
        return f"Motion({self.scheme.name}, {states} a time step of {body.step:g} apart, {body.problem!r})"

    def __getstate__(self) -> dict[str, Any]:
        """Return the copied or pickled data: the states, and the values of the load at their times."""
        times = [self.time(k) for k in range(len(self.states))]
        known = TabulatedLoad(tuple(times), np.array([self.load(instant) for instant in times]))
        return self.__dict__ | dict(load=known, work=partial(copy.copy, self.work()))

    def time(self, k: int) -> float:
        return self.start + k * self.scheme.body.step

    def posed(self, k: int) -> tuple[StepProblem, StepResult]:
        """Return the scheme's last problem for step k, which ends at state k, and its result."""
        before, load, next_load = self.states[k - 1], self.load(self.time(k - 1)), self.load(self.time(k))
        *earlier, found = self.scheme.answered(before, self.states[k])
        return self.scheme.pose(before, load, next_load, tuple(earlier)), found
