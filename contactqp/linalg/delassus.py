"""The Delassus operator of frictional contacts, normal and tangential rows together, as the law sees it.

With M = S + A'A + Z Z' on the scaled condensed unknowns, A the ties and Z the rigid motions (rows and columns of unit
length), R the rows (N_i, T_i) of all contacts and C = [A; -Z'],

    R x = free - W l - V j,        V' l + J j = held         W = R M^-1 R',  V = R M^-1 C',  J = C M^-1 C' - diag(0, I)

for contact forces l in the order (l_N, l_T) of each contact and joints j: what holds the ties, and where the bodies
are. Both rows of a contact are divided by sqrt(W_NN), so that coefficients of friction stay as they are and W_NN = 1.
Where J is regular no body floats, and the joints are eliminated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.dense import DenseCholesky, orthonormal_motions
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem

# Joints whose smallest singular value is less than this part of the largest leave a body floating.
FLOATING = 1e-9


@dataclass(frozen=True, eq=False)
class ContactCompliance:
    """The operators W, V, J of the contacts of one stiffness, for all loads, gaps and coefficients of friction."""

    W: Array  # (d m, d m)
    V: Array  # (d m, q), q = 0 where no body floats
    J: Array  # (q, q)
    scale: Vector  # (m,) sqrt(W_NN) that rows and lengths are divided by
    _rows: Array  # (d m, p) R, scaled
    _joints: Array  # (k + z, p) C
    _factor: DenseCholesky | None
    _elimination: Array  # (d m, k + z - q): what eliminated joints take to the contacts
    _unknown_scale: Vector
    _ties: int

    @property
    def floats(self) -> bool:
        """Whether a body is held by contacts alone."""
        return len(self.J) > 0

    @property
    def ties(self) -> int:
        """The joints that are ties; the others are rigid motions. None where no body floats."""
        return self._ties if self.floats else 0

    def operator(self, rows: NDArray[np.intp], joints: int) -> Array:
        """Return [[W, V], [V', J]] on some contact rows and the first of the joints."""
        V = self.V[rows, :joints]
        return np.block([[self.W[np.ix_(rows, rows)], V], [V.T, self.J[:joints, :joints]]])

    def on_rigid_motions(self) -> tuple[Array, Array]:
        """Return R Z (d m, r) and A Z (k, r): how far contact rows and ties move with the rigid motions."""
        Z = -self._joints[self._ties :].T
        return self._rows @ Z, self._joints[: self._ties] @ Z

    def free(self, problem: ContactProblem, condensation: Condensation) -> tuple[Vector, Vector]:
        """Return R x (d m,) under a problem's load without contact forces, and the lengths that joints hold (q,)."""
        load, _ = condensation.reduce_load(problem.load)
        tie_length = _lengths(condensation.tie * self._unknown_scale)
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
    tangent = np.zeros((0, len(scale))) if condensation.tangent is None else condensation.tangent.toarray() * scale
    width = len(tangent) // m if m else 0
    rows = np.concatenate([(condensation.normal * scale)[:, None], tangent.reshape(m, width, -1)], axis=1)
    tie = condensation.tie * scale
    tie = tie / _lengths(tie)[:, None]
    Z = orthonormal_motions(condensation)
    factor = None
    if len(scale):
        S = condensation.schur * (scale[:, None] * scale)
        factor = DenseCholesky(S + tie.T @ tie + Z @ Z.T)
    size = np.sqrt(_diagonal(rows[:, 0], factor))
    size = np.where(size > 0, size, 1.0)
    R = (rows / size[:, None, None]).reshape(m * (1 + width), -1)
    C = np.vstack([tie, -Z.T])
    both = np.vstack([R, C])
    G = both @ (both.T if factor is None else factor.solve(both.T))
    G = (G + G.T) / 2
    n = len(R)
    W, V, J = G[:n, :n], G[:n, n:], G[n:, n:] - np.diag(np.r_[np.zeros(len(tie)), np.ones(Z.shape[1])])
    elimination = np.zeros((n, 0))
    if len(J) and (inverse := _regular_inverse(J, len(tie))) is not None:
        elimination = V @ inverse
        W, V, J = W - elimination @ V.T, V[:, :0], J[:0, :0]
        W = (W + W.T) / 2
    return ContactCompliance(W, V, J, size, R, C, factor, elimination, scale, len(tie))


def _regular_inverse(J: Array, ties: int) -> Array | None:
    """Invert the joints' block; dependent ties share their force. None where a body floats."""
    values, vectors = np.linalg.eigh(J)
    kept = abs(values) > FLOATING * np.max(abs(values), initial=1.0)
    # A singular direction among the ties alone is a tie said twice; one that moves a body is a body that floats.
    if np.any(abs(vectors[ties:, ~kept]) > np.sqrt(FLOATING)):
        return None
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def _diagonal(rows: Array, factor: DenseCholesky | None) -> Vector:
    return np.asarray(np.einsum("ij,ji->i", rows, rows.T if factor is None else factor.solve(rows.T)))


def _lengths(rows: Array) -> NDArray[np.float64]:
    length = np.linalg.norm(rows, axis=1)
    return np.where(length > 0, length, 1.0)
