"""Linearise the friction law of slips in space, compute beginning slips, and provide factors for correcting rates.

In space friction turns with the slip s: mu l_N t of a slipping contact changes at the rate mu dl_N t + C ds, with
t = s/|s| and C = mu l_N / |s| (I - t t'). They are evaluated at an answer in twice double precision, to be as accurate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from contactqp.analysis.rate_data import EXTENDED_EPS, Parts, shape_of_tangents
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.dense import saddle_point
from contactqp.linalg.extended import Extended, two_product, two_sum
from contactqp.linalg.friction_states import StateSystem, slip_directions
from contactqp.linalg.refinement import ROUNDED_AWAY
from contactqp.model.arrays import TINY, Array, Indices, Vector
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.problem import ContactProblem

# The most sweeps over contacts that begin to slip, and their tolerance, as a start of Newton's method.
MOST_SWEEPS, SETTLED = 200, 1e-6
# The largest relative error of slips and forces for which direction and turning are defined.
LARGEST_ERROR = 2.0**-10


@dataclass(frozen=True, eq=False)
class SlipLaw:
    """The rates of friction of slipping contacts, mu dl_N t + C ds, with the errors of t and C.

    In the plane t is +-1 and C is zero. For other contacts t is zero.
    """

    coefficient: Vector  # (m,) mu
    directions: Extended  # ((d-1) m,) t
    turns: Extended  # (m,) mu l_N / |s|
    off: Vector  # (m,) the error of t
    off_turns: Vector  # (m,) the relative error of mu l_N / |s|

    @classmethod
    def of_doubles(cls, coefficient: Vector, directions: Array, turns: Vector) -> SlipLaw:
        """Return the law with exact directions (m, d-1) and turns (m,)."""
        none = np.zeros(len(turns))
        return cls(coefficient, Extended(directions.ravel()), Extended(turns), none, none)

    @classmethod
    def at(
        cls, coefficient: Vector, status: Status, slip: Extended, push: Extended, off_slip: Vector, off_push: Vector
    ) -> SlipLaw:
        """Return the law at an answer in space.

        Parameters
        ----------
        coefficient, status : (m,) arrays, mu and the states
        slip, push : slips (2 m,) and contact forces (m,)
        off_slip, off_push : (m,) arrays, their errors, of slips in length
        """
        slides = (status != OPEN) & (status != STICK)
        largest = np.max(abs(slip.hi.reshape(-1, 2)), axis=1, initial=0.0)
        unit = np.where(slides & (largest > 0), np.exp2(-np.frexp(largest)[1].astype(float)), 0.0)
        scaled = slip.times(np.repeat(unit, 2))  # by powers of two, so that squares are accurate
        squares = times(scaled, scaled)
        square = squares[0::2] + squares[1::2]
        moves = square.hi > 0
        length = _root(Extended(np.where(moves, square.hi, 1.0), np.where(moves, square.lo, 0.0)))
        directions = ratio(scaled, Extended(np.repeat(length.hi, 2), np.repeat(length.lo, 2)))
        bound = times(Extended(np.where(moves, coefficient, 0.0)), push)
        turns = ratio(bound, length).times(unit)
        size = np.where(moves, length.hi / np.where(unit > 0, unit, 1.0), np.inf)
        part = off_slip / size
        weak = off_push > LARGEST_ERROR * abs(push.hi)
        of_push = np.divide(2 * off_push, abs(push.hi), out=np.zeros_like(part), where=~weak & (push.hi != 0))
        off_turns = 2 * part + of_push + EXTENDED_EPS
        unknown = slides & (coefficient > 0) & (~moves | (part > LARGEST_ERROR) | weak)
        off = np.where(unknown, np.inf, np.where(moves, 2 * part + EXTENDED_EPS, 0.0))
        return cls(coefficient, directions, turns, off, off_turns)

    def with_slips(self, contacts: Indices, directions: Array, turns: Vector, off: Vector) -> SlipLaw:
        """Return the law with some contacts that begin to slip.

        Parameters
        ----------
        contacts, directions : (q,) and (q, d-1) arrays, these contacts and the directions of their slips
        turns, off : mu dl_N / |ds| (q,), and the errors of directions and relative errors of these
        """
        at = (contacts[:, None] * self.width + np.arange(self.width)).ravel()
        along, turned = (Extended(one.hi.copy(), one.lo.copy()) for one in (self.directions, self.turns))
        along.hi[at], along.lo[at], turned.hi[contacts], turned.lo[contacts] = directions.ravel(), 0.0, turns, 0.0
        unsure, unsure_turns = self.off.copy(), self.off_turns.copy()
        unsure[contacts] = unsure_turns[contacts] = off
        return SlipLaw(self.coefficient, along, turned, unsure, unsure_turns)

    @property
    def is_known(self) -> bool:
        """Return whether the error of t is bounded."""
        return bool(np.all(np.isfinite(self.off)))

    @property
    def width(self) -> int:
        """Return d - 1, 1 without contacts."""
        return len(self.directions) // len(self.turns) if len(self.turns) else 1

    def dragged(self, normal: Extended, coefficient: Vector | None = None) -> Extended:
        """Return mu l t (flat) for forces l (m,), optionally with other coefficients."""
        bound = times(Extended(self.coefficient if coefficient is None else coefficient), normal)
        return times(self.directions, self._each(bound))

    def along(self, slip: Extended) -> Extended:
        """Return t's (m,) for slips s (flat)."""
        products, width = times(self.directions, slip), self.width
        found = products[0::width]
        for k in range(1, width):
            found = found + products[k::width]
        return found

    def turned(self, slip: Extended) -> Extended:
        """Return C s (flat) of slips (flat)."""
        if not self.turns.hi.any():
            return Extended(np.zeros(len(slip)))
        across = slip - times(self.directions, self._each(self.along(slip)))
        return times(self._each(self.turns), across)

    def error_of_dragged(self, normal: Vector, coefficient: Vector | None = None) -> Vector:
        """Return the error of mu l t (m,) due to that of t."""
        return np.asarray(abs((self.coefficient if coefficient is None else coefficient) * normal) * self.off)

    def error_of_turned(self, slip: Array) -> Vector:
        """Return the error of C s (m,) for slips (m, d-1) due to those of t and C."""
        size = np.linalg.norm(slip, axis=1)
        return np.asarray(abs(self.turns.hi) * size * (self.off_turns + 3 * self.off))

    def _each(self, values: Extended) -> Extended:
        """Return values per contact repeated for each tangent."""
        return Extended(np.repeat(values.hi, self.width), np.repeat(values.lo, self.width))


