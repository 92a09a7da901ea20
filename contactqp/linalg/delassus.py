"""The Delassus operator of frictional contacts, with normal and tangential rows together.

With M = S + A'A + Z Z' on the scaled condensed unknowns, A the ties and Z the rigid motions (rows and columns of unit
length), R the rows (N_i, T_i) of all contacts and C = [A; -Z'],

    R x = free - W l - V j,        V' l + J j = held         W = R M^-1 R',  V = R M^-1 C',  J = C M^-1 C' - diag(0, I)

for contact forces l in the order (l_N, l_T) of each contact and joints j, the tie forces and rigid displacements. Both
rows of a contact are divided by sqrt(W_NN), so that coefficients of friction stay as they are and W_NN = 1. Where J is
regular no body floats, and the joints are eliminated.

A local problem has its W given. Forces of contacts that are in given states satisfy

    u_N = 0, and u_T = 0 where a contact sticks, r_T = -mu r_N t where it slips, r = 0 where it is open,

u = W r + q, t the direction of the slip: a linear system in the plane, in space Newton's method updates the directions,
which are doubles and so limit the accuracy of the forces. The system is refined in twice double precision
(`refined_forces`).

The condensed stiffness and the rows of contacts, tangents and ties (`FrictionalRows`) are scaled to the unit of
sqrt(energy). With D = 1/sqrt(S_jj), x = D y and rows of unit length in the energy, r_i = |E_i D|, the rows R = [N; T;
A] become R_i D / r_i, their forces l_i r_i, their lengths (gaps, slips) g_i / r_i. Coulomb's coefficient becomes mu r_T
/ r_N. Two tangential rows of a contact in space have one length r_T, the root of their mean square: cones stay round.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.dense import REGULAR, DenseCholesky, orthonormal_motions
from contactqp.linalg.extended import Extended, SparseRows, extend, extended_rows
from contactqp.linalg.measures import directions, lengths
from contactqp.linalg.runtime import lapack, refuse_more_than_memory
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem

FLOATING = 1e-9  # joints whose smallest singular value is below this part of the largest leave a body floating
MUCH, MOST_MEASURED = 1e-6, 2_000_000  # entries of responses whose residuals measure the rounding of the stiffness
FIXED_BY_TIES = 1e-13  # ties fix a contact if they reduce its compliance to this part of that without ties
# The most sweeps of refinement, and the largest relative change of forces in the last one.
SWEEPS, NEGLIGIBLE, SETTLED = 30, 1e-28, 1e-13
# Below this part of the forces their changes turn no slip, as its directions in space are rounded to doubles.
TURNS_NOTHING = 1e-3 * EPS
DENSE_ROWS, LITTLE = 4, 2.0**24  # copies of the rows that are made at a time, and entries that fit into any memory


@dataclass(frozen=True, eq=False)
class ContactOperators:
    """The operators W, V, J of contacts and of the joints that are not eliminated."""

    W: Array  # (d m, d m)
    V: Array  # (d m, q), q = 0 where no body floats
    J: Array  # (q, q)
    scale: Vector  # (m,) that rows and lengths are divided by, and forces multiplied by
    ties: int  # the joints that are ties; the others are rigid motions
    size: Vector  # (d m,) the diagonal that W had before joints were eliminated, whose rounding W has

    @property
    def rounding(self) -> float:
        """Return the relative error of the energies d'W d by rounding of the stiffness, 0 where W is given."""
        return 0.0

    @property
    def felt(self) -> Mask:
        """Return which rows (m, d) are not fixed by ties up to rounding."""
        return np.asarray(self.W.diagonal() > FIXED_BY_TIES * self.size).reshape(len(self.scale), -1)

    @property
    def floats(self) -> bool:
        """Return whether a body is held by contacts alone."""
        return len(self.J) > 0

    def operator(self, rows: Indices, joints: int) -> Array:
        """Return [[W, V], [V', J]] on some contact rows and the first of the joints."""
        V = self.V[rows, :joints]
        return np.block([[self.W[np.ix_(rows, rows)], V], [V.T, self.J[:joints, :joints]]])


