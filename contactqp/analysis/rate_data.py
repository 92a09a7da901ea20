"""What rates are made of: directions, parts of data and of solutions, factorised states and the law of slips.

In space friction turns with the slip s: of a contact that slips mu l_N t changes at the rate mu dl_N t + C ds, with
t = s/|s| and C = mu l_N / |s| (I - t t'). Both are those of the exact answer, which doubles round: taken at an answer
in twice double precision they are known as well as this is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.dense import saddle_point
from contactqp.linalg.extended import Extended, two_product, two_sum
from contactqp.linalg.friction_states import StateSystem, slip_directions
from contactqp.model.arrays import EPS, TINY, Array, Indices, Vector
from contactqp.model.coulomb import OPEN, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import AnswerOf

# Parameters that are vectors, or one for each direction of slip.
VECTORS = ("load", "gap", "tie_value", "friction", "slip_origin")
# What sums of products in twice double precision are off by, as parts of their terms.
ROUNDED = 2.0**-92
# Sweeps over contacts that begin to slip, at most, and the part of each slip that the last may change: a start of
# Newton's method.
MOST_SWEEPS, SETTLED = 200, 1e-6
# Why there are no rates.
FREE = "bodies are free to move, and their displacements are not unique"
REDUNDANT = "contacts that touch, or ties, are redundant, and share their forces in many ways"
SINGULAR = "the linear system of the contacts' states has no inverse, and the answer is not unique nearby"
# Slips and forces that may be off by more than this part of them tell no direction and no turn of it.
TOLD = 2.0**-10


class NoRates(Exception):
    """There are no rates towards a side; the message says why."""


@dataclass(frozen=True, eq=False)
class Parts:
    """A part for each unknown (n,), contact (m,), its tangents (m, d-1) and tie (k,): data, or a solution of them."""

    displacement: Vector
    normal: Vector
    tangent: Array
    tie: Vector

    @classmethod
    def of(cls, found: AnswerOf[Vector, Array]) -> Parts:
        """Return an answer, or a change of one, as such parts."""
        return cls(found.displacement, found.normal_force, found.friction_force, found.tie_force)

    @classmethod
    def zero(cls, problem: ContactProblem) -> Parts:
        return cls(
            np.zeros(problem.dimension), np.zeros(problem.contacts), np.zeros(shape_of_tangents(problem)),
            np.zeros(problem.ties),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Solved:
    """A solution in doubles, and what it may be off by for each part; None where that is not known."""

    found: Parts
    bound: Parts | None
    settled: bool  # whether refinement led anywhere
    extended: tuple[Extended, ...] = ()  # displacement, normal, flat tangents and ties in twice double precision
    remainder: float = np.inf  # what further refinement may change of these, in the square root of energy
    transposed: bool = False  # whether it is of the transposed system


def shape_of_tangents(problem: ContactProblem) -> tuple[int, int]:
    """Return (m, d-1), or (m, 0) without tangential rows."""
    origin = problem.slip_origin
    return (problem.contacts, 0) if origin is None else (problem.contacts, origin.shape[1])


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction of what a problem is made of, and what it means at an answer."""

    load: Vector  # (n,)
    gap: Vector  # (m,)
    slip_origin: Array  # (m, d-1)
    tie_value: Vector  # (k,)
    friction: Vector  # (m,)
    strained: Vector  # (n,) -dK u
    turned: Vector  # (n,) -dE_N'l_N
    closing: Vector  # (m,) -dE_N u
    work: float = 0.0  # u'dK u / 2 + l_N'dE_N u, by which the energy changes besides
    driven: float = 0.0  # not zero where it drives motions that nothing resists, or resists them
    rows: Any = None  # (m, n) dE_N, of a direction of the rows
    stiffness: Any = None  # (n, n) dK, of a direction of the stiffness

    @classmethod
    def zero(cls, problem: ContactProblem) -> Direction:
        n, m = problem.dimension, problem.contacts
        return cls(
            np.zeros(n), np.zeros(m), np.zeros(shape_of_tangents(problem)), np.zeros(problem.ties), np.zeros(m),
            np.zeros(n), np.zeros(n), np.zeros(m),
        )  # fmt: skip

    @property
    def whole_load(self) -> Vector:
        """Return the load (n,) that the rates see."""
        return self.load + self.strained + self.turned

    @property
    def whole_gap(self) -> Vector:
        """Return the gaps (m,) that the rates see."""
        return self.gap + self.closing

    @property
    def by_answer(self) -> bool:
        """Return whether the data of the rates are products with the answer, so that they have its rounding."""
        return self.stiffness is not None or self.rows is not None or bool(self.friction.any())

    def reversed(self) -> Direction:
        turned: dict[str, Any] = {name: None if value is None else -value for name, value in vars(self).items()}
        return Direction(**turned)


