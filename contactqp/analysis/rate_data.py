"""Define the data of rates: directions, parts of data and solutions, scales, and checks of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.critical_friction import critical_friction
from contactqp.errors import Unsupported
from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.extended import Extended, extend, extended_rows, two_product
from contactqp.linalg.refinement import ROUNDED_AWAY
from contactqp.model.arrays import EPS, INVISIBLE, TINY, Array, Indices, Vector
from contactqp.model.coulomb import OPEN, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import AnswerOf

# Parameters that are vectors, or have one column per tangent.
VECTORS = ("load", "gap", "tie_value", "friction", "slip_origin")
# The quantities whose rates determine sizes; gaps and reactions are sums whose terms may cancel.
MEASURED = ("displacement", "normal_force", "friction_force", "tie_force")
# Rates that differ by less than this part of the largest, in the square root of energy, are equal.
SAME_RATE = 1e-9
# The relative error of sums of products in twice double precision.
EXTENDED_EPS = 2.0**-92
# The most contacts named in a reason.
SHOWN = 5
# Reasons why there are no rates.
FREE = "bodies are free to move, and their displacements are not unique"
REDUNDANT = "contacts that touch, or ties, are redundant, and share their forces in many ways"
SINGULAR = "the linear system of the contacts' states has no inverse, and the answer is not unique nearby"


class NoRates(Exception):
    """Raised if there are no rates on a side, with the reason."""


class NoAnswer(NoRates):
    """Raised if there is no answer on a side, with the reason."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Data or a solution with parts for unknowns (n,), contacts (m,), tangents (m, d-1) and ties (k,)."""

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
    """A solution in doubles with the errors of its parts, None if unknown."""

    found: Parts
    bound: Parts | None
    settled: bool  # whether refinement converged
    extended: tuple[Extended, ...] = ()  # displacement, normal, flat tangents and ties in twice double precision
    remainder: float = np.inf  # their largest change by further refinement, in the square root of energy
    transposed: bool = False  # whether it is of the transposed system


