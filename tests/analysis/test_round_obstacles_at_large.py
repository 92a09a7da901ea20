"""Large deformation on round obstacles: a chain on a rough cylinder, a node on top of a ball."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq


def test_a_chain_at_rest_on_a_rough_cylinder_is_where_it_is_and_slides_by_the_capstan_equation():
    """Its nodes overlap by rounding of their places, which must not set it in motion. Where it slides, a node turns two
    links by t, and its force grows by (1 + mu tan(t/2)) / (1 - mu tan(t/2)) from node to node.
    """
    n, mu = 16, 0.3
    angles = np.pi - np.pi * np.arange(n + 1) / n
    nodes = np.nextafter(np.column_stack([np.cos(angles), np.sin(angles)]), 0)
    chain = cq.NonlinearTruss(nodes, [[i, i + 1] for i in range(n)], modulus=1e6, area=1.0)
    cylinder = cq.ObstacleContact(nodes, cq.Circle([0.0, 0.0], 1.0))
    pulled = np.zeros(2 * n + 2)
    pulled[[1, -1]] = -1.0
    further = pulled.copy()
    further[-1] = -2.3
    history = cq.large_deformation(chain, [pulled, further], cylinder, steps=1, friction=mu)
    assert not history[0].displacement.any()
    sliding = history[-1].normal_force[6:-1]
    assert history[-1].contact_status[6:].tolist() == ["slip"] * (n - 5)
    half = mu * np.tan(np.pi / (2 * n))
    np.testing.assert_allclose(sliding[1:] / sliding[:-1], (1 + half) / (1 - half), rtol=1e-4)


def test_a_node_that_lands_on_top_of_a_ball_and_stays_there_unstable_does_not_snap():
    """By symmetry nothing moves it, although 2 E A / L = 2 cannot hold it against its load on so small a ball."""
    post = cq.NonlinearTruss([[-2, 1], [0, 1], [2, 1], [0, 3]], [[0, 1], [1, 2], [1, 3]], 2.0, 1.0, law="engineering")
    body = cq.Supported(post, held=[0, 1, 4, 5, 6, 7])
    geometry = cq.ObstacleContact([[0.0, 1.0]], cq.Circle([0.0, 0.5], 0.05))
    history = cq.large_deformation(body, [[0.0, -2.0]], geometry, steps=5)
    np.testing.assert_allclose(history[-1].displacement, [0, -0.45], atol=1e-12)
    assert history.stable.tolist() == [True, True, False, False, False, False]
    assert not history.snaps
    assert history.notes == ("from load factor 0.4 the equilibrium is unstable: 1 motion(s) lower the energy",)


@pytest.mark.parametrize("dimension", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_coefficients_of_zero_are_no_friction_on_the_way_and_leave_zero_forces(dimension: int) -> None:
    """A node that slips off a ball: its tangent is indefinite, which friction would not stand in space."""
    fixed = np.zeros((5, dimension))
    fixed[:, :2] = [[0, 1], [-2, 1], [2, 1], [0, 3], [0, 1]]
    fixed[4, -1] += 2 if dimension == 3 else -2
    post = cq.NonlinearTruss(fixed, [[0, i] for i in range(1, 5)], 2.0, 1.0, law="engineering")
    body = cq.Supported(post, held=list(range(dimension, 5 * dimension)))
    ball = (cq.Circle if dimension == 2 else cq.Sphere)([0.01, 0.4, 0.02][:dimension], 0.3)
    geometry, load = cq.ObstacleContact(fixed[:1], ball), np.zeros(dimension)
    load[1] = -6.0
    smooth = cq.large_deformation(body, [load], geometry, steps=3)
    zero = cq.large_deformation(body, [load], geometry, steps=3, friction=0.0)
    np.testing.assert_array_equal(zero.displacements, smooth.displacements)
    assert zero.notes == smooth.notes
    assert zero[-1].friction_force.tolist() == [[0.0] * (dimension - 1)]
    assert zero[-1].slip.shape == (1, dimension - 1)
    assert zero[-1].certificate.passed