@dataclass(frozen=True, eq=False)
class Rates(AnswerOf[Vector, Array]):
    """What changes along a direction; `bound` are errors of displacement and forces, where they are known."""

    gap: Vector  # (m,)
    slip: Array  # (m, d-1)
    reaction: Vector  # (n,)
    status: Status  # (m,) the states that contacts are in along the direction
    bound: Parts | None = None
    shared: bool = False  # whether contacts that close along the direction share their forces in many ways
    off: Parts | None = None  # what data that the answer makes are off by: -dK u, whole gaps, own friction

    def reversed(self) -> Rates:
        """Return the rates towards minus a direction from those along its reverse."""
        kept: dict[str, Any] = dict(status=self.status, bound=self.bound, shared=self.shared, off=self.off)
        return Rates(**{name: 0.0 - value for name, value in vars(self).items() if name not in kept}, **kept)


def with_reaction(
    problem: ContactProblem, direction: Direction, found: Parts, friction: Array, status: Status, bound: Parts | None
) -> Rates:
    """Return rates with those of gaps, slips and reactions.

    Parameters
    ----------
    problem, direction : the problem of the answer, and what the rates are along
    found, friction : rates of displacement and forces, and of friction (m, d-1)
    status, bound : the states that contacts are in, and what displacement and forces are off by
    """
    u, slip = found.displacement, -direction.slip_origin
    if problem.tangent is not None:
        slip = slip + (problem.tangent @ u).reshape(slip.shape)
    gap = direction.whole_gap - problem.normal @ u
    if direction.rows is not None:
        reaction = direction.load + direction.strained - problem.stiffness_rows @ u
    else:  # a stiffness times a motion that hardly strains it is rounding
        tie = problem.tie[: len(found.tie)]  # behind them, what holds slips that begin along their friction
        reaction = problem.normal.T @ found.normal + tie.T @ found.tie
        if problem.tangent is not None:
            reaction = reaction + problem.tangent.T @ friction.ravel()
    return Rates(u, found.normal, friction, found.tie, gap, slip, reaction, status, bound)


@dataclass(frozen=True, eq=False)
class SlipLaw:
    """The rates of the friction of contacts that slip, mu dl_N t + C ds, and what t and C are off by.

    In the plane t is +-1 and C is zero. What does not slip has no t.
    """

    coefficient: Vector  # (m,) mu
    directions: Extended  # ((d-1) m,) t
    turns: Extended  # (m,) mu l_N / |s|
    off: Vector  # (m,) the length of what t may be off by
    off_turns: Vector  # (m,) what mu l_N / |s| may be off by, as a part of itself

    @classmethod
    def of_doubles(cls, coefficient: Vector, directions: Array, turns: Vector) -> SlipLaw:
        """Return the law with directions (m, d-1) and turns (m,) as they are."""
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
        off_slip, off_push : (m,) arrays, what these may be off by, slips in length
        """
        slides = (status != OPEN) & (status != STICK)
        largest = np.max(abs(slip.hi.reshape(-1, 2)), axis=1, initial=0.0)
        unit = np.where(slides & (largest > 0), np.exp2(-np.frexp(largest)[1].astype(float)), 0.0)
        scaled = slip.times(np.repeat(unit, 2))  # by powers of two, so that squares have all digits
        squares = times(scaled, scaled)
        square = squares[0::2] + squares[1::2]
        moves = square.hi > 0
        length = _root(Extended(np.where(moves, square.hi, 1.0), np.where(moves, square.lo, 0.0)))
        directions = ratio(scaled, Extended(np.repeat(length.hi, 2), np.repeat(length.lo, 2)))
        bound = times(Extended(np.where(moves, coefficient, 0.0)), push)
        turns = ratio(bound, length).times(unit)
        size = np.where(moves, length.hi / np.where(unit > 0, unit, 1.0), np.inf)
        part = off_slip / size
        weak = off_push > TOLD * abs(push.hi)
        off_turns = 2 * part + np.divide(2 * off_push, abs(push.hi), out=np.zeros_like(part), where=~weak) + ROUNDED
        unknown = slides & (coefficient > 0) & (~moves | (part > TOLD) | weak)
        off = np.where(unknown, np.inf, np.where(moves, 2 * part + ROUNDED, 0.0))
        return cls(coefficient, directions, turns, off, off_turns)

    @property
    def is_known(self) -> bool:
        """Return whether what t may be off by is bounded."""
        return bool(np.all(np.isfinite(self.off)))

    @property
    def width(self) -> int:
        """Return d - 1."""
        return len(self.directions) // max(len(self.turns), 1)

    def dragged(self, normal: Extended, coefficient: Vector | None = None) -> Extended:
        """Return mu l t (flat) of forces l (m,), or of other coefficients."""
        bound = times(Extended(self.coefficient if coefficient is None else coefficient), normal)
        return times(self.directions, self._each(bound))

    def along(self, slip: Extended) -> Extended:
        """Return t's (m,) of slips (flat)."""
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
        """Return what mu l t (m,) is off by for what t is, in length."""
        return np.asarray(abs((self.coefficient if coefficient is None else coefficient) * normal) * self.off)

    def error_of_turned(self, slip: Array) -> Vector:
        """Return what C s (m,) of slips (m, d-1) is off by for what t and C are, in length."""
        size = np.linalg.norm(slip, axis=1)
        return np.asarray(abs(self.turns.hi) * size * (self.off_turns + 3 * self.off))

    def _each(self, values: Extended) -> Extended:
        """Return a number for each contact once for each of its directions."""
        return Extended(np.repeat(values.hi, self.width), np.repeat(values.lo, self.width))


