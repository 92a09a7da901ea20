"""Find every change of contact state along a load path with Coulomb friction in the plane, exactly.

While no contact opens, closes, starts or stops slipping, displacements and forces are linear in the load. An event is
where a gap, a contact force or the margin mu l_N - |l_T| of a sticking contact reaches zero, or a corner of the path.
The following states satisfy Coulomb's law in rates. A sticking contact is anchored at its E_T u when it began to stick.

Along a leg the load grows by df. Open contacts, and those that stick inside their cone, keep their state. Those at the
edge of their cone, l_T = e mu l_N with e = +-1, slip or stick,

    l_T' = e mu l_N', e s' >= 0     or     s' = 0, e l_T' <= mu l_N',

and contacts with neither gap nor force choose among open, stick and slip by the same law for their rates:

    gap' >= 0, l' = 0     or     gap' = 0, l_N' >= 0, |l_T'| <= mu l_N', l_T' = mu l_N' s'/|s'| where s' != 0.

Above a critical friction no choice (the motion snaps) or several may satisfy this (Klarbring 1990). Continuations that
differ by an unresisted rigid motion without drive count as one, in which that motion rests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.history import JUMPS, SIMULTANEOUS, STEADY, Event
from contactqp.certificate.certificate import holds
from contactqp.errors import NoEquilibrium, NotConverged, SeveralEquilibria, Unsupported
from contactqp.linalg.condensation import condense
from contactqp.linalg.friction_states import SINGULAR_STATES, answer_in
from contactqp.model.arrays import Array, Indices, Mask, Vector, refuse_late
from contactqp.model.coulomb import (
    OPEN,
    SLIP_BACK,
    SLIP_ON,
    STICK,
    Status,
    combinations_at,
    number_of_combinations,
    plane_states,
)
from contactqp.model.names import NAMES_IN_A_MESSAGE
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Solution
from contactqp.solving.friction.force_system import CombinationAnswer, ForceSystem, Lengths
from contactqp.solving.friction.newton import combination_of, one_changed, suggested, without_idle_friction

# Violations of rates below this part of the largest are rounding, with lengths and forces in sqrt(energy).
STEADY_RATE = 1e-11
# Gaps, forces and margins below this part of the largest are zero.
ZERO_PART = 1e-12
# Violations above this part exceed rounding of the data; nonexistence requires this of all combinations.
CLEARLY = 1e-8
# Rates that leave this part of the load's rate unbalanced are not a solution, as those of a singular system with a
# driven motion.
UNBALANCED = 1e-4
# Violations above this part of the largest exceed the rounding of doubles.
UNSOLVED = 1e-9
# Rates that differ by more than this part of the largest are different continuations.
DISTINCT = 1e-7
# Up to this many combinations of undecided contacts, all are tried, to detect several continuations.
ALL_TRIED = 256
# Up to this many are tried if the quick search fails.
MOST_TRIED = 4096
# The most steps of the quick search, for each contact where they change one by one.
QUICK_STEPS = 40
WORDS: dict[int, str] = {OPEN: "open", STICK: "stick", SLIP_BACK: "slip back", SLIP_ON: "slip on"}


@dataclass(frozen=True, eq=False)
class Segment:
    """A part of a leg with linear displacements and forces."""

    start: float  # fraction of the leg
    end: float
    status: Status  # (m,)
    anchor: Vector  # (m,) E_T u of sticking contacts [length]
    answer: Answer  # at its start
    rate: Answer  # for the whole leg

    def near(self, fraction: float) -> Answer:
        """Return the answer at a fraction of the leg, to double precision.

        If contacts are redundant, the forces are those that continue the forces at the start.
        """
        part, one, rate = fraction - self.start, self.answer, self.rate
        friction = None
        if one.friction_force is not None and rate.friction_force is not None:
            friction = one.friction_force + part * rate.friction_force
        return Answer(
            one.displacement + part * rate.displacement,
            one.normal_force + part * rate.normal_force,
            friction,
            one.tie_force + part * rate.tie_force,
        )


@dataclass(frozen=True, eq=False)
class _Margins:
    """The quantities whose sign changes at an event, (4, m): gap, force, and both margins to the cone, scaled."""

    value: Array
    kept: Mask  # those relevant for a contact's state


class ExactPath:
    """A path followed from event to event.

    Parameters
    ----------
    problem, first : ContactProblem and the solution from which it starts
    system : the linear systems of the problem's combinations, if available
    refined : whether answers are refined; else they are those of `system` at contact unknowns only
    """

    def __init__(
        self, problem: ContactProblem, first: Solution, system: ForceSystem | None = None, refined: bool = True
    ) -> None:
        self._problem, self._condensation, self._refined = problem, condense(problem), refined
        self.system = system or ForceSystem(problem, self._condensation)
        self.status = self.system.plain(combination_of(first.problem, first.answer))
        self.answer = first.answer
        self.anchor = self._position(self.answer)
        self.events: list[Event] = []
        self.segments: list[Segment] = []

    def leg(self, start: Vector, end: Vector, time: float, lasts: float = 1.0) -> None:
        """Follow a leg, or a part of it, from a pseudo-time on; `events` and `segments` are those of this leg, up to
        its end or that of the path, with times as fractions of the leg.

        Parameters
        ----------
        start, end : (n,) arrays [force], the loads at both ends
        time : the pseudo-time at the start, for the messages of errors
        lasts : the pseudo-time that the leg takes; one for a whole leg

        Raises
        ------
        NoEquilibrium, SeveralEquilibria, NotConverged
            No continuation, several, or too many events; the message has the pseudo-time.
        """
        zero, problem = np.zeros(self._problem.contacts), self._problem
        direction = problem.replace(load=end - start, gap=zero, slip_origin=zero, tie_value=np.zeros(problem.ties))
        rates = self.system.lengths(direction, self._condensation.reduce_load(end - start)[0])
        fraction, self.events, self.segments = 0.0, [], []
        hit = np.zeros((4, len(zero)), dtype=bool)
        limit = 40 * len(zero) + 40
        for _ in range(limit):
            refuse_late("the next event was found")
            standing = self._standing(hit)
            at = f"at t = {time + lasts * fraction:.12g}"
            load = end if fraction == 1 else start + fraction * (end - start)
            standing, status = self._continued(standing, rates, load, at)
            self.events += self._decided(standing.status, status, fraction)
            rate = self._rate(direction, rates, status)
            self._go_on_in(status)
            following, hit = self._next(standing, rate)
            reached = fraction + following if fraction + following < 1 - SIMULTANEOUS else 1.0
            self.segments.append(Segment(fraction, reached, status, self.anchor, self.answer, rate))
            fraction = reached
            load = end if fraction == 1 else start + fraction * (end - start)
            self.answer = self.at(load, fraction, self.segments[-1])
            if fraction == 1:
                return
        raise NotConverged(f"follow_path: more than {limit} changes of state in one leg")

    def _continued(self, standing: Standing, rates: Lengths, load: Vector, at: str) -> tuple[Standing, Status]:
        """Return the combination in which the path continues, and the undecided contacts.

        Forces of redundant contacts are not unique. If those of the path have no continuation, the least ones of the
        same states take their place; that no others have one is not proven.
        """
        try:
            return standing, continuation(self.system, rates, standing, self._problem, at)
        except NoEquilibrium as error:
            least = self._with_least_forces() if self._refined else None
            if least is None:
                raise
            unproven = f"{error}; its forces are not unique, and with others it may go on"
        problem = self._problem.replace(load=load, slip_origin=self.anchor)
        size = self._sizes(self._margins(self.answer).value)  # beside which the least forces may be rounding
        least = answer_in(problem, self._condensation, self.system.rows, self.status, least)
        if not holds(problem.replace(slip_origin=self._position(least)), least):
            raise NotConverged(unproven)
        self.answer = without_idle_friction(self.system, least)
        try:
            standing = self._standing(self._margins(self.answer).value <= ZERO_PART * size)
            return standing, continuation(self.system, rates, standing, self._problem, at)
        except NoEquilibrium:
            raise NotConverged(unproven) from None

    def _with_least_forces(self) -> Answer | None:
        """Return the answer with the least sum of normal forces among those of its displacement and its states.

        None where its forces are unique, or no least ones are found.
        """
        from scipy.optimize import linprog

        system, rows, m, answer = self.system, self.system.rows, self._problem.contacts, self.answer
        _, values, rotation = np.linalg.svd(system.matrix(self.status))
        free = rotation[values <= SINGULAR_STATES * values[0]].T
        end = 2 * m + self._problem.ties
        if not free.shape[1] or np.any(abs(free[end:]) > SINGULAR_STATES):
            return None
        push, drag = free[:m], free[m : 2 * m]
        bound, margins = system.coefficient[:, None] * push, self._margins(answer)
        change, kept = np.array([push, bound - drag, bound + drag]), margins.kept[1:]
        room = np.maximum(margins.value[1:], 0.0)
        unit = float(np.max(room[kept], initial=0.0)) or 1.0
        limits = dict(A_ub=-change[kept], b_ub=room[kept] / unit, bounds=(None, None), method="highs")
        found = linprog(push.sum(axis=0), **limits)
        if found.x is None:
            return None
        push, drag, tie = (unit * part for part in np.split(free[:end] @ found.x, [m, 2 * m]))
        friction = self._friction(answer) + drag / rows.tangent_length
        force = np.maximum(answer.normal_force + push / rows.normal_length, 0.0)
        return Answer(answer.displacement, force, friction[:, None], answer.tie_force + tie / rows.tie_length)

    def _rate(self, direction: ContactProblem, rates: Lengths, status: Status) -> Answer:
        if not self._refined:
            return self._in_doubles(status, rates)
        return answer_in(direction, self._condensation, self.system.rows, status, _nothing(direction))

    def at(self, load: Vector, fraction: float, segment: Segment) -> Answer:
        """Return the answer to the load at a fraction of the leg within a segment."""
        problem = self._problem.replace(load=load, slip_origin=segment.anchor)
        if not self._refined:
            lengths = self.system.lengths(problem, self._condensation.reduce_load(load)[0])
            return self._in_doubles(segment.status, lengths)
        answer = answer_in(problem, self._condensation, self.system.rows, segment.status, segment.near(fraction))
        if not holds(problem.replace(slip_origin=self._position(answer)), answer):
            # A zero answer is not continued from a nonzero one.
            answer = answer_in(problem, self._condensation, self.system.rows, segment.status, _nothing(problem))
        return without_idle_friction(self.system, answer)

    def _in_doubles(self, status: Status, lengths: Lengths) -> Answer:
        """Return the answer of a combination in doubles; raise NotConverged if forces are not unique."""
        found, u = self.system.solve(status, lengths), np.zeros(self._problem.dimension)
        if self.system.redundant(status) or found.residual > UNSOLVED * lengths.size:
            raise NotConverged("follow_path: forces in doubles are not determined")
        u[self._condensation.retained] = self.system.displacement(found, lengths) * self.system.rows.scale
        return self.system.unscaled(found, u)

    def _decided(self, before: Status, now: Status, time: float) -> list[Event]:
        """Return the events of all contacts; a contact that closes slipping yields two."""
        events: list[Event] = []
        for i in np.flatnonzero(before != now).tolist():
            kinds: list[str] = []
            if (before[i] == OPEN) != (now[i] == OPEN):
                kinds.append("opened" if now[i] == OPEN else "closed")
            if now[i] != OPEN and self.system.coefficient[i] > 0 and (now[i] != STICK or before[i] != OPEN):
                kinds.append("stick" if now[i] == STICK else "slip")
            events += [Event(kind, i, time, self._problem.contact_name(i)) for kind in kinds]
        return events

    def _go_on_in(self, status: Status) -> None:
        """Continue in these states, anchoring contacts that begin to stick."""
        begins = (status == STICK) & (self.status != STICK)
        self.anchor = np.where(begins, self._position(self.answer), self.anchor)
        self.status = status

    def _standing(self, hit: Mask) -> Standing:
        """Return the undecided contacts: those that reached a zero, and those whose values are zero."""
        margins = self._margins(self.answer)
        zero = margins.kept & (hit | (margins.value <= ZERO_PART * self._sizes(margins.value)))
        closed, stuck = self.status != OPEN, self.status == STICK
        null = np.where(closed, zero[1], zero[0])
        at_edge = np.where(zero[2], 1, np.where(zero[3], -1, 0))
        edge = np.where(stuck, at_edge, np.where(closed & (self.system.coefficient > 0), self.status, 0))
        return Standing(self.status, np.where(null, 0, edge).astype(np.int8), null)

    def _next(self, standing: Standing, rate: Answer) -> tuple[float, Mask]:
        """Return the part of the leg to the next zero, and the margins (4, m) that vanish there."""
        margins, slope = self._margins(self.answer), self._margins(rate, rates=True).value
        decided = standing.null | (standing.edge != 0)
        # A margin that was just decided does not decrease.
        at_zero = margins.value <= 10 * ZERO_PART * self._sizes(margins.value)
        falls = margins.kept & (slope < -STEADY * self._sizes(slope)) & ~(decided & at_zero)
        ahead = np.full(slope.shape, np.inf)
        ahead[falls] = np.maximum(margins.value[falls], 0.0) / -slope[falls]
        nearest = float(np.min(ahead, initial=np.inf))
        return nearest, ahead <= nearest + SIMULTANEOUS

    def _margins(self, answer: Answer, rates: bool = False) -> _Margins:
        rows, problem = self.system.rows, self._problem
        gap = (0.0 if rates else problem.gap) - problem.normal @ answer.displacement
        normal = answer.normal_force * rows.normal_length
        friction = self._friction(answer) * rows.tangent_length
        bound = self.system.coefficient * normal
        closed, stuck = self.status != OPEN, self.status == STICK
        value = np.array([gap / rows.normal_length, normal, bound - friction, bound + friction])
        return _Margins(value, np.array([~closed, closed, stuck, stuck]))

    def keeps_signs(self) -> bool:
        """Return whether gaps, forces and margins at the current load are nonnegative up to rounding."""
        margins = self._margins(self.answer)
        return not np.any(margins.kept & (margins.value < -UNSOLVED * self._sizes(margins.value)))

    def _sizes(self, values: Array) -> Array:
        """Return the largest gap and the largest force as scales of margins (4, 1)."""
        gap, force = (float(np.max(abs(part), initial=0.0)) for part in (values[0], values[1:]))
        return np.array([gap, force, force, force])[:, None]

    def _friction(self, answer: Answer) -> Vector:
        return np.zeros(self._problem.contacts) if answer.friction_force is None else answer.friction_force[:, 0]

    def _position(self, answer: Answer) -> Vector:
        if self._problem.tangent is None:
            raise ValueError("exact events with friction of a problem without tangential rows")
        return np.asarray(self._problem.tangent @ answer.displacement)

    def jump_at_start(self) -> str:
        """Return in words the contact that is closed at the start of the path but anchored elsewhere, or ''."""
        origin = self._problem.slip_origin
        gap = self._problem.gap - self._problem.normal @ self.answer.displacement
        if origin is None:
            return ""
        length = abs(self.anchor) + abs(origin[:, 0])
        # A contact with a force at the start has slipped to its position.
        off = (gap <= 0) & (self.answer.normal_force <= 0) & (abs(self.anchor - origin[:, 0]) > ZERO_PART * length)
        if not np.any(off & (self.system.coefficient > 0)):
            return ""
        i = int(np.argmax(off))
        return (
            f"{self._problem.contact_name(i)} is closed at the start, at E_T u = {self.anchor[i]:.6g}, and slip_origin "
            f"anchors it at {origin[i, 0]:.6g}"
        )


def _nothing(problem: ContactProblem) -> Answer:
    none = np.zeros(problem.contacts)
    return Answer(np.zeros(problem.dimension), none, none[:, None], np.zeros(problem.ties))


@dataclass(frozen=True, eq=False)
class Standing:
    """The state of every contact at one instant, and the undecided contacts."""

    status: Status  # (m,) previous states
    edge: NDArray[np.int8]  # (m,) e = +-1 at the edge of the cone, else 0
    null: Mask  # (m,) neither gap nor force

    @property
    def undecided(self) -> Indices:
        """Return the undecided contacts (m,)."""
        return np.flatnonzero(self.null | (self.edge != 0))


def continuation(system: ForceSystem, rates: Lengths, standing: Standing, problem: ContactProblem, at: str) -> Status:
    """Return the combination of open, stick and slip in which the path continues.

    Parameters
    ----------
    system : gaps and slips of the contacts in their forces
    rates : gaps and slips per unit of the leg without contact forces
    standing : the states of the contacts, and which are undecided
    problem : the problem, for names in messages
    at : the instant, for messages

    Raises
    ------
    NoEquilibrium
        Every combination fails by far more than rounding: the equilibrium is lost at this load.
    SeveralEquilibria
        There are several.
    NotConverged, Unsupported
        None was found but one is nearly admissible, or too many contacts are undecided to try all; a free body jumps.
    """
    choices = [
        plane_states(system.coefficient[i]) if standing.null[i] else (STICK, int(standing.edge[i]))
        for i in standing.undecided.tolist()
    ]
    count = number_of_combinations(choices)
    if count > ALL_TRIED:
        quick = _quick(system, rates, standing)
        if quick is not None:
            return _resting(system, rates, standing, quick)
        if count > MOST_TRIED:
            raise NotConverged(f"follow_path: {at}: no continuation was found for {len(choices)} undecided contacts")
    found: list[CombinationAnswer] = []
    nearest = np.inf
    for status in combinations_at(standing.undecided, choices, standing.status):
        answer = system.solve(status, rates)
        nearest = min(nearest, _failing(system, rates, standing, answer))
        alike = [other for other in found if _same(system, standing, answer, other, rates)]
        if not alike and _holds(system, rates, standing, answer):
            found.append(answer)
    names = _named(problem, standing.undecided)
    if not found and nearest <= CLEARLY:
        raise NotConverged(
            f"follow_path: {at}: no continuation was found, and one choice of open, stick and slip at {names} fails by "
            f"{nearest:.2g} of the rates only, which rounding may have made"
        )
    if not found and np.isinf(nearest) and np.any(rates.drive):
        raise Unsupported(f"{JUMPS} ({at})")
    if not found:
        raise NoEquilibrium(
            f"follow_path: {at}: no continuation: the equilibrium is lost, no choice of open, stick and slip at "
            f"{names} keeps its signs as the load goes on"
        )
    loose = [one for one in found if system.undetermined(one.status)]
    if len(found) > 1 or loose:
        listed = "; ".join(
            _described(problem, standing, one) + (" at any rate" if one in loose else "") for one in found
        )
        raise SeveralEquilibria(f"follow_path: {at}: several continuations, and nothing chooses ({listed})")
    return _resting(system, rates, standing, found[0].status)


def _wrong(system: ForceSystem, standing: Standing, answer: CombinationAnswer) -> Vector:
    """Return the violation of the law by each contact's rates (m,), -inf for decided contacts."""
    coefficient, e, sticks = system.coefficient, standing.edge, answer.status == STICK
    at_null = answer.worst(coefficient)
    at_edge = np.where(sticks, e * answer.friction - coefficient * answer.normal, -e * answer.slip.astype(float))
    return np.where(standing.null, at_null, np.where(e != 0, at_edge, -np.inf))


