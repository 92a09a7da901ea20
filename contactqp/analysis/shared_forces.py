"""Analyse groups of contacts with dependent rows: their resultant is unique, its distribution to the contacts is not.

With friction the forces are in cones, and linear programs determine the combinations of open, stick and slip that can
exert the resultant, or continue to do so along a direction, and how far (`Cones`, `Group`). `Sharing` treats groups
without friction; `unheld` are motions that no closed contact resists, whatever the forces.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from itertools import pairwise, product
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.border_states import MOST_COMBINATIONS
from contactqp.analysis.rate_data import Direction, Parts, Rates, Scales
from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.factorization import right_singular
from contactqp.linalg.floating import UNRESISTED
from contactqp.linalg.nonnegative import (
    CARRIES,
    DEPENDENT_ROWS,
    forces_without_tension,
    given_rows,
    highs,
    longest_step,
)
from contactqp.model.arrays import Array, Indices, Mask, Vector, zero_beneath
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, number_of_combinations
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution

# The tolerances below which unit rows and changes of forces are zero.
NO_CHANGE = 1e-9
# The least step along a direction, relative to the force, to which a group must be able to exert it; and the least
# share of each ray, relative to the largest, for forces strictly inside the cones.
GOES_ON = 1e-6
# Sides of the polygons around and within a cone in space, and the smallest sectors of beginning slips by halving.
SIDES, NARROW = 16, np.pi / 128
# The most linear programs for excluding beginning slips in space.
MOST_PROGRAMS = 2000

# Shared forces below this part of the largest count as zero.
SEEN = 1e-6

# States of the contacts of one group.
Choice: TypeAlias = tuple[int, ...]


class Cones:
    """The rows of touching contacts and ties, of unit length, and the cones of their forces.

    Parameters
    ----------
    problem, scales : with friction
    status : (m,) array of int, the states of the answer
    touching : (q,) array, contacts that are closed or graze
    slip, slid : (m, d-1) and (m,) arrays, slips, and which contacts have slipped

    Attributes
    ----------
    slips : the directions of slip of the contacts that have slipped, of any coefficient
    along : those of contacts with friction
    rows : (p, n) array, the directions of forces, a single ray for a contact with slip
    owners : (p,) array of int, the contacts of the rows, -1 - k for tie k
    """

    def __init__(
        self, problem: ContactProblem, scales: Scales, status: Status, touching: Indices, slip: Array, slid: Mask
    ) -> None:
        unit, of_normal, _, of_tie = scales.units
        assert problem.tangent is not None
        assert problem.friction is not None
        self.scales, self.mu, self.in_space, width = scales, problem.friction, slip.shape[1] > 1, slip.shape[1]
        touching, ties = touching[of_normal[touching] > 0], np.flatnonzero(of_tie > 0)
        at = [int(width * i + k) for i in touching for k in range(width)]
        whole = sp.csc_array(sp.vstack([problem.normal[touching], problem.tangent[at], problem.tie[ties]]))
        felt = np.flatnonzero(np.diff(whole.indptr))
        normal, tangent, tied = np.split(
            whole[:, felt].toarray() * unit[felt], [len(touching), len(touching) + len(at)]
        )
        places, lengths = {int(i): k for k, i in enumerate(touching)}, of_normal[touching]
        self.normal = {i: normal[k] / lengths[k] for i, k in places.items()}
        self.tangent = {i: tangent[width * k : width * (k + 1)] / lengths[k] for i, k in places.items()}
        size = np.linalg.norm(slip, axis=1)
        moves = (slid | ((abs(status) == 1) & (self.mu > 0))) & (size > 0)
        self.slips = {i: slip[i] / size[i] for i in places if moves[i]}
        self.along = {i: direction for i, direction in self.slips.items() if self.mu[i] > 0}
        rows: list[Array] = []
        owners: list[int] = []
        for i in places:
            sticks = i not in self.along and self.mu[i] > 0
            own = np.array([self.normal[i], *self.tangent[i]]) if sticks else self.rays(i, SLIP_ON)
            rows, owners = [*rows, *own], owners + [i] * len(own)
        self.rows = np.array([*rows, *(tied / of_tie[ties, None])]).reshape(-1, len(felt))
        self.owners = np.array(owners + [-1 - int(k) for k in ties], dtype=int)

    def forces(self, answer: Parts) -> Vector:
        """Return the forces (p,) of an answer in its rows, in the square root of energy."""
        _, of_normal, _, of_tie = self.scales.units
        found: list[float] = []
        for i in self.normal:
            sticks = i not in self.along and self.mu[i] > 0
            found += [x * of_normal[i] for x in (answer.normal[i], *(answer.tangent[i] if sticks else ()))]
        ties = -1 - self.owners[self.owners < 0]
        return np.concatenate([np.array(found), answer.tie[ties] * of_tie[ties]])

    def rays(self, i: int, state: int, corners: Array | None = None) -> Array:
        """Return the rays of the cone of a contact's force in a state, as combinations of its rows.

        Parameters
        ----------
        i, state : the contact and its state
        corners : (c, d-1) array, directions of friction, by default those of the state
        """
        normal, tangent, mu = self.normal[i], self.tangent[i], self.mu[i]
        if state == OPEN:
            return np.zeros((0, len(normal)))
        if mu == 0:
            return np.asarray(normal[None])
        if corners is None and i in self.along:
            corners = self.along[i][None]
        elif corners is None and tangent.shape[0] == 1:
            corners = np.array([[1.0], [-1.0]] if state == STICK else [[float(state)]])
        elif corners is None:
            corners = _directions(np.arange(SIDES) * (2 * np.pi / SIDES)) / np.cos(np.pi / SIDES)
        return np.asarray(normal + mu * (corners @ tangent))

    def with_friction(self, mu: Vector) -> Cones:
        """Return cones of other coefficients (m,)."""
        other = copy(self)
        other.mu = mu
        return other

    def of_contact(self, i: int) -> Choice:
        """Return the possible states of a contact as others take over its force, without beginning slips in space."""
        if self.mu[i] == 0:
            return (OPEN, SLIP_ON)
        if i in self.along:
            along = self.along[i]
            return (OPEN, SLIP_ON if len(along) > 1 or along[0] > 0 else SLIP_BACK)
        return (STICK, OPEN, SLIP_ON, SLIP_BACK) if self.tangent[i].shape[0] == 1 else (STICK, OPEN)

    def begins(self, i: int, state: Any) -> bool:
        """Return whether a contact without slip begins to slip in a state."""
        return self.mu[i] > 0 and i not in self.along and state not in (OPEN, STICK)


class Group:
    """Contacts and ties with dependent rows, and their resultant; `contacts` are their indices."""

    def __init__(self, cones: Cones, forces: Vector, places: Indices) -> None:
        self._cones, self._places = cones, places
        owners = cones.owners[places]
        self.contacts = [int(i) for i in dict.fromkeys(owners[owners >= 0])]
        self._ties = cones.rows[places[owners < 0]]
        self._tied = -1 - owners[owners < 0]
        rows = cones.rows[places]
        _, sizes, basis = np.linalg.svd(rows, full_matrices=False)
        self._basis = basis[sizes > DEPENDENT_ROWS * sizes[0]]
        self._exerts = forces[places] @ rows @ self._basis.T
        self._size = float(np.max(abs(forces[places]), initial=0.0))

    def choices(self) -> list[Choice]:
        """Return the combinations of states that can exert the resultant, none if there are too many."""
        options = [self._cones.of_contact(i) for i in self.contacts]
        if number_of_combinations(options) > MOST_COMBINATIONS:
            return []
        return [choice for choice in product(*options) if self._step(self._outer(choice)) is not None]

    def _step(self, cones: list[Array], change: Vector | None = None, whole: bool = False) -> float | None:
        """Return the largest part, at most 1, of a change with which the force stays in the cones, None if it is
        outside.

        Parameters
        ----------
        cones : rays of the force of each contact
        change : the change of the force in the span of the rows, relative to the group's largest force
        whole : whether all of the change is to be made
        """
        rays = np.concatenate([*cones, self._ties]) @ self._basis.T
        moved = np.zeros(len(self._basis)) if change is None else change
        bounds = [(0.0, None)] * sum(map(len, cones)) + [(None, None)] * len(self._ties) + [(float(whole), 1.0)]
        cost = np.append(np.zeros(len(rays)), -1.0)
        exerts = self._exerts / (self._size or 1.0)
        found = highs(cost, A_eq=np.column_stack([rays.T, -moved]), b_eq=exerts, bounds=bounds)
        return None if found is None else float(found.x[-1])

    def _change(self, rates: Rates) -> Vector:
        """Return the change of the resultant at some rates, zero if it is their rounding."""
        cones, (_, of_normal, _, of_tie) = self._cones, self._cones.scales.units
        change = self._basis @ self._ties.T @ (rates.tie_force * of_tie)[self._tied]
        for i in self.contacts:
            rows = np.array([cones.normal[i], *cones.tangent[i]])
            change += self._basis @ rows.T @ np.append(rates.normal_force[i], rates.friction_force[i]) * of_normal[i]
        told = np.max(abs(change), initial=0.0) > NO_CHANGE * cones.scales.largest(rates)
        return np.where(told, change, 0.0)

    def goes_on(self, choice: Choice, rates: Rates, friction: Vector) -> bool:
        """Return whether a combination of states can exert the resultant as it changes at these rates.

        Parameters
        ----------
        choice, rates : the states of its contacts, and the rates of the answer
        friction : (m,) array, the rates of the coefficients, which widen cones or narrow them
        """
        change, wider = self._change(rates), self._wider(friction)
        size = max(float(np.max(abs(change), initial=0.0)) / (self._size or 1.0), wider)
        change = change / (size * (self._size or 1.0) or 1.0)
        if not wider:
            step = self._step(self._outer(choice), change)
            return step is not None and step >= GOES_ON
        cones = self._cones.with_friction(self._cones.mu + GOES_ON / size * friction)
        return self._step(self._outer(choice, cones), GOES_ON * change, whole=True) is not None

    def _wider(self, friction: Vector) -> float:
        """Return the largest relative rate of coefficients of contacts without slip."""
        mu, still = self._cones.mu, [i for i in self.contacts if self._cones.mu[i] > 0 and i not in self._cones.along]
        return float(np.max(abs(friction[still]) / mu[still], initial=0.0))

    def reach(self, choice: Choice, rates: Rates) -> float:
        """Return the largest step along rates in the plane up to which a combination of states exerts the resultant."""
        change, rays = self._change(rates), np.concatenate([*self._outer(choice), self._ties]) @ self._basis.T
        limits: list[Any] = [(0.0, None)] * (len(rays) - len(self._ties)) + [(None, None)] * len(self._ties)
        return longest_step(rays.T, self._exerts, change, limits) if change.any() else np.inf

    def is_steady(self, choices: list[Choice]) -> bool:
        """Return whether all combinations that exert the resultant constrain the same motions and have the same force
        directions.
        """
        spans = []
        for choice in filter(self.may_move, choices):
            pairs = list(zip(self.contacts, choice, strict=True))
            held = [self._cones.normal[i] for i, state in pairs if state != OPEN]
            held += [row for i, state in pairs if state == STICK for row in self._cones.tangent[i]]
            pushed = [row for i, state in pairs for row in self._cones.rays(i, state)]
            spans.append([np.array([*rows, *self._ties]) for rows in (held, pushed)])
        same = all(_same_span(one, other) for pair in spans for one, other in zip(pair, spans[0], strict=True))
        return bool(spans) and same and (not self._cones.in_space or self._is_within(choices))

    def is_inner(self, choice: Choice) -> bool:
        """Return whether contacts in these states can exert the resultant strictly inside their cones."""
        inner = np.arange(SIDES) * (2 * np.pi / SIDES) if self._cones.in_space else np.array([0.0, np.pi])
        corners = _directions(inner)[:, : 1 + self._cones.in_space]
        cones = [
            self._cones.rays(i, state, corners if state == STICK else None)
            for i, state in zip(self.contacts, choice, strict=True)
        ]
        step = self._step(cones, -np.concatenate([*cones, self._ties[:0]]).sum(axis=0) @ self._basis.T)
        return step is not None and step >= GOES_ON

    def _is_within(self, choices: list[Choice]) -> bool:
        """Return whether the force is strictly inside the cones in space, and no slip can begin."""
        if not self.is_inner(max(choices, key=lambda choice: sum(state != OPEN for state in choice))):
            return False
        quarters = [(k * np.pi / 2, (k + 1) * np.pi / 2) for k in range(4)]
        options = [self._cones.of_contact(i) for i in self.contacts]
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

    def _outer(self, choice: tuple[Any, ...], of: Cones | None = None) -> list[Array]:
        """Return cones that contain the forces of contacts in some states, for slips that begin in a sector."""
        cones, of = [], self._cones if of is None else of
        for i, one in zip(self.contacts, choice, strict=True):
            if isinstance(one, tuple):
                half = (one[1] - one[0]) / 2
                corners = _directions(np.array([*one, one[0] + half])) / np.array([1.0, 1.0, np.cos(half)])[:, None]
                cones.append(of.rays(i, SLIP_ON, corners))
            else:
                cones.append(of.rays(i, one))
        return cones

    def may_move(self, choice: tuple[Any, ...], along: Direction | None = None) -> bool:
        """Return whether a motion of the group exists with which its contacts stick, open or begin to slip as chosen.

        Parameters
        ----------
        choice : states of the contacts, sectors of angles of those that begin to slip in space
        along : rates of gaps, slip origins and tie values, None for zero
        """
        cones, (still, apart, begin) = self._cones, ([], [], [])
        _, of_normal, _, of_tie = cones.scales.units
        for i, one in zip(self.contacts, choice, strict=True):
            normal, tangent = (cones.normal[i], 0.0), [(row, 0.0) for row in cones.tangent[i]]
            if along is not None:
                normal = normal[0], along.whole_gap[i] / of_normal[i]
                tangent = [(row, x / of_normal[i]) for (row, _), x in zip(tangent, along.slip_origin[i], strict=True)]
            if one == OPEN:
                apart.append(normal)
                continue
            still += [normal, *(tangent if one == STICK else ())]
            if cones.begins(i, one):
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
        return found is not None and (not begin or float(found.x[-1]) > NO_CHANGE)


def _combined(turn: Vector, pairs: list[tuple[Array, float]]) -> tuple[Array, float]:
    """Return a combination of rows and of their values."""
    return sum(x * row for x, (row, _) in zip(turn, pairs, strict=True)), float(turn @ [limit for _, limit in pairs])


def _same_span(one: Array, other: Array) -> bool:
    """Return whether rows of unit length span the same space."""
    ranks = {np.linalg.matrix_rank(rows, tol=NO_CHANGE) if len(rows) else 0 for rows in (one, other)}
    both = [rows for rows in (one, other) if len(rows)]
    return len(ranks) == 1 and (not both or np.linalg.matrix_rank(np.concatenate(both), tol=NO_CHANGE) in ranks)


def _directions(angles: Any) -> Array:
    return np.column_stack([np.cos(angles), np.sin(angles)])


class Sharing:
    """The possible distributions of a resultant over touching contacts and ties, in the root of energy.

    A problem's energy changes with gaps dg and tie values db at the rate -min(l'dg + nu'db) over all of them, and where
    that is least contacts whose force may be more than nothing stay closed: what `stay` tells (Dempe 2002, of programs
    with several multipliers).

    Parameters
    ----------
    problem : ContactProblem
    contacts : (q,) array, those that touch
    units : scale of unknowns (n,), and lengths of normal, tangential and tied rows in it
    """

    def __init__(
        self, problem: ContactProblem, contacts: Indices, units: tuple[Vector, Vector, Vector, Vector]
    ) -> None:
        unit, normal, _, tie = units
        lengths = np.concatenate([normal[contacts], tie])
        rows = sp.csc_array(sp.vstack([problem.normal[contacts], problem.tie]))
        self._felt, self._unit, self._contacts = np.flatnonzero(np.diff(rows.indptr)), unit, contacts
        self._lengths = np.where(lengths > 0, lengths, 1.0)
        self.rows: Array = rows[:, self._felt].toarray() * unit[self._felt] / self._lengths[:, None]
        self._limits = [(0.0, None)] * len(contacts) + [(None, None)] * problem.ties
        _, sizes, basis = np.linalg.svd(self.rows, full_matrices=False)
        self._basis = basis[sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0)]

    def _projected(self, resultant: Vector) -> Vector:
        """Return a force (n,) along what the rows span."""
        return np.asarray(self._basis @ (resultant * self._unit)[self._felt])

    def takes_part(self, grazes: Mask) -> bool:
        """Return whether grazing contacts (q,) can carry forces, among themselves or of the others."""
        grazing = np.concatenate([grazes, np.zeros(len(self.rows) - len(grazes), dtype=bool)])
        resultant = np.append(np.zeros(self.rows.shape[1]), 1.0)
        _, residual = forces_without_tension(np.column_stack([self.rows, grazing]), resultant, grazing)
        return not residual > CARRIES

    def only(self, ties: bool) -> bool:
        """Return whether the forces of contacts, or with `ties` those of ties, are unique."""
        of_contacts, of_ties = np.split(self.rows, [len(self._contacts)])
        own, others = (of_ties, of_contacts) if ties else (of_contacts, of_ties)
        own = own[np.any(own != 0, axis=1)]  # rows of zeros have no force
        return len(self._basis) == len(own) + _rank(others)

    def _cost(self, gap: Vector, tie_value: Vector) -> Vector:
        """Return the cost of unit forces as gaps (m,) and tie values (k,) change, scaled to a maximum of one."""
        cost = np.concatenate([gap[self._contacts], tie_value]) / self._lengths
        return np.asarray(cost / (np.max(abs(cost), initial=0.0) or 1.0))

    def _least(self, resultant: Vector, cost: Vector) -> tuple[Any, Array, Vector]:
        """Return the linear program of the forces of least cost, its rows and their resultant."""
        from scipy.optimize import linprog

        span, told = self._basis @ self.rows.T, self._projected(resultant)
        told = told / (np.max(abs(told), initial=0.0) or 1.0)
        return linprog(cost, A_eq=span, b_eq=told, bounds=self._limits, method="highs-ds"), span, told

    def carrying(self, resultant: Vector, gap: Vector, tie_value: Vector) -> Indices | None:
        """Return independent contacts that carry the resultant as gaps (m,) and tie values (k,) change."""
        least, _, _ = self._least(resultant, self._cost(gap, tie_value))
        if least.status != 0:
            return None
        force = least.x[: len(self._contacts)]
        return np.asarray(self._contacts[force > CARRIES * np.max(abs(least.x), initial=0.0)], dtype=np.intp)

    def joining(self, resultant: Vector, carrying: Indices, may: Indices) -> Indices:
        """Return contacts among `may`, independent of the carrying ones and of ties, that carry the rest.

        Parameters
        ----------
        resultant : (n,) array, the force that all of them exert
        carrying, may : contacts whose forces have any sign, and contacts that can push
        """
        free = np.concatenate([np.isin(self._contacts, carrying), np.ones(len(self.rows) - len(self._contacts), bool)])
        _, sizes, basis = np.linalg.svd(self.rows[free], full_matrices=False)
        held = basis[sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0)]
        places = np.flatnonzero(np.isin(self._contacts, np.setdiff1d(may, carrying)))
        told = (resultant * self._unit)[self._felt]
        rest, rows = (one - (one @ held.T) @ held for one in (told, self.rows[places]))
        pushing = np.linalg.norm(rows, axis=1) > DEPENDENT_ROWS
        size = np.linalg.norm(rest)
        if not (pushing.any() and size > CARRIES * np.linalg.norm(told)):
            return carrying[:0]
        force, _ = forces_without_tension(rows[pushing], rest / size, np.ones(int(pushing.sum()), dtype=bool))
        return np.asarray(self._contacts[places[pushing][force > CARRIES]], dtype=np.intp)

    def stay(self, resultant: Vector, gap: Vector, tie_value: Vector) -> Indices | None:
        """Return the contacts that stay closed as gaps (m,) and tie values (k,) change, None if impossible."""
        from scipy.optimize import linprog

        cost = self._cost(gap, tie_value)
        least, span, told = self._least(resultant, cost)
        if least.status != 0:
            return None
        span, told = np.vstack([span, cost]), np.append(told, least.fun)
        stays = []
        for place, contact in enumerate(self._contacts):
            most = linprog(-np.eye(len(cost))[place], A_eq=span, b_eq=told, bounds=self._limits)
            if most.status == 3 or (most.status == 0 and -most.fun > SEEN):
                stays.append(contact)
        return np.array(stays, dtype=np.intp)

    def alone(self, contacts: Indices, resultant: Vector) -> tuple[Vector, Array]:
        """Return forces of these contacts alone with this resultant, and a basis (q, p) of what may be added."""
        ties = np.ones(len(self.rows) - len(self._contacts), dtype=bool)
        places = np.concatenate([np.isin(self._contacts, contacts), ties])
        rows, lengths = self.rows[places], self._lengths[places]
        force = np.linalg.lstsq(rows.T, (resultant * self._unit)[self._felt], rcond=DEPENDENT_ROWS)[0]
        turned, sizes, _ = np.linalg.svd(rows)
        more = turned[:, int(np.sum(sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0))) :]
        more = np.where(abs(more) > DEPENDENT_ROWS, more, 0.0)  # rounding of unique forces
        return (force / lengths)[: len(contacts)], (more / lengths[:, None])[: len(contacts)]

    def reach(self, resultant: Vector, rate: Vector) -> float:
        """Return the largest step x for which contacts can exert resultant + x rate without tension."""
        return longest_step(self._basis @ self.rows.T, self._projected(resultant), self._projected(rate), self._limits)


def _rank(rows: Array) -> int:
    sizes = np.linalg.svd(rows, compute_uv=False) if rows.size else np.zeros(0)
    return int(np.sum(sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0)))


def unheld(solution: Solution, closed: Indices | None) -> list[Vector]:
    """Return the free motions of an answer that no closed contact resists, also with other redundant forces.

    Entries of rounding size are set to zero.
    """
    found = [motion.direction for motion in solution.free_motions]
    unit = unknown_scale(solution.problem) if found else np.ones(0)
    if found and closed is not None and len(closed):
        basis = np.column_stack([z / np.max(abs(z) / unit) for z in found])
        rows = sp.csr_array(solution.problem.normal[closed])
        lengths = np.sqrt(rows.power(2) @ unit**2)[:, None]
        values, rotation = right_singular((rows @ basis) / np.where(lengths > 0, lengths, 1.0))
        found = list((basis @ rotation[int(np.sum(values > UNRESISTED)) :].T).T)
    return [zero_beneath([z], [1 / unit], UNRESISTED * float(np.max(abs(z) / unit)))[0] for z in found]


def moved_by(motions: Iterable[Vector], rows: Any) -> bool:
    """Return whether the product of rows (p, n) with a motion exceeds its rounding."""
    return any(bool(np.any(abs(rows @ z) > UNRESISTED * (abs(rows) @ abs(z)))) for z in motions)


def unique_beside(motions: Sequence[Vector], problem: ContactProblem, of: str) -> bool:
    """Return whether a quantity, by its name in `Solution.derivative`, does not change by adding motions."""
    if of == "gap":
        return not moved_by(motions, problem.normal[np.isfinite(problem.gap)])
    return not motions or of not in ("displacement", "slip")
