"""Rows too long to be summed slot by slot are summed in pairs, as exactly."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import scipy.sparse as sp

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
