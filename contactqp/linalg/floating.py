"""Floating bodies: their rigid motions, the position where contacts stop them, and forces that balance the load.

With Z the rigid motions of all bodies as columns, a body moved by Z a touches without deforming where

    max f'Z a    subject to    E_N Z a <= g,  A Z a = b,

a linear program with few unknowns. Its multipliers are contact forces that balance the load on every motion, its active
contacts hold the bodies, and if it is unbounded the load drives a motion that nothing resists.

Condensed, the answer on closed contacts B of bodies that may float comes from the null-space method (`NullSpace`;
Nocedal and Wright 2006, section 16.2): with [E_B; A]' P = Q R, x = Y R^-T (e; a) + N v, N'SN v = N'(r - S Y ...).
Dependent rows get no force, and unresisted rigid motions of K are zero.

Vectors are the part of one process, as in `contactqp.linalg.contact_iteration`; sums are over all processes.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NoEquilibrium, NotConverged
from contactqp.linalg.dense import BALANCED, IDLE, REGULAR, Condensed, DenseCholesky, orthonormal
from contactqp.linalg.equilibration import balancing_factors
from contactqp.linalg.factorization import connected_parts, right_singular
from contactqp.linalg.krylov import ConstrainedRows, Processes
from contactqp.linalg.measures import largest_of_bodies, reciprocal
from contactqp.linalg.nonnegative import highs, shift_within_gaps
from contactqp.linalg.runtime import lapack
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem

# A unit motion is not resisted by unit rows whose products with it are below this.
UNRESISTED = 1e-9
SAME_DIGITS = 12  # unit rows that agree to so many digits are one
NO_ROOM = 0.5  # the least room that counts, where any room is scaled to 1
Lengths = Callable[[Vector], Vector]
# The work of a load on a motion is rounding below this part of the sum of its terms.
WORKLESS = 1e-10
# Multipliers of the linear program below this part of the largest count as zero.
NO_MULTIPLIER = 1e-9
# SciPy's status codes of linear programs.
_INFEASIBLE, _UNBOUNDED = 2, 3
_DRIVEN = "the load drives a rigid motion that no contact and no tie holds back"


class MotionProjections:
    """Projections that remove D-orthonormal motions z (n_here, r) with K z = 0. Both are collective."""

    def __init__(self, processes: Processes, diagonal: Vector, motions: Array) -> None:
        self._processes, self._diagonal, self.motions = processes, diagonal, motions

    def admit(self, z: Vector) -> None:
        """Remove the motions from a displacement, in the metric of D, in place."""
        if self.motions.shape[1]:
            z -= self.motions @ self._processes.sum(self.motions.T @ (self._diagonal * z))

    def balanced(self, r: Vector) -> Vector:
        """Return the force with the same work on deformations and no work on the motions."""
        if not self.motions.shape[1]:
            return r.copy()
        return np.asarray(r - self._diagonal * (self.motions @ self._processes.sum(self.motions.T @ r)))


class FloatingMotions(MotionProjections):
    """The rigid motions of the bodies of a problem and its rows, contacts first.

    All methods are collective but `with_rows`.

    Parameters
    ----------
    processes : Processes, those that share the problem
    diagonal : (n_here,) array, D, the diagonal of K, positive [force / length]
    motions : (n_here, r) array, Z, orthonormal in the metric of D; no columns where all bodies are supported
    contacts : int, the number m_here of contacts
    lengths : function, returns E z (a,) of all rows, contacts first
    compliance : (a,) array, E_i D^-1 E_i' of the rows [length / force]
    """

    def __init__(
        self,
        processes: Processes,
        diagonal: Vector,
        motions: Array,
        contacts: int,
        lengths: Lengths,
        compliance: Vector,
    ) -> None:
        super().__init__(processes, diagonal, motions)
        self.contacts = contacts
        self._set_rows(lengths, compliance)

    def with_rows(self, lengths: Lengths, compliance: Vector) -> FloatingMotions:
        """Return the motions with other rows, beginning with the same contacts, and their E_i D^-1 E_i'."""
        other = copy(self)
        other.__dict__.pop("moved", None)
        other._set_rows(lengths, compliance)
        return other

    def _set_rows(self, lengths: Lengths, compliance: Vector) -> None:
        self._lengths = lengths
        self._stiffness = reciprocal(compliance)

    @property
    def count(self) -> int:
        """Return the number r of motions."""
        return int(self.motions.shape[1])

    @cached_property
    def moved(self) -> Array:
        """Return E Z (a, r), with rounding errors set to zero, so that these rows do not resist the motion."""
        own = np.sqrt(reciprocal(self._stiffness))
        columns = [np.zeros((len(own), 0))]
        for z in self.motions.T:
            size = self._processes.max(float(np.max(np.sqrt(self._diagonal) * abs(z), initial=0.0)))
            lengths = self._lengths(z)
            columns.append(np.where(abs(lengths) > UNRESISTED * own * size, lengths, 0.0)[:, None])
        return np.hstack(columns)

    def resting(self, load: Vector, limit: Vector) -> tuple[Vector, Mask]:
        """Return the rigid displacement (n_here,) to which the load moves the bodies, and the contacts that stop them.

        Raises NoEquilibrium: the load drives a motion that nothing resists; NotConverged: the linear program found
        neither a position nor such a motion.
        """
        work = self._work(load)
        every = self._processes.gathered(self.moved), self._processes.gathered(limit)
        contact = self._processes.gathered(np.arange(len(limit)) < self.contacts)
        a, force = self._processes.broadcast(
            resting_place(work, *every, contact) if self._processes.rank == 0 else None
        )
        if isinstance(a, str):
            raise (NoEquilibrium if a == _DRIVEN else NotConverged)(a)
        first = self._processes.offset(len(limit))
        push = force * np.max(abs(every[0]), axis=1, initial=0.0)  # independent of the scale of a row
        pressed = push[first : first + self.contacts] > NO_MULTIPLIER * np.max(abs(push), initial=0.0)
        return self.motions @ a, pressed

    def loose(self, closed: Mask) -> Array:
        """Return orthonormal coefficients (r, q) of the motions that no closed contact and no tie resists."""
        holding = np.append(closed, np.ones(len(self._stiffness) - self.contacts, dtype=bool))
        values, turned = self._singular_values(np.where(holding, self._stiffness, 0.0))
        return turned[:, values <= UNRESISTED * np.max(values, initial=0.0)]

    def _singular_values(self, weight: Vector) -> tuple[Vector, Array]:
        """Return the singular values (r,) of sqrt(weight) E Z, and its right singular vectors as columns."""
        here = np.linalg.qr(np.sqrt(weight)[:, None] * self.moved, mode="r")
        every = self._processes.gathered(np.vstack([here, np.zeros((1, self.count))]))
        _, values, turned = np.linalg.svd(every)
        return np.append(values, np.zeros(self.count - len(values))), turned.T

    def holds(self, closed: Mask, load: Vector) -> bool:
        """Return whether closed contacts and ties resist every motion that the load drives."""
        loose, work = self.loose(closed), self._work(load)
        return not np.any(abs(loose.T @ work) > WORKLESS * (abs(loose).T @ abs(work)))

    def projections(self, rows: ConstrainedRows, closed: Mask) -> ConstrainedRows:
        """Return the projections of constrained rows that also remove motions that no closed contact or tie resists.

        Iterates are otherwise arbitrary along these motions.
        """
        loose = self.loose(closed) if self.count else np.zeros((0, 0))
        if not loose.shape[1]:
            return rows
        return _ProjectionsWithMotions(rows, MotionProjections(self._processes, self._diagonal, self.motions @ loose))

    def at_rest(self, displacement: Vector, normal_force: Vector, gap: Vector) -> tuple[Vector, Array]:
        """Return the displacement of least norm within the gaps, and orthonormal motions (n_here, q) that are free."""
        free = self.motions @ self.loose(normal_force > 0)
        gram = self._processes.sum(free.T @ free)
        values, vectors = np.linalg.eigh(gram)
        free = free @ (vectors / np.sqrt(values))
        if not free.shape[1]:
            return displacement, free
        rows = np.column_stack([self._lengths(z)[: self.contacts] for z in free.T])
        room = gap - self._lengths(displacement)[: self.contacts]
        size = self._processes.max(float(np.max(np.sqrt(self._diagonal)[:, None] * abs(free), initial=0.0)))
        own = 1 / np.sqrt(self._stiffness[: self.contacts])
        moved = np.linalg.norm(rows, axis=1) > UNRESISTED * own * size
        shift = -self._processes.sum(free.T @ displacement)
        every, room = self._processes.gathered(rows[moved]), self._processes.gathered(room[moved])
        if len(room):
            shift = shift_within_gaps(every, room, shift)
        return displacement + free @ shift, free

    def _work(self, load: Vector) -> Vector:
        """Return Z'f (r,), zero where it is rounding."""
        work, size = self._processes.sum(np.stack([self.motions.T @ load, abs(self.motions).T @ abs(load)]))
        return np.where(abs(work) > WORKLESS * size, work, 0.0)

    def balance(self, residual: Vector, weight: Vector) -> Vector:
        """Return the forces l (a,), least in the metric of 1/weight, with Z'(r - E'l) = 0 for a residual r."""
        if not self.count:
            return np.zeros(len(self._stiffness))
        values, turned = self._singular_values(weight)
        resisted = values > UNRESISTED * np.max(values)
        work = turned[:, resisted].T @ self._processes.sum(self.motions.T @ residual)
        return np.asarray(weight * (self.moved @ (turned[:, resisted] @ (work / values[resisted] ** 2))))