@dataclass(frozen=True, eq=False)
class ContactCompliance(ContactOperators):
    """The operators of the contacts of one stiffness, for all loads, gaps and coefficients of friction.

    The scale is sqrt(W_NN).
    """

    _rows: Array  # (d m, p) R, scaled
    _joints: Array  # (k + z, p) C
    _factor: DenseCholesky | None
    _elimination: Array  # (d m, k + z - q), the coupling of eliminated joints to the contacts
    _unknown_scale: Vector
    _lost: float  # the error of M relative to its diagonal
    _grown: float  # growth of rounding by the elimination of joints
    _measured: Callable[[], float]  # `_measured_rounding`

    @cached_property
    def rounding(self) -> float:
        """Return the relative error of the energies d'W d by rounding of M.

        W = R M^-1 R' changes by x'E x for x = M^-1 R'd where M changes by E, and |x|^2 <= |M^-1| d'W d. For slender
        bodies, where this bound is large, the residuals of the responses usually give a smaller one.
        """
        from scipy.linalg.lapack import dpocon

        inverse = 0.0
        if self._factor is not None:
            part = dpocon(self._factor.lower, 1.0, uplo="L")[0] if self._factor.smallest_pivot > 0 else 0.0
            inverse = 1.0 / part if part > 0 else np.inf
        changed = self.W.diagonal()[self.felt.ravel()]
        grown = np.max(self.size[self.felt.ravel()] / changed, initial=1.0)
        bound = float(self._lost * inverse + EPS * self._grown * grown)
        return bound if bound <= MUCH or self._joints.size else min(bound, self._measured())

    def on_rigid_motions(self) -> tuple[Array, Array]:
        """Return R Z (d m, r) and A Z (k, r), the displacements of contact rows and ties by rigid motions."""
        Z = -self._joints[self.ties :].T
        return self._rows @ Z, self._joints[: self.ties] @ Z

    def that_keep(self, rows: Indices) -> Array:
        """Return an orthonormal basis (p, q) of scaled displacements with zero ties and contact `rows`."""
        kept = np.vstack([self._rows[rows], self._joints[: self.ties]])
        _, size, motions = np.linalg.svd(kept)
        return motions[np.sum(size > FLOATING * np.max(size, initial=0.0)) :].T

    def free(self, problem: ContactProblem, condensation: Condensation) -> tuple[Vector, Vector]:
        """Return R x (d m,) under a problem's load without contact forces, and the right-hand sides of joints (q,)."""
        load, _ = condensation.reduce_load(problem.load)
        tie_length = unit_rows(condensation.tie * self._unknown_scale)[1]
        value = problem.tie_value / tie_length
        x = self._solve(load * self._unknown_scale)
        wanted = np.concatenate([value, np.zeros(len(self._joints) - len(value))])
        held = self._joints @ x - wanted
        free = self._rows @ x
        return (free, held) if self.floats else (free - self._elimination @ held, held[:0])

    def _solve(self, right: Array) -> Array:
        return right if self._factor is None else self._factor.solve(right)


def contact_compliance(problem: ContactProblem, condensation: Condensation) -> ContactCompliance:
    """Return the operators of a stiffness and its rows, which are formed once."""
    if problem._computed.contact_compliance is None:
        problem._computed.contact_compliance = _made(problem, condensation)
    made: ContactCompliance = problem._computed.contact_compliance
    return made


