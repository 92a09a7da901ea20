"""Residuals by slices have digits beyond double precision."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.errors import Unsupported
from contactqp.linalg.influence import SlicedStiffness


@pytest.mark.parametrize("unit", [1.0, 1e-20, 3e15])
def test_residuals_are_those_of_rationals(unit: float) -> None:
    rng = np.random.default_rng(3)
    shape = np.where(rng.random((30, 30)) < 0.2, rng.standard_normal((30, 30)), 0.0)
    scale = 10.0 ** rng.uniform(-3, 3, 30) * unit
    K = scale[:, None] * (shape @ shape.T + np.eye(30)) * scale
    x = rng.standard_normal((30, 3)) / scale[:, None] * [1.0, 1e-12, 1e7]
    right = np.column_stack([K @ column for column in x.T])  # but for rounding, which is what is left
    sliced = SlicedStiffness(sp.csr_array(K), 1 / np.sqrt(K.diagonal()))
    found = sliced.residual(right, x)
    for j in range(3):
        true = [
            float(Fraction(right[i, j]) - sum(Fraction(K[i, k]) * Fraction(x[k, j]) for k in range(30)))
            for i in range(30)
        ]
        size = np.sqrt(K.diagonal()) * np.max(abs(x[:, j]) * np.sqrt(K.diagonal()))
        assert np.max(abs(found[:, j] - true) / size) < 30 * 2.0**-62
        assert np.max(abs(np.array(true)) / size) > 2.0**-56
    assert not sliced.residual(np.zeros((30, 1)), np.zeros((30, 1))).any()


def test_rows_that_are_too_long_are_refused() -> None:
    with pytest.raises(Unsupported, match="600 entries"):
        SlicedStiffness(sp.csr_array(np.ones((600, 600))), np.ones(600))