class _ProjectionsWithMotions:
    """Projections of constrained rows, and of motions that do not move these rows."""

    def __init__(self, rows: ConstrainedRows, motions: MotionProjections) -> None:
        self._rows, self._motions = rows, motions
        self.close, self.forces = rows.close, rows.forces

    def admit(self, z: Vector) -> None:
        self._rows.admit(z)
        self._motions.admit(z)

    def balanced(self, r: Vector) -> Vector:
        return self._motions.balanced(self._rows.balanced(r))


def resting_place(work: Vector, moved: Array, limit: Vector, contact: Mask) -> tuple[Vector | str, Vector]:
    """Solve the linear program of rigid motions under a load.

    Where no rigid motion removes an overlap of bodies, overlapping contacts count as touching.

    Parameters
    ----------
    work : (r,) array, the work Z'f of the load on each motion
    moved : (a, r) array, E Z of contacts and ties
    limit : (a,) array, g and b [length]
    contact : (a,) array of bool, which rows are contacts; the others are ties

    Returns
    -------
    coefficients : (r,) array or str
        The resting place, or why there is none.
    force : (a,) array
        The contact forces that balance the load there; 0 on ties.
    """
    size = np.max(abs(moved), axis=1, initial=0.0)
    acting = size > 0
    for reach in (limit, np.where(contact, np.maximum(limit, 0.0), 0.0)):
        found = _program(work, moved[acting] / size[acting, None], reach[acting] / size[acting], contact[acting])
        if found.status != _INFEASIBLE:
            break
    if found.status == _UNBOUNDED:
        return _DRIVEN, limit
    if found.x is None:
        return f"the resting place of the bodies that float was not found: {found.message}", limit
    force = np.zeros(len(limit))
    force[np.flatnonzero(acting & contact)] = -found.ineqlin.marginals / size[acting & contact]
    return np.asarray(found.x), force


