"""Products in more than double precision against rational numbers."""

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import extended, factorization
from contactqp.linalg.equilibration import equilibrated
from contactqp.linalg.extended import (
    Extended,
    ExtendedAnswer,
    ExtendedRows,
    SparseRows,
    StiffnessRows,
    extend,
    extended_rows,
    joined,
    residuals_of,
)
from contactqp.linalg.factorization import images
from contactqp.model.computed import OfStiffness


@pytest.mark.parametrize("short", [0, factorization.SHORT], ids=["pairs of doubles", "the longest floats there are"])
def test_images_are_right_where_doubles_cancel(monkeypatch, short):
    """K z of rows whose terms cancel but for the last digits: to half an eps of the sum of sizes, whoever adds."""
    monkeypatch.setattr(factorization, "SHORT", short)
    random = np.random.default_rng(0)
    matrix = sp.random(40, 40, 0.4, random_state=random, format="csr")
    matrix.data *= 2.0 ** random.integers(-20, 20, size=matrix.nnz)
    columns = random.normal(size=(40, 3))
    dense = matrix.toarray()
    columns[0] -= (dense @ columns)[0] / np.where(dense[0, 0], dense[0, 0], 1.0)
    found = images(matrix, columns)
    for i, row in enumerate(dense):
        for j, z in enumerate(columns.T):
            terms = [Fraction(float(a)) * Fraction(float(x)) for a, x in zip(row, z, strict=True)]
            size = float(sum(abs(term) for term in terms))
            rounded = abs(found[i, j]) * np.finfo(float).eps
            assert abs(found[i, j] - float(sum(terms))) <= 0.5 * np.finfo(float).eps * size / 2**8 + rounded


def test_long_rows_are_added_in_pairs_of_doubles(monkeypatch):
    """So many terms in floats of 64 digits would lose what rounding of doubles is told by."""
    monkeypatch.setattr(factorization, "SHORT", 3)
    row = np.array([[2.0**60, 1.0, -(2.0**60), 2.0**-20]])
    assert images(sp.csr_matrix(row), np.ones((4, 1)))[0, 0] == 1.0 + 2.0**-20


def test_no_columns_have_no_images():
    assert images(sp.identity(4, format="csr"), np.zeros((4, 0))).shape == (4, 0)


def residuals_laid_out(array, monkeypatch):
    """Residuals of an answer with ties and friction, rows of different lengths, and their exact values and sizes."""
    monkeypatch.setattr(extended, "ONE_ARRAY", array)
    random = np.random.default_rng(1)
    K, rows = random.normal(size=(7, 7)), random.normal(size=(6, 7)) * (random.random((6, 7)) < 0.5)
    problem = cq.ContactProblem(
        K @ K.T, random.normal(size=7), rows[:2], [0.1, 0.2], rows[2:4], 0.3, tie=rows[4:], tie_value=[0.0, 1.0]
    )
    u, normal, tie, friction = (Extended(random.normal(size=n), 1e-18 * random.normal(size=n)) for n in (7, 2, 2, 2))
    exact = ExtendedRows(problem)
    left = residuals_of(exact, problem, ExtendedAnswer(u, normal, friction, tie))
    found = [left.force, left.gap, left.tie, exact.gap(problem, u), exact.slip(u)]
    E_N, E_T, A = (matrix.toarray() for matrix in (problem.normal, problem.tangent, problem.tie))
    outward = np.concatenate([problem.stiffness, E_N, A, E_T]).T, joined(u, normal, tie, friction)
    expected = [missing(limit, matrix, vector) for limit, matrix, vector in (
        (problem.load, *outward), (problem.gap, E_N, u), (problem.tie_value, A, u), (problem.gap, E_N, u),
        (np.zeros(2), -E_T, u),
    )]  # fmt: skip
    if exact.together is not None:
        found, expected = [*found, left.slip], [*expected, expected[-1]]
    return found, expected, exact.together is not None


def missing(limit, matrix, vector):
    """Return limit - A x, entry by entry in rational numbers, and the sum of the sizes of its terms."""
    exactly = [Fraction(float(hi)) + Fraction(float(lo)) for hi, lo in zip(vector.hi, vector.lo, strict=True)]
    every = [
        [Fraction(float(start)), *(-Fraction(float(a)) * x for a, x in zip(row, exactly, strict=True))]
        for start, row in zip(limit, matrix, strict=True)
    ]
    return [(sum(terms), sum(abs(term) for term in terms)) for terms in every]


