"""The states of an answer's contacts near a border of two, and the steps along some rates until one is left.

Certificates see a border within their tolerance. Here the answer is taken beyond double precision in given states, and
what its gaps, forces, slips and margins are there decides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.rate_systems import EPS, Parts, Scales, shape_of_tangents
from contactqp.certificate.certificate import certificate_of
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.extended import Extended, extended_rows
from contactqp.linalg.floating import UNRESISTED
from contactqp.linalg.friction_states import friction_bound, refined_in
from contactqp.linalg.nonnegative import forces_without_tension
from contactqp.linalg.refinement import CAUTION, INVISIBLE, answer_on
from contactqp.model.arrays import Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Solution

# Combinations of states that contacts at a border may go to, at most.
MOST_COMBINATIONS = 256
# Whether answers with friction have bounds.
_PROVEN: WeakKeyDictionary[Solution, bool] = WeakKeyDictionary()
# Friction that misses its bound by this part of it is at its bound.
AT_BOUND = 4 * EPS
# Rows that are combinations of others to this part of the largest depend on them; of shared forces less is none.
DEPENDENT, SEEN = 1e-10, 1e-6


@dataclass(frozen=True, eq=False)
class Decided:
    """The states of an answer's contacts, those near a border decided by what they are beyond double precision."""

    status: Status  # (m,)
    grazing: Indices  # whose gaps and forces both vanish
    at_bound: Indices  # that stick with all of the friction that they may have
    normal_force: Vector  # (m,)
    friction_force: Array  # (m, d-1)
    gap: Vector  # (m,)
    slip: Array  # (m, d-1)


def decided(
    problem: ContactProblem, condensation: Condensation, status: Status, near: Indices, answer: Parts
) -> Decided | None:
    """Return the states of an answer, those of contacts near a border decided; None where refinement tells nothing.

    The answer is refined in the states, and those near a border are changed as its signs say, until none does; where
    that leads nowhere, all of their combinations are tried. A gap or force is none where refinement leaves as much of
    zero. Friction is at its bound where the two are one to a few roundings: the product of coefficient and force is no
    double.

    Parameters
    ----------
    problem, condensation : with friction in the plane, or without
    status : (m,) array of int, the states to begin with
    near : contacts whose states may be others
    answer : Parts, displacement, normal forces, friction and tie forces
    """
    tried: dict[bytes, Decided | Status | None] = {}

    def look(at: Status) -> Decided | Status | None:
        if at.tobytes() not in tried:
            tried[at.tobytes()] = _decided_in(problem, condensation, at, near, answer)
        return tried[at.tobytes()]

    following: Decided | Status | None = status
    while isinstance(following, np.ndarray) and following.tobytes() not in tried:
        following = look(following)
    if isinstance(following, Decided) or 4.0 ** len(near) > MOST_COMBINATIONS:
        return following if isinstance(following, Decided) else None
    choices = (OPEN, STICK, SLIP_ON, SLIP_BACK) if problem.frictional else (OPEN, SLIP_ON)
    for chosen in product(choices, repeat=len(near)):
        at = status.copy()
        at[near] = chosen
        found = look(at)
        if isinstance(found, Decided):
            return found
    return None


