"""Residuals by plain products: in double precision, or beyond it at the cost of a few.

Those of many right-hand sides at once are formed to some digits beyond it by products without rounding. Ozaki, Ogita,
Oishi, Rump (2012), Numer. Algorithms 59: numbers are cut into slices of so few bits that sums of products of slices are
doubles,

    K x = K1 x1 + (K1 x2 + K2 x1) + (K1 x3 + K2 x2 + K3 x1) + rest,    |rest| <= 2^-65 |K| max|x| for each entry of K,

in the units in which the diagonal of K is about one. Each product is a plain one of sparse and dense matrices: a
residual takes as long as six of these, a tenth of one in twice double precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import Unsupported
from contactqp.linalg.extended import Extended, Residuals, extend, two_sum
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# Bits behind the point of the first and second slices; with so many entries in a row sums of products have 53 bits.
OF_ROWS, OF_COLUMNS, LONGEST_ROW = (22, 44), (21, 42), 512
# What residuals may be off by, in the units of the diagonal and of the largest entry of x, for each entry of a row.
LEFT_OUT = 2.0**-64


class SlicedStiffness:
    """A stiffness (n, n) CSR cut into slices, in units that are powers of two near `unit` (n,), about 1/sqrt(K_jj).

    Raises Unsupported: a row has too many entries.
    """

    def __init__(self, stiffness: Any, unit: Vector) -> None:
        self.longest = int(np.max(np.diff(stiffness.indptr), initial=0))
        if self.longest > LONGEST_ROW:
            raise Unsupported(f"residuals by slices: {self.longest} entries in a row, expected at most {LONGEST_ROW}")
        self._unit = 2.0 ** np.round(np.log2(unit))
        scaled = sp.csr_array(sp.diags(self._unit) @ stiffness @ sp.diags(self._unit))
        self._slices = []
        for data in _slices(scaled.data, OF_ROWS):
            self._slices.append(sp.csr_array((data, scaled.indices, scaled.indptr), shape=scaled.shape))

    def residual(self, right: Array, x: Array) -> Array:
        """Return right - K x (n, q) for several x (n, q) at once."""
        y = x / self._unit[:, None]
        size = 2.0 ** np.ceil(np.log2(np.maximum(abs(y).max(axis=0), np.finfo(float).tiny)))
        x1, x2, x3 = _slices(y / size, OF_COLUMNS)
        K1, K2, K3 = self._slices
        high, low = two_sum(right * self._unit[:, None] / size, -(K1 @ x1))
        left = (high - (K1 @ x2 + K2 @ x1)) + (low - (K1 @ x3 + K2 @ x2 + K3 @ x1))
        return np.asarray(left * size / self._unit[:, None])


def _slices(values: Array, bits: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Return the leading bits of numbers, the following ones, and what is left."""
    first = np.ldexp(np.rint(np.ldexp(values, bits[0])), -bits[0])
    rest = values - first
    second = np.ldexp(np.rint(np.ldexp(rest, bits[1])), -bits[1])
    return first, second, rest - second


# A change of the displacement whose |K||du| is nowhere more than this part of |K||u| changes K u by a product in double
# precision, of which rounding leaves 2^-101 |K||u|.
SLIGHT = 2.0**-48


def elastic_after(problem: ContactProblem, displacement: Vector, elastic: Extended, change: Vector) -> Extended | None:
    """Return K (u + du) after a slight change of u; None if it is not slight.

    Parameters
    ----------
    problem : ContactProblem
    displacement : (n,) array [length], u
    elastic : Extended (n,), K u [force]
    change : (n,) array [length], du
    """
    sizes = problem.stiffness_sizes
    if not (sizes @ abs(change) <= SLIGHT * (sizes @ abs(displacement))).all():
        return None
    added: Vector = problem.stiffness_rows @ change
    return elastic + added


def plain_residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """Return the residuals of an answer in double precision, each to a few dozen roundings of the sizes that meet."""
    u = answer.displacement
    outer = problem.normal.T @ answer.normal_force + problem.tie.T @ answer.tie_force
    if problem.tangent is not None and answer.friction_force is not None:
        outer = outer + problem.tangent.T @ answer.friction_force.ravel()
    force = problem.load - problem.stiffness_rows @ u - outer
    return Residuals(
        extend(force), extend(problem.gap - problem.normal @ u), extend(problem.tie_value - problem.tie @ u)
    )