def times(a: Extended, b: Extended) -> Extended:
    """Return the products, entry by entry."""
    product, error = two_product(a.hi, b.hi)
    return Extended(*two_sum(product, error + (a.hi * b.lo + a.lo * b.hi)))


def ratio(a: Extended, b: Extended) -> Extended:
    """Return the quotients, entry by entry."""
    first = a.hi / b.hi
    return Extended(*two_sum(first, (a - times(Extended(first), b)).double() / b.hi))


def is_at_bound(coefficient: Vector, push: Extended, friction: list[Extended]) -> bool:
    """Return whether friction along two directions is at its bound to twice double precision, contact by contact."""
    most = times(Extended(coefficient), push)
    square = times(friction[0], friction[0]) + times(friction[1], friction[1])
    return bool(np.all(abs((square - times(most, most)).double()) <= ROUNDED_AWAY * square.hi))


def _root(a: Extended) -> Extended:
    """Return the square roots of positive numbers."""
    first = np.sqrt(a.hi)
    return Extended(*two_sum(first, (a - Extended(*two_product(first, first))).double() / (2 * first)))


def slips_that_begin(friction: Vector, push: Vector, drag: Array, pushes: Array, drags: Array) -> list[Array]:
    """Return slip rates (q, 2) with which friction is at its bound along the slips: all solutions for one contact.

    Forces are affine in the slips s: normal ones l = push + P s, friction r = drag + D s, and r_i = mu_i l_i s_i/|s_i|.
    For several contacts the slips are iterated contact by contact (Gauss-Seidel), and one solution is returned.

    Parameters
    ----------
    friction, push, drag : coefficients (q,), forces (q,) and friction (q, 2) where nothing slips
    pushes, drags : P (q, q, 2) and D (q, 2, q, 2)
    """
    if len(push) == 1:
        return [slip[None] for slip in _slips_of_one(friction[0], push[0], drag[0], pushes[0, 0], drags[0, :, 0])]
    slips = np.zeros_like(drag)
    for _ in range(MOST_SWEEPS):
        changed = 0.0
        for i in range(len(push)):
            others = slips.copy()
            others[i] = 0.0
            own = push[i] + np.sum(pushes[i] * others), drag[i] + np.einsum("ajk,jk->a", drags[i], others)
            beyond = np.linalg.norm(own[1]) > friction[i] * own[0]
            possible = _slips_of_one(friction[i], *own, pushes[i, i], drags[i, :, i]) if beyond else []
            found = possible[0] if possible else np.zeros(2)
            before, after, apart = (float(np.linalg.norm(one)) for one in (slips[i], found, found - slips[i]))
            changed, slips[i] = max(changed, apart / max(before, after, TINY)), found
        if changed <= SETTLED:
            return [slips] if np.all(slips.any(axis=1)) else []
    return []


def _slips_of_one(friction: float, push: float, drag: Vector, by_push: Vector, by_drag: Array) -> list[Vector]:
    """Return the possible slips (2,) of one contact, the best first, as in `slips_that_begin`.

    A slip |s| t has drag + |s| D t = mu (push + |s| P t) t. The component across t is a polynomial of degree 3 in the
    cosine and sine of the angle of t, without |s|.
    """
    angles = np.arange(8) * (np.pi / 4)
    t = np.stack([np.cos(angles), np.sin(angles)])
    rest, slope = drag[:, None] - friction * push * t, by_drag @ t - friction * (by_push @ t) * t
    coefficients = np.fft.fft(rest[0] * slope[1] - rest[1] * slope[0])
    roots = np.roots(np.concatenate([coefficients[3::-1], coefficients[:-4:-1]]))
    found = []
    for root in roots[roots != 0] / abs(roots[roots != 0]):
        t = np.array([root.real, root.imag])
        rest, slope = drag - friction * push * t, by_drag @ t - friction * (by_push @ t) * t
        size = -float(rest @ slope) / max(float(slope @ slope), TINY)
        if size > 0:
            found.append((float(np.linalg.norm(rest + size * slope)), size * t))
    return [slip for _, slip in sorted(found, key=lambda pair: pair[0])]


