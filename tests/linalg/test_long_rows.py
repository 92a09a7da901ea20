"""Long rows are summed in pairs, as exactly as short ones, and many of them side by side."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.linalg import extended
from contactqp.linalg.extended import LONG, Extended, SparseRows


def test_a_long_row_is_as_exact_as_a_short_one() -> None:
    rng = np.random.default_rng(0)
    count = 5 * LONG + 1
    row = rng.standard_normal(count) * 10.0 ** rng.integers(-8, 8, count)
    hi = rng.standard_normal(count)
    lo = hi * rng.uniform(-1, 1, count) * 2.0**-54
    product = SparseRows(sp.csr_matrix(np.vstack([row, np.eye(1, count)[0]]))) @ Extended(hi, lo)
    terms = [Fraction(a) * (Fraction(x) + Fraction(y)) for a, x, y in zip(row, hi, lo, strict=True)]
    exact, size = sum(terms), sum(abs(term) for term in terms)
    assert abs(Fraction(float(product.hi[0])) + Fraction(float(product.lo[0])) - exact) <= size * Fraction(2) ** -98
    assert product.hi[1] == hi[0]


def test_many_long_rows_are_summed_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two hundred dense rows had taken two hundred calls, most of the time of the residuals of a dense program."""
    rng, count = np.random.default_rng(1), LONG + 88
    rows, x = rng.integers(-9, 10, (200, count)).astype(float), rng.standard_normal(count)
    calls, product = [], extended.two_product

    def counted(*arguments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls.append(1)
        return product(*arguments)

    monkeypatch.setattr(extended, "two_product", counted)
    found = SparseRows(rows) @ Extended(x)
    assert len(calls) <= 10
    for row, hi, lo in zip(rows, found.hi, found.lo, strict=True):
        exact = sum(Fraction(a) * Fraction(b) for a, b in zip(row, x, strict=True))
        size = sum(abs(Fraction(a) * Fraction(b)) for a, b in zip(row, x, strict=True))
        assert abs(Fraction(float(hi)) + Fraction(float(lo)) - exact) <= size * Fraction(2) ** -98
