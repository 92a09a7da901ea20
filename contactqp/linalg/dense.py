"""Dense systems: Cholesky factors, scales, small interiors, and the Delassus operator of contacts and ties.

An interior that is small, or only a few times what is retained, is eliminated by `BackSubstitution`. The Delassus
operator of what is retained is

    W = [E; A] S_e^-1 [E; A]',    S_e = S + e Z Z'

on the condensed unknowns, in the scale that gives S a unit diagonal and W too. Where bodies float, W would be infinite
along their rigid motions Z; the springs e anchor them, and a proximal iteration (Rockafellar 1976) removes the force of
the anchors.

The answer on a set B of closed contacts, which may be redundant or leave motions free, solves

    [ S    E_B'  A' ] [ x   ]   [ r ]
    [ E_B  0     0  ] [ l_B ] = [ e ]
    [ A    0     0  ] [ nu  ]   [ a ]

Where S and W_BB are regular the range-space method does (`_RangeSpace`; Nocedal and Wright 2006, section 16.2),

    y = S^-1 r,    W_BB l = [E_B; A] y - (e; a),    x = y - S^-1 [E_B; A]' l,

which costs a Cholesky factorisation of W_BB alone. Elsewhere it is the null-space method
(`contactqp.linalg.floating.NullSpace`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem
from contactqp.linalg.runtime import dense_product, lapack
from contactqp.model.arrays import EPS, RUNNING, TINY, Array, Indices, Mask, Vector, inverse_root, refuse_late
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import BUCKLED

# Up to here a dense Cholesky factorisation is as fast as a sparse one and needs no ordering.
DENSE_SIZE = 300
# Added to each unit of diagonal, times the size, if rounding made a pivot nonpositive; refinement corrects it.
LIFT = 4 * EPS
# A unit-diagonal matrix may be singular, and its null space is computed, if a pivot is below this.
SUSPICIOUS_PIVOT = 1e-8
# The number of right-hand sides at a time, which limits the memory of K_ii^-1 K_ic.
BLOCK = 64
# The number of entries, including zeros, up to which rows are converted to arrays.
WRITTEN_OUT = 2**14
# The anchors are soft compared with the bodies, so that one or two proximal steps suffice, and stiff compared with
# rounding.
ANCHOR = 1e-6
# The rounding error of a double-precision operator and its answers, relative to the lengths that meet.
OPERATOR_ROUNDING = 1e-12
# Pivots of S and W_BB, with unit diagonals, below which the null-space method is more accurate.
REGULAR = 1e-7


class Factorization(Protocol):
    """A factorisation of a symmetric positive definite matrix, dense or sparse."""

    smallest_pivot: float  # of the matrix scaled to unit diagonal: 0 when singular

    def solve(self, right: Array) -> Array:
        """Return K^-1 times one right-hand side (n,) or several (n, q)."""


class DenseCholesky:
    """LAPACK's Cholesky factorisation of a small matrix, scaled to a unit diagonal or by a given scale."""

    def __init__(self, matrix: Array, scale: Array | None = None) -> None:
        self._scale = inverse_root(matrix.diagonal()) if scale is None else scale
        scaled = matrix * (self._scale[:, None] * self._scale)
        factor = lower_factor(scaled)
        if factor is not None:
            self.lower = factor
            self.smallest_pivot = float((factor.diagonal() ** 2).min(initial=np.inf)) if len(factor) else 1.0
            return
        lift = float(LIFT * len(scaled))
        self.smallest_pivot = 0.0
        lifted = lower_factor(scaled + lift * np.eye(len(scaled)))
        if lifted is None:  # indefinite beyond rounding
            from scipy.linalg import cholesky, eigvalsh

            self.smallest_pivot = min(float(eigvalsh(scaled)[0]), 0.0)
            lift = max(2 * -self.smallest_pivot, lift)
            lifted = cholesky(scaled + lift * np.eye(len(scaled)), lower=True, check_finite=False)
        self.lower = lifted

    @property
    def least_stiffness(self) -> float:
        """Return 1 / |A^-1| of the scaled matrix: where stiffnesses are graded, no pivot need be as small."""
        return float(lapack().dpocon(self.lower, 1.0, uplo="L")[0]) if self.smallest_pivot > 0 else 0.0

    def solve(self, right: Array) -> Array:
        if not right.size:
            return np.zeros(right.shape)
        return np.asarray((lapack().dpotrs(self.lower, (right.T * self._scale).T, lower=True)[0].T * self._scale).T)


