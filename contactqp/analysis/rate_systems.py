"""The linear systems of the rates of an answer, whose contacts keep their states, and of their adjoints.

With c the closed contacts, b those that stick, t the directions of slip and C = E_T' diag(mu l_N/|s| (I - t t')) E_T,

    [ K + C   E_N' + E_T' diag(mu t)   E_T'   A' ] [ du   ]   [ load ]
    [ E_N                                        ] [ dl_N ] = [ gap  ]  of c
    [ E_T                                        ] [ dl_T ]   [ slip ]  of b
    [ A                                          ] [ dnu  ]   [ tie  ]

The factors that the answer was found with solve it in double precision (without friction `SaddlePoint`, with it
`StateSystem`, which knows the transposed system, too); residuals in twice double precision refine what they give, as
they refine answers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeAlias

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.dense import saddle_point
from contactqp.linalg.extended import Extended, SparseRows, extend, extended_rows, two_product
from contactqp.linalg.friction_states import StateSystem, friction_bound, slip_directions
from contactqp.linalg.refinement import CAUTION, INVISIBLE
from contactqp.model.arrays import EPS, Array, Vector, zero_beneath
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import AnswerOf

# Parameters that are vectors, or one for each direction of slip.
VECTORS = ("load", "gap", "tie_value", "friction", "slip_origin")
# Sweeps of refinement at most; two or three are made.
MAX_SWEEPS = 12
# Rates that differ by this part of the largest, in the square root of energy, are one.
SAME = 1e-9
# What a further sweep may change, as a part of the whole, when refinement stops: next to nothing beside rounding. Of
# gradients of large bodies, which have no bound and most of whose cost it is, it is what derivatives are right to.
ENOUGH, ENOUGH_OF_GRADIENTS = 2.0**-10 * EPS, 1e-9
# What sums of products in twice double precision are off by, as parts of their terms.
ROUNDED = 2.0**-92
# Solutions for data of random signs are of the size that those of the worst signs have over the root of their number;
# so many of them, and so many times as much, are taken.
PROBES, ALIKE = 3, 16.0
# Of fewer unknowns, whose factors are dense or nearly so, refinement costs next to nothing.
LARGE = 2000


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


class _System(Protocol):
    """What is refined by: an approximate inverse, and products of the unknowns with the system."""

    @property
    def contraction(self) -> float | None:
        """The part of a correction that its successor finds missing, where an answer's refinement has told it."""

    def correct(self, left: Parts, transposed: bool) -> Parts:
        """Return a solution in double precision."""

    def held(self, normal: Extended, slip: Extended, transposed: bool) -> Extended:
        """Return what the rows of normals hold, from E_N u and E_T u."""

    def friction(self, normal: Extended, slip: Vector, transposed: bool) -> Extended:
        """Return the friction (m (d-1),) of contacts that slip."""


# A solution, its bound, and what its data are off by; None where that is not known.
_Completed: TypeAlias = tuple[Parts, Parts | None, Parts | None]


