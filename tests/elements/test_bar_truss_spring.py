"""Bars, trusses and springs: exact numbers stay exact, forces balance, rigid motions cost nothing."""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contactqp.elements import bar, spring
from contactqp.elements.exact import square_root, unit_vector
from contactqp.errors import InvalidProblem

EA = (F(210_000_000), F(15, 10_000))  # kN/m^2, m^2
ORIGIN = np.array([F(0), F(0)])
COORDINATE = st.fractions(min_value=-10, max_value=10, max_denominator=100)


def test_the_bar_of_example_2_5_is_exact():
    assert bar.stiffness(*EA, F(2)).tolist() == [[157500, -157500], [-157500, 157500]]
    assert isinstance(bar.stiffness(*EA, F(2))[0, 0], F)
    assert bar.axial_force(*EA, F(2), F(1, 1000)) == F(315, 2)


def test_a_truss_on_one_axis_is_the_bar():
    K = bar.truss_stiffness(*EA, np.array([F(1)]), np.array([F(3)]))
    assert K.tolist() == bar.stiffness(*EA, F(2)).tolist()


def test_the_truss_of_example_2_10():
    left = bar.truss_stiffness(*EA, ORIGIN, np.array([F(-3), F(4)]))[:2, :2]
    assert left.tolist() == [[22680, -30240], [-30240, 40320]]  # a 3-4-5 triangle is rational
    right = bar.truss_stiffness(*EA, ORIGIN, np.array([F(3), F(3)]))[:2, :2]
    assert all(isinstance(k, float) for k in right.ravel())
    K = (left + right).astype(float)
    exact = np.array([[22680 + 26250 * np.sqrt(2), 26250 * np.sqrt(2) - 30240], [0, 40320 + 26250 * np.sqrt(2)]])
    np.testing.assert_allclose(np.triu(K), exact, rtol=4e-16)


def test_a_truss_in_space_is_exact_where_its_length_is():
    K = bar.truss_stiffness(F(27), F(1), np.array([F(0)] * 3), np.array([F(1), F(2), F(2)]))
    assert K[0, 0] == 1
    assert K[1, 5] == -4
    u = np.array([0, 0, 0, 1, 0, 0])
    assert bar.truss_axial_force(F(27), F(1), np.array([F(0)] * 3), np.array([F(1), F(2), F(2)]), u) == F(3)


@given(st.lists(COORDINATE, min_size=2, max_size=2), st.lists(COORDINATE, min_size=2, max_size=2))
def test_a_truss_resists_no_rigid_motion_and_balances(start, end):
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    if np.linalg.norm(b - a) < 0.01:
        return
    K = bar.truss_stiffness(2.0, 3.0, a, b)
    turn = np.array([-a[1], a[0], -b[1], b[0]])
    for motion in ([1, 0, 1, 0], [0, 1, 0, 1], turn):
        assert np.abs(K @ np.asarray(motion, dtype=float)).max() <= 1e-13 * np.abs(K).max() * np.abs(motion).max()
    assert np.abs(K - K.T).max() == 0


def test_the_axial_force_is_the_stiffness_times_the_displacement():
    a, b, u = np.array([0.0, 0.0]), np.array([2.0, 1.0]), np.array([0.1, -0.2, 0.3, 0.4])
    force = bar.truss_stiffness(5.0, 2.0, a, b) @ u
    n = (b - a) / np.linalg.norm(b - a)
    assert np.isclose(force[2:] @ n, bar.truss_axial_force(5.0, 2.0, a, b, u))
    assert bar.truss_axial_force(5.0, 2.0, a, b, np.array([0.0, 0.0, *n])) > 0  # pulled apart: tension


def test_springs_are_exact_along_any_rational_direction():
    K = spring.to_ground(F(10), [F(1), F(1)])
    assert K.tolist() == [[5, 5], [5, 5]]
    assert spring.stiffness(F(10), [F(2)]).tolist() == [[10, -10], [-10, 10]]
    assert spring.force(F(10), [F(3), F(4)], [F(1), F(0)]) == 6


def test_no_direction_is_refused():
    with pytest.raises(InvalidProblem, match="spring direction: expected a vector of positive length"):
        spring.to_ground(1.0, [0.0, 0.0])
    with pytest.raises(InvalidProblem):
        unit_vector([float("nan"), 1.0], "direction")


def test_roots_of_squares_are_exact():
    assert square_root(F(49, 36)) == F(7, 6)
    assert isinstance(square_root(F(2)), float)
    assert isinstance(square_root(4.0), float)