def times(a: Extended, b: Extended) -> Extended:
    """Return the products, entry by entry."""
    product, error = two_product(a.hi, b.hi)
    return Extended(*two_sum(product, error + (a.hi * b.lo + a.lo * b.hi)))


def ratio(a: Extended, b: Extended) -> Extended:
    """Return the quotients, entry by entry."""
    first = a.hi / b.hi
    return Extended(*two_sum(first, (a - times(Extended(first), b)).double() / b.hi))


def _root(a: Extended) -> Extended:
    """Return the square roots of positive numbers."""
    first = np.sqrt(a.hi)
    return Extended(*two_sum(first, (a - Extended(*two_product(first, first))).double() / (2 * first)))


def errors_of(problem: ContactProblem, of: str, rates: Rates, direction: Direction) -> Any:
    """Return what entries of rates may be off by, gaps, slips, friction and reactions in the plane; None if not known.

    Parameters
    ----------
    problem, of : the problem of the answer, and the name of a quantity
    rates, direction : its rates, with bounds of displacement and forces, and what they are along
    """
    bound, u = rates.bound, abs(rates.displacement)
    if bound is None:
        return None
    off = Parts.zero(problem) if rates.off is None else rates.off
    if of in ("displacement", "normal_force", "tie_force"):
        return dict(displacement=bound.displacement, normal_force=bound.normal, tie_force=bound.tie)[of]
    if of == "friction_force" and problem.friction is not None:
        dragged = problem.friction[:, None] * rates.normal_force[:, None]  # one of its three terms, which may cancel
        rounding = 8 * EPS * (abs(rates.friction_force) + abs(dragged))
        return bound.tangent + problem.friction[:, None] * bound.normal[:, None] + off.tangent + rounding
    if of == "reaction" and direction.rows is None:
        pairs = [(problem.normal, bound.normal, rates.normal_force), (problem.tie, bound.tie, rates.tie_force)]
        if problem.tangent is not None:
            unsure = errors_of(problem, "friction_force", rates, direction) if problem.frictional else 0 * bound.tangent
            pairs.append((problem.tangent, unsure.ravel(), rates.friction_force.ravel()))
        terms = 3 + sum(int(np.max(np.bincount(matrix.indices), initial=0)) for matrix, *_ in pairs)
        return sum(abs(matrix).T @ (off + EPS * terms * abs(force)) for matrix, off, force in pairs)
    rows = dict(gap=problem.normal, slip=problem.tangent, reaction=problem.stiffness_rows).get(of)
    if rows is None:
        return None
    own = dict(gap=direction.whole_gap, slip=direction.slip_origin.ravel(), reaction=direction.load)[of]
    if of == "reaction":
        own = abs(own) + abs(direction.strained)
    more = dict(gap=off.normal, reaction=off.displacement).get(of, 0.0)
    sizes, terms = abs(sp.csr_array(rows)), int(np.max(np.diff(sp.csr_array(rows).indptr), initial=0)) + 3
    errors = sizes @ bound.displacement + EPS * terms * (abs(own) + sizes @ u) + more
    return errors.reshape(getattr(rates, of).shape)


