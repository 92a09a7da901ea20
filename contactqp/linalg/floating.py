"""Floating bodies: their rigid motions, the answer on contacts that hold them, and the balance of forces on them.

The condensed answer on closed contacts B of bodies that may float comes from the null-space method (`NullSpace`;
Nocedal and Wright 2006, section 16.2): with [E_B; A]' P = Q R, x = Y R^-T (e; a) + N v, N'SN v = N'(r - S Y ...).
Dependent rows get no force, and tell which forces are unique; unresisted rigid motions of K are zero.
`contactqp.linalg.contact_iteration` has the motions of bodies that are iterated on.
Errors of single forces are measured with the scale that rows give unknowns without stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.dense import (
    BALANCED,
    IDLE,
    REGULAR,
    Condensed,
    DenseCholesky,
    RigidMotions,
    SaddlePoint,
    orthonormal,
)
from contactqp.linalg.equilibration import balancing_factors
from contactqp.linalg.extended import extend, extended_rows
from contactqp.linalg.factorization import connected_parts, right_singular
from contactqp.linalg.measures import (
    NOTHING_BY_DEFAULT,
    given_on,
    largest_of_bodies,
    outer_forces,
    parts,
    ratio,
    reciprocal,
    row_sizes,
    scale_through_rows,
)
from contactqp.linalg.nonnegative import highs
from contactqp.linalg.runtime import lapack
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# A unit motion is not resisted by unit rows whose products with it are below this.
UNRESISTED = 1e-9
# Relative forces K z of rigid motions above which a real resistance is possible.
RESISTED = 1e-9
SAME_DIGITS = 12  # unit rows that agree to so many digits are one
NO_ROOM = 0.5  # the least room that counts, where any room is scaled to 1


# Entries of a motion below this part of its largest, both in units of the unknowns and of energy, are rounding errors.
STANDS_STILL = 256 * EPS


def without_rounded_motion(problem: ContactProblem, motions: Array) -> Array:
    """Return rigid motions (n, r) with rounding errors at unknowns set to zero.

    If forces act only on such unknowns, their work would otherwise be rounding relative to rounding.
    """
    sizes = np.linalg.norm(motions, axis=1)
    still = np.ones(len(sizes), dtype=bool)
    for size in (sizes, np.sqrt(problem.diagonal) * sizes):
        still &= size <= STANDS_STILL * largest_of_bodies(problem, size)
    return np.where(still[:, None], 0.0, motions) if np.any(still & (sizes > 0)) else motions


def motions_as_stated(problem: ContactProblem, motions: Array) -> tuple[Array, Mask]:
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
    """Return the coordinates (r, q) of the scaled rigid motions (p, r) that scaled rows (k, p) do not resist."""
    coordinates = _orthonormal_by_body(motions)
    return coordinates @ _unresisted_of(motions @ coordinates, bodies, rows)


def _unresisted_of(motions: Any, bodies: Indices, rows: Any) -> Array:
    """Return the coordinates (r, q) of `unresisted` for orthonormal motions (p, r); they and rows may be sparse.

    The sizes of motions depend on units and stiffness, so rows and bodies are scaled to bring the largest entry of a
    row on each body times the size of the motion near one, and products are compared with that.
    """
    if not rows.shape[0] or not motions.shape[1]:
        return np.eye(motions.shape[1])
    of_motion = bodies[np.asarray(abs(motions).argmax(axis=0)).ravel()]
    of_row, of_body = balancing_factors(_largest_entries(rows, bodies, of_motion), of_motion)
    moved = rows @ motions
    moved = moved.toarray() if sp.issparse(moved) else moved
    values, rotation = right_singular(of_row[:, None] * moved * of_body)
    return np.asarray(of_body[:, None] * rotation[int(np.sum(values > UNRESISTED)) :].T)


def free_of_bodies(motions: Any, bodies: Indices, rows: Any, scale: Vector) -> tuple[Array, Array]:
    """Return a basis (n, q) of rigid motions that rows do not resist, orthonormal, and one that is so over `scale`.

    They are found body by body and combined in their coordinates, which are far fewer than unknowns.

    Parameters
    ----------
    motions : (n, r) sparse array, each of one body
    bodies : (n,) array of int, the body of each unknown
    rows : (k, n) sparse array, of closed contacts and ties
    scale : (n,) array, of the unknowns in the scale of energy
    """
    weight = sp.diags(scale)
    unit = _by_body(sp.diags(1 / scale) @ motions, bodies)
    along = _unresisted_of(unit, bodies, rows @ weight)
    stretched = weight @ unit
    lengths = _by_body(stretched, bodies)
    of_lengths = orthonormal((lengths.T @ stretched) @ along)
    return lengths @ of_lengths, stretched @ orthonormal(along)


def _by_body(motions: Any, bodies: Indices) -> Any:
    """Return orthonormal motions (n, r) that span those of each body, sparse like these."""
    columns = sp.csc_array(motions)
    columns.eliminate_zeros()
    of_column = bodies[columns.indices[columns.indptr[:-1]]]
    alone = np.bincount(of_column)[of_column] == 1  # as an unknown without stiffness is
    first = sp.coo_array(columns[:, alone])
    length = np.sqrt(np.bincount(first.col, first.data**2, first.shape[1]))
    found = [(first.row, np.flatnonzero(alone)[first.col], first.data / length[first.col])]
    order = np.flatnonzero(~alone)[np.argsort(of_column[~alone], kind="stable")]
    for some in np.split(order, np.flatnonzero(np.diff(of_column[order])) + 1) if order.size else ():
        part = columns[:, some]
        members = np.unique(part.indices)
        local = sp.coo_array(orthonormal(part[members].toarray()))
        found.append((members[local.row], some[local.col], local.data))
    row, column, data = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return sp.csr_array((data, (row, column)), shape=columns.shape)


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


def imbalance(problem: ContactProblem, answer: Answer, rigid: RigidMotions, largest: float = 0.0) -> float:
    """Return the largest relative imbalance of the outer forces over a basis of rigid motions.

    It is |z'r| / |z|'F_outer of a motion z, with r the sum of loads, contact and tie forces. On a motion on which only
    rounding of the `largest` force acts, it is relative to that force.

    Parameters
    ----------
    problem, answer : whose outer forces these are
    rigid : the rigid motions of the bodies
    largest : a force in the scale of the stiffness [square root of energy]
    """
    rows = extended_rows(problem)
    if not rigid.count:
        return 0.0
    motions = without_rounded_motion(problem, rigid.motions)
    outer = extend(problem.load) - rows.contact_force(extend(answer.normal_force), extend(answer.tie_force))
    missed = motions.T @ (outer - rows.friction_force(answer.friction_force)).double()
    size, whole = _acting_on(problem, answer, motions, largest)
    return float(np.max(ratio(abs(missed), np.where(size > NOTHING_BY_DEFAULT * whole, size, whole))))


def _acting_on(problem: ContactProblem, answer: Answer, motions: Array, largest: float) -> tuple[Vector, Vector]:
    """Return |z|'F_outer of each motion (r,), and what it would be if the `largest` force acted everywhere."""
    size, whole = (abs(motions).T @ x for x in (outer_forces(problem, answer), largest * np.sqrt(problem.diagonal)))
    return np.asarray(size), np.asarray(whole)