def _program(work: Vector, rows: Array, limit: Vector, contact: Mask) -> Any:
    from scipy.optimize import linprog

    length = np.max(abs(limit), initial=0.0) or 1.0
    push = np.max(abs(work), initial=0.0) or 1.0
    found = linprog(
        -work / push,
        A_ub=rows[contact],
        b_ub=limit[contact] / length,
        A_eq=rows[~contact] if not np.all(contact) else None,
        b_eq=limit[~contact] / length if not np.all(contact) else None,
        bounds=[(None, None)] * len(work),
        method="highs",
    )
    if found.x is not None:
        found.x, found.ineqlin.marginals = length * found.x, push * found.ineqlin.marginals
    return found


# Entries of a motion below this part of its largest, both in units of the unknowns and of energy, are rounding errors.
STANDS_STILL = 256 * EPS


def that_move(problem: ContactProblem, motions: Array) -> Array:
    """Return rigid motions (n, r) with rounding errors at unknowns set to zero.

    If forces act only on such unknowns, their work would otherwise be rounding relative to rounding.
    """
    sizes = np.linalg.norm(motions, axis=1)
    still = np.ones(len(sizes), dtype=bool)
    for size in (sizes, np.sqrt(problem.diagonal) * sizes):
        still &= size <= STANDS_STILL * largest_of_bodies(problem, size)
    return np.where(still[:, None], 0.0, motions) if np.any(still & (sizes > 0)) else motions


