"""The least solution of sparse equations, of ill-conditioned and dependent ones too."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.linalg.convexity import least_solution, nearly_cancelling


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


def test_many_rows_that_nearly_cancel_are_made_to_cancel() -> None:
    # A chain around a ring: its springs' stretches add up to nothing, in other units along the ring.
    n, random = 800, np.random.default_rng(2)
    units = random.uniform(0.5, 2.0, n)
    ring = sp.csr_matrix((sp.identity(n) - sp.csr_matrix(np.roll(np.eye(n), 1, axis=1))).T @ sp.identity(n))
    rows = sp.csr_matrix(sp.diags(units) @ ring)
    near = (1.0 + 1e-7 * random.normal(size=n)) / units
    found = nearly_cancelling(rows, np.ones(n), near)
    assert np.max(abs(rows.T @ near)) > 1e-8
    assert np.max(abs(rows.T @ found)) < 1e-15
    assert found == pytest.approx(1.0 / units, rel=1e-5)
