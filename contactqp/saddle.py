"""The equality-constrained problem on a set of closed contacts that may be redundant or leave motions free.

    [ S    E_B'  A' ] [ x   ]   [ r ]
    [ E_B  0     0  ] [ l_B ] = [ e ]       B: the closed contacts
    [ A    0     0  ] [ nu  ]   [ a ]

is solved by the null-space method on the condensed unknowns (Nocedal and Wright 2006, section 16.2): with
[E_B; A]' P = Q R, x = Y R^-T (e; a) + N v, N'SN v = N'(r - S Y ...). Rows that depend on others get no force;
motions that neither S nor a row resists (found from the rigid motions of K, not from small eigenvalues) stay at rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.condensation import UNRESISTED, Condensation
from contactqp.factorization import Array, DenseCholesky
from contactqp.problem import Vector

# Rows of unit length (in the energy scale) that are closer to dependent than this are dependent.
DEPENDENT = 1e-13
# The work of a load on a motion below this part of the forces that take part is rounding of a balanced load.
BALANCED = 1e-10
# So is a push of this part of all forces on motions that lie where no force acts.
IDLE = 256 * np.finfo(float).eps


class SaddlePoint:
    """Factorisation of the saddle-point system of one set of closed contacts."""

    def __init__(self, condensation: Condensation, closed: NDArray[np.intp], tied: bool = True) -> None:
        from scipy.linalg import qr

        self.closed = np.asarray(closed, dtype=np.intp)
        self._scale = condensation.scale
        self._uncertainty = condensation.rigid.uncertainty
        ties = condensation.tie if tied else condensation.tie[:0]
        rows = np.vstack([condensation.normal[self.closed], ties]) * self._scale
        self._row_scale = 1.0 / np.linalg.norm(rows, axis=1)
        rows = rows * self._row_scale[:, None]
        self._S = condensation.schur * np.outer(self._scale, self._scale)
        size = len(self._S)
        if len(rows):
            Q, R, pivots = qr(rows.T, pivoting=True)
            diagonal = abs(np.diag(R))
            rank = int(np.sum(diagonal > DEPENDENT * max(size, len(rows))))
        else:
            Q, R, pivots, rank = np.eye(size), np.zeros((size, 0)), np.zeros(0, dtype=int), 0
        self.independent = np.asarray(pivots[:rank], dtype=np.intp)  # rows, contacts first, that carry the set
        self.redundant = rank < len(rows)
        self._R, self._Y, self._N = R[:rank, :rank], Q[:, :rank], Q[:, rank:]
        self.free = self._unresisted(condensation, rows)
        self._hessian = self._factorise_hessian()

    def _unresisted(self, condensation: Condensation, rows: Array) -> Array:
        """An orthonormal basis (p, q) of the scaled motions that neither S nor a row resists."""
        motions = condensation.rigid.motions[condensation.retained] / self._scale[:, None]
        if not motions.shape[1]:
            return motions
        motions, _ = np.linalg.qr(motions)
        if not len(rows):
            return motions
        _, values, rotation = np.linalg.svd(rows @ motions)
        resisted = int(np.sum(values > UNRESISTED))
        return np.asarray(motions @ rotation[resisted:].T)

    def _factorise_hessian(self) -> DenseCholesky | None:
        motion = self._N.T @ self.free
        hessian = self._N.T @ self._S @ self._N + motion @ motion.T
        return DenseCholesky(hessian) if len(hessian) else None

    def solve(self, r: Array, e: Array, a: Array) -> tuple[Array, Array, Array]:
        """x, l_B, nu; right-hand sides are vectors or have one column a right-hand side."""
        from scipy.linalg import solve_triangular

        r = (r.T * self._scale).T
        rows = (np.concatenate([e, a]).T * self._row_scale).T
        x = np.zeros_like(r)
        if self.independent.size:
            x = self._Y @ solve_triangular(self._R, rows[self.independent], trans="T")
        if self._hessian is not None:
            step = self._N @ self._hessian.solve(self._N.T @ (r - self._S @ x))
            x = x + step - self.free @ (self.free.T @ step)
        force = np.zeros_like(rows)
        if self.independent.size:
            force[self.independent] = solve_triangular(self._R, self._Y.T @ (r - self._S @ x))
        force = (force.T * self._row_scale).T
        return (x.T * self._scale).T, force[: len(self.closed)], force[len(self.closed) :]

    def drive(self, load: Vector, size: Vector) -> Vector:
        """The scaled motion (p,) along which a condensed load drives what is free; zero if rounding of `size` does."""
        if not self.free.shape[1]:
            return np.zeros(len(load))
        push, size = self.free.T @ (load * self._scale), size * self._scale
        motion = self.free @ push
        part, idle = max(BALANCED, self._uncertainty), max(IDLE, self._uncertainty)
        rounding = max(part * float(size @ abs(motion)), float(idle * (push @ push) ** 0.5 * (size @ size) ** 0.5))
        return motion if float(push @ push) > rounding else np.zeros(len(load))