def dense_factor(matrix: Any) -> DenseCholesky:
    """Factorise a small matrix, dense or sparse.

    Raises InvalidProblem: a pivot is negative beyond rounding: the matrix is indefinite.
    """
    factor = DenseCholesky(matrix.toarray() if sp.issparse(matrix) else np.asarray(matrix))
    refuse_negative(factor.smallest_pivot)
    return factor


def lower_factor(matrix: Array) -> Array | None:
    """Return L of a symmetric matrix L L' (its upper part is arbitrary), None if a pivot is not positive."""
    if not len(matrix):
        return matrix
    factor, info = lapack().dpotrf(matrix, lower=True, clean=False)
    return factor if info == 0 else None


def refuse_negative(smallest_pivot: float) -> None:
    """Raise InvalidProblem if a pivot is negative beyond rounding: the matrix is indefinite."""
    if smallest_pivot < -SUSPICIOUS_PIVOT:
        got = f"got a pivot of {smallest_pivot:.3g} after scaling its diagonal to one"
        raise InvalidProblem(f"stiffness: expected positive semidefinite, {got}{BUCKLED}")


def orthonormal(motions: Array) -> Array:
    """Return an orthonormal basis (n, r) of motions, accurate in any units, or the motions if they are dependent in
    doubles.
    """
    if not motions.shape[1]:
        return motions
    for _ in range(2):  # twice, as motions may be nearly parallel by their units
        R: Array = np.asarray(np.linalg.qr(motions, mode="r"))
        if not np.all(R.diagonal()):
            return motions
        motions = motions @ np.linalg.inv(R)
    gram = motions.T @ motions  # more accurate than reflections for entries of very different sizes
    least = min(np.linalg.eigvalsh(gram)) if np.all(np.isfinite(gram)) else 0.0
    return motions @ np.linalg.inv(np.linalg.cholesky(gram).T) if least > REGULAR * np.trace(gram) else motions


@dataclass(frozen=True, eq=False)
class RigidMotions:
    """The null space of K."""

    motions: Array  # (n, r) a basis, orthonormal where K has unit diagonal: accurate at every unknown in any units
    softest: float = 1.0  # the least energy of a motion that is not rigid, K scaled to unit diagonal
    forces: Array | None = None  # (n, r) K z in extended precision, rounded; None if not formed

    @cached_property
    def count(self) -> int:
        """Return the number of motions."""
        return int(self.motions.shape[1])

    @property
    def uncertainty(self) -> float:
        """Return the part of the softest elastic motion in a rigid one, which rounding of K does not separate."""
        return min(MIXED / self.softest, MIXED_AT_MOST) if self.softest < MIXING else 0.0

    @cached_property
    def basis(self) -> Array:
        """Return an orthonormal basis (n, r) that is as accurate at every unknown as the motions."""
        return orthonormal(self.motions)

    def coordinates(self, displacement: Vector, diagonal: Vector) -> Vector:
        """Return the rigid part of a displacement (n,) by coordinates (r,), by least squares of sqrt(K_jj) u_j."""
        weight = np.sqrt(diagonal)
        found, *_ = np.linalg.lstsq(weight[:, None] * self.motions, weight * displacement, rcond=None)
        return np.asarray(found)

    def without_rigid_part(self, displacement: Vector, diagonal: Vector) -> Vector:
        """Return a displacement (n,) without its rigid part; unknowns without stiffness are unchanged."""
        return displacement - self.motions @ self.coordinates(displacement, diagonal) if self.count else displacement

    def work_to_add(self, motions: Array, bodies: Indices, load: Vector, reduced: Vector) -> Vector:
        """Return a correction (p,), scaled, after which the work of a condensed load on rigid motions is that of the
        load.

        An unloaded body gets no load at all, as rounding of its neighbours' loads would drive it.

        Parameters
        ----------
        motions, bodies : (p, r) and (p,) arrays, the motions of the retained unknowns, scaled, and their bodies
        load, reduced : (n,) and (p,) arrays, the load and the condensed one, scaled
        """
        missing = self.motions.T @ load - motions.T @ reduced
        rounding = 4 * EPS * (abs(self.motions).T @ abs(load))
        of_body = bodies[np.argmax(abs(motions), axis=0)]
        acting = np.isin(of_body, of_body[abs(missing) > rounding])
        change, *_ = np.linalg.lstsq(motions[:, acting].T, missing[acting], rcond=None)
        return np.where(np.isin(bodies, of_body[acting]), change, 0.0)


