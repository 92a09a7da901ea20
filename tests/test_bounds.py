"""Bounds are never below the true error: small problems whose errors are known by hand, in the corners of rounding."""

import numpy as np
import pytest

import contactqp as cq

CHAIN = 100.0 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])


def chain(**changes):
    """Three nodes that float, the first held by a tie, the others before walls; pushed against both."""
    data = dict(stiffness=CHAIN, load=[0.0, 3.0, 5.0], normal=[[0, 1, 0], [0, 0, 1]], gap=[0.01, 0.02], tie=[[1, 0, 0]])
    return cq.ContactProblem(**(data | changes))


def test_forces_of_bodies_that_only_ties_hold_are_bounded_in_their_tied_compliance():
    problem = chain()
    force, tie = np.array([3.0, 4.0]), np.array([1.0])
    W = np.array([[1.0, 1.0], [1.0, 2.0]]) / 100  # by hand: the first node is the ground
    change = np.array([1e-3, -2e-3])
    certificate = cq.certify(problem, [0.0, 0.01, 0.02], force + change, tie_force=tie)
    error = np.sqrt(change @ W @ change) / np.sqrt(force @ W @ force)
    assert error * (1 - 1e-12) <= certificate.force_error <= 1.001 * error
    assert cq.certify(problem, [0.0, 0.01, 0.02], force, tie_force=tie).passed


def test_with_and_without_ties_the_larger_force_error_is_the_bound():
    K = CHAIN + np.diag([100.0, 0.0, 0.0])
    problem = chain(stiffness=K)
    force, change = np.array([3.0, 4.0]), np.array([2e-3, -2e-3])
    certificate = cq.certify(problem, [0.0, 0.01, 0.02], force + change, tie_force=[1.0])
    E = np.array([[0, 1, 0], [0, 0, 1.0]])
    for W in (E @ np.linalg.solve(K, E.T), np.array([[1.0, 1.0], [1.0, 2.0]]) / 100):
        assert certificate.force_error >= np.sqrt(change @ W @ change) / np.sqrt(force @ W @ force) * (1 - 1e-12)


def test_a_large_free_motion_does_not_hide_a_small_strain():
    """Moved by 2 along the motion that nothing resists, strained by 1e-13: v'Kv drowns in the rounding of Kv."""
    problem = cq.ContactProblem(CHAIN, [1.0, 0.0, -1.0], [[0, 0, 1.0]], [10.0])
    truth = np.array([0.01, 0.0, -0.01])
    moved = truth + 2.0 + np.array([0.0, 1e-13, 0.0])
    strain = np.diff(moved - truth)  # exact: numbers of like size are subtracted
    error = np.sqrt(100 * strain @ strain / (truth @ CHAIN @ truth))
    certificate = cq.certify(problem, moved, [0.0])
    assert error <= certificate.energy_error <= 100 * error
    assert certificate.passed


def test_what_is_open_or_closed_by_rounding_is_in_the_bounds():
    """Penetrated by one unit in the last place: the force that closes it, 2 * 2^-53, is the error of none."""
    problem = cq.ContactProblem([[2.0]], [2.0], [[1.0]], [1.0 - 2.0**-53])
    certificate = cq.certify(problem, [1.0], [0.0])
    assert certificate.force_bound[0] >= 2.0**-52
    assert certificate.force_error >= np.sqrt(0.5) * 2.0**-52
    assert certificate.energy_error >= 2.0**-53
    assert certificate.passed


def test_the_closed_contacts_are_searched_for_where_corrections_of_the_set_go_in_circles():
    """Nearly redundant contacts and an answer with no force: the bound is the error, not the gap of energies."""
    n = 6
    K = np.diag(np.full(n, 2.0)) - np.eye(n, k=1) - np.eye(n, k=-1)
    rng = np.random.default_rng(3)
    rows = np.ones((n, n)) + 1e-5 * rng.normal(size=(n, n))
    problem = cq.ContactProblem(K, rng.normal(size=n) + 1.0, rows, 0.1 + 1e-6 * rng.normal(size=n))
    solution = cq.solve(problem)
    free = np.linalg.solve(K, problem.load)
    error = free - solution.displacement
    true = np.sqrt(error @ K @ error) / np.sqrt(solution.displacement @ K @ solution.displacement)
    certificate = cq.certify(problem, free, np.zeros(n))
    assert certificate.energy_error == pytest.approx(true, rel=1e-6)
    assert not certificate.passed