def _decided_in(
    problem: ContactProblem, condensation: Condensation, status: Status, near: Indices, answer: Parts
) -> Decided | Status | None:
    """Return the states where the signs of an answer in them hold, else those that the signs lead to, or None."""
    found = _beyond_doubles(problem, condensation, status.copy(), answer)
    if found is None:
        return None
    (push, drag, gap, slip), no_force, no_gap, room = found
    following, grazing, at_bound = status.copy(), [], []
    for i in near:
        smooth = problem.friction is None or problem.friction[i] == 0
        if abs(push[i]) <= no_force[i] and abs(gap[i]) <= no_gap[i]:
            grazing.append(i)
        elif status[i] == OPEN or push[i] < 0:
            following[i] = OPEN if status[i] != OPEN or gap[i] > 0 else SLIP_ON if smooth else STICK
        elif smooth:
            following[i] = SLIP_ON
        elif status[i] == STICK and abs(room[i]) > AT_BOUND * abs(drag[i, 0]):
            following[i] = STICK if room[i] > 0 else SLIP_ON if drag[i, 0] > 0 else SLIP_BACK
        elif status[i] == STICK or slip[i, 0] == 0:
            at_bound.append(i)
        else:
            following[i] = status[i] if status[i] * slip[i, 0] > 0 else STICK
    if not np.array_equal(following, status):
        return following
    following[at_bound], following[grazing] = STICK, OPEN
    at_border = np.array(grazing, dtype=np.intp), np.array(at_bound, dtype=np.intp)
    return Decided(following, *at_border, push, drag, gap, slip)


def _beyond_doubles(
    problem: ContactProblem, condensation: Condensation, status: Status, answer: Parts
) -> tuple[tuple[Vector, Array, Vector, Array], Vector, Vector, Vector] | None:
    """Return forces, friction, gaps and slips in some states, what forces and gaps are nothing, and friction's room."""
    rows, shape = extended_rows(problem), shape_of_tangents(problem)
    none = np.zeros(shape)
    if not problem.frictional:
        on = answer_on(problem, condensation, np.flatnonzero(status != OPEN), caution=CAUTION)
        if on.saddle.redundant or on.contraction * CAUTION > 1 or on.cleared > 0:
            return None
        compliance, lengths = condensation.delassus.compliance[: problem.contacts], on.nothing[: problem.contacts]
        nothing = np.divide(lengths, compliance, out=np.zeros_like(lengths), where=compliance > 0)
        return (on.doubles.normal_force, none, on.gaps, none), nothing, lengths, np.zeros(problem.contacts)
    scaled = condensed_frictional_rows(problem, condensation)
    start = Answer(answer.displacement, answer.normal, answer.tangent, answer.tie)
    found = refined_in(problem, condensation, scaled, status, start)
    if not found.regular:
        return None
    u, push = found.displacement.double(), found.normal_force.double()
    unit = condensation.unknown_scale
    normal, tangent = (np.sqrt(sp.csr_array(one).power(2) @ unit**2) for one in (problem.normal, problem.tangent))
    last = max(np.max(abs(found.last.displacement) / unit, initial=0.0), np.max(abs(found.last.normal_force) * normal))
    whole = max(np.max(abs(u) / unit, initial=0.0), np.max(abs(push) * normal), np.max(abs(problem.load) * unit))
    if last > EPS * whole:
        return None
    nothing = INVISIBLE * whole + last
    force = np.divide(nothing, normal, out=np.zeros_like(normal), where=normal > 0)
    drag = found.friction_force.double()
    room = friction_bound(problem, found.normal_force, np.ones(shape)) - Extended(
        abs(found.friction_force.hi), np.where(found.friction_force.hi < 0, -1.0, 1.0) * found.friction_force.lo
    )
    slip = (
        rows.slip(found.displacement) - (none if problem.slip_origin is None else problem.slip_origin).ravel()
    ).double()
    slip[abs(slip) <= nothing * tangent] = 0.0
    gap = rows.gap(problem, found.displacement).double()
    return (push, drag.reshape(shape), gap, slip.reshape(shape)), force, nothing * normal, room.double()


@dataclass(frozen=True, eq=False)
class Margins:
    """What keeps contacts in their states, or its rates: gaps (m,), forces (m,), friction and slips (m, d-1)."""

    gap: Vector
    push: Vector
    drag: Array
    slip: Array


