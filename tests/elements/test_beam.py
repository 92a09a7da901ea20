"""The beam against the textbook's cantilevers, in every direction."""

from fractions import Fraction as F

import numpy as np
import pytest

from contactqp.elements import beam


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 2, 2.5, -1.0])
def test_a_cantilever_bends_by_the_textbook(angle):
    """Tip load: w = F L^3 / (3 E I), theta = F L^2 / (2 E I); axial: F L / (E A)."""
    E, A, inertia, L, force = 7.0, 2.0, 0.3, 1.7, 0.9
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    K = beam.stiffness(E, A, inertia, np.zeros(2), L * along)[3:, 3:]
    bent = np.linalg.solve(K, [*(force * across), 0.0])
    np.testing.assert_allclose(bent[:2], force * L**3 / (3 * E * inertia) * across, atol=1e-14)
    assert np.isclose(bent[2], force * L**2 / (2 * E * inertia))
    stretched = np.linalg.solve(K, [*(force * along), 0.0])
    np.testing.assert_allclose(stretched, [*(force * L / (E * A) * along), 0.0], atol=1e-14)


def test_a_positive_rotation_turns_the_first_axis_towards_the_second():
    K = beam.stiffness(1.0, 1.0, 1.0, np.zeros(2), np.array([1.0, 0.0]))[3:, 3:]
    assert np.linalg.solve(K, [0.0, 1.0, 0.0])[2] > 0


def test_rigid_motions_cost_nothing():
    a, b = np.array([0.5, -0.2]), np.array([1.3, 0.9])
    K = beam.stiffness(3.0, 2.0, 0.1, a, b)
    turn = np.array([-a[1], a[0], 1, -b[1], b[0], 1])
    for motion in ([1, 0, 0, 1, 0, 0], [0, 1, 0, 0, 1, 0], turn):
        assert np.abs(K @ np.asarray(motion, dtype=float)).max() < 1e-13 * np.abs(K).max()


def test_a_beam_of_rational_length_is_exact():
    K = beam.stiffness(F(5), F(1), F(1), np.array([F(0), F(0)]), np.array([F(3), F(4)]))
    assert all(isinstance(entry, F | int) for entry in K.ravel())
    assert K[2, 2] == 4  # 4 E I / L
    assert (K == K.T).all()