def _made(problem: ContactProblem, condensation: Condensation) -> ContactCompliance:
    scale, m = condensation.scale, problem.contacts
    _refuse_too_many(problem, len(scale))
    tangent = np.zeros((0, len(scale))) if condensation.tangent is None else condensation.tangent.toarray() * scale
    width = len(tangent) // m if m else 0
    rows = np.concatenate([(condensation.normal * scale)[:, None], tangent.reshape(m, width, -1)], axis=1)
    tie = unit_rows(condensation.tie * scale)[0]
    Z = orthonormal_motions(condensation)
    factor = None
    if len(scale):
        factor = DenseCholesky(condensation.schur * (scale[:, None] * scale) + tie.T @ tie + Z @ Z.T)
    normal = rows[:, 0]
    size = np.sqrt(np.einsum("ij,ji->i", normal, normal.T if factor is None else factor.solve(normal.T)))
    size = np.where(size > 0, size, 1.0)
    R = (rows / size[:, None, None]).reshape(m * (1 + width), -1)
    C = np.vstack([tie, -Z.T])
    both, n = np.vstack([R, C]), len(R)
    G = both @ (both.T if factor is None else factor.solve(both.T))
    G = (G + G.T) / 2
    W, V, J = G[:n, :n], G[:n, n:], G[n:, n:] - np.diag(np.r_[np.zeros(len(tie)), np.ones(Z.shape[1])])
    elimination, before, grown = np.zeros((n, 0)), W.diagonal(), 0.0
    if len(J) and (inverse := _regular_inverse(J, len(tie))) is not None:
        elimination, grown = V @ inverse, float(np.linalg.norm(inverse, 2) * np.linalg.norm(J, 2))
        W, V, J = W - elimination @ V.T, V[:, :0], J[:0, :0]
        W = (W + W.T) / 2
        unfelt = W.diagonal() <= max(FIXED_BY_TIES, EPS * grown) * before
        W[unfelt] = W[:, unfelt] = 0.0  # rounding of rows in the span of ties would appear as compliance
    lost, ties = max(condensation.lost_digits, len(scale) * EPS), len(tie) if len(J) else 0

    def measured() -> float:
        return _measured_rounding(problem, condensation, made)

    made = ContactCompliance(W, V, J, size, ties, before, R, C, factor, elimination, scale, lost, grown, measured)
    return made


def _measured_rounding(problem: ContactProblem, condensation: Condensation, made: ContactCompliance) -> float:
    """Return the relative error of d'W d by the residuals of the responses u, infinite if they are too many.

    Of rows E and the residuals r = E' - K u the compliance is E u + u'r but for the energy of r, of second order.
    """
    m, felt = problem.contacts, made.felt.ravel()
    width = len(made.W) // m
    if problem.dimension * len(made.W) > MOST_MEASURED or problem.tangent is None:
        return np.inf
    order = np.column_stack([np.arange(m), m + np.arange((width - 1) * m).reshape(m, -1)]).ravel()[felt]
    E = sp.vstack([problem.normal, problem.tangent], format="csr")[order]
    size, rows, stiffness = made.scale.repeat(width)[felt], SparseRows(E), extended_rows(problem).stiffness
    _, inner = condensation.reduce_residual(np.zeros(problem.dimension))
    responses = made._solve(made._rows[felt].T).T * made._unknown_scale
    u = np.array([condensation.expand(one, inner) for one in responses]) * size[:, None]
    W, change = made.W[np.ix_(felt, felt)], np.zeros((len(E.indptr) - 1,) * 2)
    for k, one in enumerate(u):
        left = extend(E[[k]].toarray()[0]) - stiffness @ extend(one)
        change[k] = (rows @ extend(one) - W[k] * size[k] * size).double() + u @ left.double()
    values, vectors = np.linalg.eigh(W)
    if not values[0] > 0:
        return np.inf
    half = vectors / np.sqrt(values) / size[:, None]
    return float(2 * np.linalg.norm(half.T @ change @ half, 2))


def _regular_inverse(J: Array, ties: int) -> Array | None:
    """Invert the joints' block; dependent ties share their force. None where a body floats."""
    values, vectors = np.linalg.eigh(J)
    kept = abs(values) > FLOATING * np.max(abs(values), initial=1.0)
    # A singular direction among the ties is a dependent tie; one with a rigid displacement is a floating body.
    if np.any(abs(vectors[ties:, ~kept]) > np.sqrt(FLOATING)):
        return None
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def velocity_of(problem: LocalProblem, force: Array, joint_force: Vector | None = None) -> Array:
    """Return u = W r + q + V l (m, d) of a problem in local form at forces (m, d) and (p,), in twice double precision.

    Self-equilibrated forces of redundant contacts may be so large that q is lost in doubles.
    """
    u = _extended_delassus(problem) @ extend(np.asarray(force, dtype=float).ravel()) + extend(problem.offset)
    if joint_force is not None and problem.joints:
        u = u + SparseRows(problem.bilateral) @ extend(joint_force)
    return np.asarray(u.double().reshape(problem.contacts, problem.dimension))


def _extended_delassus(problem: LocalProblem) -> SparseRows:
    if (computed := problem._of_matrices).extended is None:
        computed.extended = SparseRows(problem.delassus)
    extended: SparseRows = computed.extended
    return extended