def _size(answer: CombinationAnswer, rates: Lengths) -> float:
    parts = (answer.gap, answer.slip, answer.normal, answer.friction)
    return max(rates.size if np.any(rates.load) else 0.0, *(float(np.max(abs(part), initial=0.0)) for part in parts))


def _failing(system: ForceSystem, rates: Lengths, standing: Standing, answer: CombinationAnswer) -> float:
    """Return the violation of equilibrium or signs by a combination, relative to the largest rate."""
    size = _size(answer, rates)
    if np.any(rates.load) and answer.residual > UNBALANCED * rates.size:
        return np.inf
    wrong = max(float(np.max(_wrong(system, standing, answer), initial=0.0)), answer.residual)
    return wrong / size if size > 0 else float(np.where(wrong > 0, np.inf, 0.0))


def _holds(system: ForceSystem, rates: Lengths, standing: Standing, answer: CombinationAnswer) -> bool:
    return _failing(system, rates, standing, answer) <= STEADY_RATE


def _same(
    system: ForceSystem, standing: Standing, one: CombinationAnswer, other: CombinationAnswer, rates: Lengths
) -> bool:
    """Return whether two continuations differ at most by unresisted motions without drive."""
    loaded = ~standing.null & (standing.status != OPEN)
    return system.same(one, other, loaded, DISTINCT * max(_size(one, rates), _size(other, rates)))