def shape_of_tangents(problem: ContactProblem) -> tuple[int, int]:
    """Return (m, d-1), or (m, 0) without tangential rows."""
    origin = problem.slip_origin
    return (problem.contacts, 0) if origin is None else (problem.contacts, origin.shape[1])


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction of the data of a problem, and its effect at an answer."""

    load: Vector  # (n,)
    gap: Vector  # (m,)
    slip_origin: Array  # (m, d-1)
    tie_value: Vector  # (k,)
    friction: Vector  # (m,)
    strained: Vector  # (n,) -dK u
    turned: Vector  # (n,) -dE_N'l_N
    closing: Vector  # (m,) -dE_N u
    work: float = 0.0  # u'dK u / 2 + l_N'dE_N u, the additional change of energy
    driven: float = 0.0  # nonzero if it drives or resists otherwise unresisted motions
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
        """Return the whole rate of the load (n,)."""
        return self.load + self.strained + self.turned

    @property
    def whole_gap(self) -> Vector:
        """Return the whole rates of gaps (m,)."""
        return self.gap + self.closing

    @property
    def moves(self) -> bool:
        """Return whether gaps or ties change, so that closed contacts or ties move."""
        return bool(self.whole_gap.any() or self.tie_value.any())

    @property
    def by_answer(self) -> bool:
        """Return whether the data of the rates are products with the answer, with its rounding."""
        return self.stiffness is not None or self.rows is not None or bool(self.friction.any())

    def reversed(self) -> Direction:
        turned: dict[str, Any] = {name: None if value is None else -value for name, value in vars(self).items()}
        return Direction(**turned)


@dataclass(frozen=True, eq=False)
class Rates(AnswerOf[Vector, Array]):
    """The rates along a direction; `bound` are errors of displacement and forces, if known."""

    gap: Vector  # (m,)
    slip: Array  # (m, d-1)
    reaction: Vector  # (n,)
    status: Status  # (m,) the states of contacts along the direction
    bound: Parts | None = None
    shared: bool = False  # whether forces of contacts that close along the direction are not unique
    off: Parts | None = None  # errors of data computed from the answer: -dK u, whole gaps, own friction
    motions: tuple[Vector, ...] = ()  # additional motions that bodies may have along the direction

    def reversed(self) -> Rates:
        """Return the rates on the minus side of a direction from those along its reverse."""
        kept = ("status", "bound", "shared", "off", "motions")
        return Rates(**{name: one if name in kept else 0.0 - one for name, one in vars(self).items()})


def with_reaction(
    problem: ContactProblem, direction: Direction, found: Parts, friction: Array, status: Status, bound: Parts | None
) -> Rates:
    """Return rates with those of gaps, slips and reactions.

    Parameters
    ----------
    problem, direction : the problem of the answer, and what the rates are along
    found, friction : rates of displacement and forces, and of friction (m, d-1)
    status, bound : the contact states, and the errors of displacement and forces
    """
    u, slip = found.displacement, -direction.slip_origin
    if problem.tangent is not None:
        slip = slip + (problem.tangent @ u).reshape(slip.shape)
    gap = direction.whole_gap - problem.normal @ u
    if direction.rows is not None:
        reaction = direction.load + direction.strained - problem.stiffness_rows @ u
    else:  # a stiffness times a nearly rigid motion is rounding
        tie = problem.tie[: len(found.tie)]  # after them, the constraints of slips that begin along their friction
        reaction = problem.normal.T @ found.normal + tie.T @ found.tie
        if problem.tangent is not None:
            reaction = reaction + problem.tangent.T @ friction.ravel()
    return Rates(u, found.normal, friction, found.tie, gap, slip, reaction, status, bound)


class Scales:
    """Factors that convert quantities of a problem to square roots of energy, to make them comparable."""

    def __init__(self, problem: ContactProblem) -> None:
        self._problem = problem

    def same(self, of: str, one: Rates, other: Rates) -> bool:
        """Return whether a quantity has the same rates, relative to all rates in the square root of energy."""
        return self._apart(of, one, other) <= 0

    def _apart(self, of: str, one: Rates, other: Rates) -> float:
        """Return the difference of rates of a quantity beyond rounding of all rates, in the square root of energy."""
        difference = self.of(of, getattr(one, of) - getattr(other, of))
        return float(np.max(abs(difference), initial=0.0)) - SAME_RATE * max(self.largest(one), self.largest(other))

    def largest(self, rates: Rates) -> float:
        """Return the largest of the rates of displacements and forces, in the square root of energy."""
        return max(float(np.max(abs(self.of(name, getattr(rates, name))), initial=0.0)) for name in MEASURED)

    def are_one(self, one: Rates, other: Rates) -> bool:
        """Return whether two combinations of states have the same rates.

        Differences that are negligible relative to slips, or within the error bounds of both, are ignored.
        """
        sizes = [self.of(name, getattr(rates, name)) for name in ("slip", "gap") for rates in (one, other)]
        nothing = 64 * EPS * max(float(np.max(abs(size), initial=0.0)) for size in sizes)
        nothing = max(nothing, self._left_open(one) + self._left_open(other))
        return all(self._apart(name, one, other) <= nothing for name in MEASURED)

    def _left_open(self, rates: Rates) -> float:
        """Return the largest error bound of rates, in the square root of energy, 0 if there is none."""
        if (bound := rates.bound) is None:
            return 0.0
        parts = bound.displacement, bound.normal, bound.tangent, bound.tie
        return max(float(np.max(self.of(name, one), initial=0.0)) for name, one in zip(MEASURED, parts, strict=True))

    def of(self, name: str, values: Array) -> Vector:
        """Return a quantity in the square root of energy, flat, zero for idle rows."""
        unit, normal, tangent, tie = self.units
        flat = values.ravel()
        if name in ("displacement", "reaction"):
            return flat / unit if name == "displacement" else flat * unit
        length = dict(normal_force=normal, gap=normal, tie_force=tie).get(name, tangent)
        if name in ("gap", "slip"):
            return np.divide(flat, length, out=np.zeros_like(flat), where=length > 0)
        return flat * length if flat.size else flat

    @cached_property
    def units(self) -> tuple[Vector, Vector, Vector, Vector]:
        """Return the scale of unknowns, and the lengths of normal, tangential and tied rows in it."""
        problem, unit = self._problem, unknown_scale(self._problem)
        rows = (problem.normal, problem.tangent, problem.tie)
        normal, tangent, tie = (
            np.zeros(0) if one is None else np.sqrt(sp.csr_array(one).power(2) @ unit**2) for one in rows
        )
        return unit, normal, tangent, tie


def errors_of(problem: ContactProblem, of: str, rates: Rates, direction: Direction) -> Any:
    """Return the errors of rates of gaps, slips, friction and reactions, None if unknown.

    Parameters
    ----------
    problem, of : the problem of the answer, and the name of a quantity
    rates, direction : its rates, with bounds of displacement and forces, and their direction
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