@dataclass(frozen=True, eq=False)
class RefinedForces:
    """Forces in given states, their velocities, and the change in the last sweep."""

    force: Extended  # (d m,)
    velocity: Extended  # (d m,)
    last: Vector  # (d m,) [force]


def refined_forces(problem: LocalProblem, force: Array, status: Status) -> RefinedForces | None:
    """Return the forces in these states (m,) nearest to given ones (m, d), None if the refinement fails."""
    (m, d), closed = force.shape, status != OPEN
    scale, rows, q = np.repeat(problem.contact_scale, d), _extended_delassus(problem), extend(problem.offset)
    own = np.arange(m * d).reshape(m, d)[closed].ravel()
    r, last = extend(np.where(closed[:, None], force, 0.0).ravel()), np.zeros(m * d)
    turns = d == 3 and bool(np.any((problem.friction > 0) & closed & (status != STICK)))
    before, negligible = np.inf, TURNS_NOTHING if turns else NEGLIGIBLE
    for _ in range(SWEEPS if len(own) else 0):
        matrix, left = _equations(problem, status, r, (rows @ r + q).double())
        try:
            change = np.linalg.solve(matrix[np.ix_(own, own)], -left[own])
        except np.linalg.LinAlgError:
            return None
        size, whole = float(np.linalg.norm(change)), float(np.linalg.norm(r.double() / scale))
        if not np.isfinite(size):
            return None
        last = np.zeros(m * d)
        last[own] = change * scale[own]
        r = r + last
        if size <= negligible * whole or (size > 0.5 * before and size <= SETTLED * whole):
            break
        before = size
    else:
        if len(own):
            return None
    return RefinedForces(r, rows @ r + q, last)


def _equations(problem: LocalProblem, status: Status, r: Extended, velocity: Vector) -> tuple[Array, Vector]:
    """Return the derivatives (d m, d m) and residuals (d m,) of every contact's equations, all scaled."""
    m, d = problem.contacts, problem.dimension
    scale, mu = np.repeat(problem.contact_scale, d), problem.friction
    left, matrix = scale * velocity, problem.scaled_delassus.toarray()
    slip = left.reshape(m, d)[:, 1:]
    along = _along(status, slip)
    tangential = np.arange(m * d).reshape(m, d)[:, 1:].ravel()
    missed = left.copy()
    missed[tangential] = (r[tangential] + r[::d].spread(mu[:, None] * along)).double() / scale[tangential]
    force = (r.double() / scale).reshape(m, d)
    turning = np.divide(mu * force[:, 0], lengths(slip), out=np.zeros(m), where=(lengths(slip) > 0) & (d == 3))
    across = np.eye(d - 1) - along[:, :, None] * along[:, None, :]
    blocks = matrix.reshape(m, d, m * d)
    for i in np.flatnonzero(_slides_or_is_smooth(status, mu)):
        rows = slice(i * d + 1, (i + 1) * d)
        matrix[rows] = turning[i] * across[i] @ blocks[i, 1:] if turning[i] else 0.0
        matrix[rows, rows] += np.eye(d - 1)
        matrix[rows, i * d] += mu[i] * along[i]
        left[rows] = missed[rows]
    return matrix, left


def _along(status: Status, slip: Array) -> Array:
    """Return the directions of slip (m, d-1): in the plane those of the states."""
    return status[:, None].astype(float) * np.ones((1, 1)) if slip.shape[1] == 1 else directions(slip)


def _slides_or_is_smooth(status: Status, mu: Vector) -> Mask:
    """Return the closed contacts (m,) whose friction is known from their normal force."""
    return np.asarray((status != OPEN) & ((status != STICK) | (mu == 0)))