def as_stated(problem: ContactProblem, motions: Array) -> tuple[Array, Mask]:
    """Return rigid motions as `near_null_space` states them, body by body where it spans them, and which it spans.

    These are exact, without rounded combinations; the motions of other bodies are returned as they were recognised.

    Parameters
    ----------
    problem : ContactProblem, whose stated motions are compared with rigid ones in the scale of its stiffness
    motions : (n, r) array, rigid motions, each of one body
    """
    spanned = np.zeros(motions.shape[1], dtype=bool)
    if problem.near_null_space is None or not spanned.size:
        return motions, spanned
    body, weight = connected_parts(problem.stiffness_rows)[1], np.sqrt(problem.diagonal)
    owner, found = body[np.argmax(weight[:, None] * abs(motions), axis=0)], []
    for number in np.unique(owner):
        own = np.where((body == number)[:, None], problem.near_null_space, 0.0)
        own, rigid = own[:, own.any(axis=0)], motions[:, owner == number]
        unit = weight[:, None] * own
        unit, basis = unit / np.linalg.norm(unit, axis=0), np.linalg.qr(weight[:, None] * rigid)[0]
        within = np.linalg.norm(unit - basis @ (basis.T @ unit), axis=0) <= UNRESISTED
        values = np.linalg.svd(unit[:, within], compute_uv=False)
        spans = len(values) == rigid.shape[1] == np.count_nonzero(within) and values[-1] > UNRESISTED
        spanned[owner == number] = spans
        found.append(own[:, within] if spans else rigid)
    return np.hstack(found), spanned


def _orthonormal_by_body(motions: Array) -> Array:
    """Return coordinates (r, r) of orthonormal combinations of motions (p, r), each of one body to the last digit.

    Products of motions of different bodies are zero exactly, and Cholesky's factor keeps these zeros.
    """
    largest = abs(motions).max(axis=0)  # squares of 1e-160 underflow
    coordinates = np.diag(1 / np.linalg.norm(motions / largest, axis=0) / largest)
    for _ in range(2):
        unit = motions @ coordinates
        coordinates = coordinates @ np.linalg.inv(np.linalg.cholesky(unit.T @ unit)).T
    return np.asarray(coordinates)


def _largest_entries(rows: Any, bodies: Indices, of_motion: Indices) -> Array:
    """Return the size of the largest entry of each row on the body of each motion (k, r)."""
    moving, entries, place = np.unique(of_motion), sp.coo_matrix(rows), np.zeros(np.max(bodies) + 1, dtype=np.intp)
    place[moving] = 1 + np.arange(len(moving))
    largest = np.zeros((rows.shape[0], len(moving) + 1))
    np.maximum.at(largest, (entries.row, place[bodies[entries.col]]), abs(entries.data))
    return largest[:, place[of_motion]]