def rigid_forces(problem: ContactProblem, answer: Answer, rigid: RigidMotions) -> float:
    """Return K z of rigid motions by rounding of K, relative to the outer forces.

    Of motions that are not stated it is only what may be a resistance that no outer force balances: what is more than
    `RESISTED` along motions on which none acts, else 0.
    """
    if not rigid.count:
        return 0.0
    coordinates, size = rigid.coordinates(answer.displacement, problem.diagonal), _largest_outer_force(problem, answer)
    if problem.near_null_space is None:
        acting, whole = _acting_on(problem, answer, rigid.motions, size)
        coordinates = np.where(acting > NOTHING_BY_DEFAULT * whole, 0.0, coordinates)
    moved = extend(rigid.motions @ coordinates)
    forces = problem.own_scale * abs((extended_rows(problem).stiffness @ moved).double())
    made = float(np.max(forces, initial=0.0)) / size if size > 0 else 0.0
    return made if problem.near_null_space is not None or made > RESISTED else 0.0


def imbalance_of_acting(problem: ContactProblem, answer: Answer, rigid: RigidMotions, missed: float) -> float:
    """Return the imbalance, of which `missed` is the largest, where more than rounding of other bodies' forces acts.

    A body that others carry along has no forces but those that rounding of K makes.

    Parameters
    ----------
    problem, answer, rigid : as in `imbalance`
    missed : the result where motions are stated, which are exact
    """
    if problem.near_null_space is not None:
        return missed
    beside = imbalance(problem, answer, rigid, _largest_outer_force(problem, answer))
    return max(beside, rigid_forces(problem, answer, rigid), BALANCED)


def _largest_outer_force(problem: ContactProblem, answer: Answer) -> float:
    return float(np.max(problem.own_scale * outer_forces(problem, answer), initial=0.0))


def unique_forces(condensation: Condensed, saddle: SaddlePoint) -> Mask:
    """Return whether the force of each contact and tie (m + k,) is unique where a saddle has all closed contacts.

    A dependent row is a sum of independent ones. One of these belongs to it, and has forces of many sizes, where the
    dependent row is farther from the span of the others than rounding: the weight itself has the rounding of nearly
    dependent rows.

    Parameters
    ----------
    condensation : the Condensation of the problem
    saddle : the factorised system of the closed contacts, whose rows are redundant
    """
    from scipy.linalg import solve_triangular

    rows = np.vstack([condensation.normal, condensation.tie]) * condensation.scale
    unique = np.ones(len(rows), dtype=bool)
    held = np.append(saddle.closed, np.arange(len(condensation.normal), len(rows)))
    unit = rows[held] / np.linalg.norm(rows[held], axis=1, keepdims=True)
    Q, R = np.linalg.qr(unit[saddle.independent].T)
    inverse = solve_triangular(R, np.eye(len(R)))
    weights = inverse @ (Q.T @ np.delete(unit, saddle.independent, axis=0).T)
    apart = np.max(abs(weights), axis=1, initial=0.0) / np.linalg.norm(inverse, axis=1)
    unique[held] = False
    unique[held[saddle.independent]] = apart <= DEPENDENT_IN_ENERGY * max(unit.shape)
    return unique


