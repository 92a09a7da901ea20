"""The rows of contacts: E_N u <= gap, the gap positive when open, in every dimension and with exact numbers.

Membranes over obstacles have one unknown a node: their rows, their sides, and a string whose contact zone is known.
"""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import contactqp as cq
from contactqp.elements.members import point_mass_matrix, weight
from contactqp.elements.obstacle import Plane, against_plane, between_nodes, tangents
from contactqp.elements.pairing import Pairing
from contactqp.errors import InvalidProblem

DIRECTION = st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1)


def test_the_wall_of_example_2_5():
    rows = against_plane(np.array([F(2)]), Plane(point=np.array([F(2001, 1000)]), normal=np.array([-1])))
    assert rows.normal.tolist() == [1]
    assert rows.gap == F(1, 1000)
    assert rows.tangent.shape == (0, 1)


def test_the_floor_of_example_2_10():
    rows = against_plane(np.array([F(0), F(0)]), Plane(point=np.array([F(7), F(-1, 1000)]), normal=np.array([0, 3])))
    assert rows.normal.tolist() == [0, -1]
    assert rows.gap == F(1, 1000)
    assert rows.tangent.tolist() == [[1, 0]]


def test_the_two_bars_of_example_2_13():
    rows = between_nodes(np.array([F(2)]), np.array([F(2001, 1000)]), [1])
    assert rows.normal.tolist() == [1, -1]
    assert rows.gap == F(1, 1000)


@pytest.mark.slow
@given(DIRECTION, DIRECTION)
def test_moving_a_node_changes_its_gap_by_the_row(normal, motion):
    """gap(x + u) = gap(x) - E_N u, and moving along a tangent leaves the gap."""
    plane = Plane(point=[0.1, 0.2, 0.3], normal=normal)
    x, u = np.array([1.0, 2.0, -1.0]), np.array(motion)
    rows = against_plane(x, plane)
    assert np.isclose(plane.distance([x + u])[0], rows.gap - rows.normal @ u)
    assert len(rows.tangent) == 2
    for t in rows.tangent:
        assert np.isclose(plane.distance([x + t])[0], rows.gap)


@pytest.mark.slow
@given(DIRECTION)
def test_tangents_are_orthonormal(normal):
    n = np.array(normal) / np.linalg.norm(normal)
    frame = np.vstack([n, tangents(n)])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)


@pytest.mark.slow
@given(DIRECTION, DIRECTION, DIRECTION)
def test_two_nodes_slip_by_their_relative_motion_only(direction, motion, common):
    rows = between_nodes([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], direction)
    together = np.concatenate([common, common])
    assert np.allclose(rows.normal @ together, 0)
    assert np.allclose(rows.tangent @ together, 0)
    apart = np.concatenate([motion, common])
    n = np.array(direction) / np.linalg.norm(direction)
    assert np.isclose(rows.normal @ apart, n @ (np.array(motion) - common))


def test_pairs_are_placed_where_the_unknowns_are():
    floor = cq.elements.pairing.Plane(point=[0.0, 0.0], normal=[0.0, 2.0])
    E_N, g, E_T = cq.pair([[0.0, 0.5], [1.0, -0.25]], floor, unknowns=[[4, 5], [0, 1]], dimension=6)
    assert E_N.toarray().tolist() == [[0, 0, 0, 0, 0, -1], [0, -1, 0, 0, 0, 0]]
    assert g.tolist() == [0.5, -0.25]
    assert E_T.toarray().tolist() == [[0, 0, 0, 0, 1, 0], [1, 0, 0, 0, 0, 0]]


def test_pairs_in_space_are_contact_major():
    pairing = cq.pair(np.zeros((2, 3)), Plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0]))
    assert isinstance(pairing, Pairing)
    assert pairing.tangent.shape == (4, 6)
    assert pairing.tangent.toarray()[2:].tolist() == [[0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0]]


def test_a_pair_makes_a_problem():
    E_N, g, E_T = cq.pair([[0.0]], Plane(point=[1e-3], normal=[-1.0]))
    solution = cq.solve(cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=E_N, gap=g))
    assert np.isclose(solution.normal_force[0], 142.5, rtol=1e-12)
    assert E_T.shape == (0, 1)


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        ([[0.0, 0.0, 0.0]], {}, "points: expected shape"),
        ([[0.0, float("nan")]], {}, "points: expected finite"),
        ([[0.0, 0.0]], {"unknowns": [[0]]}, "unknowns: expected whole numbers of shape"),
        ([[0.0, 0.0]], {"unknowns": [[0.0, 1.0]]}, "unknowns: expected whole numbers"),
        ([[0.0, 0.0]], {"unknowns": [[0, 5]], "dimension": 3}, "unknowns: expected numbers from 0 to 2"),
        ([[0.0, 0.0]], {"unknowns": [[-1, 0]]}, "unknowns: expected numbers from 0"),
    ],
)
def test_pairs_that_do_not_fit_are_refused(points, options, message):
    with pytest.raises(InvalidProblem, match=message):
        cq.pair(points, Plane(point=[0.0, 0.0], normal=[0.0, 1.0]), **options)