def blocked_either_way(rows: Array) -> Array | None:
    """Return the motions (q, r) that rows (p, q) of contacts that touch leave; None where they block none either way.

    Of all a with rows a <= 0 a row has rows_i a = 0 throughout where others oppose it, as two walls do that touch from
    both sides: those rows are the ones for which a linear program finds no room, max sum s, rows a + s <= 0, s <= 1.
    """
    if len(rows) < 2:
        return None
    unit = np.unique((rows / np.linalg.norm(rows, axis=1)[:, None]).round(SAME_DIGITS), axis=0)
    count, dimension = unit.shape
    cost = np.concatenate([np.zeros(dimension), -np.ones(count)])
    bounds = [(None, None)] * dimension + [(0.0, 1.0)] * count
    found = highs(cost, A_ub=np.hstack([unit, np.eye(count)]), b_ub=np.zeros(count), bounds=bounds)
    if found is None or np.all(found.x[dimension:] > NO_ROOM):
        return None
    values, rotation = right_singular(unit[found.x[dimension:] <= NO_ROOM])
    return np.asarray(rotation[int(np.sum(values > UNRESISTED)) :].T)


def unresisted(motions: Array, bodies: Indices, rows: Any) -> Array:
    """Return the coordinates (r, q) of the scaled rigid motions (p, r) that scaled rows (k, p) do not resist.

    Rows may be sparse. The sizes of motions depend on units and stiffness, so rows and bodies are scaled to bring the
    largest entry of a row on each body times the size of the motion near one, and products are compared with that.
    """
    coordinates = _orthonormal_by_body(motions)
    if not rows.shape[0] or not len(coordinates):
        return coordinates
    motions = motions @ coordinates
    of_motion = bodies[np.argmax(abs(motions), axis=0)]
    felt = _largest_entries(rows, bodies, of_motion)
    of_row, of_body = balancing_factors(felt * np.linalg.norm(motions, axis=0), of_motion)
    values, rotation = right_singular(of_row[:, None] * (rows @ motions) * of_body)
    return np.asarray((coordinates * of_body) @ rotation[int(np.sum(values > UNRESISTED)) :].T)


# Unit rows (in the energy scale) are dependent if they are closer to dependence than this.
DEPENDENT_IN_ENERGY = 1e-13