def _quick(system: ForceSystem, rates: Lengths, standing: Standing) -> Status | None:
    """Run Newton's method on the undecided contacts, from their previous states and from touching ones that stick.

    While all contacts of floating bodies are open nothing says which of them close; once too many are open, neither.
    """
    touching = np.where(standing.null, STICK, standing.status).astype(np.int8)
    for start, singly in ((standing.status, False), (touching, False), (touching, True)):
        status = _newton(system, rates, standing, start, singly)
        if status is not None:
            return status
    return None


def _newton(system: ForceSystem, rates: Lengths, standing: Standing, status: Status, singly: bool) -> Status | None:
    m, seen = system.contacts, set()
    for _ in range(QUICK_STEPS * m if singly else QUICK_STEPS):
        if status.tobytes() in seen:
            return None
        seen.add(status.tobytes())
        answer = system.solve(status, rates)
        if _holds(system, rates, standing, answer):
            return status
        e = standing.edge
        trial = e * (answer.friction + system.resistance[m:] * answer.slip) - system.coefficient * answer.normal
        at_edge = np.where(trial > 0, e, STICK)
        undecided = np.where(standing.null, suggested(system, answer), np.where(e != 0, at_edge, standing.status))
        following = system.plain(undecided.astype(np.int8))
        status = one_changed(status, following, _wrong(system, standing, answer)) if singly else following
    return None


def _resting(system: ForceSystem, rates: Lengths, standing: Standing, status: Status) -> Status:
    """Return the same continuation, with state "stick" for contacts at their edge that do not slip."""
    answer = system.solve(status, rates)
    still = (standing.edge != 0) & ~standing.null & (abs(answer.slip) <= STEADY_RATE * _size(answer, rates))
    resting = np.where(still, STICK, status).astype(np.int8)
    if np.array_equal(resting, status):
        return status
    other = system.solve(resting, rates)
    return (
        resting if _holds(system, rates, standing, other) and _same(system, standing, answer, other, rates) else status
    )


def _described(problem: ContactProblem, standing: Standing, answer: CombinationAnswer) -> str:
    some = standing.undecided[:NAMES_IN_A_MESSAGE].tolist()
    return ", ".join(f"{problem.contact_name(i)} {WORDS[int(answer.status[i])]}" for i in some)


def _named(problem: ContactProblem, contacts: Indices) -> str:
    names = [problem.contact_name(i) for i in contacts.tolist()]
    more = len(names) - NAMES_IN_A_MESSAGE
    return (", ".join(names[:NAMES_IN_A_MESSAGE]) or "no contact") + (f" and {more} more" if more > 0 else "")