def unknown_scale(problem: ContactProblem) -> Array:
    """Return D (n,), positive: 1/sqrt(K_jj), or without stiffness a scale that makes row entries similar to others.

    It scales systems. Answers are measured by `measures.scale_through_rows`, which may be zero.
    """
    if problem._computed.unknown_scale is not None:
        return problem._computed.unknown_scale
    D = problem.own_scale.copy()
    bare = problem.diagonal == 0
    if bare.any():
        largest = _largest_entries(sp.vstack([problem.normal, problem.tie]))
        along = np.zeros_like(largest) if problem.tangent is None else _largest_entries(problem.tangent)
        stiff = (largest * D)[~bare & (largest > 0)]
        if not stiff.size:
            stiff = (along * D)[~bare & (along > 0)]
        size = np.median(stiff) if stiff.size else _apart(D, bare, largest)
        largest = np.maximum(largest, along)  # the lever of friction may be all that a rotation has
        D[bare] = size / np.where(largest[bare] > 0, largest[bare], 1.0)
    return D


def _apart(D: Vector, bare: Mask, largest: Vector) -> float:
    """Return the size to which entries of rows on unknowns without stiffness are scaled where no row is stiff.

    It is a typical D, which depends on units like that of stiff unknowns.
    """
    felt = largest[bare & (largest > 0)]
    if bare.all() or not felt.size:
        return 1.0
    return float(np.median(D[~bare]) * np.median(felt))


def _largest_entries(rows: Any) -> Array:
    """Return the size (n,) of the largest entry of rows at each unknown."""
    return np.asarray(
        abs(sp.csc_matrix(rows)).max(axis=0).toarray().ravel() if rows.shape[0] else np.zeros(rows.shape[1])
    )


class BackSubstitution:
    """The Schur complement S from the factors of K_ii alone, formed column by column.

    It suits an interior that is small, or at most a few times as large as the retained part.
    """

    solver = "superlu"

    def __init__(self, stiffness: Any, retained: Indices, factorise: Callable[[Any], Factorization]) -> None:
        self._retained = retained
        eliminated = np.ones(stiffness.shape[0], dtype=bool)
        eliminated[retained] = False
        self._interior = eliminated.nonzero()[0]
        if stiffness.shape[0] <= DENSE_SIZE:
            stiffness = stiffness.toarray()
        self._coupling = _block(stiffness, self._interior, retained)
        self._factor: Factorization | None = None
        self.half_substitutions = 0
        if self._interior.size:
            inner = _block(stiffness, self._interior, self._interior)
            self._factor = (dense_factor if self._interior.size <= DENSE_SIZE else factorise)(inner)
        self.smallest_pivot = 1.0 if self._factor is None else self._factor.smallest_pivot
        self.schur = self._schur_complement(stiffness)

    def _schur_complement(self, stiffness: Any) -> Array:
        S = _dense(_block(stiffness, self._retained, self._retained))
        for start in range(0, len(self._retained) if self._interior.size else 0, BLOCK):
            if start:
                refuse_late("the stiffness was condensed")
            columns = slice(start, start + BLOCK)
            right = _dense(self._coupling[:, columns])
            S[:, columns] -= self._coupling.T @ self._solve(right)
        return np.asarray((S + S.T) / 2)

    def _solve(self, right: Array) -> Array:
        if self._factor is None:
            return np.zeros_like(right)
        count = 2 * (1 if right.ndim == 1 else right.shape[1])
        self.half_substitutions += count
        if (clock := RUNNING.get()) is not None:
            clock.half_substitutions += count
        return self._factor.solve(right)

    def reduce(self, load: Vector) -> tuple[Vector, Vector]:
        if self._factor is None:  # nothing lies inside
            return load[self._retained], np.zeros(0)
        inner = self._solve(load[self._interior])
        return load[self._retained] - self._coupling.T @ inner, inner

    def expand(self, retained: Vector, state: Vector) -> Vector:
        u = np.empty(len(self._retained) + len(self._interior))
        u[self._retained] = retained
        if self._factor is not None:
            u[self._interior] = state - self._solve(self._coupling @ retained)
        return u

    def expand_motions(self, retained: Array) -> Array:
        u = np.empty((len(self._retained) + len(self._interior), retained.shape[1]))
        u[self._retained] = retained
        u[self._interior] = -self._solve(self._coupling @ retained)
        return u


def _block(stiffness: Any, rows: Indices, columns: Indices) -> Any:
    """Return the entries of K in these rows and columns, of an array or a CSR matrix."""
    return stiffness[rows[:, None], columns] if isinstance(stiffness, np.ndarray) else stiffness[rows][:, columns]


def _dense(matrix: Any) -> Array:
    return np.asarray(matrix.toarray() if sp.issparse(matrix) else matrix)