class NullSpace:
    """The null-space method, for redundant sets, floating bodies and a large range of stiffnesses."""

    def __init__(self, condensation: Condensed, closed: Indices, tied: bool = True) -> None:
        from scipy.linalg import qr

        self.closed = np.asarray(closed, dtype=np.intp)
        self.contraction: float | None = None
        self.corrected_motions: Array | None = None
        self._scale = condensation.scale
        self._uncertainty = condensation.rigid.uncertainty
        self._bodies = condensation.bodies
        ties = condensation.tie if tied else condensation.tie[:0]
        rows = np.vstack([condensation.normal[self.closed], ties]) * self._scale
        self._row_scale = 1.0 / np.linalg.norm(rows, axis=1)
        rows = rows * self._row_scale[:, None]
        self._S = condensation.schur * (self._scale[:, None] * self._scale)
        size = len(self._S)
        self._rows = rows
        self.independent = _independent_first(rows, first=np.arange(len(self.closed), len(rows)))
        Q, R = qr(rows[self.independent].T) if self.independent.size else (np.eye(size), np.zeros((size, 0)))
        if not np.all(apart := R.diagonal() != 0):
            self.independent, (Q, R) = self.independent[apart], qr(rows[self.independent[apart]].T)
        self.redundant = (rank := len(self.independent)) < len(rows)
        self._R, self._Y, self._N = R[:rank, :rank], Q[:, :rank], Q[:, rank:]
        self.free_coordinates = condensation.unresisted(rows)
        motions = condensation.rigid.motions[condensation.retained] / self._scale[:, None]
        self.free = _rigid_again(motions, orthonormal(motions @ self.free_coordinates))
        self._hessian = self._factorise_hessian()
        pivot = min((self._R.diagonal() ** 2).min(initial=1.0), self._hessian.smallest_pivot if self._hessian else 1.0)
        self.regular = bool(pivot >= REGULAR)

    def _factorise_hessian(self) -> DenseCholesky | None:
        motion = self._N.T @ self.free
        inner = self._N.T @ self._S @ self._N if self.independent.size else self._S
        hessian = inner + motion @ motion.T
        return DenseCholesky(hessian) if len(hessian) else None

    def solve(self, r: Array, e: Array, a: Array) -> tuple[Array, Array, Array]:
        """Solve for (x, l_B, nu): displacement, forces of the closed contacts and of the ties.

        Each right-hand side is a vector, or has a column for each of several systems.
        """
        from scipy.linalg import solve_triangular

        r = (r.T * self._scale).T
        rows = (np.concatenate([e, a]).T * self._row_scale).T
        x = np.zeros_like(r)
        if self.independent.size:
            x = self._Y @ solve_triangular(self._R, rows[self.independent], trans="T", check_finite=False)
        if self._hessian is not None:
            step = self._N @ self._hessian.solve(self._N.T @ (r - self._S @ x))
            x = x + step - self.free @ (self.free.T @ step)
        force = np.zeros_like(rows)
        if self.independent.size:
            force[self.independent] = solve_triangular(self._R, self._Y.T @ (r - self._S @ x), check_finite=False)
        force = (force.T * self._row_scale).T
        return (x.T * self._scale).T, force[: len(self.closed)], force[len(self.closed) :]

    def exchange(self, entering: int, force: Vector) -> int | None:
        """Return the index of the contact that opens when the dependent one of index `entering` closes.

        With row_j = sum c_k row_k over the independent rows, contact j takes force from those with c_k > 0; the first
        whose force l_k (at position k of `closed`) reaches zero opens: min l_k / c_k. None if there is none, as the
        rows conflict.
        """
        from scipy.linalg import solve_triangular

        share = solve_triangular(self._R, self._Y.T @ self._rows[entering])
        contacts = self.independent < len(self.closed)
        gives = np.flatnonzero(contacts & (share > DEPENDENT_IN_ENERGY * len(self._rows)))
        if not gives.size:
            return None
        positions = self.independent[gives]
        ratios = force[positions] / self._row_scale[positions] / share[gives]
        return int(positions[np.argmin(ratios)])

    def drive(self, load: Vector, size: Vector) -> Vector:
        """Return the scaled free motion (p,) along which a condensed load does work beyond the rounding of `size`.

        The part carried by contacts and ties does no work on a free motion up to rounding.
        """
        if not self.free.shape[1]:
            return np.zeros(len(load))
        load, size = load * self._scale, size * self._scale
        push = self.free.T @ load
        motion = self.free @ push
        part, idle = max(BALANCED, self._uncertainty), max(IDLE, self._uncertainty)
        on_bodies = np.bincount(self._bodies, weights=(size + abs(load)) ** 2)
        of_bodies = np.bincount(self._bodies, weights=motion**2)
        rounding = max(part * float(size @ abs(motion)), idle * float(np.sum(np.sqrt(on_bodies * of_bodies))))
        return motion if float(push @ push) > rounding else np.zeros(len(load))


def _rigid_again(motions: Array, free: Array) -> Array:
    """Return combinations (p, q) of rigid motions (p, r), recomputed from their coordinates.

    Orthonormal columns have rounding errors at bodies with small motions, on which large balanced loads would do work.
    """
    if not free.shape[1]:
        return free
    return np.asarray(motions @ np.linalg.lstsq(motions, free, rcond=None)[0])


def _independent_first(rows: Array, first: Indices) -> Indices:
    """Return the indices of independent unit rows that span all of them, preferring those in `first`."""
    chosen = first[independent_rows(rows[first])]
    others = np.setdiff1d(np.arange(len(rows)), first)
    basis, _ = np.linalg.qr(rows[chosen].T)
    beyond = rows[others] - (rows[others] @ basis) @ basis.T
    return np.concatenate([others[independent_rows(beyond)], chosen]).astype(np.intp)


def independent_rows(rows: Array) -> Indices:
    """Return the indices of independent rows among unit rows, as many as their rank."""
    if not rows.size:
        return np.zeros(0, dtype=np.intp)
    columns, geqp3 = np.asarray_chkfinite(rows).T, lapack().dgeqp3
    R, pivots, *_ = geqp3(columns, lwork=int(geqp3(columns, lwork=-1)[3][0]))
    rank = int(np.sum(abs(R.diagonal()) > DEPENDENT_IN_ENERGY * max(rows.shape)))
    return np.sort(pivots[:rank] - 1).astype(np.intp)