def compliance_of(S: Array, motions: Array) -> Array:
    """Return the pseudoinverse S^+ (p, p) of a stiffness whose null space is spanned by orthonormal motions (p, q)."""
    if not motions.shape[1]:
        return _inverse(S)
    inverse = _inverse(S + motions @ motions.T)
    inverse = inverse - motions @ (motions.T @ inverse)
    return np.asarray(inverse - (inverse @ motions) @ motions.T)


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric matrix that is positive definite up to rounding."""
    factor, failed = lapack().dpotrf(matrix, lower=1)
    if failed or not len(matrix):
        return np.asarray(np.linalg.inv(matrix))
    lower = np.tril(lapack().dpotri(factor, lower=1)[0])
    return np.asarray(lower + np.tril(lower, -1).T)


class FrictionalRows:
    """A frictional problem on its retained unknowns, scaled.

    Attributes
    ----------
    S : (p, p) array, the condensed stiffness, its diagonal one
    normal, tangent, tie : (m, p), ((d-1) m, p), (k, p) arrays, rows of unit length, tangents contact by contact
    all_rows : (d m + k, p) array, one after the other
    width : int, d-1, tangential rows a contact
    slides : (m,) array of bool
        Which contacts can slide: a tangential row whose unknowns are all supported is zero, and its arbitrary friction
        force is set to zero.
    coefficient : (m,) array, mu r_T / r_N: friction bounds in scaled forces
    corrections : int, the number of corrections by systems of combinations so far
    """

    def __init__(self, problem: ContactProblem, condensation: Condensation) -> None:
        if problem.friction is None or condensation.tangent is None:
            raise ValueError("frictional rows of a problem without friction")
        self.scale = condensation.scale
        self.S = condensation.schur * (self.scale[:, None] * self.scale)
        self.normal, self.normal_length = unit_rows(condensation.normal * self.scale)
        tangent = condensation.tangent.toarray() * self.scale
        self.width = len(tangent) // problem.contacts if problem.contacts else 1
        of_contacts, length = unit_rows(tangent.reshape(problem.contacts, -1))
        # The root mean square of a contact's rows.
        self.tangent_length = np.where(np.any(of_contacts != 0, axis=1), length / np.sqrt(self.width), 1.0)
        self.tangent = tangent / np.repeat(self.tangent_length, self.width)[:, None]
        self.slides = np.any(of_contacts != 0, axis=1)
        self.tie, self.tie_length = unit_rows(condensation.tie * self.scale)
        self.all_rows = np.vstack([self.normal, self.tangent, self.tie])
        self.coefficient = problem.friction * self.tangent_length / self.normal_length
        self.motions = orthonormal_motions(condensation)
        self.system: dict[bool, Any] = {}  # the last one, by `independent`
        self.corrections = 0

    @cached_property
    def compliance(self) -> Array:
        """Return the pseudoinverse S^+ (p, p): the inverse of S, zero on the rigid motions."""
        return compliance_of(self.S, self.motions)

    @cached_property
    def response(self) -> Array:
        """Return S^+ R' (p, d m + k), the displacements under unit forces."""
        return np.asarray(self.compliance @ self.all_rows.T)

    @cached_property
    def W(self) -> Array:
        """Return R S^+ R' (d m + k, d m + k), R the rows."""
        return np.asarray(self.all_rows @ self.response)

    def lengths(self, problem: ContactProblem) -> tuple[Vector, Vector, Vector]:
        """Return scaled gaps (m,), slip origins ((d-1) m,) and tie values (k,)."""
        origin = np.zeros(len(self.tangent)) if problem.slip_origin is None else problem.slip_origin.ravel()
        slip = origin / np.repeat(self.tangent_length, self.width)
        return problem.gap / self.normal_length, slip, problem.tie_value / self.tie_length


def unit_rows(rows: Array) -> tuple[Array, Vector]:
    """Return rows scaled to unit length and the original lengths; an empty row is unchanged, with length 1."""
    length = np.linalg.norm(rows, axis=1)
    length = np.where(length > 0, length, 1.0)
    return np.asarray(rows / length[:, None]), length


def condensed_frictional_rows(problem: ContactProblem, condensation: Condensation) -> FrictionalRows:
    """Return the scaled rows of a problem, computed once for its coefficients and condensation."""
    cached = problem._computed.frictional_rows
    if cached is None or cached[1] is not condensation or np.any(cached[0] != problem.friction):
        _refuse_too_many(problem, len(condensation.scale))
        rows = FrictionalRows(problem, condensation)
        cached = problem._computed.frictional_rows = problem.friction, condensation, rows
    found: FrictionalRows = cached[2]
    return found


def _refuse_too_many(problem: ContactProblem, retained: int) -> None:
    """Raise Unsupported where the dense operators of contacts with friction do not fit into memory."""
    count = problem.ties + problem.contacts + (0 if problem.tangent is None else problem.tangent.shape[0])
    if (size := (DENSE_ROWS * count + retained) * retained + count**2) > LITTLE:
        what = f"dense operators of {problem.contacts} contacts with friction and {retained} unknowns at them"
        refuse_more_than_memory(what, size)


