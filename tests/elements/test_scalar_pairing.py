"""Membranes over obstacles: rows, sides, and a string whose contact zone is known."""

import numpy as np
import pytest

import contactqp as cq
from contactqp.errors import InvalidProblem

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