@pytest.mark.parametrize(("point", "normal"), [([0.0], [0.0]), ([0.0, 0.0], [1.0]), ([0.0] * 4, [1.0] * 4)])
def test_planes_that_are_none_are_refused(point, normal):
    with pytest.raises(InvalidProblem, match="plane"):
        Plane(point=point, normal=normal)


def test_a_point_mass_weighs_and_resists():
    assert weight(F(2), [F(0), F(-981, 100)]).tolist() == [0, F(-981, 50)]
    assert point_mass_matrix(2.0, 2).tolist() == [[2, 0], [0, 2]]


POINTS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])


def test_above_and_below():
    above = cq.pair_scalar(POINTS, lambda x: x[:, 0] + x[:, 1])
    assert above.normal.toarray().tolist() == (-np.eye(3)).tolist()
    assert above.gap.tolist() == [0, -1, -2]
    below = cq.pair_scalar(POINTS, [0.5, 1.0, 2.0], side="below", unknowns=[4, 0, 1], dimension=6)
    assert below.normal.toarray()[:, [4, 0, 1]].tolist() == np.eye(3).tolist()
    assert below.gap.tolist() == [0.5, 1.0, 2.0]
    assert below.tangent.shape == (0, 6)
    u = np.array([3.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    np.testing.assert_allclose(below.gap - below.normal @ u, [0.5 - 1, 1 - 3, 2 - 0])


def test_no_obstacle_is_no_contact():
    pairing = cq.pair_scalar(POINTS, [-np.inf, 1.0, -np.inf])
    assert pairing.nodes.tolist() == [1]
    assert pairing.unpaired.tolist() == [0, 2]
    assert pairing.normal.toarray().tolist() == [[0, -1, 0]]


def test_a_string_over_a_parabola_lifts_off_where_its_tangent_reaches_the_supports():
    """Over h = 0.5 - x^2 on (-1, 1), u(+-1) = 0: the tangent through (1, 0) touches at a, a^2 - 2 a + 1/2 = 0."""
    n = 401
    x = np.linspace(-1, 1, n)
    K = (np.diag(np.full(n, 2.0)) - np.diag(np.ones(n - 1), 1) - np.diag(np.ones(n - 1), -1)) / (x[1] - x[0])
    free = slice(1, -1)
    pairing = cq.pair_scalar(x[free, np.newaxis], lambda x: 0.5 - x[:, 0] ** 2)
    solution = cq.solve(
        cq.ContactProblem(stiffness=K[free, free], load=np.zeros(n - 2), normal=pairing.normal, gap=pairing.gap)
    )
    held = x[free][solution.normal_force > 1e-9]
    a = 1 - np.sqrt(0.5)
    assert abs(held.max() - a) < 2 / (n - 1)
    assert np.isclose(solution.normal_force.sum(), 4 * a, rtol=1e-2)  # the slopes at the supports, -h'(a) = 2 a each
    inner = np.abs(x[free]) < a - 0.02
    np.testing.assert_allclose(solution.normal_force[inner] / (x[1] - x[0]), 2.0, rtol=1e-8)  # pressure -h''


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((POINTS, [1.0, 2.0]), {}, r"obstacle_height: expected shape \(3,\), got \(2,\)"),
        ((POINTS, [0.0, np.nan, 0.0]), {}, r"expected a number at node 1, \[1.0, 0.0\], got nan"),
        ((POINTS, [0.0, 0.0, np.inf]), {}, "expected a number at node 2"),
        ((POINTS, [0.0, 0.0, -np.inf]), {"side": "below"}, "expected a number at node 2"),
        ((POINTS, [0.0, 0.0, 0.0]), {"side": "left"}, "side: expected one of"),
        ((POINTS, [0.0, 0.0, 0.0]), {"unknowns": [0, 1]}, r"whole numbers of shape \(3,\)"),
        ((POINTS, [0.0, 0.0, 0.0]), {"unknowns": [0, 1, -1]}, "expected numbers from 0, got -1"),
        ((POINTS, [0.0, 0.0, 0.0]), {"dimension": 2}, "expected numbers from 0 to 1, got 2"),
        ((POINTS[0], [0.0]), {}, "points: expected finite numbers of shape"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, options, message):
    with pytest.raises(InvalidProblem, match=message):
        cq.pair_scalar(*arguments, **options)