def steps_to_events(
    mu: Vector | None, status: Status, now: Margins, rates: Margins, edges: Indices, rests: Indices, at_bound: Indices
) -> Iterator[float]:
    """Yield the steps along some rates at which contacts leave their states.

    Parameters
    ----------
    mu : (m,) array, or None without friction
    status : (m,) array of int, the states that the rates are of
    now, rates : Margins, and how they change
    edges : contacts that graze, of which neither forces nor gaps fall from nothing
    rests : contacts whose slips begin here
    at_bound : contacts whose friction is at its bound, which in the plane it may leave for the other
    """
    touching = np.setdiff1d(np.flatnonzero(status != OPEN), edges)
    apart = np.setdiff1d(np.flatnonzero(status == OPEN), edges)
    yield from falls(now.push[touching], rates.push[touching])
    yield from falls(now.gap[apart], rates.gap[apart])
    if mu is None:
        return
    slips = np.setdiff1d(np.flatnonzero((abs(status) == 1) & (mu > 0)), rests).astype(int)
    along = status[slips].astype(float)
    yield from falls(along * now.slip[slips, 0], along * rates.slip[slips, 0])
    for i in np.setdiff1d(np.flatnonzero(status == STICK), edges):
        push, drag, push_rate, drag_rate = now.push[i], now.drag[i], rates.push[i], rates.drag[i]
        if len(drag) > 1:
            yield from _reaches_bound(mu[i], push, drag, push_rate, drag_rate)
            continue
        bounds = np.array([side for side in (1.0, -1.0) if i not in at_bound or side * drag[0] < 0])
        yield from falls(mu[i] * push - bounds * drag[0], mu[i] * push_rate - bounds * drag_rate[0])


def falls(size: Vector, rate: Vector) -> Iterator[float]:
    """Yield the steps at which positive sizes reach zero."""
    falls = rate < 0
    yield from (np.maximum(size[falls], 0.0) / -rate[falls]).tolist()


def _reaches_bound(mu: float, push: float, drag: Vector, push_rate: float, drag_rate: Vector) -> Iterator[float]:
    """Yield the first step x > 0 at which |drag + x drag'| = mu (push + x push')."""
    a = float(drag_rate @ drag_rate) - (mu * push_rate) ** 2
    b = 2 * (float(drag @ drag_rate) - mu**2 * push * push_rate)
    c = float(drag @ drag) - (mu * push) ** 2
    roots = np.roots([a, b, c]) if a != 0 else np.array([-c / b]) if b != 0 else np.zeros(0)
    real = [float(root.real) for root in np.atleast_1d(roots) if abs(root.imag) == 0 and root.real > 0]
    yield from sorted(real)[:1]


def rates_posed(problem: ContactProblem, closed: Indices, grazing: Indices) -> ContactProblem:
    """Return the problem of rates without friction: what grazes are its contacts, what is closed is among its ties."""
    rows = sp.csr_array(sp.vstack([problem.tie, problem.normal[closed]]))
    posed = ContactProblem(
        problem.stiffness, np.zeros(problem.dimension), problem.normal[grazing], np.zeros(len(grazing)),
        tie=rows, tie_value=np.zeros(rows.shape[0]), near_null_space=problem.near_null_space,
    )  # fmt: skip
    posed._computed.wider_condensation = problem._computed.condensation
    return posed


