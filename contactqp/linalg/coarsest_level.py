"""The coarsest level of a hierarchy, factorised densely once for every set of rows that may hold.

With t the unknowns that rows touch and o the others, scaled to a diagonal of ones,

    K_oo = L L',    X = L^-1 K_ot,    S = K_tt - X'X,

and S + E'CE, of few unknowns, is all that a change of the rows factorises anew.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import Unsupported
from contactqp.model.arrays import Array


class SingularLevel(Unsupported):
    """A level that Cholesky's method finds singular."""


class CoarsestLevel:
    """Factors of K_oo.

    Parameters
    ----------
    matrix : (n, n) sparse matrix
        K of the level; an unknown with a zero row gets a diagonal of one.
    touched : (t,) array of int
        The unknowns that rows may touch.
    """

    def __init__(self, matrix: Any, touched: NDArray[np.intp]) -> None:
        dense = matrix.toarray()
        empty = np.flatnonzero(np.diag(dense) <= 0)
        dense[empty, empty] = 1.0
        self.scale = 1 / np.sqrt(np.diag(dense))
        dense *= np.outer(self.scale, self.scale)
        self.touched = touched
        self.others = np.setdiff1d(np.arange(len(dense)), touched)
        self.lower = cholesky(dense[np.ix_(self.others, self.others)])
        coupling = dense[np.ix_(self.others, touched)]
        self.coupling = forward(self.lower, coupling)
        self.schur = dense[np.ix_(touched, touched)] - self.coupling.T @ self.coupling


class HeldCoarsestLevel:
    """(K + E'CE)^-1 on the coarsest level; `added` (t, t) is E'CE of the touched unknowns."""

    def __init__(self, level: CoarsestLevel, added: Array) -> None:
        self._level = level
        scale = level.scale[level.touched]
        self._lower = cholesky(level.schur + np.outer(scale, scale) * added)

    def solve(self, right: Array) -> Array:
        level, scaled = self._level, self._level.scale * right
        inner = forward(level.lower, scaled[level.others])
        x = np.empty_like(scaled)
        at = backward(self._lower, forward(self._lower, scaled[level.touched] - level.coupling.T @ inner))
        x[level.touched] = at
        inner -= level.coupling @ at
        x[level.others] = backward(level.lower, inner)
        return level.scale * x


def cholesky(matrix: Array) -> Array:
    """L of a matrix with a diagonal of about one.

    Raises
    ------
    SingularLevel
    """
    from scipy.linalg import cholesky as factor

    if not len(matrix):
        return matrix
    try:
        return np.asarray(factor(matrix, lower=True, check_finite=False))
    except np.linalg.LinAlgError:
        raise SingularLevel(
            "pyamg: the stiffness is singular, or too near to it to be solved by iteration; factorise it instead: "
            "CONTACTQP_SPARSE_SOLVER=pardiso or superlu"
        ) from None


def forward(lower: Array, right: Array) -> Array:
    """L^-1 right; LAPACK refuses what is empty."""
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(lower, right, lower=True, check_finite=False)) if right.size else right.copy()


def backward(lower: Array, right: Array) -> Array:
    """L'^-1 right."""
    from scipy.linalg import solve_triangular

    if not right.size:
        return right.copy()
    return np.asarray(solve_triangular(lower, right, lower=True, trans="T", check_finite=False))
