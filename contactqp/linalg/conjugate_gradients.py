"""Preconditioned conjugate gradients on the displacements that held rows allow, and what they tell of the error.

With z = M r, rho_k = r_k'z_k and step lengths a_k,

    |e_0|_K^2 - |e_k|_K^2 = sum of a_j rho_j over j < k            (Hestenes and Stiefel 1952, theorem 6:1)
    |e_k|_K^2 <= rho_k / (least eigenvalue of M K)

and the eigenvalues of the tridiagonal matrix of the steps (Ritz values) approach those of M K from within.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from contactqp.model.arrays import Vector

# The square of a residual that is zero.
TINY = float(np.finfo(float).tiny)


class Projections(Protocol):
    """What rows that hold make of displacements and forces."""

    def admit(self, z: Vector) -> None:
        """Take out of z what moves the rows, in place."""

    def balanced(self, r: Vector) -> Vector:
        """What the forces on the rows leave of r."""


class ConjugateGradients:
    """The state of one run; `step` changes it.

    Parameters
    ----------
    product : callable
        K x.
    precondition : callable
        z = M r, symmetric positive definite.
    x, residual : (n,) arrays
        Where it starts, rows closed, and f - K x there; both are changed in place.
    rows : Projections
        Of the rows that x must keep.
    dot : callable
        a'b of two vectors.
    """

    def __init__(
        self,
        product: Callable[[Vector], Vector],
        precondition: Callable[[Vector], Vector],
        x: Vector,
        residual: Vector,
        rows: Projections,
        dot: Callable[[Vector, Vector], float] = np.dot,
    ) -> None:
        self._product, self._precondition, self._rows, self._dot = product, precondition, rows, dot
        self.x, self.residual = x, residual
        self.unbalanced = rows.balanced(residual)  # what the forces on the rows leave of the residual
        self.gained = 0.0  # |e_0|^2 - |e|^2
        self._lengths: list[float] = []  # a_k
        self._ratios: list[float] = []  # rho_k+1 / rho_k
        self._square: float | None = None  # rho of the residual as it is; None until M is applied to it
        self._before, self._before_size = np.inf, 1.0  # rho of the residual before it, and that residual squared
        self._direction = np.zeros(0)

    @property
    def steps(self) -> int:
        return len(self._lengths)

    def square(self) -> float:
        """rho = r'M r."""
        if self._square is None:
            self._square = self._aim()
        return self._square

    def estimate(self) -> float:
        """rho as far as the last application of M tells, scaled with the residual; infinite before the first."""
        return self._before * self._size() / self._before_size

    def _aim(self) -> float:
        """The next direction, and rho."""
        z = self._precondition(self.unbalanced)
        self._rows.admit(z)
        square = max(float(self._dot(self.unbalanced, z)), 0.0)
        if self._lengths:
            self._ratios.append(square / self._before)
            self._direction *= self._ratios[-1]
            self._direction += z
        else:
            self._direction = z
        self._before, self._before_size = square, max(self._size(), TINY)
        return square

    def _size(self) -> float:
        return float(self._dot(self.unbalanced, self.unbalanced))

    def step(self) -> bool:
        """One iteration; false where rounding or a singular K leave nothing to go along."""
        square = self.square()
        force = self._product(self._direction)
        stiffness = float(self._dot(self._direction, force))
        if not (square > 0 and stiffness > 0 and np.isfinite(stiffness)):
            return False
        length = square / stiffness
        self.x += length * self._direction
        force *= length
        self.residual -= force
        self.unbalanced = self._rows.balanced(self.residual)
        self.gained += length * square
        self._lengths.append(length)
        self._square = None
        return True

    def least_eigenvalue(self) -> float:
        """The least Ritz value of M K; one, the largest that M K can have, before the first step."""
        from scipy.linalg import eigvalsh_tridiagonal

        if not self._lengths:
            return 1.0
        a, b = np.array(self._lengths), np.array(self._ratios[: len(self._lengths) - 1])
        diagonal = 1 / a
        diagonal[1:] += b / a[:-1]
        return float(eigvalsh_tridiagonal(diagonal, np.sqrt(b) / a[:-1])[0])