class RateSystem:
    """The rates of one answer in one combination of states; `closed` and `stuck` are its places.

    Parameters
    ----------
    problem : ContactProblem
    condensation : Condensation, that of the problem
    status : (m,) array of int, the combination: OPEN, STICK, SLIP_BACK or SLIP_ON
    answer : Parts, displacements and forces whose rates are asked for

    Attributes
    ----------
    status : (m,) array of int, the combination
    regular : bool, whether the system has one solution for all data
    redundant : bool, whether rows depend on others, so that forces are not unique
    across : contacts in space that begin to slip (q,), and what is across their friction (q, 2), held by the last ties
    """

    across: tuple[NDArray[np.intp], Array] | None = None

    def __init__(self, problem: ContactProblem, condensation: Condensation, status: Status, answer: Parts) -> None:
        self._problem, self._exact, self.status = problem, extended_rows(problem), status
        self.closed, self.stuck = np.flatnonzero(status != OPEN), np.flatnonzero(status == STICK)
        self._unit = condensation.unknown_scale
        with_friction = problem.frictional
        self._system: _System
        if with_friction:
            frictional = _Frictional(problem, condensation, status, answer)
            self._system, self.regular, self.redundant = frictional, frictional.regular, False
            self.directions, self.turning = frictional.directions, frictional.turning
        else:
            plain = _Frictionless(problem, condensation, self.closed)
            self._system, self.redundant = plain, plain.redundant
            self.regular = not plain.redundant
            self.directions = np.zeros(shape_of_tangents(problem))
            self.turning = np.zeros((*self.directions.shape, self.directions.shape[1]))
        self._sizes = [
            np.sqrt(sp.csr_array(rows).power(2) @ self._unit**2) if rows is not None else np.zeros(0)
            for rows in (problem.normal, problem.tangent, problem.tie)
        ]

    def solve(self, right: Parts, transposed: bool = False, bounded: bool = True) -> Solved:
        """Return the solution of the system, or of the transposed one, which is refined for a bound.

        Without one that of a large body is not refined for a gradient where the answer's own refinement has told that
        a substitution leaves little, ten thousand times as much allowed.
        """
        given = (right.displacement, right.normal, right.tangent, right.tie)
        y = [Extended(np.zeros(part.size)) for part in given]
        last, contraction, size = np.inf, 1.0, 0.0
        once = transposed and not bounded and len(right.displacement) > LARGE
        foreseen = self._system.contraction if once else None
        for sweep in range(MAX_SWEEPS):
            left = self._on_own_rows(right) if sweep == 0 else self._residual(right, y, transposed)
            change = self._system.correct(left, transposed)
            parts = (change.displacement, change.normal, change.tangent.ravel(), change.tie)
            y = [whole + part for whole, part in zip(y, parts, strict=True)]
            size, whole_size = self._size(parts), self._size([part.double() for part in y])
            if sweep:
                contraction = size / last if last > 0 else 0.0
                if size * min(contraction * CAUTION, 1.0) <= ENOUGH * whole_size or size > 0.5 * last:
                    break
            elif foreseen is not None and foreseen * CAUTION <= ENOUGH_OF_GRADIENTS:
                contraction = foreseen
                break
            last = size
        u, normal, tangent, tie = zero_beneath(
            [part.double() for part in y], (1.0 / self._unit, *self._sizes), INVISIBLE * whole_size
        )
        found = Parts(u, normal, tangent.reshape(right.tangent.shape), tie)
        contraction = max(contraction, EPS)
        settled = contraction < 0.5
        remainder = np.inf
        if settled:
            remainder = size * min(contraction * CAUTION, 1.0) / (1 - contraction) + INVISIBLE * whole_size
        done = settled or size <= ENOUGH * whole_size
        return Solved(found, self._bound(found, remainder), done, tuple(y), remainder, transposed)

    def gap(self, solved: Solved, changes: Vector) -> Vector:
        """Return the rates of gaps (m,) whose own changes are given: bodies may move far, and gaps next to nothing."""
        u, push, *others = solved.extended
        whole = self._size([part.double() for part in (u, push, *others)])
        found = (extend(changes) - self._exact.normal @ u).double()
        per = np.divide(1.0, self._sizes[0], out=np.zeros_like(found), where=self._sizes[0] > 0)
        return zero_beneath([found], [per], INVISIBLE * whole)[0]

    def answer(self) -> Solved:
        """Return the answer where no slip turns, solution for the problem's own data, with the friction of slips."""
        problem, origin = self._problem, self._problem.slip_origin
        gap = np.where(np.isfinite(problem.gap), problem.gap, 0.0)
        slip = Parts.zero(problem).tangent if origin is None else origin
        solved = self.solve(Parts(problem.load, gap, slip, problem.tie_value))
        if problem.friction is None or not problem.frictional or solved.bound is None:
            return solved
        found, bound, dragged = solved.found, solved.bound, problem.friction[:, None] * self.directions
        tangent = found.tangent + dragged * found.normal[:, None]
        apart = bound.tangent + abs(dragged) * bound.normal[:, None] + 2 * EPS * abs(tangent)
        return replace(solved, found=replace(found, tangent=tangent), bound=replace(bound, tangent=apart))

    def completed(self, solved: Solved, data: Parts, own: Array, direction: Direction, known: Solved) -> _Completed:
        """Return a solution for data that the answer makes, its bound, and what these data are off by.

        Their products in doubles lack what twice double precision has; the system is solved for that, too. What is not
        known of the answer then is spread by the inverse, by solutions for such data of random signs.

        Parameters
        ----------
        solved, data : a solution, and the data in doubles that it is for
        own : (m, d-1) array, of the data, the friction of slips by a change of coefficients
        direction : that of stiffness, rows or coefficients
        known : the answer
        """
        problem, exact, (u, push, *_) = self._problem, self._exact, known.extended
        if not np.isfinite(known.remainder):
            return solved.found, None, None
        ends = (
            known.remainder * self._unit,
            np.divide(known.remainder, self._sizes[0], out=np.zeros_like(self._sizes[0]), where=self._sizes[0] > 0),
        )
        left_u, left_push = (end + ROUNDED * abs(one.hi) for end, one in zip(ends, (u, push), strict=True))
        load, gap, strained = extend(direction.load), extend(direction.gap), extend(direction.strained)
        lost, rest_load, rest_gap = extend(own.ravel()), np.zeros_like(left_u), np.zeros_like(left_push)
        if (dK := direction.stiffness) is not None:
            strained = -(SparseRows(dK) @ u)
            load, rest_load = load + strained, abs(dK) @ left_u
        if (dE := direction.rows) is not None:
            load, gap = load - SparseRows(dE.T) @ push, gap - SparseRows(dE) @ u
            rest_load, rest_gap = rest_load + abs(dE).T @ left_push, abs(dE) @ left_u
        if direction.friction.any() and problem.tangent is not None:
            lost = _products(direction.friction, push)
            lost = Extended(lost.hi * self.directions[:, 0], lost.lo * self.directions[:, 0])
            load, spread = load - exact.friction_force(lost), abs(direction.friction) * left_push
            rest_load = rest_load + abs(problem.tangent).T @ spread
        rest_load, rest_gap = rest_load + ROUNDED * abs(load.hi), rest_gap + ROUNDED * abs(gap.hi)
        low = (load - data.displacement).double(), (gap - data.normal).double()
        zero = Parts.zero(problem)
        rest = replace(zero, displacement=rest_load, normal=rest_gap)
        found, bound = self.with_more(solved, replace(zero, displacement=low[0], normal=low[1]), rest)
        off = Parts(
            abs((strained - direction.strained).double()) + rest_load, abs(low[1]) + rest_gap,
            abs((lost - own.ravel()).double()).reshape(own.shape) + (abs(direction.friction) * left_push)[:, None],
            zero.tie,
        )  # fmt: skip
        return found, bound, off

    def with_more(self, solved: Solved, low: Parts, rest: Parts) -> tuple[Parts, Parts | None]:
        """Return a solution with what its data in doubles lack, and its bound where the sum is off by up to `rest`."""
        more = self.solve(low, solved.transposed)
        found = Parts(*(getattr(solved.found, name) + getattr(more.found, name) for name in vars(low)))
        bounds = solved.bound, more.bound, self._bound(found, self._spread(rest, solved.transposed))
        if any(one is None for one in bounds):
            return found, None
        return found, Parts(*(sum(getattr(one, name) for one in bounds) for name in vars(low)))

    def _spread(self, rest: Parts, transposed: bool) -> float:
        """Return what data up to these sizes may change of a solution, by those of random signs."""
        rng, largest = np.random.default_rng(0), 0.0
        if not (rest.displacement.any() or rest.normal.any()):
            return 0.0
        for _ in range(PROBES):
            signed = Parts(*(part * rng.choice([-1.0, 1.0], part.shape) for part in vars(rest).values()))
            found = self._system.correct(self._on_own_rows(signed), transposed)
            largest = max(largest, self._size((found.displacement, found.normal, found.tangent.ravel(), found.tie)))
        return ALIKE * float(np.sqrt(rest.displacement.size + rest.normal.size)) * largest

    def unresolved(self) -> list[Parts]:
        """Return a basis of what may be added to solutions, with friction and where the system has no inverse."""
        assert isinstance(self._system, _Frictional)
        return self._system.unresolved()

    def _bound(self, found: Parts, remainder: float) -> Parts | None:
        """Return what further refinement and rounding to doubles may change of each part."""
        if not np.isfinite(remainder):
            return None
        normal, tangent, tie = (
            np.divide(remainder, size, out=np.zeros_like(size), where=size > 0) for size in self._sizes
        )
        return Parts(
            remainder * self._unit + EPS * abs(found.displacement),
            normal + EPS * abs(found.normal),
            tangent.reshape(found.tangent.shape) + EPS * abs(found.tangent),
            tie + EPS * abs(found.tie),
        )

    def _size(self, parts: tuple[Vector, ...] | list[Vector]) -> float:
        """Return the largest part, each in the square root of energy."""
        u, *forces = parts
        sizes = [abs(force) * size for force, size in zip(forces, self._sizes, strict=True) if force.size]
        return float(max([(abs(u) / self._unit).max(initial=0.0), *(size.max(initial=0.0) for size in sizes)]))

    def _on_own_rows(self, right: Parts) -> Parts:
        """Return data with zeros for contacts that are open and tangents that do not stick."""
        normal, tangent = np.zeros_like(right.normal), np.zeros_like(right.tangent)
        normal[self.closed], tangent[self.stuck] = right.normal[self.closed], right.tangent[self.stuck]
        return Parts(right.displacement, normal, tangent, right.tie)

    def _residual(self, right: Parts, y: list[Extended], transposed: bool) -> Parts:
        exact, (u, normal, tangent, tie) = self._exact, y
        slip = exact.slip(u)
        outer = extend(right.displacement) - exact.contact_force(normal, tie)
        if len(slip):
            outer = outer - exact.friction_force(tangent + self._system.friction(normal, slip.double(), transposed))
        held = self._system.held(exact.normal @ u, slip, transposed)
        return self._on_own_rows(
            Parts(
                (outer - exact.stiffness @ u).double(),
                (extend(right.normal) - held).double(),
                (extend(right.tangent.ravel()) - slip).double().reshape(right.tangent.shape)
                if len(slip)
                else right.tangent,
                (extend(right.tie) - exact.tie @ u).double(),
            )
        )


