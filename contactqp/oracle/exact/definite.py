"""Proven lower bounds of the least eigenvalue of symmetric matrices of floats.

A factorisation P (M - s I) P' = L D L' + R with D > 0 proves  lambda_min(M) >= s - |R|,  whatever rounding there was on
the way to it, once R is bounded: its entries are computed, and what rounding may have added to them is bounded by the
same products of absolute values; dense matrices likewise with P = I and D^(1/2) within L. Floating-point Cholesky in
the spirit of Rump (2006), BIT 46, 433, a posteriori.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

EPS = float(np.finfo(float).eps)
# Sums of positive numbers in floats, of up to 1e8 terms, are this far from the truth at most.
SAFE = 1 + 1e-7
# Multiplications of the product L D L' beyond which it is not formed.
MOST_WORK = 3e9
POWER_STEPS = 12
# Matrices with more entries than this part of all, and fewer rows, are factorised as dense ones.
DENSE, MOST_DENSE = 0.2, 6000


def largest_row_sum(matrix: Any) -> float:
    """An upper bound of |M|_inf, and with it of every eigenvalue of a symmetric M."""
    sums = np.asarray(abs(matrix).sum(axis=1)).ravel()
    return float(np.max(sums, initial=0.0)) * SAFE


def least_eigenvalue(matrix: Any, uncertainty: float = 0.0) -> float | None:
    """A number that is positive and proven not to exceed lambda_min, or None where none was found.

    Parameters
    ----------
    matrix : (n, n) sparse symmetric matrix of floats
    uncertainty : float
        The matrix meant differs by at most this, in the infinity norm.
    """
    matrix = sp.csc_matrix(matrix)
    size = matrix.shape[0]
    if not size:
        return np.inf
    estimate = _estimate(matrix)
    if estimate is None:
        return None
    for part in (0.5, 0.1):
        shift = part * estimate
        off = _left_out(matrix, shift)
        if off is not None and (bound := (shift - (off + uncertainty) * SAFE) / SAFE) > 0:
            return float(bound)
    return None


def _estimate(matrix: Any) -> float | None:
    """About the least eigenvalue, by inverse iteration."""
    factors = _dense_factors(matrix) if _is_dense(matrix) else _factors(matrix)
    if factors is None:
        return None
    x = np.random.default_rng(0).standard_normal(matrix.shape[0])
    value = 0.0
    for _ in range(POWER_STEPS):
        y = factors.solve(x / np.linalg.norm(x))
        length = float(np.linalg.norm(y))
        if not np.isfinite(length) or length == 0:
            return None
        value, x = 1 / length, y
    return value


def _is_dense(matrix: Any) -> bool:
    size = matrix.shape[0]
    return bool(size <= MOST_DENSE and matrix.nnz > DENSE * size * size)


@dataclass(frozen=True, eq=False)
class _Cholesky:
    L: NDArray[np.float64]

    def solve(self, right: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(scipy.linalg.cho_solve((self.L, True), right))


def _dense_factors(matrix: Any) -> _Cholesky | None:
    try:
        return _Cholesky(np.linalg.cholesky(matrix.toarray()))
    except np.linalg.LinAlgError:
        return None


def _left_out_of_dense(shifted: Any) -> tuple[float, float] | None:
    """|M - LL'|_inf as computed, and what rounding may have added to it; of sums in whatever order."""
    factors = _dense_factors(shifted)
    if factors is None or not np.all(np.isfinite(factors.L)):
        return None
    L, size = np.tril(factors.L), len(factors.L)
    absolute = abs(L) @ (abs(L).T @ np.ones(size))
    return largest_row_sum(shifted.toarray() - L @ L.T), 2 * (size + 4) * EPS * float(np.max(absolute))


def _factors(matrix: Any) -> Any:
    from scipy.sparse.linalg import splu

    options = dict(SymmetricMode=True, Equil=False)
    try:
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError:  # exactly singular
        return None


def _left_out(matrix: Any, shift: float) -> float | None:
    """A bound of |R|_inf, None where the matrix less the shift is not found to be positive definite."""
    size = matrix.shape[0]
    shifted = sp.csc_matrix(matrix - shift * sp.identity(size, format="csc"))
    forming = 4 * EPS * (largest_row_sum(matrix) + shift)
    if _is_dense(shifted):
        parts = _left_out_of_dense(shifted)
        return None if parts is None else (sum(parts) + forming) * SAFE
    factors = _factors(shifted)
    if factors is None:
        return None
    order: NDArray[np.intp] = factors.perm_r
    pivots = factors.U.diagonal()
    if not np.array_equal(order, factors.perm_c) or not np.all(pivots > 0) or not np.all(np.isfinite(pivots)):
        return None
    L = sp.csc_matrix(factors.L)
    counts = np.diff(L.indptr).astype(float)
    if float(np.sum(counts**2)) > MOST_WORK:
        return None
    scaled = sp.csc_matrix(L @ sp.diags(pivots))
    back = np.empty(size, dtype=np.intp)
    back[order] = np.arange(size)
    permuted = shifted[back][:, back]
    rest = permuted - scaled @ L.T
    terms = float(np.max(np.diff(sp.csr_matrix(L).indptr))) + 4
    # Rounding: of the products, of their sums, and of forming the shifted matrix and the difference.
    absolute = abs(scaled) @ (abs(L).T @ np.ones(size))
    rounding = 2 * terms * EPS * float(np.max(absolute)) + forming
    return (largest_row_sum(rest) + rounding) * SAFE
