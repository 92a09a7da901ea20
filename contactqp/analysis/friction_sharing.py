"""Compute rates for contacts with friction and ties whose rows are dependent, so that only their resultant is unique.

Examples are two walls that hold one node, or a tie along a floor on which a node sticks. The forces that balance an
answer then form a polyhedron (in space between two polyhedra) of sums over cones of sticking or slipping contacts.
Rates of the displacement are unique if they are the same for all combinations of open, stick and slip that can exert
the resultant and continue to do so along the direction. These are found by linear programs for each group of contacts
(`contactqp.analysis.shared_forces`).

A maximal set of independent rows then has the rates of all, with error bounds, if the other rows are satisfied to twice
double precision. This requires that all groups can exert their forces strictly inside their cones, and that all other
contacts satisfy their states beyond the errors of refinement.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from math import prod

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from contactqp.analysis.border_states import MOST_COMBINATIONS, Borders
from contactqp.analysis.rate_data import (
    REDUNDANT,
    SAME_RATE,
    SINGULAR,
    Direction,
    NoAnswer,
    NoRates,
    Parts,
    Rates,
    Scales,
    Solved,
    missed,
    named,
    parts_from,
)
from contactqp.analysis.rate_systems import RateSystem
from contactqp.analysis.shared_forces import NO_CHANGE, Cones, Group
from contactqp.analysis.slip_law import StateMargins, falls, steps_to_events
from contactqp.linalg.nonnegative import CARRIES, DEPENDENT_ROWS, width_within
from contactqp.model.arrays import EPS, TINY, Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem

# Rates that differ by more than this relative amount are not unique.
SEEN = 1e-6


class FrictionSharing:
    """The groups of contacts with friction that share forces, and their possible combinations of states.

    Parameters
    ----------
    problem, scales : with friction
    status : (m,) array of int, the states of the answer
    touching : (q,) array, contacts that are closed or graze
    answer : displacement and forces
    slip, slid : (m, d-1) and (m,) arrays, slips, and which contacts have slipped

    Attributes
    ----------
    members : contacts that share forces
    is_steady : whether all possible combinations constrain the same motions, and thus stay possible
    """

    def __init__(
        self, problem: ContactProblem, scales: Scales, status: Status, touching: Indices, answer: Parts, slip: Array,
        slid: Mask,
    ) -> None:  # fmt: skip
        self._problem, self.scales, self._status, self._slip = problem, scales, status, slip
        self._cones, self._touching = Cones(problem, scales, status, touching, slip, slid), touching
        self._forces = self._cones.forces(answer)
        left, sizes, _ = np.linalg.svd(np.asarray(np.linalg.qr(self._cones.rows.T, mode="r")).T, full_matrices=True)
        null = left[:, int(np.sum(sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0))) :]
        self.null = np.where(abs(null) > NO_CHANGE, null, 0.0)
        self._groups = [Group(self._cones, self._forces, places) for places in self._places()]
        self.members = np.array(sorted(i for group in self._groups for i in group.contacts), dtype=np.intp)
        self._choices = [group.choices() for group in self._groups]
        self.is_steady = all(g.is_steady(found) for g, found in zip(self._groups, self._choices, strict=True))

    def _places(self) -> Iterator[Indices]:
        """Yield the indices of dependent rows, group by group."""
        projector = abs(self.null @ self.null.T) > NO_CHANGE
        same = (self._cones.owners[:, None] == self._cones.owners[None, :]) & np.any(projector, axis=1)[:, None]
        _, of = connected_components(sp.csr_array(projector | same), directed=False)
        for group in np.unique(of[np.any(projector, axis=1)]):
            yield np.flatnonzero(of == group)

    def moves(self, system: RateSystem) -> bool:
        """Return whether the null space of a singular system contains displacements, not only forces."""
        zero = Direction.zero(self._problem)
        for part in [] if system.regular else system.unresolved():
            rates = system.of_parts(zero, part, None, zero.slip_origin)
            if np.max(abs(self.scales.of("displacement", rates.displacement))) > NO_CHANGE * self.scales.largest(rates):
                return True
        return False

    def only(self, of: str, friction: Vector) -> bool:
        """Return whether forces of one kind are the same for all distributions, as coefficients change (m,)."""
        free, along = np.any(self.null != 0, axis=1), self._cones.along
        first = np.r_[True, self._cones.owners[1:] != self._cones.owners[:-1]]
        slides = np.array([i >= 0 and (i in along or friction[i] != 0) for i in self._cones.owners], dtype=bool)
        of_kind = dict(normal_force=first & (self._cones.owners >= 0), tie_force=self._cones.owners < 0)
        of_kind["friction_force"] = (self._cones.owners >= 0) & (~first | slides)
        return not np.any(free & of_kind[of])

    @property
    def steady(self) -> Status:
        """Return states (m,) in which the contacts that share forces constrain as many motions as possible."""
        status = self._status.copy()
        for group, choices in zip(self._groups, self._choices, strict=True):
            status[group.contacts] = min(choices, key=lambda choice: sum(state == OPEN for state in choice))
        return status

    def answer(self, system: RateSystem) -> Solved | None:
        """Return the answer beyond doubles on independent rows, None if it is not confirmed.

        It is confirmed if groups exert their forces strictly inside their cones, and all other contacts satisfy their
        states beyond the errors of refinement; slips in space, whose friction turns, are not covered.
        """
        problem, status = self._problem, system.status
        known = None if system.turns or not system.regular else system.answer()
        if known is None or known.bound is None or problem.tangent is None:
            return None
        choices = [(group, tuple(int(state) for state in status[group.contacts])) for group in self._groups]
        exerted, forces = (self._cones.rows.T @ one for one in (self._forces, self._cones.forces(known.found)))
        same = np.max(abs(exerted - forces), initial=0.0) <= CARRIES * np.max(abs(self._forces), initial=0.0)
        if not (same and all(group.is_inner(choice) for group, choice in choices)):
            return None
        others = np.setdiff1d(np.arange(problem.contacts), self.members)
        sure = states_hold(problem, status, known, self._slip, others)
        return known if sure and parts_from(problem, known, self._touching, system.closed) else None

    def reach(self, rates: Rates) -> float:
        """Return the largest step along rates in the plane up to which groups can exert their resultants.

        Slips do not change their direction within it.
        """
        status = rates.status
        slides = np.array([i for i in self.members if i in self._cones.along and status[i] != OPEN], dtype=np.intp)
        slips = (status[slides] * one[slides].sum(axis=1) for one in (self._slip, rates.slip))
        ends = [group.reach(tuple(status[group.contacts]), rates) for group in self._groups]
        return float(min([*ends, *falls(*slips)], default=np.inf))

    def events(
        self, rates: Rates, now: StateMargins, edges: Indices, rests: Indices, at_bound: Indices
    ) -> Iterator[float]:
        """Yield the steps along rates in the plane at which contacts leave their states, or groups cannot exert their
        resultants.

        Parameters
        ----------
        rates : rates for one distribution of forces
        now, edges, rests, at_bound : as in `contactqp.analysis.slip_law.steps_to_events`
        """
        yield self.reach(rates)
        others = np.setdiff1d(np.arange(self._problem.contacts), self.members)
        parts = rates.gap, rates.normal_force, rates.friction_force, rates.slip
        margins = now.gap, now.push, now.drag, now.slip
        along, now = (StateMargins(*(one[others] for one in every)) for every in (parts, margins))
        places = [np.flatnonzero(np.isin(others, contacts)) for contacts in (edges, rests, at_bound)]
        yield from steps_to_events(self._cones.mu[others], rates.status[others], now, along, *places)

    def turns_alike(self, direction: Direction, status: Status) -> bool:
        """Return whether the effect of forces along a direction, and as slips turn, is the same for all distributions.

        Parameters
        ----------
        direction : the change of the data
        status : (m,) array of int, the states, in the plane of contacts that begin to slip, too
        """
        begins = {i: np.array([float(status[i])]) for i in self._cones.normal if self._cones.begins(i, status[i])}
        problem, width = self._problem, self._slip.shape[1]
        assert problem.tangent is not None
        unknown = [i for i in self._cones.normal if self._cones.mu[i] == 0 and i not in self._cones.slips]
        for one in self.null.T:
            normal = np.zeros(problem.contacts)
            for place in np.flatnonzero(one)[::-1]:  # the first row of a contact is its normal one
                if (i := self._cones.owners[place]) >= 0:
                    normal[i] = one[place] / self.scales.units[1][i]
            if np.any(direction.friction[unknown] * normal[unknown]):
                return False
            along = np.zeros_like(self._slip)
            across = np.zeros((problem.contacts, width, width))
            for i, t in begins.items():
                along[i] = direction.friction[i] * normal[i] * t
            for i, t in self._cones.slips.items():
                along[i] = direction.friction[i] * normal[i] * t
                size = float(np.linalg.norm(self._slip[i]))
                across[i] = self._cones.mu[i] * normal[i] / size * (np.eye(width) - np.outer(t, t))
            parts = [problem.tangent.T @ along.ravel()]
            whole = [abs(problem.tangent).T @ abs(along).ravel()]
            if direction.rows is not None:
                parts, whole = [*parts, direction.rows.T @ normal], [*whole, abs(direction.rows).T @ abs(normal)]
            if width > 1:
                blocks = sp.block_diag([sp.csr_array(one) for one in across], format="csr")
                parts.append((problem.tangent.T @ blocks @ problem.tangent).toarray())
                whole.append((abs(problem.tangent).T @ abs(blocks) @ abs(problem.tangent)).toarray())
            if any(np.any(abs(x) > NO_CHANGE * np.max(y, initial=0.0)) for x, y in zip(parts, whole, strict=True)):
                return False
        return True

    def sides(
        self, direction: Direction, system: RateSystem | None, borders: Borders,
        system_of: Callable[[Status], RateSystem], rates_of: Callable[[RateSystem, Direction], Rates],
    ) -> tuple[Rates | NoRates, Rates | NoRates]:  # fmt: skip
        """Return the rates along minus and plus a direction, with one distribution of forces, or in their place why
        there are none, or several.

        Parameters
        ----------
        direction, system : along which they are, and the system of steady states
        borders : contacts at a border of two states
        system_of, rates_of : return the system of some states, and its rates along a direction
        """
        if not self.turns_alike(direction, self._status):
            return NoRates(REDUNDANT), NoRates(REDUNDANT)
        if system is not None and not (direction.moves or direction.slip_origin.any()):
            return on_sides(lambda along: replace(rates_of(system, along), shared=True), direction, False)
        others = replace(borders, undecided=np.setdiff1d(borders.undecided, self.members))
        return on_sides(lambda along: self.continued(along, others, system_of, rates_of), direction)

    def continued(
        self, along: Direction, borders: Borders, system_of: Callable[[Status], RateSystem],
        rates_of: Callable[[RateSystem, Direction], Rates],
    ) -> Rates:  # fmt: skip
        """Return the common rates in the plane of all combinations of states that continue to exert the resultants.

        These are the rates of the combination that does so furthest, with a bound of the differences of the others.

        Raises NoRates: there are none, or several, or too many combinations.

        Parameters
        ----------
        along : the direction
        borders : other contacts at a border of two states
        system_of, rates_of : return the system of some states, and its rates along a direction
        """
        found = []
        for status in self._combinations(along, list(borders.combinations())):
            system = system_of(status)
            try:
                rates = rates_of(system, along)
            except NoRates:
                continue
            places = system.closed, system.stuck
            fits = system.regular or missed(self._problem, self.scales, rates, along, places) <= SEEN
            if fits and borders.hold(rates, along, system) and self._hold(status, rates, along):
                if self.moves(system):
                    raise NoRates(SINGULAR)
                if not self.turns_alike(along, status):
                    raise NoRates(REDUNDANT)
                found.append(rates if system.regular else _on_independent(system, rates, along, rates_of))
        if not all(self.scales.same("displacement", rates, found[0]) for rates in found):
            raise NoRates(f"several rates continue the answer: {REDUNDANT}")
        if not found:
            raise NoAnswer("no rates continue the answer: contacts that touch, and ties, cannot change so")
        furthest = max(found, key=self.reach)
        if any(rates.bound is None for rates in found):
            return replace(furthest, shared=True, bound=None, off=None)
        u = furthest.displacement
        apart = [abs(one.displacement - u) + one.bound.displacement for one in found if one.bound is not None]
        assert furthest.bound is not None
        return replace(furthest, shared=True, bound=replace(furthest.bound, displacement=np.max(apart, axis=0)))

    def _combinations(self, along: Direction, others: list[Status]) -> Iterator[Status]:
        """Yield states (m,) in which all groups can exert their resultants and move, with each choice for other
        contacts.
        """
        pairs = zip(self._groups, self._choices, strict=True)
        choices = [[choice for choice in found if group.may_move(choice, along)] for group, found in pairs]
        if self._cones.in_space or len(others) * prod(map(len, choices)) > MOST_COMBINATIONS or not all(self._choices):
            raise NoRates(REDUNDANT)
        for other, chosen in product(others, product(*choices)):
            status = other.copy()
            for group, choice in zip(self._groups, chosen, strict=True):
                status[group.contacts] = choice
            yield status

    def _hold(self, status: Status, rates: Rates, along: Direction) -> bool:
        """Return whether contacts that share forces keep their states at rates along a direction."""
        gaps = self.scales.of("gap", rates.gap)
        slips = self.scales.of("slip", rates.slip)
        nothing = SAME_RATE * self.scales.largest(rates)
        for i in self.members:
            if status[i] == OPEN and gaps[i] < -nothing:
                return False
            if self._cones.begins(i, status[i]) and status[i] * slips[i] < -nothing:
                return False
        return all(group.goes_on(tuple(status[group.contacts]), rates, along.friction) for group in self._groups)


def _on_independent(
    system: RateSystem, rates: Rates, direction: Direction, rates_of: Callable[[RateSystem, Direction], Rates]
) -> Rates:
    """Return rates of a singular system from independent rows, with bounds if the other rows are satisfied.

    Parameters
    ----------
    system, rates : the system, and its least-squares rates
    direction, rates_of : the direction of the rates, and the function that returns the rates of a system
    """
    try:
        found = rates_of(system.of_independent_rows(), direction)
    except NoRates:
        return replace(rates, bound=None, off=None)
    return replace(rates, bound=None, off=None) if found.bound is None else found


def states_hold(problem: ContactProblem, status: Status, known: Solved, slip: Array, contacts: Indices) -> bool:
    """Return whether contacts satisfy their states by more than the error of the answer.

    In the plane slips have the sign of their states; in space those of a refined answer are along its friction.

    Parameters
    ----------
    problem, status : with friction, and (m,) array of int, the states
    known, slip : the answer beyond doubles, and slips (m, d-1) in doubles
    contacts : the contacts to check; for all others only slip is checked
    """
    found, bound, mu = known.found, known.bound, problem.friction
    if bound is None or mu is None or problem.tangent is None:
        return False
    closed, sticks = contacts[status[contacts] != OPEN], contacts[status[contacts] == STICK]
    drag, off = (np.linalg.norm(one, axis=1) for one in (found.tangent, bound.tangent))
    room = mu * (found.normal - bound.normal) - drag - off - 4 * EPS * drag
    slides = np.flatnonzero((abs(status) == 1) & (mu > 0))
    origin = 0.0 if problem.slip_origin is None else abs(problem.slip_origin).ravel()
    unsure = abs(problem.tangent) @ (bound.displacement + 4 * EPS * abs(found.displacement)) + 4 * EPS * origin
    ahead = np.linalg.norm(slip[slides], axis=1) if slip.shape[1] > 1 else status[slides] * slip[slides, 0]
    onward = ahead > unsure.reshape(slip.shape)[slides].sum(axis=1)
    pushes = found.normal[closed] > bound.normal[closed]
    return bool(np.all(pushes) and np.all(room[sticks] > 0) and np.all(onward))


def on_sides(
    towards: Callable[[Direction], Rates], direction: Direction, one_sided: bool = True
) -> tuple[Rates | NoRates, Rates | NoRates]:
    """Return the rates along minus and plus a direction, or in their place why there are none.

    Parameters
    ----------
    towards : returns the rates on the plus side of a direction, or raises NoRates
    direction : the direction
    one_sided : whether the sides may differ
    """

    def attempted(along: Direction) -> Rates | NoRates:
        try:
            return towards(along)
        except NoRates as none:
            return none

    ahead = attempted(direction)
    if not one_sided:
        return ahead, ahead
    back = attempted(direction.reversed())
    return back.reversed() if isinstance(back, Rates) else back, ahead


def among_states(
    borders: Borders, direction: Direction, system_of: Callable[..., RateSystem],
    rates_of: Callable[[RateSystem, Direction], Rates],
) -> Rates:  # fmt: skip
    """Return the rates of the only possible combination of states of contacts at a border that agrees with its rates.

    Raises NoRates: there are none, or several, or forces are not unique.

    Parameters
    ----------
    borders, direction : the contacts, and what the rates are along
    system_of, rates_of : return the system of some states, and its rates along a direction
    """
    holding: list[Rates] = []
    for status in borders.combinations():
        begins = borders.free[status[borders.free] == SLIP_ON]
        turned = borders.turned(status, begins, direction, system_of, rates_of)
        for system in turned if len(begins) else [system_of(status)]:
            if not system.regular:
                refuse_many(borders, system, direction, rates_of)
                continue
            found = rates_of(system, direction)
            known = any(borders.scales.are_one(found, other) for other in holding)
            if not known and borders.hold(found, direction, system):
                holding.append(found)
    if len(holding) != 1:
        none = "no rates were found that continue" if len(borders.free) else "no rates continue"
        count = "several rates continue" if holding else none
        missing = NoRates if holding or len(borders.free) else NoAnswer
        raise missing(f"{count} the answer: {named(borders.problem, borders.undecided)} may change its state")
    return holding[0]


def refuse_many(
    borders: Borders, system: RateSystem, direction: Direction, rates_of: Callable[[RateSystem, Direction], Rates]
) -> None:
    """Raise `NoRates` if several rates may continue the answer in a combination with a singular system.

    The rates x + N z, with the null space N of the system, whose signs s(x) + s(N) z agree with the combination form a
    polyhedron. Forces are not unique if s(N) z >= 0 has nonzero solutions, or if it is more than a point.

    Parameters
    ----------
    borders : the contacts at the border of two states
    system, direction : the system of the combination, and the direction of the rates
    rates_of : returns the rates that fit a system best
    """
    problem, zero = borders.problem, Direction.zero(borders.problem)
    many = NoRates(f"{named(problem, borders.undecided)} may come to share forces or motions in many ways")
    if borders.drag.shape[1] > 1:
        raise many
    basis = [system.of_parts(zero, part, None, zero.slip_origin) for part in system.unresolved()]
    if not basis:
        return
    turns = np.column_stack([borders.signs(one, zero, system) for one in basis])
    if not np.all(np.isfinite(turns)) or width_within(turns, np.zeros(len(turns)), 1.0) > SEEN:
        raise many
    try:
        found = rates_of(system, direction)
    except NoRates:
        return
    places = system.closed, system.stuck  # least-squares solutions may not be rates
    if missed(problem, borders.scales, found, direction, places) > SEEN:
        return
    signs = borders.signs(found, direction, system)
    size = max(float(np.max(abs(signs), initial=0.0)), TINY)
    if width_within(turns, signs / size, np.inf) > SEEN:
        raise many
