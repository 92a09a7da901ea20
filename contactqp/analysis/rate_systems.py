"""Solve the linear systems of the rates of an answer with fixed contact states, and the transposed systems.

With c the closed contacts, b those that stick, t the directions of slip and C = E_T' diag(mu l_N/|s| (I - t t')) E_T,

    [ K + C   E_N' + E_T' diag(mu t)   E_T'   A' ] [ du   ]   [ load ]
    [ E_N                                        ] [ dl_N ] = [ gap  ]  of c
    [ E_T                                        ] [ dl_T ]   [ slip ]  of b
    [ A                                          ] [ dnu  ]   [ tie  ]

The factors of the answer solve it in double precision (`SaddlePoint` without friction, `StateSystem` with friction,
also for the transposed system), refined by residuals in twice double precision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.analysis.rate_data import (
    EXTENDED_EPS,
    Direction,
    Parts,
    Rates,
    Solved,
    all_held,
    parts_from,
    shape_of_tangents,
    signs_hold,
    with_reaction,
)  # fmt: skip
from contactqp.analysis.slip_law import FactorisedStates, Frictional, Frictionless, SlipLaw, times
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.extended import Extended, SparseRows, extend, extended_rows
from contactqp.linalg.refinement import CAUTION
from contactqp.model.arrays import EPS, INVISIBLE, Array, Vector, zero_beneath
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.problem import ContactProblem

# The most sweeps of refinement; usually two or three are made.
MAX_SWEEPS = 12
# The relative change by a further sweep at which refinement stops, far below rounding. For gradients of large bodies,
# which have no bound and for which refinement is the main cost, it is the accuracy of derivatives.
ENOUGH, ENOUGH_OF_GRADIENTS = 2.0**-10 * EPS, 1e-9
# Solutions for random signs have the size of those for the worst signs over the root of their number. The number of
# samples, and the safety factor.
PROBES, ALIKE = 3, 16.0
# With fewer unknowns, whose factors are dense, refinement costs little.
LARGE = 2000


# A solution, the errors of its data or None, and friction if slips turn.
Completed: TypeAlias = tuple[Solved, Parts | None, Array | None]


class RateSystem:
    """The rates of one answer in one combination of states, with the indices `closed` and `stuck`.

    Parameters
    ----------
    problem : ContactProblem
    condensation : Condensation, that of the problem
    status : (m,) array of int, the combination: OPEN, STICK, SLIP_BACK or SLIP_ON
    answer : Parts, displacements and forces whose rates are asked for
    independent : whether of rows with friction that depend on others, to be held by these, only as many act

    Attributes
    ----------
    status : (m,) array of int, the combination
    regular : bool, whether the system has a unique solution for all data
    redundant : bool, whether rows are dependent, so that forces are not unique
    turns : bool, whether slips in space turn their friction
    across : contacts in space that begin to slip (q,), what is across their friction (q, 2), held by the last ties, and
        what that may be off by (q,)
    law : SlipLaw, of the contacts that slip; that of doubles until `answer` has told what these lack
    """

    across: tuple[NDArray[np.intp], Array, Vector] | None = None

    def __init__(
        self, problem: ContactProblem, condensation: Condensation, status: Status, answer: Parts,
        independent: bool = False,
    ) -> None:  # fmt: skip
        self._problem, self._exact, self.status = problem, extended_rows(problem), status
        self.closed, self.stuck = np.flatnonzero(status != OPEN), np.flatnonzero(status == STICK)
        self._unit, self._answer, self._condensation = condensation.unknown_scale, answer, condensation
        self._independent = independent
        with_friction = problem.frictional
        self._system: FactorisedStates
        if with_friction:
            frictional = Frictional(problem, condensation, status, answer, independent)
            self._system, self.regular, self.redundant = frictional, frictional.regular, False
            self.directions, self.turning, turns = frictional.directions, frictional.turning, frictional.turns
        else:
            plain = Frictionless(problem, condensation, self.closed)
            self._system, self.redundant = plain, plain.redundant
            self.regular = not plain.redundant
            self.directions = np.zeros(shape_of_tangents(problem))
            self.turning = np.zeros((*self.directions.shape, self.directions.shape[1]))
            turns = np.zeros(problem.contacts)
        coefficient = np.zeros(problem.contacts) if problem.friction is None else problem.friction
        self.law = SlipLaw.of_doubles(coefficient, self.directions, turns)
        slides = (status != OPEN) & (status != STICK) & (coefficient > 0)
        self.turns = with_friction and self.directions.shape[1] > 1 and bool(slides.any())
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

        def left(y: list[Extended], sweep: int) -> Parts:
            friction = None if sweep == 0 else self._friction(y, transposed)
            return self._on_own_rows(right) if friction is None else self._residual(right, y, transposed, friction)

        once = transposed and not bounded and len(right.displacement) > LARGE
        foreseen = self._system.contraction if once else None
        solved = self._refined([Extended(np.zeros(part.size)) for part in given], left, transposed, foreseen)
        if self._independent and not (transposed or self._holds(solved, right)):
            return replace(solved, bound=None, remainder=np.inf)
        if not (bounded and self.law.off.any() and np.isfinite(solved.remainder)):
            return solved
        remainder = solved.remainder + self._spread(self._rest_of_law(solved.found, transposed), transposed)
        return replace(solved, bound=self._bound(solved.found, remainder), remainder=remainder)

    def _refined(
        self, y: list[Extended], left: Callable[[list[Extended], int], Parts], transposed: bool,
        foreseen: float | None = None,
    ) -> Solved:  # fmt: skip
        """Refine a solution until its remainder, computed by a function, is negligible.

        If slips turn, at least three sweeps are made and the slowest is used, as slow convergence for small slips may
        not be visible at first.

        Parameters
        ----------
        y : the start: displacement, normal forces, flat tangents and ties
        left : function of the solution and the sweep, returns its residual in doubles
        transposed : whether the system is the transposed one
        foreseen : the contraction, if one sweep may suffice
        """
        last, contraction, size = np.inf, 1.0, 0.0
        for sweep in range(MAX_SWEEPS):
            change = self._system.correct(left(y, sweep), transposed)
            parts = (change.displacement, change.normal, change.tangent.ravel(), change.tie)
            y = [whole + part for whole, part in zip(y, parts, strict=True)]
            size, whole_size = self._size(parts), self._size([part.double() for part in y])
            if sweep and self.turns:
                ratio = size / last if last > INVISIBLE * whole_size else 0.0
                contraction = ratio if sweep == 1 else max(contraction, ratio)
                if ratio > 0.5 or (sweep > 1 and size <= INVISIBLE * whole_size):
                    break
            elif sweep:
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
        found = Parts(u, normal, tangent.reshape(self.directions.shape), tie)
        contraction = max(contraction, EPS)
        settled = contraction < 0.5
        remainder = np.inf
        if settled:
            remainder = size * min(contraction * CAUTION, 1.0) / (1 - contraction) + INVISIBLE * whole_size
        done = settled or size <= ENOUGH * whole_size
        return Solved(found, self._bound(found, remainder), done, tuple(y), remainder, transposed)

    def rates(self, direction: Direction, push: Vector, known: Solved | None) -> Rates | None:
        """Return the rates along a direction, None if refinement failed.

        Parameters
        ----------
        direction : the change of load, gaps, stiffness and so on
        push : (m,) array, contact forces of the answer [force]
        known : the answer beyond double precision, if available
        """
        problem = self._problem
        load, slip_origin = direction.whole_load, direction.slip_origin
        own = np.zeros_like(slip_origin)  # friction of slipping contacts, in addition to that of the rates
        if problem.tangent is not None and problem.frictional:
            own = (direction.friction * push)[:, None] * self.directions
            own -= np.einsum("mij,mj->mi", self.turning, slip_origin)
            load = load - problem.tangent.T @ own.ravel()
        tie_value = direction.tie_value
        if (begin := self.across) is not None:
            tie_value = np.concatenate([tie_value, np.sum(begin[1] * slip_origin[begin[0]], axis=1)])
        data = Parts(load, direction.whole_gap, slip_origin, tie_value)
        solved, off, friction = self.solve(data), None, None
        if not solved.settled:
            return None
        if known is not None and (direction.by_answer or self.turns):
            solved, off, friction = self.completed(solved, data, own, direction, known)
        rates = self.of_parts(direction, solved.found, solved.bound, own, friction)
        return replace(rates, off=off, gap=self.gap(solved, data.normal) if direction.rows is None else rates.gap)

    def where_signs_hold(
        self, direction: Direction, push: Vector, known: Solved | None,
        sides: tuple[NDArray[np.intp], NDArray[np.intp]], margin: float,
    ) -> Rates | None:  # fmt: skip
        """Return rates without friction and their bounds, None if these are unknown or their signs do not agree.

        Parameters
        ----------
        direction, push, known : as in `rates`
        sides : contacts that are to push at these rates, and contacts that are to open or to stay
        margin : the error of signs allowed, in units of bounds; if negative, signs must be certain
        """
        found = self.rates(direction, push, known) if self.regular else None
        return found if found and found.bound and signs_hold(self._problem, found, direction, sides, margin) else None

    def of_parts(
        self, direction: Direction, found: Parts, bound: Parts | None, own: Array, drag: Array | None = None
    ) -> Rates:
        """Return the rates given by a solution of the system.

        Parameters
        ----------
        direction : the direction of the rates
        found, bound : the solution, and its bound
        own : (m, d-1) array, the friction of slips contained in the data
        drag : (m, d-1) array, the rates of friction where they are known beyond doubles
        """
        problem, friction = self._problem, found.tangent
        if drag is not None:
            friction = drag
        elif problem.tangent is not None and problem.friction is not None and problem.frictional:
            dragged = (problem.friction * found.normal)[:, None] * self.directions
            moved = (problem.tangent @ found.displacement).reshape(friction.shape)
            friction = friction + dragged + own + np.einsum("mij,mj->mi", self.turning, moved)
        if (begin := self.across) is not None:
            (contacts, across, _), ties = begin, problem.ties - len(begin[0])
            friction = friction.copy()
            friction[contacts] += found.tie[ties:, None] * across
            found, bound = replace(found, tie=found.tie[:ties]), bound and replace(bound, tie=bound.tie[:ties])
        return with_reaction(problem, direction, found, friction, self.status, bound)

    def gap(self, solved: Solved, changes: Vector) -> Vector:
        """Return the rates of gaps (m,) with given changes of their data, accurate also if motions are much larger."""
        u, push, *others = solved.extended
        whole = self._size([part.double() for part in (u, push, *others)])
        found = (extend(changes) - self._exact.normal @ u).double()
        per = np.divide(1.0, self._sizes[0], out=np.zeros_like(found), where=self._sizes[0] > 0)
        return zero_beneath([found], [per], INVISIBLE * whole)[0]

    def carries(self, known: Solved, touching: NDArray[np.intp]) -> bool:
        """Return whether the answer on these closed contacts is confirmed.

        Each of them has a positive force, the other touching ones have zero gaps to twice double precision, and all
        others are open.
        """
        if known.bound is None or not np.all(known.found.normal[self.closed] > known.bound.normal[self.closed]):
            return False
        return parts_from(self._problem, known, touching, self.closed)

    def of_independent_rows(self) -> RateSystem:
        """Return the system on independent rows, with bounds if all rows are satisfied."""
        return RateSystem(self._problem, self._condensation, self.status, self._answer, True)

    def _holds(self, solved: Solved, right: Parts) -> bool:
        """Return whether a solution satisfies all closed and sticking rows to twice double precision."""
        left = min(solved.remainder, np.finfo(float).max) * self._unit + EXTENDED_EPS * abs(solved.extended[0].hi)
        return all_held(self._problem, solved.extended[0], left, right, (self.closed, self.stuck))

    def answer(self) -> Solved:
        """Return the answer, the solution for the problem's data, with the friction of slips.

        In space that is by Newton's method, from the answer in doubles, and `law` is then that of the solution.
        """
        problem, origin = self._problem, self._problem.slip_origin
        gap = np.where(np.isfinite(problem.gap), problem.gap, 0.0)
        data = Parts(problem.load, gap, Parts.zero(problem).tangent if origin is None else origin, problem.tie_value)
        solved = self._newton(data) if self.turns else self.solve(data)
        if problem.friction is None or not problem.frictional or solved.bound is None:
            return solved
        found, bound = solved.found, solved.bound
        dragged = self.law.dragged(extend(found.normal)).double().reshape(self.directions.shape)
        apart = problem.friction * bound.normal + self.law.error_of_dragged(found.normal)
        tangent = found.tangent + dragged
        apart = bound.tangent + apart[:, None] + 2 * EPS * abs(tangent)
        return replace(solved, found=replace(found, tangent=tangent), bound=replace(bound, tangent=apart))

    def _newton(self, data: Parts) -> Solved:
        """Return the answer to the problem's data if slips turn, and store its law, without bound if it failed."""
        problem, start, origin = self._problem, self._answer, data.tangent.ravel()
        assert problem.tangent is not None
        coefficient = self.law.coefficient

        def slip_of(u: Extended) -> Extended:
            return self._exact.slip(u) - origin

        def left(y: list[Extended], sweep: int) -> Parts:
            del sweep
            none = np.zeros(problem.contacts)
            law = SlipLaw.at(coefficient, self.status, slip_of(y[0]), y[1], none, none)
            return self._residual(data, y, False, law.dragged(y[1]))

        push, sticks = np.where(self.status != OPEN, start.normal, 0.0), np.zeros(self.directions.size)
        first = [Extended(one) for one in (start.displacement, push, sticks, start.tie)]
        solved = self._refined(first, left, False)
        # Small slips of an answer in doubles have inaccurate directions, which are corrected by Newton's method.
        rounded = [part.double() for part in solved.extended]
        found = Parts(
            rounded[0], rounded[1], slip_of(solved.extended[0]).double().reshape(self.directions.shape), start.tie
        )
        self._system = frictional = Frictional(problem, self._condensation, self.status, found, self._independent)
        self.directions, self.turning = frictional.directions, frictional.turning
        solved = self._refined([Extended(part) for part in rounded], left, False)
        if not (frictional.regular and np.isfinite(solved.remainder)):
            return replace(solved, bound=None, remainder=np.inf)
        u, normal = solved.extended[:2]
        moved = solved.remainder * self._unit + EXTENDED_EPS * abs(u.hi)
        off_slip = (abs(problem.tangent) @ moved + EXTENDED_EPS * abs(origin)).reshape(self.directions.shape)
        off_push = self._forces(solved.remainder, 0) + EXTENDED_EPS * abs(normal.hi)
        law = SlipLaw.at(coefficient, self.status, slip_of(u), normal, np.linalg.norm(off_slip, axis=1), off_push)
        if not law.is_known:
            return replace(solved, bound=None, remainder=np.inf)
        self.law = law
        return solved

    def _forces(self, remainder: float, which: int) -> Vector:
        """Return a remainder in the square root of energy as normal, tangential or tie forces."""
        size = self._sizes[which]
        return np.divide(remainder, size, out=np.zeros_like(size), where=size > 0)

    def completed(self, solved: Solved, data: Parts, own: Array, direction: Direction, known: Solved) -> Completed:
        """Return a solution for data computed from the answer, the errors of these data, and friction if slips turn.

        The rounding of their products in doubles is corrected by another solution. The effect of the answer's error is
        estimated by solutions for such data of random signs.

        Parameters
        ----------
        solved, data : a solution, and the data in doubles that it is for
        own : (m, d-1) array, of the data, the friction of slips by a change of coefficients or of their origins
        direction : the change of stiffness, rows or coefficients
        known : the answer
        """
        problem, exact, (u, push, *_) = self._problem, self._exact, known.extended
        if not np.isfinite(known.remainder):
            return replace(solved, bound=None), None, None
        ends = known.remainder * self._unit, self._forces(known.remainder, 0)
        left_u, left_push = (end + EXTENDED_EPS * abs(one.hi) for end, one in zip(ends, (u, push), strict=True))
        load, gap, strained = extend(direction.load), extend(direction.gap), extend(direction.strained)
        rest_load, rest_gap = np.zeros_like(left_u), np.zeros_like(left_push)
        if (dK := direction.stiffness) is not None:
            strained = -(SparseRows(dK) @ u)
            load, rest_load = load + strained, abs(dK) @ left_u
        if (dE := direction.rows) is not None:
            load, gap = load - SparseRows(dE.T) @ push, gap - SparseRows(dE) @ u
            rest_load, rest_gap = rest_load + abs(dE).T @ left_push, abs(dE) @ left_u
        lost, spread = extend(own.ravel()), np.zeros_like(left_push)
        if problem.tangent is not None and own.any():
            lost = self.law.dragged(push, direction.friction) - self.law.turned(extend(direction.slip_origin.ravel()))
            spread = abs(direction.friction) * left_push + self.law.error_of_dragged(push.hi, direction.friction)
            spread = spread + self.law.error_of_turned(direction.slip_origin)
            load = load - exact.friction_force(lost)
            rest_load = rest_load + abs(problem.tangent).T @ np.repeat(spread, own.shape[1])
        inexact = direction.by_answer or bool(own.any())
        if inexact:
            rest_load, rest_gap = rest_load + EXTENDED_EPS * abs(load.hi), rest_gap + EXTENDED_EPS * abs(gap.hi)
            low = (load - data.displacement).double(), (gap - data.normal).double()
            zero = Parts.zero(problem)
            rest = replace(zero, displacement=rest_load, normal=rest_gap)
            solved = self.with_more(solved, replace(zero, displacement=low[0], normal=low[1]), rest)
        off = Parts(
            abs((strained - direction.strained).double()) + rest_load,
            abs((gap - direction.whole_gap).double()) + rest_gap,
            abs((lost - own.ravel()).double()).reshape(own.shape) + spread[:, None],
            np.zeros(problem.ties),
        )
        if not self.turns:
            return solved, off, None
        friction, unknown = self._drag_of(solved, lost)
        if (begin := self.across) is not None and solved.bound is not None:
            (contacts, _, unsure), last = begin, slice(-len(begin[0]), None)
            unknown[contacts] += solved.bound.tie[last] + (unsure + 8 * EPS) * abs(solved.found.tie[last])
        return solved, replace(off, tangent=np.repeat((unknown + spread)[:, None], own.shape[1], axis=1)), friction

    def _drag_of(self, solved: Solved, own: Extended) -> tuple[Array, Vector]:
        """Return rates of friction (m, 2) if slips turn, and their errors beyond those of contact forces."""
        problem, law, (u, normal, tangent, _) = self._problem, self.law, solved.extended
        assert problem.tangent is not None
        slip = self._exact.slip(u)
        friction = (tangent + law.dragged(normal) + law.turned(slip) + own).double().reshape(self.directions.shape)
        slips, remainder = slip.double().reshape(friction.shape), min(solved.remainder, np.finfo(float).max)
        moved = (abs(problem.tangent) @ (remainder * self._unit + EXTENDED_EPS * abs(u.hi))).reshape(friction.shape)
        unknown = law.error_of_dragged(normal.hi) + law.error_of_turned(slips)
        return friction, unknown + abs(law.turns.hi) * np.linalg.norm(moved, axis=1)

    def with_more(self, solved: Solved, low: Parts, rest: Parts) -> Solved:
        """Return a solution corrected by the low parts of its data, and its bound for data errors up to `rest`."""
        more, spread = self.solve(low, solved.transposed), self._spread(rest, solved.transposed)
        found = Parts(*(getattr(solved.found, name) + getattr(more.found, name) for name in vars(low)))
        bounds = solved.bound, more.bound, self._bound(found, spread)
        known = all(one is not None for one in bounds)
        bound = Parts(*(sum(getattr(one, name) for one in bounds) for name in vars(low))) if known else None
        whole = tuple(one + other for one, other in zip(solved.extended, more.extended, strict=True))
        remainder = solved.remainder + more.remainder + spread
        return replace(solved, found=found, bound=bound, extended=whole, remainder=remainder)

    def _rest_of_law(self, found: Parts, transposed: bool) -> Parts:
        """Return the largest residual in the data of a solution due to the error of the law."""
        problem, law, zero = self._problem, self.law, Parts.zero(self._problem)
        assert problem.tangent is not None
        slip = (problem.tangent @ found.displacement).reshape(self.directions.shape)
        friction, normal = law.error_of_turned(slip), zero.normal
        if transposed:
            normal = law.error_of_dragged(np.linalg.norm(slip, axis=1))
        else:
            friction = friction + law.error_of_dragged(found.normal)
        tie = zero.tie
        if (begin := self.across) is not None:
            (contacts, _, unsure), last = begin, slice(-len(begin[0]), None)
            tie[last] = unsure * np.linalg.norm(slip[contacts], axis=1)
            friction[contacts] += unsure * abs(found.tie[last])
        load = abs(problem.tangent).T @ np.repeat(friction, slip.shape[1])
        return replace(zero, displacement=load, normal=normal, tie=tie)

    def _spread(self, rest: Parts, transposed: bool) -> float:
        """Return the change of a solution by data up to these sizes, estimated with random signs."""
        rng, largest = np.random.default_rng(0), 0.0
        if not any(part.any() for part in vars(rest).values()):
            return 0.0
        for _ in range(PROBES):
            signed = Parts(*(part * rng.choice([-1.0, 1.0], part.shape) for part in vars(rest).values()))
            found = self._system.correct(self._on_own_rows(signed), transposed)
            largest = max(largest, self._size((found.displacement, found.normal, found.tangent.ravel(), found.tie)))
        return ALIKE * float(np.sqrt(sum(part.size for part in vars(rest).values()))) * largest

    def unresolved(self) -> list[Parts]:
        """Return a basis of the null space of a singular system with friction."""
        assert isinstance(self._system, Frictional)
        return self._system.unresolved()

    def _bound(self, found: Parts, remainder: float) -> Parts | None:
        """Return the largest change of each part by further refinement and rounding to doubles."""
        if not np.isfinite(remainder):
            return None
        normal, tangent, tie = (self._forces(remainder, which) for which in range(3))
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
        """Return data with zeros for open contacts and tangents that do not stick."""
        normal, tangent = np.zeros_like(right.normal), np.zeros_like(right.tangent)
        normal[self.closed], tangent[self.stuck] = right.normal[self.closed], right.tangent[self.stuck]
        return Parts(right.displacement, normal, tangent, right.tie)

    def _friction(self, y: list[Extended], transposed: bool) -> Extended:
        """Return the friction (flat) of slipping contacts, or the corresponding part of the transposed system."""
        _, normal, tangent, _ = y
        if not (len(tangent) and self._problem.frictional):
            return Extended(np.zeros(len(tangent)))
        turned = self.law.turned(self._exact.slip(y[0]))
        return turned if transposed else turned + self.law.dragged(normal)

    def _residual(self, right: Parts, y: list[Extended], transposed: bool, friction: Extended) -> Parts:
        exact, (u, normal, tangent, tie) = self._exact, y
        slip, held = exact.slip(u), exact.normal @ u
        outer = extend(right.displacement) - exact.contact_force(normal, tie)
        if len(slip):
            outer = outer - exact.friction_force(tangent + friction)
        if transposed and len(slip) and self._problem.frictional:
            held = held + times(Extended(self.law.coefficient), self.law.along(slip))
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
