"""Norms of contact forces in the energy of the bodies, for the bounds with friction.

Forces d have the norm |d|_W; `ForceNorms` gives the largest force, gap and slip of each contact for |d|_W = 1.

Bodies held by contacts only have no W: with joints eliminated as far as possible, R x = free - W d - V c for the
contact rows R, with the rigid displacements c, and forces balance if V'd has a given value. Differences d of two
answers to one load then have V'd = 0, the energy d'W d, and change the lengths R u by W d + V c. Balance determines the
states of some contacts: if l_N + a.l_T is in the range of V' for some a, its value b follows from the load, and l_N >=
b / (1 + mu |a|) in every answer. Contacts with positive b are closed in all answers, and those with statically
determined forces within the friction bound stick. Their lengths do not change, which determines c by d as far as V of
these rows has rank; the remaining motions must not displace contacts with friction along their tangents.
`BalancedForces` has the norms of forces d that balance, and

    kappa = largest eigenvalue of 1/2 sum mu_i (c_i d_N,i^2 + |e_i|^2 / c_i) by d'W d >= sum mu_i |d_N,i| |e_i| / d'W d

with e = (W d + V c)_T and any c_i > 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from contactqp.certificate.critical_friction import (
    MOST_CONTACTS,
    acting_rows,
    coupling,
    felt_rows,
    inverse_of_lower,
    of_operator,
)
from contactqp.certificate.figures import PIVOTS_FLATTER
from contactqp.certificate.state_bodies import RefinedLengths
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import (
    FLOATING,
    ContactCompliance,
    ContactOperators,
    contact_compliance,
)
from contactqp.linalg.dense import orthonormal_motions
from contactqp.linalg.measures import lengths
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem

# The largest relative rounding of W for which kappa and norms of its blocks are used.
TOO_ROUNDED = 1e-2
# Products of unit rows with a motion that count as zero, and those that are uncertain.
NOT_MOVED, HARDLY_MOVED = 1e-12, 1e-6
# A combination of forces is determined by balance if its part outside the range is below the first number, and positive
# above the second part of the largest force.
DETERMINED, BEYOND_ROUNDING = 1e-11, 1e-9
# Gaps below this part of the largest length count as closed.
CLOSED = 1e-9
# A norm is blind to a motion if it has less than this part of it.
SEEN = 1e-9


def rigid_uncertainty(
    compliance: ContactCompliance, status: Status, refined: RefinedLengths, mu: Vector
) -> tuple[float, bool]:
    """Bound the rigid displacement of the refined answer by the gaps and slips of contacts that hold bodies.

    Also return whether free motions remain. The bound is infinite if contacts slip along these, as rounding then
    decides whether friction balances the load.

    Parameters
    ----------
    compliance : the operators of the contacts
    status, mu : their states and coefficients (m,)
    refined : the refined answer of these states
    """
    closed, sticks = status != OPEN, (status == STICK) & (mu > 0)
    moved, tied = compliance.on_rigid_motions()
    moved = moved.reshape(len(mu), -1, moved.shape[1])
    held = np.vstack([moved[closed, 0], moved[sticks, 1:].reshape(-1, moved.shape[2]), tied])
    missed = np.concatenate([refined.gap[closed], refined.slip[sticks].ravel()])
    _, size, motions = np.linalg.svd(held)
    count = int(np.sum(size > HARDLY_MOVED))
    free = motions[count:].T
    if np.any(abs(moved[closed & ~sticks & (mu > 0), 1:] @ free) > NOT_MOVED):
        return np.inf, True
    return float(np.linalg.norm(missed) / np.min(size[:count], initial=np.inf)), free.shape[1] > 0


@dataclass(frozen=True, eq=False)
class ForceNorms:
    """The largest force, gap and slip of each contact (m,) for |d|_W = 1, in the scale of the compliance."""

    normal_force: Vector
    tangential_force: Vector
    force: Vector  # of the whole vector
    gap: Vector  # of (W d)_N
    slip: Vector  # of (W d)_T

    allowance: float  # the relative error of W^-1 and kappa by rounding of W, included in the norms

    @staticmethod
    def nearby(compliance: ContactOperators, lost_digits: float, status: Status, mu: Vector) -> ForceNorms | None:
        """Return the norms for answers with the same open contacts and, in the plane, the same slip directions.

        In the plane l_T = mu l_N s is not a separate force, so that tangential rows of slipping contacts may be
        dependent.

        Parameters
        ----------
        compliance, lost_digits : as in `of`
        status, mu : states and coefficients (m,)
        """
        acting = acting_rows(compliance, status, mu)
        slides = (abs(status) == 1) & (mu > 0) & (acting.shape[1] == 2)
        return ForceNorms.of(compliance, lost_digits, acting, np.where(slides, mu * status, 0.0))

    @staticmethod
    def of(
        compliance: ContactOperators, lost_digits: float, acting: Mask, drag: Vector | None = None
    ) -> ForceNorms | None:
        """Return the norms of forces on the rows that act (m, d), and on ties where a body floats.

        None if these rows are dependent up to rounding.

        Parameters
        ----------
        compliance, acting : the operators of the contacts, and the rows (m, d)
        lost_digits : by which W is rounded
        drag : (m,) l_T / l_N of contacts in the plane where it is known, 0 elsewhere
        """
        contacts, d = acting.shape
        rows = np.flatnonzero(acting)
        operator, joined = compliance.operator(rows, compliance.ties), _joined(acting, drag, compliance.ties)
        size = np.concatenate([compliance.size[rows], np.diag(operator)[len(rows) :]])
        if joined is not None:
            operator, size = joined.T @ operator @ joined, joined.T**2 @ size
        try:
            factor = np.linalg.cholesky(operator)
        except np.linalg.LinAlgError:
            return None
        pivots = np.diag(factor) ** 2 / size
        rounding = max(lost_digits, len(pivots) * EPS)
        allowance = float(PIVOTS_FLATTER * rounding / np.min(pivots, initial=1.0)) + compliance.rounding
        half = inverse_of_lower(factor)
        if not (allowance <= TOO_ROUNDED and np.all(np.isfinite(half))):
            return None
        half = half if joined is None else half @ joined.T
        inverse = np.zeros((contacts * d, contacts * d))
        inverse[np.ix_(rows, rows)] = (half.T @ half)[: len(rows), : len(rows)]
        own, response_of = (
            blocks.reshape(contacts, d, contacts, d)[np.arange(contacts), :, np.arange(contacts), :]
            for blocks in (inverse, compliance.W)
        )
        more = 1 + allowance
        return ForceNorms(
            more * np.sqrt(own[:, 0, 0]),
            more * np.sqrt(largest_eigenvalues(own[:, 1:, 1:])),
            more * np.sqrt(largest_eigenvalues(own)),
            more * np.sqrt(response_of[:, 0, 0]),
            more * np.sqrt(largest_eigenvalues(response_of[:, 1:, 1:])),
            allowance,
        )


def _joined(acting: Mask, drag: Vector | None, ties: int) -> Array | None:
    """Return the forces on acting rows and ties as combinations (q + k, p + k) of independent ones, None if all are
    independent.

    Parameters
    ----------
    acting, drag : as in `ForceNorms.of`
    ties : k
    """
    slides = np.flatnonzero((drag != 0) & acting.all(axis=1)) if drag is not None else np.zeros(0, dtype=np.intp)
    if drag is None or not len(slides):
        return None
    number = np.cumsum(acting).reshape(acting.shape) - 1
    all_forces = np.eye(int(np.sum(acting)) + ties)
    all_forces[number[slides, 1], number[slides, 0]] = drag[slides]
    return np.asarray(np.delete(all_forces, number[slides, 1], axis=1))


def margins_of(refined: RefinedLengths, norms: ForceNorms, status: Status, mu: Vector) -> Vector:
    """Return the distances (m,) beyond which contacts can be in another state, in the norm of forces and slips.

    A contact with a slip that counts as none may also stick, at any distance.

    Parameters
    ----------
    refined, norms : the refined answer and the norms of differences of forces
    status, mu : states and coefficients (m,)
    """
    closed, frictional = status != OPEN, mu > 0
    sticks, slides = closed & (status == STICK) & frictional, (abs(status) == 1) & frictional
    room = over(refined.room(mu), mu * norms.normal_force + norms.tangential_force)
    along = lengths(refined.slip) if refined.slip.shape[1] > 1 else status * refined.slip[:, 0]
    along = np.where(along <= refined.still, np.minimum(along, 0.0), along)
    found = np.where(closed, over(refined.normal, norms.normal_force), over(refined.gap, norms.gap))
    found = np.where(sticks, np.minimum(found, room), found)
    return np.asarray(np.where(slides, np.minimum(found, over(along, norms.slip)), found))


def wedged(compliance: ContactOperators, mu: Vector, refined: RefinedLengths) -> bool:
    """Return whether ties fix the gap but not the slip of a closed contact, so that its force is arbitrary."""
    felt, lengths_there = felt_rows(compliance), np.column_stack([refined.normal, refined.gap, refined.slip])
    least = refined.correction + CLOSED * np.max(abs(lengths_there), initial=0.0)
    return bool(np.any(~felt[:, 0] & felt[:, 1:].any(axis=1) & (mu > 0) & (refined.gap <= least)))


def over(size: Vector, norm: Vector) -> Vector:
    """Return size / norm, infinite if the norm is zero."""
    return np.divide(size, norm, out=np.full_like(size, np.inf), where=norm > 0)


def largest_eigenvalues(blocks: Array) -> Vector:
    """Return the largest eigenvalue of each of some symmetric blocks (m, d, d), 0 of empty ones."""
    return np.asarray(np.max(np.linalg.eigvalsh(blocks), axis=1, initial=0.0))


def norms_of_all_rows(compliance: ContactOperators, problem: LocalProblem) -> tuple[ForceNorms | None, float]:
    """Return the norms of forces on all contacts, and kappa; None and infinite if W is singular."""
    if problem.contacts > MOST_CONTACTS:
        return None, np.inf
    norms = ForceNorms.of(compliance, 0.0, rows_with_friction(compliance, problem.friction))
    if norms is None:
        return None, np.inf
    kappa = of_operator(compliance.W, problem.friction, problem.contacts, floats=False).kappa
    return norms, kappa * (1 + norms.allowance)


def norms_of_skew(
    compliance: ContactOperators, W: Array, mu: Vector, lost_digits: float = 0.0, acting: Mask | None = None
) -> tuple[ForceNorms | None, float]:
    """Return the norms and kappa of an unsymmetric operator W, by its symmetric part H.

    |(Wd)_i| <= w_i |d|_H with w_i^2 the largest eigenvalue of (W H^-1 W')_ii, and for any c_i > 0

        sum mu_i |d_N,i| |(Wd)_T,i| <= 1/2 sum mu_i (c_i d_N,i^2 + |(Wd)_T,i|^2 / c_i) <= kappa |d|_H^2.

    Parameters
    ----------
    compliance, W : H, with the scale of the contacts, and the operator (d m, d m)
    mu : coefficients of friction (m,)
    lost_digits : by which W is rounded
    acting : the rows (m, d) on which forces act, all by default
    """
    m, d = len(mu), len(W) // len(mu)
    acting = np.ones((m, d), dtype=bool) if acting is None else acting
    norms, rows = ForceNorms.of(compliance, lost_digits, acting), np.flatnonzero(acting)
    if norms is None:
        return None, np.inf
    half, more = np.zeros((m * d, len(rows))), 1 + norms.allowance
    half[rows] = inverse_of_lower(np.linalg.cholesky(compliance.W[np.ix_(rows, rows)])).T
    felt = (W @ half).reshape(m, d, -1)
    slip, gap = more * np.sqrt(largest_eigenvalues(felt[:, 1:] @ felt[:, 1:].swapaxes(1, 2))), felt[:, 0]
    if not acting.all():  # open contacts may have a force in another answer
        of_all = norms_of_skew(compliance, W, mu, lost_digits)[0]
        gap = np.full((m, 1), np.inf) if of_all is None else of_all.gap[:, None]
    gap = more * np.linalg.norm(gap, axis=1)
    kappa = more * coupling(half.reshape(m, d, -1)[:, 0], felt[:, 1:], mu)
    return replace(norms, gap=gap, slip=slip), kappa


@dataclass(frozen=True, eq=False)
class Eliminated:
    """The compliance W' of some contacts, all others keeping their states: forces d on them make T d on all rows."""

    W: Array  # (d q, d q), not symmetric where others slip in the plane
    whole: Array  # T (d m, d q)
    energy: Array  # T'W T
    response: Array  # (d q, p) response of these rows to unit eliminated forces
    inverse: Array  # |M^-1| (p, p), from residuals of their rows to those forces
    own: Array  # |P'W P| (p, p)
    held: Indices  # (p,) the rows that keep their length
    forces: Array  # P (d m, p): forces on all rows by unit eliminated forces
    growth: float  # |M| |M^-1|, the amplification of rounding of W


def eliminated(compliance: ContactOperators, status: Status, mu: Vector, law: Mask) -> Eliminated | None:
    """Eliminate the closed contacts but those of `law` (m,): they keep their gap, and slip where they stick.

    In the plane a slipping one has l_T = mu l_N s. None if that system is singular, or if some friction of `law` has no
    effect.

    Parameters
    ----------
    compliance : ContactOperators of bodies of which none floats
    status, mu : (m,) states and coefficients
    law : (m,) bool, the contacts that remain, all that slip in space among them
    """
    m, d, n = len(mu), len(compliance.W) // len(mu), len(compliance.W)
    place, W, felt = np.arange(n).reshape(m, d), compliance.W, felt_rows(compliance)
    if not felt[law].all():
        return None
    closed = (status != OPEN) & ~law
    sticks = felt[:, 1:] & (closed & (status == STICK) & (mu > 0))[:, None]
    held = np.concatenate([place[closed, 0], place[:, 1:][sticks]])
    P = np.zeros((n, len(held)))
    P[held, np.arange(len(held))] = 1.0
    slides = np.flatnonzero(closed & (abs(status) == 1) & (mu > 0))
    P[place[slides, 1], np.searchsorted(np.flatnonzero(closed), slides)] = (mu * status)[slides]
    kept, M = place[law].ravel(), W[held] @ P
    try:
        inverse = np.linalg.inv(M)
    except np.linalg.LinAlgError:
        return None
    T = -P @ (inverse @ W[np.ix_(held, kept)])
    T[kept, np.arange(len(kept))] += 1.0
    response, own = W[kept] @ P, abs(P.T @ W @ P)
    growth = float(np.linalg.norm(M, 1) * np.linalg.norm(inverse, 1)) if len(M) else 1.0
    return Eliminated(W[kept] @ T, T, T.T @ W @ T, abs(response), abs(inverse), own, held, P, growth)


@dataclass(frozen=True, eq=False)
class BalancedForces:
    """Norms of balanced differences of forces on bodies held by contacts only."""

    norms: ForceNorms  # infinite for gaps that rigid motions change freely
    kappa: float
    gap: Vector  # (m,) errors of gaps of the refined answer
    slip: Vector  # (m,) errors of its slips
    moved: Array  # (m, d, r) gaps and slips by unit rigid motions
    motions: int  # coordinates that displace bodies
    always: bool  # no motion slides a contact with friction, so an equilibrium exists

    def settled_by(self, closed: Mask, sticks: Mask) -> bool:
        """Return whether fixing the gaps of some contacts (m,) and the slips of others prevents all rigid motions."""
        rows = np.vstack([self.moved[closed, 0], self.moved[sticks, 1:].reshape(-1, self.moved.shape[2])])
        return len(rows) >= self.motions and int(np.linalg.matrix_rank(rows, HARDLY_MOVED)) == self.motions


def balanced_forces(
    compliance: ContactOperators, mu: Vector, refined: RefinedLengths, lost_digits: float
) -> BalancedForces | None:
    """Return the norms of differences of forces that balance, and kappa.

    None if contact rows are dependent, if balance does not determine a motion along which a contact has friction, or if
    rounding is too large.

    Parameters
    ----------
    compliance : the operators of the contacts
    mu, refined : coefficients of friction (m,), and the refined answer, whose forces balance
    lost_digits : by which W is rounded
    """
    W, V, motions = _rigid_lengths(compliance)
    m, n = len(mu), len(W)
    acting = rows_with_friction(compliance, mu)
    rows = np.flatnonzero(acting)
    if (U := _in_balance(V[rows])) is None:
        return None
    held = _settled_by_balance(U, rows, mu, refined)
    carried, left = _carried(V, held)
    free = abs(left).max(axis=1, initial=0.0).reshape(m, -1) > NOT_MOVED
    basis = np.linalg.qr(U, mode="complete")[0][:, U.shape[1] :]  # of forces that balance
    factored = _half_inverse(basis, W[np.ix_(rows, rows)], compliance.size[rows], lost_digits, compliance.rounding)
    if np.any(free[:, 1:] & (mu > 0)[:, None]) or factored is None:
        return None
    force, allowance = np.zeros((n, basis.shape[1])), factored[1]
    force[rows] = basis @ factored[0]
    length = (W - carried @ W[held]) @ force
    own = np.sqrt(W.diagonal()) * refined.correction
    missed = abs(np.column_stack([refined.gap, refined.slip]).ravel()[held]) + own[held]
    uncertain = (own + abs(carried) @ missed).reshape(m, -1)
    d, e = (one.reshape(*acting.shape, basis.shape[1]) for one in (force, length))
    sizes = [np.linalg.norm(one, ord=2, axis=(1, 2)) if one.size else np.zeros(m) for one in (d[:, 1:], d, e[:, 1:])]
    pushed, gap = (np.linalg.norm(one[:, 0], axis=1) for one in (d, e))
    more = 1 + allowance
    gap = np.where(free[:, 0], np.inf, more * gap)
    norms = ForceNorms(more * pushed, more * sizes[0], more * sizes[1], gap, more * sizes[2], allowance)
    kappa = more * coupling(d[:, 0], e[:, 1:], mu)
    moved = V.reshape(m, -1, V.shape[1])
    always = not np.any(abs(moved[mu > 0, 1:]) > NOT_MOVED)
    return BalancedForces(norms, kappa, uncertain[:, 0], lengths(uncertain[:, 1:]), moved, motions, always)


def part_that_is_seen(
    problem: ContactProblem, condensation: Condensation, mu: Vector, refined: RefinedLengths
) -> float:
    """Return the least v'Kv + sum K_jj v_j^2 for |v|_M = 1, v a difference of two answers; 0 if the norm is blind.

    It is at least one if every unknown has stiffness; others are determined by ties, and by contacts whose states
    follow from balance.

    Parameters
    ----------
    problem, condensation : of bodies that contacts alone hold
    mu, refined : coefficients of friction (m,), and the refined answer
    """
    if np.all(problem.diagonal > 0):
        return 1.0
    compliance = contact_compliance(problem, condensation)
    _, V, _ = _rigid_lengths(compliance)
    rows = np.flatnonzero(rows_with_friction(compliance, mu))
    U = _in_balance(V[rows])
    held = rows[:0] if U is None else _settled_by_balance(U, rows, mu, refined)
    basis, Z = compliance.that_keep(held), orthonormal_motions(condensation)
    scale = condensation.scale
    S = condensation.schur * (scale[:, None] * scale)
    seen = S + np.diag(problem.diagonal[condensation.retained] * scale**2)
    try:
        factor = np.linalg.cholesky(basis.T @ seen @ basis)
    except np.linalg.LinAlgError:
        return 0.0
    half = basis @ inverse_of_lower(factor).T
    most = float(np.max(np.linalg.eigvalsh(half.T @ (S + Z @ Z.T) @ half), initial=1.0))
    return 1.0 / most if most * SEEN < 1 else 0.0


def _rigid_lengths(compliance: ContactOperators) -> tuple[Array, Array, int]:
    """Return W and V of the tied bodies, and the number of motions that ties do not prevent."""
    values, vectors = np.linalg.eigh(compliance.J)
    held = abs(values) > FLOATING * np.max(abs(values), initial=1.0)
    V = compliance.V @ vectors
    W = compliance.W - (V[:, held] / values[held]) @ V[:, held].T
    return (W + W.T) / 2, V[:, ~held], int(np.linalg.matrix_rank(vectors[compliance.ties :, ~held], NOT_MOVED))


def rows_with_friction(compliance: ContactOperators, mu: Vector) -> Mask:
    """Return the rows (m, d) with compliance on which a force may act."""
    rows = compliance.felt
    rows[:, 1:] &= (mu > 0)[:, None]
    return rows


def _in_balance(V: Array) -> Array | None:
    """Return an orthonormal basis of the forces determined by balance, the range of V; None if its rank is
    uncertain.
    """
    U, size, _ = np.linalg.svd(V, full_matrices=False)
    felt = size > NOT_MOVED * np.max(size, initial=0.0)
    return None if not len(V) or np.any(size[felt] < HARDLY_MOVED) else U[:, felt]


def _settled_by_balance(U: Array, rows: Indices, mu: Vector, refined: RefinedLengths) -> Indices:
    """Return the contact rows with zero lengths in every answer, whose contacts are closed or stick by balance.

    Parameters
    ----------
    U : (p, k), orthonormal, spans what balance determines of the forces on some rows
    rows : (p,) those rows among all (d m)
    mu : (m,) coefficients of friction
    refined : the refined answer, whose forces balance
    """
    m, force = len(mu), np.column_stack([refined.normal, refined.friction])
    d = force.shape[1]
    spanned = np.zeros((m * d, U.shape[1]))
    spanned[rows] = U
    acting = np.isin(np.arange(m * d), rows).reshape(m, d)
    own = np.eye(d) - spanned.reshape(m, d, -1) @ spanned.reshape(m, d, -1).swapaxes(1, 2)
    values, vectors = np.linalg.eigh(own[:, 1:, 1:])
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=values > HARDLY_MOVED)
    a = -np.einsum("iab,ib,icb,ic->ia", vectors, inverse, vectors, own[:, 1:, 0])
    combined = np.zeros((m, m, d))
    combined[np.arange(m), np.arange(m)] = np.column_stack([np.ones(m), a])
    combined = combined.reshape(m, m * d)
    nothing = BEYOND_ROUNDING * np.max(abs(force), initial=0.0)
    known = np.linalg.norm(combined - (combined @ spanned) @ spanned.T, axis=1) <= DETERMINED
    closed = acting[:, 0] & known & (force[:, 0] + np.sum(a * force[:, 1:], axis=1) > nothing)
    alone = np.linalg.norm(np.eye(m * d) - spanned @ spanned.T, axis=1).reshape(m, d) <= DETERMINED
    sticks = closed & (acting & alone).all(axis=1) & (lengths(force[:, 1:]) < mu * force[:, 0] - nothing)
    return np.flatnonzero(np.column_stack([closed, np.repeat(sticks[:, None], d - 1, axis=1)]))