class Sharing:
    """The ways in which contacts that touch, and ties, may share the force that they exert, in the root of energy.

    A problem's energy changes with gaps dg and tie values db at the rate -min(l'dg + nu'db) over all of them, and where
    that is least contacts whose force may be more than nothing stay closed: what `stay` tells (Dempe 2002, of programs
    with several multipliers).

    Parameters
    ----------
    problem : ContactProblem
    contacts : (q,) array, those that touch
    scales : Scales
    """

    def __init__(self, problem: ContactProblem, contacts: Indices, scales: Scales) -> None:
        unit, normal, _, tie = scales.units
        lengths = np.concatenate([normal[contacts], tie])
        rows = sp.csc_array(sp.vstack([problem.normal[contacts], problem.tie]))
        self._felt, self._unit, self._contacts = np.flatnonzero(np.diff(rows.indptr)), unit, contacts
        self._lengths = np.where(lengths > 0, lengths, 1.0)
        self.rows: Array = rows[:, self._felt].toarray() * unit[self._felt] / self._lengths[:, None]
        self._limits = [(0.0, None)] * len(contacts) + [(None, None)] * problem.ties
        _, sizes, basis = np.linalg.svd(self.rows, full_matrices=False)
        self._basis = basis[sizes > DEPENDENT * np.max(sizes, initial=0.0)]

    def _told(self, resultant: Vector) -> Vector:
        """Return a force (n,) along what the rows span."""
        return np.asarray(self._basis @ (resultant * self._unit)[self._felt])

    def takes_part(self, grazes: Mask) -> bool:
        """Return whether those that graze (q,) can hold one another, or what the others hold."""
        grazing = np.concatenate([grazes, np.zeros(len(self.rows) - len(grazes), dtype=bool)])
        resultant = np.append(np.zeros(self.rows.shape[1]), 1.0)
        _, residual = forces_without_tension(np.column_stack([self.rows, grazing]), resultant, grazing)
        return not residual > UNRESISTED

    def stay(self, resultant: Vector, gap: Vector, tie_value: Vector) -> Indices | None:
        """Return the contacts that stay closed as gaps (m,) and tie values (k,) change; None where these cannot."""
        from scipy.optimize import linprog

        span, told = self._basis @ self.rows.T, self._told(resultant)
        cost = np.concatenate([gap[self._contacts], tie_value]) / self._lengths
        cost /= np.max(abs(cost), initial=0.0) or 1.0
        told = told / (np.max(abs(told), initial=0.0) or 1.0)
        least = linprog(cost, A_eq=span, b_eq=told, bounds=self._limits)
        if least.status != 0:
            return None
        span, told = np.vstack([span, cost]), np.append(told, least.fun)
        stays = []
        for place, contact in enumerate(self._contacts):
            most = linprog(-np.eye(len(cost))[place], A_eq=span, b_eq=told, bounds=self._limits)
            if most.status == 3 or (most.status == 0 and -most.fun > SEEN):
                stays.append(contact)
        return np.array(stays, dtype=np.intp)

    def reach(self, resultant: Vector, rate: Vector) -> float:
        """Return the largest step x along which contacts can exert the force resultant + x rate without pulling."""
        from scipy.optimize import linprog

        told, turns = self._told(resultant), self._told(rate)
        size, speed = (float(np.max(abs(one), initial=0.0)) or 1.0 for one in (told, turns))
        span = np.column_stack([self._basis @ self.rows.T, -turns / speed])
        cost = np.append(np.zeros(len(self._limits)), -1.0)
        most = linprog(cost, A_eq=span, b_eq=told / size, bounds=[*self._limits, (0.0, None)])
        return float(-most.fun * size / speed) if most.status == 0 else np.inf if most.status == 3 else 0.0


def width_within(turns: Array, signs: Vector, far: float) -> float:
    """Return how far apart z with signs + turns z >= 0 and |z| <= far may be along some direction, 0 where none is."""
    from scipy.optimize import linprog

    along, ends = np.cos(np.arange(1.0, turns.shape[1] + 1)), []
    for sign in (1.0, -1.0):
        end = linprog(sign * along, A_ub=-turns, b_ub=signs, bounds=(-far, far))
        if end.status != 0:
            return 0.0 if end.status == 2 else np.inf
        ends.append(float(end.fun))
    return -sum(ends)


def is_proven(solution: Solution) -> bool:
    """Return whether errors of an answer are bounded; one with friction is proven when this is first asked of it."""
    problem, certificate = solution.problem, solution.certificate
    if certificate.proven or not problem.frictional:
        return certificate.proven
    if solution not in _PROVEN:
        forces = solution.normal_force, solution.friction_force, solution.tie_force
        limits = certificate.tolerance, certificate.error_tolerance, condense(problem)
        found = certificate_of(problem, Answer(solution.displacement, *forces), *limits, prove_friction=True)
        _PROVEN[solution] = found.proven
    return _PROVEN[solution]