@pytest.mark.parametrize("array", [extended.ONE_ARRAY, 0])
def test_residuals_are_right_to_twice_double_precision_in_one_array_and_row_by_row(array, monkeypatch):
    found, expected, in_one_array = residuals_laid_out(array, monkeypatch)
    assert in_one_array == (array > 0)
    for one, exact in zip(found, expected, strict=True):
        assert one.hi.size
        for hi, lo, (value, size) in zip(one.hi, one.lo, exact, strict=True):
            assert abs(Fraction(float(hi)) + Fraction(float(lo)) - value) <= 4 * extended.FINE_EPS * size
            assert hi + lo == hi


def test_a_slight_change_of_a_displacement_changes_its_elastic_forces_by_a_product_of_doubles(monkeypatch):
    """K (u + du) is known to a few roundings of twice double precision; where |K||du| is more it is formed anew."""
    random = np.random.default_rng(2)
    K = random.normal(size=(7, 7))
    problem = cq.ContactProblem(K @ K.T, random.normal(size=7), random.normal(size=(2, 7)), [0.1, 0.2])
    products, product = [], extended._product
    monkeypatch.setattr(extended, "_product", lambda block, *given: products.append(block) or product(block, *given))
    rows = StiffnessRows(problem.stiffness_rows, OfStiffness(sizes=problem.stiffness_sizes))
    u = Extended(random.normal(size=7), 1e-18 * random.normal(size=7))
    change = 1e-16 * u.hi * random.normal(size=7)
    for moved, formed in ((u, 1), (u + change, 1), (u + 2 * change, 1), (u + 1e3 * change, 2), (extend(u.double()), 3)):
        found = rows @ moved
        assert len(products) == formed
        for one, (value, size) in zip(-found, missing(np.zeros(7), problem.stiffness, moved), strict=True):
            assert abs(Fraction(float(one.hi)) + Fraction(float(one.lo)) - value) <= 16 * extended.FINE_EPS * size
    unlike = u.hi * np.where(np.arange(7) == 3, 1e3, 1.0)  # far at one unknown alone
    rows @ extend(unlike)
    assert len(products) == 4


def test_a_product_that_another_thread_stores_meanwhile_is_not_mixed_with_the_last_one():
    """Problems with other contacts share a stiffness, but no lock; here |K| stores another product when asked."""
    problem = cq.ContactProblem(np.diag([1.0, 2.0, 3.0]), np.ones(3), np.eye(3), np.ones(3))

    class Meanwhile:
        def __matmul__(self, sizes):
            rows._last = extend(np.full(3, 7.0)), extend(np.full(3, 9.0))
            return problem.stiffness_sizes @ sizes

    rows = StiffnessRows(problem.stiffness_rows, OfStiffness(sizes=Meanwhile()))
    for _ in range(2):
        rows._last = extend(np.ones(3)), extend([1.0, 2.0, 3.0])
        assert (rows @ extend(np.ones(3))).double().tolist() == [1.0, 2.0, 3.0]


def test_a_matrix_without_columns_makes_nothing():
    none = extended.DenseRows(np.zeros((0, 3))) @ Extended(np.zeros(0))
    assert not none.hi.any()
    assert len(none) == 3


def test_rows_in_other_units_are_laid_out_once_and_equal_to_the_last_bit():
    rng = np.random.default_rng(3)
    n, m, k = 900, 60, 20
    half = sp.random(n, n, 0.01, random_state=rng, format="csr")
    units = 10.0 ** rng.uniform(-4, 4, n)
    K = sp.diags(units) @ (half + half.T + 20 * sp.identity(n)) @ sp.diags(units)
    rows = sp.random(m + k, n, 0.02, random_state=rng, format="csr") + sp.identity(n, format="csr")[: m + k]
    problem = cq.ContactProblem(K, rng.normal(size=n), rows[:m], np.ones(m), tie=rows[m:], tie_value=np.ones(k))
    twin, _ = equilibrated(problem)
    found, expected = extended_rows(twin), ExtendedRows(twin.replace(load=twin.load))
    expected._of_stiffness = OfStiffness()
    vector = Extended(rng.normal(size=n), 1e-17 * rng.normal(size=n))
    forces = Extended(rng.normal(size=m + k), 1e-17 * rng.normal(size=m + k))
    for name, given in (("stiffness", vector), ("normal", vector), ("tie", vector), ("outward", forces)):
        one, other = getattr(found, name) @ given, getattr(expected, name) @ given
        assert isinstance(getattr(expected, name), SparseRows)
        assert not isinstance(getattr(found, name), SparseRows)
        assert np.array_equal(one.hi, other.hi)
        assert np.array_equal(one.lo, other.lo)
