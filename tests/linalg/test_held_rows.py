"""Projections on held rows, against the formulas with dense matrices; rows that depend on others."""

import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.linalg.krylov import AssembledRows, IndependentRows


def random_rows(seed=0, count=5, columns=9):
    generator = np.random.default_rng(seed)
    E = generator.standard_normal((count, columns)) * (generator.random((count, columns)) < 0.5)
    E[np.arange(count), np.arange(count)] = 2.0
    return E, 10.0 ** generator.uniform(-2, 2, columns), generator.standard_normal(count)


def test_the_projections_are_those_of_their_formulas():
    E, compliance, limit = random_rows()
    columns = np.array([1, 2, 4, 5, 7, 8, 10, 11, 12])
    rows = AssembledRows(sp.csr_matrix(E), columns, limit, compliance)
    r, x = np.random.default_rng(1).standard_normal((2, 14))
    gram = E * compliance @ E.T
    force = np.linalg.solve(gram, E @ (compliance * r[columns]))
    assert rows.forces(r) == pytest.approx(force, rel=1e-12)
    left = r.copy()
    left[columns] -= E.T @ force
    assert rows.balanced(r) == pytest.approx(left, rel=1e-12)
    closed, moved = x.copy(), x.copy()
    rows.close(closed)
    rows.admit(moved)
    assert E @ closed[columns] == pytest.approx(limit, rel=1e-12)
    assert E @ moved[columns] == pytest.approx(np.zeros(5), abs=1e-13)
    assert (closed - moved)[columns] == pytest.approx(compliance * (E.T @ np.linalg.solve(gram, limit)), rel=1e-10)
    others = np.setdiff1d(np.arange(14), columns)
    assert closed[others].tolist() == x[others].tolist() == moved[others].tolist()


@pytest.mark.parametrize("seed", range(5))
def test_dependent_rows_carry_nothing_and_are_met_with_the_others(seed):
    E, compliance, limit = random_rows(seed)
    twice = np.vstack([E, -3 * E[1], E[0] + E[2]])
    limits = np.concatenate([limit, [-3 * limit[1], limit[0] + limit[2]]])
    rows = AssembledRows(sp.csr_matrix(twice), np.arange(9), limits, compliance)
    x = np.random.default_rng(seed).standard_normal(9)
    force = rows.forces(x)
    assert np.count_nonzero(force) == 5
    single = AssembledRows(sp.csr_matrix(E), np.arange(9), limit, compliance)
    assert twice.T @ force == pytest.approx(E.T @ single.forces(x), rel=1e-10)
    rows.close(x)
    assert twice @ x == pytest.approx(limits, rel=1e-10)


@pytest.mark.parametrize("seed", [2917, 2966, 2983])
def test_rows_whose_dependence_rounding_hides_are_left_out(seed):
    """Whole numbers, of which some rows are sums of others: pivots of these cancel to zero, which SuperLU refuses."""
    rng = np.random.default_rng(seed)
    m, n = rng.integers(2, 12, 2)
    rows = sp.random(m, n, 0.4, random_state=seed).tocsr()
    rows.data = rng.choice([-2.0, -1.0, 1.0, 2.0], len(rows.data))
    rows = sp.csr_matrix(sp.vstack([rows, rng.integers(-1, 2, (3, m)) @ rows]))
    rows.eliminate_zeros()
    rows = rows[np.diff(rows.indptr) > 0]
    unit = sp.csr_matrix(sp.diags(1 / np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())) @ rows)
    assert len(IndependentRows(unit, np.ones(n)).kept) == np.linalg.matrix_rank(rows.toarray())