def closed_on(problem: ContactProblem, contacts: Indices) -> Status:
    """Return states (m,) in which only these contacts are closed, without friction."""
    return np.where(np.isin(np.arange(problem.contacts), contacts), SLIP_ON, OPEN).astype(np.int8)


def rates_posed(problem: ContactProblem, closed: Indices, grazing: Indices) -> ContactProblem:
    """Return the problem of rates without friction, with grazing contacts as contacts and closed ones among its
    ties.
    """
    rows = sp.csr_array(sp.vstack([problem.tie, problem.normal[closed]]))
    posed = ContactProblem(
        problem.stiffness, np.zeros(problem.dimension), problem.normal[grazing], np.zeros(len(grazing)),
        tie=rows, tie_value=np.zeros(rows.shape[0]), near_null_space=problem.near_null_space,
    )  # fmt: skip
    posed._computed.wider_condensation = problem._computed.condensation
    return posed


def rates_at_rest(problem: ContactProblem, begins: Indices, holds: Indices, status: Status) -> ContactProblem:
    """Return the problem of rates of grazing contacts without slip, with friction; constrained rows are among its ties.

    Parameters
    ----------
    problem : of the answer
    begins, holds : contacts that graze, and those that are closed, of which none slips against friction
    status : (m,) array of int, of which those that stick hold their tangents, too
    """
    assert problem.tangent is not None
    assert problem.friction is not None
    width = shape_of_tangents(problem)[1]
    along, stuck = (
        np.add.outer(width * one, np.arange(width)).ravel() for one in (begins, holds[status[holds] == STICK])
    )
    tie = sp.csr_array(sp.vstack([problem.tie, problem.normal[holds], problem.tangent[stuck]]))
    return ContactProblem(
        problem.stiffness, np.zeros(problem.dimension), problem.normal[begins], np.zeros(len(begins)),
        tangent=problem.tangent[along], friction=problem.friction[begins], tie=tie, tie_value=np.zeros(tie.shape[0]),
        near_null_space=problem.near_null_space,
    )  # fmt: skip