class FactorisedStates(Protocol):
    """The interface of factors for refinement: an approximate inverse, and products with the system."""

    @property
    def contraction(self) -> float | None:
        """Return the ratio of successive corrections, if known from the refinement of an answer."""

    def correct(self, left: Parts, transposed: bool) -> Parts:
        """Return a solution in double precision."""


class Frictionless:
    """The symmetric saddle-point system of closed contacts and ties."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, closed: Indices) -> None:
        self._condensation, self._closed, self._contacts = condensation, closed, problem.contacts
        self._saddle = saddle_point(condensation, closed)
        self.redundant = self._saddle.redundant

    @property
    def contraction(self) -> float | None:
        return self._saddle.contraction

    def correct(self, left: Parts, transposed: bool) -> Parts:
        del transposed
        data = left.displacement, left.normal[self._closed], left.tie
        du, dl, tie = self._condensation.correction(self._saddle, *data)
        normal = np.zeros(self._contacts)
        normal[self._closed] = dl
        return Parts(du, normal, np.zeros_like(left.tangent), tie)


class Frictional:
    """The system of one combination of open, stick and slip at an answer.

    Parameters
    ----------
    problem, condensation : with friction, and its condensation
    status : (m,) array of int, the combination
    answer : displacement and forces, and slips in place of friction
    independent : whether of rows that depend on others only as many act as are independent
    """

    contraction: float | None = None  # number of corrections by dense factors, which are cheap

    def __init__(
        self, problem: ContactProblem, condensation: Condensation, status: Status, answer: Parts, independent: bool
    ) -> None:
        rows = condensed_frictional_rows(problem, condensation)
        self._problem, self._shape = problem, shape_of_tangents(problem)
        slip = answer.tangent.ravel()
        self.directions, scaled = slip_directions(rows, status, slip, answer.normal)
        self._system = StateSystem(condensation, rows, status, self.directions, scaled, independent)
        self.regular = self._system.regular and (self._system.sound or not independent)
        across = np.eye(self._shape[1]) - self.directions[:, :, None] * self.directions[:, None, :]
        turns = np.zeros(self._shape[0])
        if scaled is not None and problem.friction is not None:
            size = np.linalg.norm(answer.tangent, axis=1)
            turns = np.divide(problem.friction * answer.normal, size, out=turns, where=scaled > 0)
        self.turns, self.turning = turns, turns[:, None, None] * across  # (m,), (m, d-1, d-1)

    def correct(self, left: Parts, transposed: bool) -> Parts:
        data = left.displacement, left.normal, left.tangent.ravel(), left.tie
        return Parts.of(self._system.correct(*data, transposed=transposed))

    def unresolved(self) -> list[Parts]:
        """Return a basis of the null space of the system."""
        return [Parts.of(one) for one in self._system.unresolved()]


@dataclass(frozen=True, eq=False)
class StateMargins:
    """Quantities that determine contact states, or rates: gaps (m,), forces (m,), friction and slips (m, d-1)."""

    gap: Vector
    push: Vector
    drag: Array
    slip: Array


def steps_to_events(
    mu: Vector | None,
    status: Status,
    now: StateMargins,
    rates: StateMargins,
    edges: Indices,
    rests: Indices,
    at_bound: Indices,
) -> Iterator[float]:
    """Yield the steps along some rates at which contacts leave their states.

    Parameters
    ----------
    mu : (m,) array, or None without friction
    status : (m,) array of int, the states that the rates are of
    now, rates : StateMargins, and how they change
    edges : grazing contacts, whose forces and gaps do not decrease from zero
    rests : contacts whose slips begin
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
    yield from (np.maximum(size[rate < 0], 0.0) / -rate[rate < 0]).tolist()


def _reaches_bound(mu: float, push: float, drag: Vector, push_rate: float, drag_rate: Vector) -> Iterator[float]:
    """Yield the first step x > 0 at which |drag + x drag'| = mu (push + x push')."""
    a = float(drag_rate @ drag_rate) - (mu * push_rate) ** 2
    b = 2 * (float(drag @ drag_rate) - mu**2 * push * push_rate)
    c = float(drag @ drag) - (mu * push) ** 2
    roots = np.roots([a, b, c]) if a != 0 else np.array([-c / b]) if b != 0 else np.zeros(0)
    real = [float(root.real) for root in np.atleast_1d(roots) if abs(root.imag) == 0 and root.real > 0]
    yield from sorted(real)[:1]
