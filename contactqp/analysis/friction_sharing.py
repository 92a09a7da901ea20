"""Contacts with friction, and ties, whose rows depend on one another: what they exert is unique, how they share it not.

Two walls that hold one node are such, or a tie across a floor on which a node sticks. The forces that balance an answer
are a polyhedron then (in space between two polyhedra): cones of contacts that stick or slip, which exert what is left
of the load. Rates of the displacement are unique where all combinations of open, stick and slip that can exert it, and
go on doing so along the direction, lead to the same: those are found by linear programs of one group of contacts each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise, product
from math import prod
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from contactqp.analysis.border_states import MOST_COMBINATIONS, Borders
from contactqp.analysis.rate_data import (
    REDUNDANT,
    SAME,
    SINGULAR,
    Direction,
    NoRates,
    Parts,
    Rates,
    Scales,
    missed,
    named,
)
from contactqp.analysis.rate_systems import RateSystem
from contactqp.linalg.nonnegative import DEPENDENT_ROWS, given_rows, highs, width_within
from contactqp.model.arrays import TINY, Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, number_of_combinations
from contactqp.model.problem import ContactProblem

# Rates that differ by this part of a combination's signs, or of what its system leaves open, are many.
SEEN = 1e-6
# Of unit rows and of changes of forces, what is none.
NOTHING = 1e-9
# Contacts of one group share a step along a direction, whose length is that of their force, at least so far.
GOES_ON = 1e-6
# Sides of the polygons about and in a cone in space, and sectors of slips that begin, which are halved down to these.
SIDES, NARROW = 16, np.pi / 128
# Linear programs that exclude slips which begin in space, at most.
MOST_PROGRAMS = 2000

# A choice of states for the contacts of one group.
Choice: TypeAlias = tuple[int, ...]


class FrictionSharing:
    """The groups of contacts with friction that share forces, and the combinations of states that can exert them.

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
    is_steady : whether all combinations that can exert the forces hold the same motions, and so go on doing so
    """

    def __init__(
        self, problem: ContactProblem, scales: Scales, status: Status, touching: Indices, answer: Parts, slip: Array,
        slid: Mask,
    ) -> None:  # fmt: skip
        unit, of_normal, _, of_tie = scales.units
        assert problem.tangent is not None
        assert problem.friction is not None
        self._problem, self.scales, self._status, self._slip = problem, scales, status, slip
        self.in_space, width = slip.shape[1] > 1, slip.shape[1]
        touching, ties = touching[of_normal[touching] > 0], np.flatnonzero(of_tie > 0)
        at = [int(width * i + k) for i in touching for k in range(width)]
        whole = sp.csc_array(sp.vstack([problem.normal[touching], problem.tangent[at], problem.tie[ties]]))
        felt = np.flatnonzero(np.diff(whole.indptr))
        normal, tangent, tied = np.split(
            whole[:, felt].toarray() * unit[felt], [len(touching), len(touching) + len(at)]
        )
        places, lengths = {int(i): k for k, i in enumerate(touching)}, of_normal[touching]
        self._unit, self._felt, self._length, self._mu = unit, felt, of_normal, problem.friction
        self.normal = {i: normal[k] / lengths[k] for i, k in places.items()}
        self.tangent = {i: tangent[width * k : width * (k + 1)] / lengths[k] for i, k in places.items()}
        size = np.linalg.norm(slip, axis=1)
        moves = (slid | (abs(status) == 1)) & (self._mu > 0) & (size > 0)
        self._along = {i: slip[i] / size[i] for i in places if moves[i]}
        rows: list[Array] = []
        owners: list[int] = []
        forces: list[float] = []
        for i in places:
            own, force = self.rays(i, SLIP_ON), np.array([answer.normal[i]])
            if i not in self._along and self._mu[i] > 0:
                own, force = np.array([self.normal[i], *self.tangent[i]]), np.append(force, answer.tangent[i])
            rows, owners, forces = [*rows, *own], owners + [i] * len(own), [*forces, *(force * of_normal[i])]
        self.rows = np.array([*rows, *(tied / of_tie[ties, None])]).reshape(-1, len(felt))
        self.owners = np.array(owners + [-1 - int(k) for k in ties], dtype=int)
        self.forces = np.concatenate([np.array(forces), answer.tie[ties] * of_tie[ties]])
        left, sizes, _ = np.linalg.svd(np.asarray(np.linalg.qr(self.rows.T, mode="r")).T, full_matrices=True)
        null = left[:, int(np.sum(sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0))) :]
        self.null = np.where(abs(null) > NOTHING, null, 0.0)
        self._groups = [_Group(self, places) for places in self._places()]
        self.members = np.array(sorted(i for group in self._groups for i in group.contacts), dtype=np.intp)
        self._choices = [group.choices() for group in self._groups]
        self.is_steady = all(g.is_steady(found) for g, found in zip(self._groups, self._choices, strict=True))

    def _places(self) -> Iterator[Indices]:
        """Yield the places of rows that depend on one another, group by group."""
        projector = abs(self.null @ self.null.T) > NOTHING
        same = (self.owners[:, None] == self.owners[None, :]) & np.any(projector, axis=1)[:, None]
        _, of = connected_components(sp.csr_array(projector | same), directed=False)
        for group in np.unique(of[np.any(projector, axis=1)]):
            yield np.flatnonzero(of == group)

    def rays(self, i: int, state: int, corners: Array | None = None) -> Array:
        """Return the rays of the cone that a contact's force is in: rows of it, in one of its states.

        Parameters
        ----------
        i, state : the contact and its state
        corners : (c, d-1) array, directions of friction; those of the state and the dimension where it is None
        """
        normal, tangent, mu = self.normal[i], self.tangent[i], self._mu[i]
        if state == OPEN:
            return np.zeros((0, len(normal)))
        if mu == 0:
            return np.asarray(normal[None])
        if corners is None and i in self._along:
            corners = self._along[i][None]
        elif corners is None and tangent.shape[0] == 1:
            corners = np.array([[1.0], [-1.0]] if state == STICK else [[float(state)]])
        elif corners is None:
            corners = _directions(np.arange(SIDES) * (2 * np.pi / SIDES)) / np.cos(np.pi / SIDES)
        return np.asarray(normal + mu * (corners @ tangent))

    def of_contact(self, i: int) -> Choice:
        """Return the states that a contact may be in as others take its force; slips that begin in space apart."""
        if self._mu[i] == 0:
            return (OPEN, SLIP_ON)
        if i in self._along:
            along = self._along[i]
            return (OPEN, SLIP_ON if len(along) > 1 or along[0] > 0 else SLIP_BACK)
        return (STICK, OPEN, SLIP_ON, SLIP_BACK) if self.tangent[i].shape[0] == 1 else (STICK, OPEN)

    def moves(self, system: RateSystem) -> bool:
        """Return whether a system without inverse leaves displacements free, not forces alone."""
        zero = Direction.zero(self._problem)
        for part in [] if system.regular else system.unresolved():
            rates = system.of_parts(zero, part, None, zero.slip_origin)
            if np.max(abs(self.scales.of("displacement", rates.displacement))) > NOTHING * self.scales.largest(rates):
                return True
        return False

    def begins(self, i: int, state: Any) -> bool:
        """Return whether a contact that has not slipped does so in a state."""
        return self._mu[i] > 0 and i not in self._along and state not in (OPEN, STICK)

    def only(self, of: str) -> bool:
        """Return whether forces of one kind are the same however they are shared."""
        free = np.any(self.null != 0, axis=1)
        first = np.r_[True, self.owners[1:] != self.owners[:-1]]
        slides = np.array([i in self._along for i in self.owners], dtype=bool)
        of_kind = dict(normal_force=first & (self.owners >= 0), tie_force=self.owners < 0)
        of_kind["friction_force"] = (self.owners >= 0) & (~first | slides)
        return not np.any(free & of_kind[of])

    @property
    def steady(self) -> Status:
        """Return states (m,) in which the contacts that share forces hold all that they can."""
        status = self._status.copy()
        for group, choices in zip(self._groups, self._choices, strict=True):
            status[group.contacts] = min(choices, key=lambda choice: sum(state == OPEN for state in choice))
        return status

    def turns_alike(self, direction: Direction) -> bool:
        """Return whether what forces do along a direction, and as slips turn, is the same in all ways to share."""
        problem, width = self._problem, self._slip.shape[1]
        assert problem.tangent is not None
        for one in self.null.T:
            normal = np.zeros(problem.contacts)
            for place in np.flatnonzero(one)[::-1]:  # the first row of a contact is its normal one
                if (i := self.owners[place]) >= 0:
                    normal[i] = one[place] / self._length[i]
            along = np.zeros_like(self._slip)
            across = np.zeros((problem.contacts, width, width))
            for i, t in self._along.items():
                along[i] = direction.friction[i] * normal[i] * t
                size = float(np.linalg.norm(self._slip[i]))
                across[i] = self._mu[i] * normal[i] / size * (np.eye(width) - np.outer(t, t))
            parts = [problem.tangent.T @ along.ravel()]
            whole = [abs(problem.tangent).T @ abs(along).ravel()]
            if direction.rows is not None:
                parts, whole = [*parts, direction.rows.T @ normal], [*whole, abs(direction.rows).T @ abs(normal)]
            if width > 1:
                blocks = sp.block_diag(list(across), format="csr")
                parts.append((problem.tangent.T @ blocks @ problem.tangent).toarray())
                whole.append((abs(problem.tangent).T @ abs(blocks) @ abs(problem.tangent)).toarray())
            if any(np.any(abs(x) > NOTHING * np.max(y, initial=0.0)) for x, y in zip(parts, whole, strict=True)):
                return False
        return True

    def sides(
        self, direction: Direction, system: RateSystem | None, borders: Borders,
        system_of: Callable[[Status], RateSystem], rates_of: Callable[[RateSystem, Direction], Rates],
    ) -> tuple[Rates, Rates]:  # fmt: skip
        """Return the rates towards minus and plus a direction; those of forces are of one way to share them.

        Raises NoRates: there are none, or several.

        Parameters
        ----------
        direction, system : along which they are, and the system of steady states
        borders : contacts at a border of two states
        system_of, rates_of : return the system of some states, and its rates along a direction
        """
        if not self.turns_alike(direction):
            raise NoRates(REDUNDANT)
        if system is not None and not (direction.moves or direction.slip_origin.any()):
            ahead = replace(rates_of(system, direction), shared=True)
            return ahead, ahead
        others = replace(borders, undecided=np.setdiff1d(borders.undecided, self.members))
        back, ahead = (
            self.continued(along, others, system_of, rates_of) for along in (direction.reversed(), direction)
        )
        return back.reversed(), ahead

    def continued(
        self, along: Direction, borders: Borders, system_of: Callable[[Status], RateSystem],
        rates_of: Callable[[RateSystem, Direction], Rates],
    ) -> Rates:  # fmt: skip
        """Return the rates in the plane to which all combinations of states lead that go on exerting the forces.

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
            if fits and borders.hold(rates, along, system) and self._hold(status, rates):
                if self.moves(system):
                    raise NoRates(SINGULAR)
                found.append(rates)
        if not all(self.scales.same("displacement", rates, found[0]) for rates in found):
            raise NoRates(f"several rates continue the answer: {REDUNDANT}")
        if not found:
            raise NoRates("no rates continue the answer: contacts that touch, and ties, cannot change so")
        return replace(found[0], shared=True, bound=None, off=None)

    def _combinations(self, along: Direction, others: list[Status]) -> Iterator[Status]:
        """Yield states (m,) in which all groups exert their forces and may move so, with each of other contacts."""
        pairs = zip(self._groups, self._choices, strict=True)
        choices = [[choice for choice in found if group.may_move(choice, along)] for group, found in pairs]
        if self.in_space or len(others) * prod(map(len, choices)) > MOST_COMBINATIONS or not all(self._choices):
            raise NoRates(REDUNDANT)
        for other, chosen in product(others, product(*choices)):
            status = other.copy()
            for group, choice in zip(self._groups, chosen, strict=True):
                status[group.contacts] = choice
            yield status

    def _hold(self, status: Status, rates: Rates) -> bool:
        """Return whether contacts that share forces go on as their states say."""
        gaps = self.scales.of("gap", rates.gap)
        slips = self.scales.of("slip", rates.slip)
        nothing = SAME * self.scales.largest(rates)
        for i in self.members:
            if status[i] == OPEN and gaps[i] < -nothing:
                return False
            if self.begins(i, status[i]) and status[i] * slips[i] < -nothing:
                return False
        return all(group.goes_on(tuple(status[group.contacts]), rates) for group in self._groups)