# Forces that meet at an unknown without stiffness are rounding up to this part of the forces of the problem.
ROUNDED_FORCES = 4 * EPS


@dataclass(frozen=True, eq=False)
class SingleErrors:
    """Errors of the forces of contacts and ties, one by one, measured as the largest force is."""

    felt: Vector  # (m + k,) |d_i| |E_i D| [square root of energy]
    largest: Vector  # (m + k,) the largest |l_j*| |E_j D| of those that row i may be compared with
    at_bare: Vector  # (m + k,) |d_i| over the forces that meet at an unknown without stiffness
    problem: ContactProblem  # with m contacts, k ties and their names

    @property
    def parts(self) -> Vector:
        """The errors (m + k,) over the largest force, one where all forces are zero."""
        return np.divide(self.felt, self.largest, out=np.ones(len(self.felt)), where=self.largest > 0)

    @property
    def of_bare_contacts(self) -> Vector:
        """The errors (m,) of contacts at unknowns without stiffness, over the largest force and what meets there."""
        return np.minimum(self.parts, self.at_bare)[: self.problem.contacts]

    def nothing(self, tolerance: float, rounding: float, size: float) -> Vector:
        """Return the size (m + k,) of no error: rounding if it counts at an unknown that rows hardly join to bodies."""
        return np.where(self.at_bare > tolerance, rounding, max(rounding, size))

    def worst_tie(self, tolerance: float, rounding: float, size: float) -> tuple[str, float] | None:
        """Return the tie with the largest error beyond the tolerance and `nothing`, over the largest force, or None."""
        off = self.felt > np.maximum(tolerance * self.largest, self.nothing(tolerance, rounding, size))
        parts = np.where(off, self.parts, 0.0)[self.problem.contacts :]
        return (self.problem.tie_name(i := int(np.argmax(parts))), float(parts[i])) if parts.any() else None

    def among(self, whole: ContactProblem, places: tuple[Indices, Indices], others: Any = None) -> SingleErrors:
        """Return the errors of contacts and ties at some places of a problem among its rows, elsewhere 0 or others."""
        every = np.zeros((3, whole.contacts + whole.ties))
        every[:] = 0.0 if others is None else (others.felt, others.largest, others.at_bare)
        every[:, np.append(places[0], whole.contacts + places[1])] = self.felt, self.largest, self.at_bare
        return SingleErrors(every[0], every[1], every[2], whole)


def single_errors(problem: ContactProblem, errors: Vector, forces: Vector) -> SingleErrors:
    """Measure errors with D = 1/sqrt(K_jj), and for unknowns without stiffness the largest scale that rows give them.

    Rows of parts without any stiffness are compared with those of their part. `errors` and `forces` (m + k,) are those
    of contacts and ties of the `problem`, the latter the true ones.
    """
    m, pair = problem.contacts, (problem.normal, problem.tie)
    pushing, held = (row_sizes(problem, rows) for rows in pair)
    if problem.diagonal.all():
        felt = np.sqrt(np.append(pushing.compliance, held.compliance))
        largest = np.full(len(felt), np.max(felt * abs(forces), initial=0.0))
        return SingleErrors(felt * errors, largest, np.zeros(len(felt)), problem)
    bare, D = problem.diagonal == 0, scale_through_rows(problem)
    scale = given_on(problem, np.where(bare, 0.0, problem.own_scale), np.maximum)
    apart = np.where(scale == 0, 1 + parts(problem), 0)
    first = np.concatenate([np.append(rows.indices, 0)[rows.indptr[:-1]] for rows in pair])
    felt = np.sqrt(np.concatenate([rows.power(2) @ np.where(scale == 0, 1.0, scale) ** 2 for rows in pair]))
    np.maximum.at(largest := np.zeros(int(apart.max(initial=0)) + 1), apart[first], felt * abs(forces))
    meeting = pushing.forces(abs(forces[:m])) + held.forces(abs(forces[m:])) + problem.load_size
    size = max(largest[0], float(np.max(D * problem.load_size, initial=0.0)))
    meeting = np.where(bare & (meeting > ROUNDED_FORCES * size * reciprocal(D)), meeting, np.inf)
    at_bare = np.append(pushing.measure(errors[:m], meeting), held.measure(errors[m:], meeting))
    return SingleErrors(felt * errors, largest[apart[first]], at_bare, problem)