@dataclass(frozen=True, eq=False)
class AcrossSlips:
    """Rows across the slip directions in space, combinations of the two tangential rows of each contact."""

    contacts: Indices  # (a,)
    rows: Array  # (a, d-1)
    compliance: Vector  # (a,) |s| / mu l_N of the forces along them


NONE_ACROSS = AcrossSlips(np.zeros(0, dtype=np.intp), np.zeros((0, 1)), np.zeros(0))  # in the plane no slip turns


def across_slips(directions: Array, turning: Vector) -> AcrossSlips:
    """Return the rows across directions of slip (m, 2), of contacts at which mu l_N / |s| (m,) is positive.

    Large compliances, where bodies move far under small forces, are scaled to one together with their rows.
    """
    moving = np.flatnonzero(turning > 0)
    left = np.column_stack([-directions[moving, 1], directions[moving, 0]])
    scale = np.sqrt(np.minimum(turning[moving], 1.0))
    return AcrossSlips(moving, scale[:, None] * left, 1.0 / np.maximum(turning[moving], 1.0))


class ReducedStates:
    """The system of a combination (`contactqp.linalg.friction_states`) by its Schur complement on the forces.

    With constrained rows H = B R and rows P = A R along which forces act, combinations of the rows R of all contacts
    and ties, and the compliances C of forces across slips,

        [ S  P' ] [ x ]   [ r ]
        [ H  -C ] [ l ] = [ e ],    (B W A' + C) l = H S^-1 r - e,    x = S^-1 (r - P'l),    W = R S^-1 R',

    for bodies that do not float; W is formed once for all combinations.

    Attributes
    ----------
    regular : bool, whether the reciprocal condition of the complement is at least `REGULAR`

    Parameters
    ----------
    rows : FrictionalRows
    acting : (q,) array of int, the rows of R that are held
    directions : (m, d-1) array, of slip; zero where a contact does not slip
    across : AcrossSlips
    """

    def __init__(self, rows: FrictionalRows, acting: Indices, directions: Array, across: AcrossSlips) -> None:
        m, q, a = len(rows.normal), len(acting), len(across.contacts)
        along = m + np.arange(len(rows.tangent)).reshape(m, rows.width)
        own, crossed, of = np.arange(q), q + np.arange(a), across.contacts
        pushing = acting[acting < m]
        drag = rows.coefficient[pushing, None] * directions[pushing]
        held = [(np.ones(q), own, acting), (across.rows.ravel(), crossed.repeat(rows.width), along[of].ravel())]
        pushed = [*held, (drag.ravel(), own[: len(pushing)].repeat(rows.width), along[pushing].ravel())]
        self._rows = rows
        self._held, self._pushed = (_combined(parts, (q + a, len(rows.all_rows))) for parts in (held, pushed))
        matrix = np.asarray(self._pushed @ (self._held @ rows.W).T).T
        matrix[crossed, crossed] += across.compliance
        self.regular = len(matrix) > 0
        if self.regular:
            factor, pivots, info = lapack().dgetrf(matrix)
            self.regular = info == 0 and bool(lapack().dgecon(factor, np.linalg.norm(matrix, 1))[0] >= REGULAR)
            self._factor = factor, pivots

    def solve(self, right: Vector, transposed: bool) -> Vector:
        """Return x and l of right-hand sides r and e, one after the other, or those of the transposed system."""
        rows, p = self._rows, len(self._rows.S)
        held, pushed = (self._pushed, self._held) if transposed else (self._held, self._pushed)
        x = rows.compliance @ right[:p]
        force = lapack().dgetrs(*self._factor, held @ (rows.all_rows @ x) - right[p:], trans=int(transposed))[0]
        return np.concatenate([x - rows.response @ (pushed.T @ force), force])


def _combined(parts: list[tuple[Vector, Indices, Indices]], shape: tuple[int, int]) -> sp.csr_array:
    """Return a sparse matrix of entries with their rows and columns."""
    values, row, column = (np.concatenate(one) for one in zip(*parts, strict=True))
    return sp.csr_array((values, (row, column)), shape=shape)
