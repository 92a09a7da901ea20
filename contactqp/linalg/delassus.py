"""The Delassus operator: what the contacts and ties feel of each other through the bodies.

    W = [E; A] S_e^-1 [E; A]',    S_e = S + e Z Z'

on the condensed unknowns, in the scale that gives S a unit diagonal and W too. Where bodies float, W would be
infinite along their rigid motions Z: the springs e anchor them, and a proximal iteration (Rockafellar 1976) takes the
anchors' force away.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.factorization import DenseCholesky
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem

# Soft against the bodies, so that one or two proximal steps suffice; stiff against rounding of W.
ANCHOR = 1e-6
# What a double-precision operator cannot tell from zero, relative to the lengths that meet.
OPERATOR_ROUNDING = 1e-12


class Delassus:
    """W and the free response, for one condensation and all of its loads."""

    def __init__(self, condensation: Condensation) -> None:
        self.scale = condensation.scale
        motions = condensation.rigid.motions[condensation.retained] / self.scale[:, None]
        self.motions = np.linalg.qr(motions)[0] if motions.shape[1] else motions
        self.rows = np.vstack([condensation.normal, condensation.tie]) * self.scale
        self._factor = self._factorised(condensation)
        response = self.solve(self.rows.T)
        W = sp.csr_array(self.rows) @ response  # a contact touches few unknowns
        self.row_scale = 1.0 / np.sqrt(np.diag(W))
        self.W = (W + W.T) / 2 * np.outer(self.row_scale, self.row_scale)
        self.response = response * self.row_scale

    def _factorised(self, condensation: Condensation) -> DenseCholesky | None:
        """S_e in its scale."""
        if not len(condensation.schur):
            return None
        if not self.motions.shape[1]:
            return condensation.schur_factor()
        S = condensation.schur * np.outer(self.scale, self.scale)
        return DenseCholesky(S + ANCHOR * self.motions @ self.motions.T)

    def solve(self, right: Array) -> Array:
        """S_e^-1 right, both scaled."""
        return right if self._factor is None else self._factor.solve(right)

    @property
    def smallest_pivot(self) -> float:
        """Of S with a diagonal of ones; beneath REGULAR its inverse has lost half of the digits."""
        return 1.0 if self._factor is None else self._factor.smallest_pivot

    @property
    def compliance(self) -> Vector:
        """W_ii of every contact and tie [length / force]."""
        return np.asarray(1.0 / self.row_scale**2)

    def squared_norm(self, force: Vector) -> tuple[float, float]:
        """|d|_W^2 of contact forces (m,), the ties away, and what it would be if they all helped each other."""
        scaled = force / self.row_scale[: len(force)]
        return float(scaled @ self.W[: len(force), : len(force)] @ scaled), float(np.sum(abs(scaled)) ** 2)

    def free_response(self, load: Vector, anchor: Vector) -> Vector:
        """Scaled displacement without contact forces, rigid motions anchored at the scaled displacement `anchor`."""
        return self.solve(load * self.scale + ANCHOR * self.motions @ (self.motions.T @ anchor))

    def dual_data(self, problem: ContactProblem, free: Vector) -> tuple[Array, Vector, NDArray[np.bool_], Vector]:
        """W, the excess of every row in the scaled displacement `free`, which rows are ties, what excess is none."""
        limit = np.concatenate([problem.gap, problem.tie_value])
        tolerance = OPERATOR_ROUNDING * self.row_scale * (abs(self.rows) @ abs(free) + abs(limit))
        excess = self.row_scale * (self.rows @ free - limit)
        return self.W, excess, np.arange(len(limit)) >= problem.contacts, tolerance

    def displaced(self, free: Vector, force: Vector) -> Vector:
        """The scaled displacement under scaled contact and tie forces."""
        return np.asarray(free - self.response @ force)


def delassus(condensation: Condensation) -> Delassus:
    """Made once for a condensation."""
    if not condensation.delassus:
        condensation.delassus.append(Delassus(condensation))
    operator: Delassus = condensation.delassus[0]
    return operator