class _Frictionless:
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

    def held(self, normal: Extended, slip: Extended, transposed: bool) -> Extended:
        del slip, transposed
        return normal

    def friction(self, normal: Extended, slip: Vector, transposed: bool) -> Extended:
        del normal, transposed
        return Extended(np.zeros_like(slip))


class _Frictional:
    """The system of one combination of open, stick and slip at an answer."""

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
        self.turning = turns[:, None, None] * across  # (m, d-1, d-1)

    def correct(self, left: Parts, transposed: bool) -> Parts:
        data = left.displacement, left.normal, left.tangent.ravel(), left.tie
        return Parts.of(self._system.correct(*data, transposed=transposed))

    def unresolved(self) -> list[Parts]:
        """Return a basis of what may be added to solutions."""
        return [Parts.of(one) for one in self._system.unresolved()]

    def held(self, normal: Extended, slip: Extended, transposed: bool) -> Extended:
        """Return E_N u, of the transposed system (E_N + mu t'E_T) u."""
        if not transposed:
            return normal
        coefficient = np.zeros(self._shape[0]) if self._problem.friction is None else self._problem.friction
        along = (coefficient[:, None] * self.directions).ravel()
        dragged = _products(along, slip)
        width = self._shape[1]
        for k in range(width):
            normal = normal + Extended(dragged.hi[k::width], dragged.lo[k::width])
        return normal

    def friction(self, normal: Extended, slip: Vector, transposed: bool) -> Extended:
        turned: Vector = np.einsum("mij,mj->mi", self.turning, slip.reshape(self._shape)).ravel()
        return Extended(turned) if transposed else friction_bound(self._problem, normal, self.directions) + turned


def _products(factor: Vector, values: Extended) -> Extended:
    """Return the products of doubles and extended numbers, entry by entry."""
    product, error = two_product(factor, values.hi)
    return Extended(product, error + factor * values.lo)


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