class _Group:
    """Contacts and ties whose rows depend on one another, and what they exert; `contacts` are its places."""

    def __init__(self, whole: FrictionSharing, places: Indices) -> None:
        self._whole, self._places = whole, places
        owners = whole.owners[places]
        self.contacts = [int(i) for i in dict.fromkeys(owners[owners >= 0])]
        self._ties = whole.rows[places[owners < 0]]
        self._tied = -1 - owners[owners < 0]
        rows = whole.rows[places]
        _, sizes, basis = np.linalg.svd(rows, full_matrices=False)
        self._basis = basis[sizes > DEPENDENT_ROWS * sizes[0]]
        self._exerts = whole.forces[places] @ rows @ self._basis.T
        self._size = float(np.max(abs(whole.forces[places]), initial=0.0))

    def choices(self) -> list[Choice]:
        """Return the combinations of states that can exert what the group does; none where there are too many."""
        options = [self._whole.of_contact(i) for i in self.contacts]
        if number_of_combinations(options) > MOST_COMBINATIONS:
            return []
        return [choice for choice in product(*options) if self._step(self._outer(choice)) is not None]

    def _step(self, cones: list[Array], change: Vector | None = None) -> float | None:
        """Return how far the force of the group may change so that it stays in cones, 1 at most; None if it is in none.

        Parameters
        ----------
        cones : rays of the force of each contact
        change : of the force, along what the rows span, as a part of the group's largest force
        """
        rays = np.concatenate([*cones, self._ties]) @ self._basis.T
        moved = np.zeros(len(self._basis)) if change is None else change
        bounds = [(0.0, None)] * sum(map(len, cones)) + [(None, None)] * len(self._ties) + [(0.0, 1.0)]
        cost = np.append(np.zeros(len(rays)), -1.0)
        exerts = self._exerts / (self._size or 1.0)
        found = highs(cost, A_eq=np.column_stack([rays.T, -moved]), b_eq=exerts, bounds=bounds)
        return None if found is None else float(found.x[-1])

    def goes_on(self, choice: Choice, rates: Rates) -> bool:
        """Return whether the group goes on exerting its force, changing at these rates, in a combination of states."""
        whole, change = self._whole, np.zeros(len(self._basis))
        scales = whole.scales.units
        for i in self.contacts:
            rows = np.array([whole.normal[i], *whole.tangent[i]])
            change += self._basis @ rows.T @ np.append(rates.normal_force[i], rates.friction_force[i]) * scales[1][i]
        change += self._basis @ self._ties.T @ (rates.tie_force * scales[3])[self._tied]
        size = float(np.max(abs(change), initial=0.0))
        step = self._step(self._outer(choice), change / size if size > NOTHING * whole.scales.largest(rates) else None)
        return step is not None and step >= GOES_ON

    def is_steady(self, choices: list[Choice]) -> bool:
        """Return whether all combinations that exert the force hold the same motions and push along the same."""
        spans = []
        for choice in filter(self.may_move, choices):
            pairs = list(zip(self.contacts, choice, strict=True))
            held = [self._whole.normal[i] for i, state in pairs if state != OPEN]
            held += [row for i, state in pairs if state == STICK for row in self._whole.tangent[i]]
            pushed = [row for i, state in pairs for row in self._whole.rays(i, state)]
            spans.append([np.array([*rows, *self._ties]) for rows in (held, pushed)])
        same = all(_same_span(one, other) for pair in spans for one, other in zip(pair, spans[0], strict=True))
        return bool(spans) and same and (not self._whole.in_space or self._is_within(choices))

    def _is_within(self, choices: list[Choice]) -> bool:
        """Return whether the force is within cones in space, not at their border, and no slip can begin."""
        inner = np.arange(SIDES) * (2 * np.pi / SIDES)
        full = max(choices, key=lambda choice: sum(state != OPEN for state in choice))
        cones = [
            self._whole.rays(i, state, _directions(inner) if state == STICK else None)
            for i, state in zip(self.contacts, full, strict=True)
        ]
        step = self._step(cones, -np.concatenate([*cones, self._ties[:0]]).sum(axis=0) @ self._basis.T)
        if step is None or step < GOES_ON:
            return False
        quarters = [(k * np.pi / 2, (k + 1) * np.pi / 2) for k in range(4)]
        options = [self._whole.of_contact(i) for i in self.contacts]
        wider: list[Any] = [[*option, *quarters] if STICK in option else option for option in options]
        left: list[tuple[Any, ...]] = [
            choice for choice in product(*wider) if any(isinstance(one, tuple) for one in choice)
        ]
        for _ in range(MOST_PROGRAMS):
            if not left:
                return True
            choice = left.pop()
            if not (self.may_move(choice) and self._step(self._outer(choice)) is not None):
                continue
            wide = max((one[1] - one[0], place) for place, one in enumerate(choice) if isinstance(one, tuple))
            if wide[0] < NARROW:
                return False
            before, (first, last), after = choice[: wide[1]], choice[wide[1]], choice[wide[1] + 1 :]
            left += [(*before, half, *after) for half in pairwise((first, (first + last) / 2, last))]
        return False

    def _outer(self, choice: tuple[Any, ...]) -> list[Array]:
        """Return cones about the forces of contacts in some states, of slips that begin in a sector."""
        cones = []
        for i, one in zip(self.contacts, choice, strict=True):
            if isinstance(one, tuple):
                half = (one[1] - one[0]) / 2
                corners = _directions(np.array([*one, one[0] + half])) / np.array([1.0, 1.0, np.cos(half)])[:, None]
                cones.append(self._whole.rays(i, SLIP_ON, corners))
            else:
                cones.append(self._whole.rays(i, one))
        return cones

    def may_move(self, choice: tuple[Any, ...], along: Direction | None = None) -> bool:
        """Return whether the group may move so that contacts hold, open, or begin to slip, all that are to do so.

        Parameters
        ----------
        choice : states of the contacts, sectors of angles of those that begin to slip in space
        along : what gaps, slip origins and tie values change at; nothing where it is None
        """
        whole, (still, apart, begin) = self._whole, ([], [], [])
        _, of_normal, _, of_tie = whole.scales.units
        for i, one in zip(self.contacts, choice, strict=True):
            normal, tangent = (whole.normal[i], 0.0), [(row, 0.0) for row in whole.tangent[i]]
            if along is not None:
                normal = normal[0], along.whole_gap[i] / of_normal[i]
                tangent = [(row, x / of_normal[i]) for (row, _), x in zip(tangent, along.slip_origin[i], strict=True)]
            if one == OPEN:
                apart.append(normal)
                continue
            still += [normal, *(tangent if one == STICK else ())]
            if whole.begins(i, one):
                ends = _directions(np.array(one)) if isinstance(one, tuple) else np.array([[float(one)]])
                turned = np.array([[-ends[0, 1], ends[0, 0]], [ends[-1, 1], -ends[-1, 0]]] if len(ends) > 1 else [])
                apart += [_combined(-turn, tangent) for turn in turned]
                begin.append(_combined(-ends.sum(axis=0), tangent))
        still += [(row, 0.0 if along is None else along.tie_value[k] / of_tie[k]) for row, k in
                  zip(self._ties, self._tied, strict=True)]  # fmt: skip
        most = max([1.0, *(abs(x) for _, x in still + apart + begin)])
        parts: dict[str, Any] = {}
        for kind, pairs, slack in (("eq", still, 0.0), ("ub", apart + begin, 1.0)):
            rows = np.array([row @ self._basis.T for row, _ in pairs]).reshape(len(pairs), len(self._basis))
            room = np.full((len(pairs), 1), slack)
            room[: len(apart) if slack else None] = 0.0
            parts |= given_rows(kind, np.column_stack([rows, room]), np.array([x / most for _, x in pairs]))
        cost = np.append(np.zeros(len(self._basis)), -1.0)
        found = highs(cost, bounds=[(None, None)] * len(self._basis) + [(0.0, 1.0)], **parts)
        return found is not None and (not begin or float(found.x[-1]) > NOTHING)


