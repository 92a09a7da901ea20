"""Mass taken from the nodes that touch: what is kept, what cannot be done."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import block_diag

import contactqp as cq
from tests.analysis.motions import rod_at_wall


@pytest.mark.parametrize("lumped", [True, False])
def test_a_rod_keeps_its_mass(lumped: bool) -> None:
    problem, mass = rod_at_wall(10, lumped=lumped)
    moved = cq.redistributed_mass(mass, problem)
    assert moved.sum() == pytest.approx(mass.sum(), rel=1e-14)
    assert abs(moved[0]).sum() == 0.0
    assert abs(moved - mass)[3:, 3:].sum() == 0.0  # what is far from the contact stays


def test_a_plane_body_keeps_mass_centre_and_inertia() -> None:
    """A frame of springs in the plane: three rigid motions, and z'Mz of all of them as before."""
    rng = np.random.default_rng(3)
    points = np.array([[x, y] for x in range(5) for y in range(4)], float) + 0.1 * rng.normal(size=(20, 2))
    K = np.zeros((40, 40))
    for a in range(20):
        for b in range(a):
            way = points[a] - points[b]
            if np.linalg.norm(way) < 1.8:
                row = np.zeros(40)
                row[[2 * a, 2 * a + 1]], row[[2 * b, 2 * b + 1]] = way, -way
                K += np.outer(row, row)
    M = np.diag(np.repeat(rng.uniform(1.0, 2.0, 20), 2))
    normal = np.zeros((2, 40))
    normal[0, [0, 1]], normal[1, 9] = [0.6, 0.8], -1.0
    problem = cq.ContactProblem(K, np.zeros(40), normal, [1.0, 1.0])
    moved = cq.redistributed_mass(M, problem)
    turn = np.column_stack([-points[:, 1], points[:, 0]]).ravel()
    Z = np.column_stack([np.tile([1.0, 0], 20), np.tile([0, 1.0], 20), turn])
    np.testing.assert_allclose(Z.T @ moved @ Z, Z.T @ M @ Z, rtol=1e-9, atol=1e-9 * np.trace(M))
    assert abs(moved.toarray()[[0, 1, 9]]).sum() == 0.0
    assert np.linalg.eigvalsh(moved.toarray())[0] >= 0.0


def test_each_body_keeps_its_own_and_a_held_one_too() -> None:
    free, M = rod_at_wall(6)
    K = free.stiffness.toarray()
    held = K[1:, 1:]  # its first node is a support
    both, masses = block_diag(K, held), sp.block_diag([M, M.toarray()[1:, 1:]])
    rows = np.zeros((1, 13))
    rows[0, [6, 12]] = 1.0, -1.0
    problem = cq.ContactProblem(both, np.zeros(13), rows, [1.0])
    moved = cq.redistributed_mass(masses, problem).toarray()
    assert moved[:7, :7].sum() == pytest.approx(M.sum())
    assert moved[7:, 7:].sum() == pytest.approx(M.toarray()[1:, 1:].sum())
    assert abs(moved[[6, 12]]).sum() == 0.0


def test_what_has_no_neighbours_left_is_refused() -> None:
    pair = cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [0, 0], np.eye(2), [1.0, 1.0])
    with pytest.raises(cq.InvalidProblem, match="cannot be moved to others of the same body"):
        cq.redistributed_mass([1.0, 1.0], pair)