def slips_that_begin(friction: Vector, push: Vector, drag: Array, pushes: Array, drags: Array) -> list[Array]:
    """Return slips (q, 2) at whose rates the friction of contacts is at its bound, along them: all of one contact.

    Forces are affine in the slips s: normal ones l = push + P s, friction r = drag + D s, and r_i = mu_i l_i s_i/|s_i|.
    Of more than one contact each is given its slip in turn, until none changes (Gauss-Seidel), and these are returned.

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
    """Return the slips (2,) that one contact may begin with, those that fit best first; as `slips_that_begin`.

    A slip |s| t has drag + |s| D t = mu (push + |s| P t) t. The product with what is across t leaves of it a polynomial
    of degree 3 in the cosine and sine of the angle of t, without |s|.
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
    """What is refined by: an approximate inverse, and products of the unknowns with the system."""

    @property
    def contraction(self) -> float | None:
        """The part of a correction that its successor finds missing, where an answer's refinement has told it."""

    def correct(self, left: Parts, transposed: bool) -> Parts:
        """Return a solution in double precision."""


class Frictionless:
    """The saddle point of closed contacts and ties, which is symmetric."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, closed: NDArray[np.intp]) -> None:
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
    """

    contraction: float | None = None  # of corrections by dense factors, which cost little

    def __init__(self, problem: ContactProblem, condensation: Condensation, status: Status, answer: Parts) -> None:
        rows = condensed_frictional_rows(problem, condensation)
        self._problem, self._shape = problem, shape_of_tangents(problem)
        slip = answer.tangent.ravel()
        self.directions, scaled = slip_directions(rows, status, slip, answer.normal)
        self._system = StateSystem(condensation, rows, status, self.directions, scaled)
        self.regular = self._system.regular
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
        """Return a basis of what may be added to solutions."""
        return [Parts.of(one) for one in self._system.unresolved()]


def closed_on(problem: ContactProblem, contacts: Indices) -> Status:
    """Return states (m,) in which these contacts alone are closed, without friction."""
    return np.where(np.isin(np.arange(problem.contacts), contacts), SLIP_ON, OPEN).astype(np.int8)


def rates_posed(problem: ContactProblem, closed: Indices, grazing: Indices) -> ContactProblem:
    """Return the problem of rates without friction: what grazes are its contacts, what is closed is among its ties."""
    rows = sp.csr_array(sp.vstack([problem.tie, problem.normal[closed]]))
    posed = ContactProblem(
        problem.stiffness, np.zeros(problem.dimension), problem.normal[grazing], np.zeros(len(grazing)),
        tie=rows, tie_value=np.zeros(rows.shape[0]), near_null_space=problem.near_null_space,
    )  # fmt: skip
    posed._computed.wider_condensation = problem._computed.condensation
    return posed


def slips_across(problem: ContactProblem, contacts: Indices, across: Array) -> ContactProblem:
    """Return the problem with the slips of some contacts across their friction (q, 2) among its ties."""
    assert problem.tangent is not None
    rows = [
        sp.csr_array(unit[None] @ problem.tangent[2 * i : 2 * i + 2]) for i, unit in zip(contacts, across, strict=True)
    ]
    value = np.concatenate([problem.tie_value, np.zeros(len(contacts))])
    posed = problem.replace(tie=sp.csr_array(sp.vstack([problem.tie, *rows])), tie_value=value)
    posed._computed.wider_condensation = problem._computed.condensation
    return posed


def repeated(problem: ContactProblem, turn: Any, contacts: Indices, others: Indices) -> Indices:
    """Return contacts whose row, gap and change of the row are those of another times one number, to the last digit.

    Parameters
    ----------
    problem, turn : and the change (m, n) of its rows
    contacts, others : those asked about, and those that they may repeat
    """

    def data(i: int) -> Vector:
        rows = (sp.csr_array(one)[[i]].toarray().ravel() for one in (problem.normal, turn))
        return np.concatenate([*rows, problem.gap[[i]]])

    found = []
    for i in contacts:
        one, place = data(i), int(np.argmax(abs(data(i))))
        for other in map(data, others):  # products of doubles with their errors are exact
            left, right = two_product(one, other[place]), two_product(other, one[place])
            if other[place] != 0 and all(map(np.array_equal, left, right)):
                found.append(i)
                break
    return np.array(found, dtype=np.intp)