class Condensed(Protocol):
    """The part of `contactqp.linalg.condensation.Condensation` that dense systems use."""

    schur: Array  # (p, p) S
    scale: Array  # (p,) 1/sqrt(S_jj)
    normal: Array  # (m, p) E of the retained unknowns
    tie: Array  # (k, p) A likewise
    retained: Indices  # (p,)
    rigid: Any  # the RigidMotions of K
    saddles: dict[Any, Any]  # the last saddle points

    @property
    def bodies(self) -> Indices:
        """Return the number of the body of each retained unknown (p,)."""

    @property
    def schur_factor(self) -> DenseCholesky:
        """Return the Cholesky factors of the scaled Schur complement."""

    @property
    def delassus(self) -> Delassus:
        """Return the Delassus operator of the contacts and ties, formed once."""

    def unresisted(self, rows: Array) -> Array:
        """Return the coordinates (r, q) of the rigid motions that scaled rows do not resist."""

    def null_space(self, closed: Indices, tied: bool) -> SaddlePoint:
        """Return the saddle point of closed contacts by the null-space method, which takes any."""


def orthonormal_motions(condensation: Condensed) -> Array:
    """Return an orthonormal basis (p, r) of the rigid motions in the scaled unknowns that are retained."""
    motions: Array = condensation.rigid.motions[condensation.retained] / condensation.scale[:, None]
    return np.linalg.qr(motions)[0] if motions.shape[1] else motions


class Delassus:
    """The Delassus operator W of normal contacts and ties of one condensation, and its responses to loads."""

    def __init__(self, condensation: Condensed) -> None:
        self.scale = condensation.scale
        self.motions = orthonormal_motions(condensation)
        self.rows = np.vstack([condensation.normal, condensation.tie]) * self.scale
        self._factor = self._factorised(condensation)
        # The pivot of S with unit diagonal; below REGULAR its inverse has half of the digits.
        self.smallest_pivot = 1.0 if self._factor is None else self._factor.smallest_pivot
        if len(self.rows) > BLOCK:
            refuse_late("the compliances of contacts were formed")
        response = self.solve(self.rows.T)
        few = self.rows.size <= WRITTEN_OUT
        W = self.rows @ response if few else dense_product(sp.csr_array(self.rows), response)
        self.row_scale = 1.0 / np.sqrt(np.maximum(W.diagonal(), TINY))
        self.compliance = np.asarray(1.0 / self.row_scale**2)  # W_ii of every contact and tie [length / force]
        self.W = (W + W.T) / 2 * (self.row_scale[:, None] * self.row_scale)
        self.response = response * self.row_scale

    def _factorised(self, condensation: Condensed) -> DenseCholesky | None:
        """Factorise S_e, the scaled Schur complement with springs on rigid motions, None if nothing is retained."""
        if not len(condensation.schur):
            return None
        if not self.motions.shape[1]:
            return condensation.schur_factor
        S = condensation.schur * (self.scale[:, None] * self.scale)
        return DenseCholesky(S + ANCHOR * self.motions @ self.motions.T)

    def solve(self, right: Array) -> Array:
        """Return S_e^-1 times a right-hand side, both scaled."""
        return right if self._factor is None else self._factor.solve(right)

    def squared_norm(self, force: Vector) -> tuple[float, float]:
        """Return |d|_W^2 of contact forces d (m,) without the ties, and its bound if all rows were parallel."""
        scaled = force / self.row_scale[: len(force)]
        return float(scaled @ self.W[: len(force), : len(force)] @ scaled), float(np.sum(abs(scaled)) ** 2)

    def free_response(self, load: Vector, anchor: Vector) -> Vector:
        """Return the scaled displacement without contact forces, with the rigid part of the scaled `anchor`."""
        return self.solve(load * self.scale + ANCHOR * self.motions @ (self.motions.T @ anchor))

    def dual_data(self, problem: ContactProblem, free: Vector) -> tuple[Array, Vector, Mask, Vector]:
        """Return W, the excess of each row in the scaled displacement `free`, which rows are ties, and the rounding."""
        limit = np.concatenate([problem.gap, problem.tie_value])
        tolerance = OPERATOR_ROUNDING * self.row_scale * (abs(self.rows) @ abs(free) + abs(limit))
        excess = self.row_scale * (self.rows @ free - limit)
        return self.W, excess, np.arange(len(limit)) >= problem.contacts, tolerance

    def displaced(self, free: Vector, force: Vector) -> Vector:
        """Return the scaled displacement under scaled contact and tie forces."""
        return np.asarray(free - self.response @ force)


