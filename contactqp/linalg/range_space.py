"""The saddle-point system on independent contacts of bodies that nothing lets float: by the range-space method.

    y = S^-1 r,    W_BB l = [E_B; A] y - (e; a),    x = y - S^-1 [E_B; A]' l

(Nocedal and Wright 2006, section 16.2). With S^-1 and W at hand (`delassus`) a set of closed contacts costs a Cholesky
factorisation of W_BB and nothing else; where S or W_BB is nearly singular `saddle` takes the null-space method.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import Delassus
from contactqp.linalg.factorization import DenseCholesky
from contactqp.model.arrays import Array, Vector

# Pivots of S and of W_BB, with diagonals of ones, beneath which the null-space method keeps more digits.
REGULAR = 1e-7


class RangeSpace:
    """Factorisation for one set of closed contacts."""

    redundant = False

    def __init__(self, condensation: Condensation, operator: Delassus, closed: NDArray[np.intp], tied: bool) -> None:
        self.closed = closed
        self.contraction: float | None = None
        self._operator = operator
        ties = np.arange(len(condensation.normal), len(operator.rows)) if tied else np.zeros(0, dtype=np.intp)
        self._members = np.concatenate([closed, ties])
        self.independent = np.arange(len(self._members))
        self.free: Array = np.zeros((len(condensation.retained), 0))
        self.free_coordinates: Array = np.zeros((condensation.rigid.count, 0))
        self._factor = DenseCholesky(operator.W[np.ix_(self._members, self._members)]) if len(self._members) else None
        self.regular = self._factor is None or self._factor.smallest_pivot >= REGULAR

    def solve(self, r: Array, e: Array, a: Array) -> tuple[Array, Array, Array]:
        """x, l_B, nu; right-hand sides are vectors or have one column a right-hand side."""
        operator, members = self._operator, self._members
        x = operator.solve((r.T * operator.scale).T) if np.any(r) else np.zeros_like(r)
        force = np.concatenate([e, a])
        if self._factor is not None:
            rows, scale = operator.rows[members], operator.row_scale[members]
            load = self._factor.solve(((rows @ x - force).T * scale).T)
            x = x - operator.response[:, members] @ load
            force = (load.T * scale).T
        return (x.T * operator.scale).T, force[: len(self.closed)], force[len(self.closed) :]

    def exchange(self, entering: int, force: Vector) -> int | None:
        """None: no contact depends on others."""
        del entering, force
        return None

    def drive(self, load: Vector, size: Vector) -> Vector:
        """Nothing is free to be driven."""
        del size
        return np.zeros(len(load))