def begin_in_one_way(problem: ContactProblem, begins: Indices, holds: Indices, status: Status) -> bool:
    """Return whether grazing contacts without slip are known to have unique rates for every change of data.

    Parameters
    ----------
    problem, begins, holds, status : as in `rates_at_rest`
    """
    try:
        return critical_friction(rates_at_rest(problem, begins, holds, status)).unique
    except Unsupported:
        return False


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
    """Return contacts whose row, gap and change of row are exact multiples of another's.

    Parameters
    ----------
    problem, turn : and the change (m, n) of its rows
    contacts, others : the contacts to check, and those of which they may be multiples
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


def named(problem: ContactProblem, contacts: Indices) -> str:
    """Return the names of some contacts."""
    names = [problem.contact_name(int(i)) for i in contacts[:SHOWN]]
    return f"{', '.join(names)}{f' and {len(contacts) - SHOWN} more' if len(contacts) > SHOWN else ''}"


def at_border(problem: ContactProblem, grazing: Indices, at_bound: Indices) -> str:
    """Return in words the grazing contacts and those that stick at their bounds."""
    kinds = ((grazing, "grazes", "graze"), (at_bound, "sticks at its bound", "stick at their bounds"))
    return "; ".join(
        f"{named(problem, which)} {one if len(which) == 1 else many}" for which, one, many in kinds if len(which)
    )


def missed(
    problem: ContactProblem, scales: Scales, found: Rates, direction: Direction, places: tuple[Indices, Indices]
) -> float:
    """Return the relative residual of rates in equilibrium and constraints.

    Parameters
    ----------
    problem, scales : of the answer, with friction in the plane
    found, direction : rates, and their direction
    places : the contacts that are closed, and that stick, in their system
    """
    tie_length = scales.units[3]
    assert problem.tangent is not None
    outer = found.reaction + direction.turned - problem.normal.T @ found.normal_force
    outer = outer - problem.tangent.T @ found.friction_force.ravel() - problem.tie.T @ found.tie_force
    closed, stuck = (np.isin(np.arange(problem.contacts), where) for where in places)
    held = (problem.tie @ found.displacement - direction.tie_value) / np.where(tie_length > 0, tie_length, 1.0)
    missed = [scales.of("reaction", outer), held, scales.of("gap", np.where(closed, found.gap, 0.0))]
    missed.append(scales.of("slip", np.where(stuck[:, None], found.slip, 0.0)))
    rates = [scales.of(name, getattr(found, name)) for name in ("displacement", "normal_force", "friction_force")]
    left = max(float(np.max(abs(one), initial=0.0)) for one in missed)
    return left / max([left, *(float(np.max(abs(one), initial=0.0)) for one in rates), TINY])


def turned_by_rounding(problem: ContactProblem, slip: Array, known: Solved) -> Vector:
    """Return the errors of directions of slips (m, 2) of an answer in doubles, infinite without slip."""
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    assert known.bound is not None
    off = abs(problem.tangent) @ (known.bound.displacement + 4 * EPS * abs(known.found.displacement))
    off = np.linalg.norm(off.reshape(slip.shape) + 4 * EPS * abs(problem.slip_origin), axis=1)
    size = np.linalg.norm(slip, axis=1)
    return np.asarray(8 * EPS + np.divide(2 * off, size, out=np.full(len(size), np.inf), where=size > 0))


def signs_hold(
    problem: ContactProblem, found: Rates, direction: Direction, sides: tuple[Indices, Indices], margin: float
) -> bool:
    """Return whether rates have positive forces at closing contacts, and positive gaps at opening ones.

    Parameters
    ----------
    problem, found, direction : the problem of the answer, rates with their bounds, and their direction
    sides, margin : as in `contactqp.analysis.rate_systems.RateSystem.where_signs_hold`
    """
    closing, opening = sides
    assert found.bound is not None
    off = errors_of(problem, "gap", found, direction)
    signs = np.concatenate([found.normal_force[closing], found.gap[opening]])
    signs += margin * np.concatenate([found.bound.normal[closing], off[opening]])
    return bool(np.all(signs > 0 if margin < 0 else signs >= 0))


def _gaps_of(problem: ContactProblem, known: Solved) -> tuple[Vector, Vector]:
    """Return the gaps (m,) of an answer, 0 for infinite ones, and their errors after refinement."""
    u = known.extended[0]
    given = np.where(np.isfinite(problem.gap), problem.gap, 0.0)
    moved = known.remainder * unknown_scale(problem) + EXTENDED_EPS * abs(u.hi)
    nothing = abs(problem.normal) @ moved + EXTENDED_EPS * abs(given)
    return (extend(given) - extended_rows(problem).normal @ u).double(), nothing


def touch(problem: ContactProblem, known: Solved, contacts: Indices) -> bool:
    """Return whether gaps of an answer are zero to twice double precision."""
    gaps, nothing = _gaps_of(problem, known)
    return bool(np.all(abs(gaps[contacts]) <= nothing[contacts] * (ROUNDED_AWAY / INVISIBLE)))


def parts_from(problem: ContactProblem, known: Solved, touching: Indices, closed: Indices) -> bool:
    """Return whether gaps of contacts that do not touch are positive, and touching ones that are not closed have zero
    gaps.

    Parameters
    ----------
    problem, known : and the answer beyond doubles
    touching, closed : contacts that touch, and those of them on which the answer is computed
    """
    gaps, nothing = _gaps_of(problem, known)
    apart = np.setdiff1d(np.flatnonzero(np.isfinite(problem.gap)), touching)
    return touch(problem, known, np.setdiff1d(touching, closed)) and bool(np.all(gaps[apart] > nothing[apart]))


def all_held(
    problem: ContactProblem, u: Extended, moved: Vector, data: Parts, places: tuple[Indices, Indices]
) -> bool:  # fmt: skip
    """Return whether closed contacts, sticking contacts and ties satisfy their data to twice double precision.

    Parameters
    ----------
    problem, u : and the displacement (n,)
    moved : (n,) array, its error after refinement, with rounding
    data : the values of gaps, slips and ties
    places : the contacts that are closed, and that stick
    """
    exact, width = extended_rows(problem), data.tangent.shape[1]
    along = np.add.outer(width * places[1], np.arange(width)).ravel()
    for rows, held, given, where in (
        (problem.normal, exact.normal @ u, data.normal, places[0]),
        (problem.tangent, exact.slip(u), data.tangent.ravel(), along),
        (problem.tie, exact.tie @ u, data.tie, np.arange(problem.ties)),
    ):
        if rows is not None and len(where):
            nothing = (abs(rows) @ moved + EXTENDED_EPS * abs(given)) * (ROUNDED_AWAY / INVISIBLE)
            if np.any(abs((extend(given) - held).double()[where]) > nothing[where]):
                return False
    return True
