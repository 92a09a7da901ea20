"""Systems of closed contacts by signs: against `solve` where that can be asked, and beyond it."""

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.analysis.large import active_kkt
from contactqp.analysis.large.active_kkt import (
    by_signs,
    coulomb_by_signs,
    determinant_sign,
    lowest_eigenvalue,
    negative_on,
    positive_semidefinite,
    solve_system,
)
from contactqp.analysis.large.deformation import Forces
from contactqp.errors import NotConverged
from contactqp.linalg.dense import DENSE_SIZE

LARGE = DENSE_SIZE + 60


def problem(seed, n=8, m=5, friction=None):
    random = np.random.default_rng(seed)
    A = random.standard_normal((n, n))
    K, normal = A @ A.T + np.eye(n), random.standard_normal((m, n))
    tangential = {} if friction is None else dict(tangent=random.standard_normal((m, n)), friction=friction)
    return cq.ContactProblem(
        K,
        3 * random.standard_normal(n),
        normal,
        random.uniform(0, 1, m),
        tie=random.standard_normal((1, n)),
        tie_value=[0.3],
        **tangential,
    )


def chain(diagonal):
    """A large tridiagonal matrix."""
    return sp.csc_array(
        sp.diags_array([np.full(LARGE - 1, -1.0), diagonal, np.full(LARGE - 1, -1.0)], offsets=(-1, 0, 1))
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(10))
def test_signs_find_the_minimum_of_a_convex_problem(seed):
    p = problem(seed)
    solution = cq.solve(p)
    closed = np.random.default_rng(seed).random(p.contacts) < 0.5
    u, force, tie, found = by_signs(sp.csc_array(p.stiffness), p.load, p.normal, p.gap, p.tie, p.tie_value, closed)
    np.testing.assert_allclose(u, solution.displacement, atol=1e-10)
    np.testing.assert_allclose(force, solution.normal_force, atol=1e-10)
    np.testing.assert_allclose(tie, solution.tie_force, atol=1e-10)
    np.testing.assert_array_equal(found, solution.normal_force > 0)


def test_signs_find_a_stationary_point_of_an_indefinite_problem():
    """1/2 (u_1^2 - u_2^2) with u_2 <= 1 and a load on it: pushed onto the contact, or, with none closed, at -f."""
    K, normal = sp.csc_array(np.diag([1.0, -1.0])), sp.csr_array([[0.0, 1.0]])
    none = sp.csr_array((0, 2))
    data = (K, np.array([2.0, 0.5]), normal, np.array([1.0]), none, np.zeros(0))
    u, force, _, closed = by_signs(*data, np.array([True]))
    np.testing.assert_allclose(u, [2, 1])
    np.testing.assert_allclose(force, [1.5])
    assert negative_on(K, normal[np.flatnonzero(closed)]) == 0
    u, _, _, closed = by_signs(*data, np.array([False]))
    np.testing.assert_allclose(u, [2, -0.5])
    assert negative_on(K, normal[np.flatnonzero(closed)]) == 1


@pytest.mark.sampled(14)
@pytest.mark.parametrize("seed", range(25))
def test_signs_with_friction_find_what_solve_finds(seed):
    p = problem(seed, n=14, friction=0.3)
    solution = cq.solve(p)
    u, forces = coulomb_by_signs(sp.csc_array(p.stiffness), p, p.load, Forces(np.zeros(5), np.zeros(1)))
    np.testing.assert_allclose(u, solution.displacement, atol=1e-9)
    np.testing.assert_allclose(forces.normal, solution.normal_force, atol=1e-9)
    np.testing.assert_allclose(forces.friction, solution.friction_force, atol=1e-9)
    assert cq.certify(p, u, forces.normal, forces.friction, forces.tie).passed


def test_a_search_ends_where_sets_come_back_one_by_one(monkeypatch):
    """A set decides which one follows: what has come back so does for ever, and four solves a contact told no more."""
    solved = []
    original = active_kkt.solve_system
    monkeypatch.setattr(active_kkt, "solve_system", lambda *given: (solved.append(1), original(*given))[1])
    random = np.random.default_rng(19)
    half = random.integers(-3, 4, (4, 4)).astype(float)
    normal = sp.csr_array(random.integers(-2, 3, (6, 4)).astype(float))
    gap = random.integers(-2, 4, 6).astype(float)
    data = (sp.csc_array(half + half.T), random.integers(-3, 4, 4).astype(float), normal, gap)
    with pytest.raises(NotConverged, match="comes back"):
        by_signs(*data, sp.csr_array((0, 4)), np.zeros(0), np.zeros(6) > 0)
    assert 2 <= len(solved) <= 6


def test_redundant_contacts_are_singular():
    twice = sp.csr_array([[1.0], [1.0]])
    with pytest.raises(NotConverged, match="singular"):
        by_signs(
            sp.csc_array([[1.0]]), np.ones(1), twice, np.zeros(2), sp.csr_array((0, 1)), np.zeros(0), np.ones(2) > 0
        )
    with pytest.raises(NotConverged, match="singular"):
        solve_system(chain(np.zeros(LARGE)) * 0, np.zeros(LARGE))


def test_signs_of_determinants_dense_and_sparse():
    random = np.random.default_rng(0)
    for size in (3, 40, LARGE):
        for _ in range(3):
            matrix = sp.csc_array(random.random((size, size)) * (random.random((size, size)) < 8 / size))
            matrix = sp.csc_array(matrix + sp.diags_array(random.choice([-1.0, 1.0], size)))
            shuffled = sp.csc_array(matrix[random.permutation(size)])
            sign, _ = np.linalg.slogdet(shuffled.toarray())
            assert determinant_sign(shuffled) == sign != 0
            swapped = sp.csc_array(shuffled[[1, 0, *range(2, size)]])
            assert determinant_sign(swapped) == -sign
    assert determinant_sign(sp.csc_array(np.ones((2, 2)))) == 0


def test_definiteness_of_large_matrices_by_pivots():
    soft = np.full(LARGE, 2.0)
    none = sp.csr_array((0, LARGE))
    assert positive_semidefinite(chain(soft))
    assert negative_on(chain(soft), none) == 0
    soft[LARGE // 2] = 0.5
    assert not positive_semidefinite(chain(soft))
    assert negative_on(chain(soft), none) == 1
    held = sp.csr_array(sp.eye_array(LARGE).tocsr()[[LARGE // 2]])
    assert negative_on(chain(soft), held) == 0
    lowest = np.linalg.eigvalsh(chain(soft).toarray())[0]
    assert lowest_eigenvalue(chain(soft)) <= lowest < 0