def _carried(V: Array, held: Indices) -> tuple[Array, Array]:
    """Return the rigid displacements of all rows by those of fixed ones (n, p), and by the remaining motions (n, q)."""
    turned, size, motions = np.linalg.svd(V[held])
    rank = int(np.sum(size > HARDLY_MOVED))
    return V @ (motions[:rank].T / size[:rank]) @ turned[:, :rank].T, V @ motions[rank:].T


def _half_inverse(
    basis: Array, W: Array, size: Vector, lost_digits: float, of_stiffness: float
) -> tuple[Array, float] | None:
    """Return X with X'B'W B X = 1 for a basis B, and the relative error of its squares; None if that is large.

    Parameters
    ----------
    basis, W : B (p, q) and W (p, p)
    size : (p,) the diagonal that W had before joints were eliminated
    lost_digits, of_stiffness : by which W is rounded, relative to `size`, and d'W d by rounding of the stiffness
    """
    energy = basis.T @ W @ basis
    try:
        factor = np.linalg.cholesky(energy)
    except np.linalg.LinAlgError:
        return None
    pivots = factor.diagonal() ** 2 / (basis.T**2 @ size)
    rounding = max(lost_digits, len(W) * EPS)
    allowance = float(PIVOTS_FLATTER * rounding / np.min(pivots, initial=1.0)) + of_stiffness
    half = inverse_of_lower(factor).T
    return (half, allowance) if allowance <= TOO_ROUNDED and np.all(np.isfinite(half)) else None
