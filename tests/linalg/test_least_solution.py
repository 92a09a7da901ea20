"""The least solution of sparse equations, of ill-conditioned and dependent ones too."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.linalg.least_norm import least_solution


def test_second_differences_are_met_where_least_squares_by_iteration_would_take_thousands_of_steps() -> None:
    n = 400
    differences = sp.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n, n + 2), format="csr")
    right = np.sin(np.arange(n))
    found = least_solution(differences, right)
    assert found == pytest.approx(np.linalg.lstsq(differences.toarray(), right, rcond=None)[0], rel=1e-8, abs=1e-8)
    assert differences @ found == pytest.approx(right, abs=1e-11)


def test_dependent_rows_in_other_units_are_met_together() -> None:
    rows = sp.csr_matrix([[1.0, 1.0, 0.0], [2e6, 2e6, 0.0], [0.0, 0.0, 1e-6]])
    found = least_solution(rows, np.array([1.0, 2e6, 3e-6]))
    assert rows @ found == pytest.approx([1.0, 2e6, 3e-6], rel=1e-14)
    assert found == pytest.approx([0.5, 0.5, 3.0], rel=1e-3)
