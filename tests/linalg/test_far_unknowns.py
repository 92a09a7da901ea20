"""Unknowns that run far away do not hide from the bounds that a row among short lengths is not met."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from tests.linalg.test_crossover import wide


def of_size_one(problem: cq.ContactProblem) -> cq.ContactProblem:
    """Return a problem with rows scaled by powers of two to largest entries near one, which has the same answers."""
    rows, ties = (
        2.0 ** -np.round(np.log2(abs(matrix.toarray()).max(axis=1))) for matrix in (problem.normal, problem.tie)
    )
    return cq.ContactProblem(
        problem.stiffness, problem.load, sp.diags_array(rows) @ problem.normal, rows * problem.gap,
        tie=sp.diags_array(ties) @ problem.tie, tie_value=ties * problem.tie_value,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("decades", [2.25, 0.0])
def test_a_tie_that_is_not_met_passes_in_no_units_of_rows(decades: float) -> None:
    """A tie was met to 3e-5 of its own lengths, and an energy of 1051 proven, where `cq.exact` finds 5785204."""
    try:
        energy = cq.solve(of_size_one(wide(0, 60, decades))).energy
    except cq.NotCertified:
        return
    assert energy == pytest.approx(5785204.45, rel=1e-8)