def _combined(turn: Vector, pairs: list[tuple[Array, float]]) -> tuple[Array, float]:
    """Return a combination of rows and of what they are to be."""
    return sum(x * row for x, (row, _) in zip(turn, pairs, strict=True)), float(turn @ [limit for _, limit in pairs])


def _same_span(one: Array, other: Array) -> bool:
    """Return whether rows of unit length span the same."""
    ranks = {np.linalg.matrix_rank(rows, tol=NOTHING) if len(rows) else 0 for rows in (one, other)}
    both = [rows for rows in (one, other) if len(rows)]
    return len(ranks) == 1 and (not both or np.linalg.matrix_rank(np.concatenate(both), tol=NOTHING) in ranks)


def _directions(angles: Any) -> Array:
    return np.column_stack([np.cos(angles), np.sin(angles)])


def refuse_many(
    borders: Borders, system: RateSystem, direction: Direction, rates_of: Callable[[RateSystem, Direction], Rates]
) -> None:
    """Raise `NoRates` where many rates may continue the answer in a combination whose system has no inverse.

    Those rates x + N z, N what the system leaves open, whose signs s(x) + s(N) z lead to where it says are a
    polyhedron: forces are not unique where s(N) z >= 0 has solutions, or where it is more than a point.

    Parameters
    ----------
    borders : the contacts at the border of two states
    system, direction : of the combination, and what the rates are along
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
    places = system.closed, system.stuck  # those that fit best may be no rates
    if missed(problem, borders.scales, found, direction, places) > SEEN:
        return
    signs = borders.signs(found, direction, system)
    size = max(float(np.max(abs(signs), initial=0.0)), TINY)
    if width_within(turns, signs / size, np.inf) > SEEN:
        raise many