class _RangeSpace:
    """The saddle point of one set of independent closed contacts, factorised by its Schur complement E S^-1 E'."""

    redundant = False

    def __init__(self, condensation: Condensed, operator: Delassus, closed: Indices, tied: bool) -> None:
        self.closed = closed
        self.contraction: float | None = None
        self.corrected_motions: Array | None = None
        self._operator = operator
        ties = np.arange(len(condensation.normal), len(operator.rows)) if tied else np.zeros(0, dtype=np.intp)
        self._members = np.concatenate([closed, ties])
        self.independent = np.arange(len(self._members))
        self.free: Array = np.zeros((len(condensation.retained), 0))
        self.free_coordinates: Array = np.zeros((condensation.rigid.count, 0))
        self._factor = DenseCholesky(operator.W[self._members[:, None], self._members]) if len(self._members) else None
        self._rows, self._row_scale = operator.rows[self._members], operator.row_scale[self._members]
        self._response = operator.response[:, self._members]
        self.regular = self._factor is None or self._factor.smallest_pivot >= REGULAR

    def solve(self, r: Array, e: Array, a: Array) -> tuple[Array, Array, Array]:
        """Solve for (x, l_B, nu): displacement, forces of the closed contacts and of the ties.

        Each right-hand side is a vector, or has a column for each of several systems.
        """
        operator = self._operator
        x = operator.solve((r.T * operator.scale).T) if r.any() else np.zeros(r.shape)
        force = np.concatenate([e, a]) if len(a) else e
        if self._factor is not None:
            load = self._factor.solve(((self._rows @ x - force).T * self._row_scale).T)
            x = x - self._response @ load
            force = (load.T * self._row_scale).T
        return (x.T * operator.scale).T, force[: len(self.closed)], force[len(self.closed) :]

    def exchange(self, entering: int, force: Vector) -> int | None:  # noqa: ARG002
        """Return None, since no contact of the set depends on others."""
        return None

    def drive(self, load: Vector, size: Vector) -> Vector:  # noqa: ARG002
        """Return zero (p,), since no motion is free."""
        return np.zeros(len(load))


# Rounding of K mixes motions this far apart in energy by MIXED over their distance.
MIXING = 1e-6
MIXED = 64 * EPS
# What is more mixed than this is refused rather than forgiven.
MIXED_AT_MOST = 1e-6
# Resultants below this part of the forces, and works of loads on a motion, count as balanced.
BALANCED = 1e-12
# So is a push of this part of all forces on a body rounding, on a motion of it that lies where no force acts.
IDLE = 256 * EPS


class SaddlePoint(Protocol):
    """The factorised saddle-point system of one set of closed contacts, by either of the two methods below."""

    closed: Indices
    redundant: bool  # whether rows depend on others
    independent: Indices  # places among the closed contacts and ties, as many contacts as can be
    free: Array  # (p, q) orthonormal scaled motions that nothing resists
    free_coordinates: Array  # (r, q) of such in the rigid motions
    regular: bool  # whether pivots are so large that refinement contracts alike under all loads
    contraction: float | None  # what refinement leaves of a correction, once it has been measured, if regular
    corrected_motions: Array | None  # (n, q) free ones, to a few eps at every unknown, once they have been asked for

    def solve(self, r: Array, e: Array, a: Array) -> tuple[Array, Array, Array]:
        """Solve for (x, l_B, nu): displacement, forces of the closed contacts and of the ties.

        Each right-hand side is a vector, or has a column for each of several systems.
        """

    def exchange(self, entering: int, force: Vector) -> int | None:
        """Return the place of the closed contact that opens when a dependent one takes its share; None if none can."""

    def drive(self, load: Vector, size: Vector) -> Vector:
        """Return the scaled free motion (p,) along which a condensed load does work beyond the rounding of `size`."""


# Factorisations kept for one condensation: the sets of a solution, of its certificate, and none for good.
KEPT = 6


def saddle_point(condensation: Condensed, closed: Indices, tied: bool = True) -> SaddlePoint:
    """Factorise the saddle point of a set of closed contacts.

    The last few factorisations are kept: refinement and certificate ask for the same sets.
    """
    kept: dict[tuple[bytes, bool], SaddlePoint] = condensation.saddles
    key = (np.asarray(closed, dtype=np.intp).tobytes(), tied)
    if key not in kept:
        if len(kept) >= KEPT:
            kept.pop(next(iter(kept)))
        kept[key] = _factorised(condensation, closed, tied)
    return kept[key]


def _factorised(condensation: Condensed, closed: Indices, tied: bool) -> SaddlePoint:
    if not condensation.rigid.count and (operator := condensation.delassus).smallest_pivot >= REGULAR:
        found = _RangeSpace(condensation, operator, np.asarray(closed, dtype=np.intp), tied)
        if found.regular:
            return found
    return condensation.null_space(closed, tied)
