"""Follow a load path with Coulomb friction in the plane, in rational numbers, from event to event.

Between events (a contact opens, closes, starts or stops slipping) all quantities are affine in the load. At each event
and corner Coulomb's law in rates determines the contacts at a limit (see `contactqp.analysis.friction_events`):

    edge of the cone, l_T = e mu l_N:    s' = 0 and e l_T' <= mu l_N'    or    l_T' = e mu l_N' and e s' >= 0
    neither gap nor force:    gap' >= 0    or    gap' = 0, l_N' >= 0 and |l_T'| <= mu l_N', = mu l_N' along s' != 0

Every choice is tried, and the path continues if exactly one is admissible. The law is proven at both ends of every
piece, with slips from rates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial

from flint import fmpq, fmpq_mat

from contactqp.errors import NoEquilibrium, NotConverged, SeveralEquilibria, Unsupported
from contactqp.linalg.exact_algebra import Polyhedron, dot
from contactqp.linalg.rational import fraction, is_zero, null_space, take, zeros
from contactqp.model.coulomb import (
    CLOSED,
    OPEN,
    SLIP_BACK,
    SLIP_ON,
    STICK,
    combinations_of,
    number_of_combinations,
    plane_states,
)
from contactqp.oracle.exact.exact_solution import ExactEvent
from contactqp.oracle.exact.rational_equilibrium import Combination, System, system_of
from contactqp.oracle.exact.rational_problem import RationalAnswer, RationalProblem, wrong

# Rates of a load path that are not unique for the contact states: their existence, and uniqueness of forces.

Rooms = Callable[[RationalAnswer], list[fmpq]]


class LooseRates:
    """All solutions of a singular system with nonnegative slacks that are linear in the rates.

    Parameters
    ----------
    system : System, of one combination, singular
    motion, forces : (n, 1), (r, 1) fmpq_mat, rates of displacements and held forces that solve it
    rooms : Rooms, returns from an answer the numbers that may not become negative

    Attributes
    ----------
    empty : bool, whether it is proven that there is none
    forces_known : bool, whether all of them have the same contact forces
    """

    def __init__(self, system: System, motion: fmpq_mat, forces: fmpq_mat, rooms: Rooms) -> None:
        n, rows = system.data.unknowns, system.held.nrows()
        null = null_space(system.matrix)
        size = int(null.ncols())
        columns = [null * _unit(size, j) for j in range(size)]
        ways = [system.answer(take(x, range(n)), take(x, range(n, n + rows))) for x in columns]
        start = [fraction(x) for x in rooms(system.answer(motion, forces))]
        slopes = _transposed([[fraction(x) for x in rooms(way)] for way in ways], len(start))
        region = Polyhedron(start, slopes, size)
        self.empty = region.empty
        self.forces_known = True
        if self.empty:
            return
        pushes = [[fraction(x) for part in _forces(way) for x in part.entries()] for way in ways]
        for row in _transposed(pushes, sum(int(part.nrows()) for part in _forces(ways[0]))):
            if any(row) and self.forces_known:
                low, high = region.range(row)
                self.forces_known = low is not None and high is not None and dot(row, low) == dot(row, high)


def _forces(rate: RationalAnswer) -> tuple[fmpq_mat, fmpq_mat]:
    return rate.normal_force, rate.friction_force


def _unit(size: int, j: int) -> fmpq_mat:
    return fmpq_mat(size, 1, [int(i == j) for i in range(size)])


def _transposed(columns: list[list[Fraction]], rows: int) -> list[list[Fraction]]:
    return [[column[i] for column in columns] for i in range(rows)]


# The state of closed contacts without friction, in addition to those with friction.
WORDS: dict[int, str] = {OPEN: "open", CLOSED: "closed", STICK: "stick", SLIP_BACK: "slip back", SLIP_ON: "slip on"}
SLIPPING = (SLIP_BACK, SLIP_ON)
MOST_TRIED = 4096
EVENTS_A_CONTACT = 40

States = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class PathEnd:
    """The end of a path: its answer, the last contact states, and all events."""

    answer: RationalAnswer
    status: tuple[str, ...]
    events: tuple[ExactEvent, ...]
    pieces: int


def follow(data: RationalProblem, corners: Sequence[fmpq_mat], names: Sequence[str]) -> PathEnd:
    """Return the end of the path on which the load goes linearly from zero, at rest, to each corner (n, 1) in turn.

    Raises NoEquilibrium: no states continue at some load; SeveralEquilibria: several do; Unsupported: the path does not
    start at rest, a loose body jumps, rates are not unique, or friction in space.
    """
    if data.width != 1:
        raise Unsupported("exact: friction on a load path in space, where slip directions turn")
    walk = _Walk(data, names)
    before = zeros(data.unknowns, 1)
    for leg, corner in enumerate(corners):
        walk.leg(before, corner, leg)
        before = corner
    return PathEnd(walk.answer, walk.words(), tuple(walk.events), walk.pieces)


class _Walk:
    def __init__(self, data: RationalProblem, names: Sequence[str]) -> None:
        self.data, self.names = data, names
        m = data.contacts
        self.answer = RationalAnswer(zeros(data.unknowns, 1), zeros(m, 1), zeros(m, 1), zeros(data.ties, 1))
        self.states: States = (OPEN,) * m
        self.events: list[ExactEvent] = []
        self.pieces = 0
        at_rest = replace(data, f=zeros(data.unknowns, 1))
        if next(wrong(at_rest, self.answer), None) is not None or not is_zero(data.b):
            raise Unsupported("exact: a load path that does not start without forces, gaps and ties met at rest")
        for i, gap in enumerate(data.g.entries()):
            if gap == 0 and data.friction[i] > 0 and data.slip_origin[i, 0] != 0:
                raise Unsupported(f"exact: {names[i]} is closed at the start, away from its slip_origin")

    def leg(self, start: fmpq_mat, end: fmpq_mat, time: int) -> None:
        """Follow one leg: the load is start + x (end - start), x from 0 to 1."""
        direction, x = end - start, fmpq(0)
        rates = replace(
            self.data,
            f=direction,
            g=zeros(self.data.contacts, 1),
            b=zeros(self.data.ties, 1),
            slip_origin=zeros(self.data.contacts, 1),
        )
        for _ in range(EVENTS_A_CONTACT * (self.data.contacts + 1)):
            at = f"at t = {float(fraction(x)) + time:.12g}"
            states, rate = self._continuation(rates, at)
            self._tell(states, time + fraction(x))
            self.states = states
            self._prove(start + direction * x, rate)
            step = min(self._ahead(rate), 1 - x)
            self.answer = _moved(self.answer, rate, step)
            x += step
            self.pieces += 1
            self._prove(start + direction * x, rate)
            if x == 1:
                return
        raise NotConverged(f"exact: too many changes of state in leg {time + 1} of the load path")

    def _continuation(self, rates: RationalProblem, at: str) -> tuple[States, RationalAnswer]:
        found: list[tuple[States, RationalAnswer]] = []
        loose: list[States] = []
        driven = True  # in every combination
        for states in self._choices(at):
            system = system_of(rates, _combination(states))
            solved = system.solve()
            if solved is None:
                continue
            driven = False
            motion, forces, only = solved
            if not only:
                rates_left = LooseRates(system, motion, forces, partial(self._rooms, states))
                if not rates_left.empty and not rates_left.forces_known:
                    raise Unsupported(f"exact: {at}: contact forces are not unique in rates")
                if not rates_left.empty:
                    loose.append(states)
                continue
            rate = system.answer(motion, forces)
            if any(room < 0 for room in self._rooms(states, rate)):
                continue
            known = next((i for i, (_, other) in enumerate(found) if _same(rate, other)), None)
            if known is None:
                found.append((states, rate))
            elif states.count(STICK) > found[known][0].count(STICK):
                found[known] = states, rate  # all that do not slip count as sticking
        if any(not any(self._is_of(states, rate) for _, rate in found) for states in loose):
            raise Unsupported(f"exact: {at}: motions are not unique in rates")
        if driven:
            raise Unsupported(f"exact: {at}: the path jumps where the load moves a body that nothing holds")
        if not found:
            raise NoEquilibrium(f"exact: {at}: no continuation: the equilibrium is lost (proven in rational numbers)")
        if len(found) > 1:
            listed = "; ".join(", ".join(WORDS[state] for state in states) for states, _ in found)
            raise SeveralEquilibria(f"exact: {at}: several continuations, and nothing chooses ({listed})")
        return found[0]

    def _is_of(self, states: States, rate: RationalAnswer) -> bool:
        """Return whether a continuation is also one in these states, which leave a motion free that then rests."""
        approach, slips = (self.data.E * rate.displacement).entries(), (self.data.T * rate.displacement).entries()
        for i, state in enumerate(states):
            push, drag = rate.normal_force[i, 0], rate.friction_force[i, 0]
            if state == OPEN:
                same = push == drag == 0
            else:
                same = approach[i] == 0 and (state != STICK or slips[i] == 0)
                same = same and (state not in SLIPPING or drag == state * self.data.friction[i] * push)
            if not same:
                return False
        return True

    def _choices(self, at: str) -> Iterator[States]:
        choices = list[States]()
        gap = self.data.gap(self.answer.displacement).entries()
        for i, mu in enumerate(self.data.friction):
            push, drag = self.answer.normal_force[i, 0], self.answer.friction_force[i, 0]
            if gap[i] > 0:
                choices.append((OPEN,))
            elif push == 0:
                choices.append((OPEN, CLOSED) if mu == 0 else plane_states(mu))
            elif mu == 0:
                choices.append((CLOSED,))
            elif abs(drag) < mu * push:
                choices.append((STICK,))
            else:
                choices.append((STICK, SLIP_ON if drag > 0 else SLIP_BACK))
        count = number_of_combinations(choices)
        if count > MOST_TRIED:
            raise Unsupported(f"exact: {at}: {count} ways to go on are too many to try in rational numbers")
        return combinations_of(choices)

    def _rooms(self, states: States, rate: RationalAnswer) -> list[fmpq]:
        """Return the conditions on rates of contacts at a limit: linear functions that must not be negative."""
        gaps = (-1 * self.data.E * rate.displacement).entries()
        slips = (self.data.T * rate.displacement).entries()
        now = self.data.gap(self.answer.displacement).entries()
        rooms = list[fmpq]()
        for i, state in enumerate(states):
            mu, push = self.data.friction[i], self.answer.normal_force[i, 0]
            more, drag = rate.normal_force[i, 0], rate.friction_force[i, 0]
            if state == OPEN:
                rooms += [gaps[i]] if now[i] <= 0 else []
                continue
            if state in SLIPPING:
                rooms.append(state * slips[i])
            edge = self.answer.friction_force[i, 0]
            if push == 0:
                rooms += [more, *((mu * more - drag, mu * more + drag) if state == STICK else ())]
            elif state == STICK and abs(edge) == mu * push:
                rooms.append(mu * more - (drag if edge > 0 else -drag))
        return rooms

    def _ahead(self, rate: RationalAnswer) -> fmpq:
        """Return the distance to the next limit as a part of the leg, at most 1."""
        nearest = fmpq(1)
        gaps, rates = self.data.gap(self.answer.displacement).entries(), (self.data.E * rate.displacement).entries()
        for i, state in enumerate(self.states):
            mu = self.data.friction[i]
            push, more = self.answer.normal_force[i, 0], rate.normal_force[i, 0]
            drag, turn = self.answer.friction_force[i, 0], rate.friction_force[i, 0]
            rooms = [(gaps[i], -rates[i])] if state == OPEN else [(push, more)]
            if state == STICK:
                rooms += [(mu * push - s * drag, mu * more - s * turn) for s in (-1, 1)]
            for room, slope in rooms:
                if room > 0 > slope:
                    nearest = min(nearest, room / -slope)
        return nearest

    def _prove(self, load: fmpq_mat, rate: RationalAnswer) -> None:
        """Prove all conditions, with slips from the position of each contact without its rate of slip."""
        moved = self.data.T * rate.displacement
        origin = self.data.T * self.answer.displacement
        for i, state in enumerate(self.states):
            if state in SLIPPING:
                origin[i, 0] = origin[i, 0] - moved[i, 0]
        here = replace(self.data, f=load, slip_origin=origin)
        failed = next(wrong(here, self.answer), None)
        if failed is not None:
            raise ArithmeticError(f"a piece of the path fails the exact proof: {failed}")

    def _tell(self, states: States, time: Fraction) -> None:
        for i, (before, now) in enumerate(zip(self.states, states, strict=True)):
            if before == now:
                continue
            kinds = []
            if (before == OPEN) != (now == OPEN):
                kinds.append("opened" if now == OPEN else "closed")
            if now not in (OPEN, CLOSED) and (now != STICK or before != OPEN):
                kinds.append("stick" if now == STICK else "slip")
            self.events += [ExactEvent(kind, i, self.names[i], time) for kind in kinds]

    def words(self) -> tuple[str, ...]:
        """Return the states (m,) of the last piece in the words of `Solution.contact_status`."""
        gap, push = self.data.gap(self.answer.displacement).entries(), self.answer.normal_force.entries()
        return tuple(
            ("open" if gap[i] != 0 else "grazing") if push[i] == 0 else ("slip" if state in SLIPPING else WORDS[state])
            for i, state in enumerate(self.states)
        )


def _combination(states: States) -> Combination:
    closed = tuple(i for i, state in enumerate(states) if state != OPEN)
    stuck = tuple(i for i in closed if states[i] == STICK)
    return Combination(closed, stuck, {i: (fmpq(states[i]),) for i in closed if states[i] in SLIPPING})


def _moved(one: RationalAnswer, rate: RationalAnswer, step: fmpq) -> RationalAnswer:
    return RationalAnswer(
        one.displacement + rate.displacement * step,
        one.normal_force + rate.normal_force * step,
        one.friction_force + rate.friction_force * step,
        one.tie_force + rate.tie_force * step,
    )


def _same(one: RationalAnswer, other: RationalAnswer) -> bool:
    return (
        one.displacement == other.displacement
        and one.normal_force == other.normal_force
        and one.friction_force == other.friction_force
        and one.tie_force == other.tie_force
    )
