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


def _pulled_over_a_quarter(links: int, pull: float) -> tuple[cq.LargeHistory, float]:
    """Return the history of a chain over a quarter of a cylinder, pulled by 1 at both ends and then harder at one, and
    the ratio of the forces of nodes that slide.
    """
    mu, angles = 0.3, np.pi - np.pi / 2 * np.arange(links + 1) / links
    nodes = np.column_stack([np.cos(angles), np.sin(angles)])
    chain = cq.NonlinearTruss(nodes, [[i, i + 1] for i in range(links)], modulus=1e6, area=1.0)
    both = np.zeros(2 * links + 2)
    both[1] = -1.0
    one = both.copy()
    both[-2], one[-2] = 1.0, pull
    cylinder = cq.ObstacleContact(nodes, cq.Circle([0.0, 0.0], 1.0))
    half = mu * np.tan(np.pi / 4 / links)
    return cq.large_deformation(chain, [both, one], cylinder, steps=4, friction=mu), (1 + half) / (1 - half)


@pytest.mark.slow
def test_nodes_that_slid_in_an_earlier_step_may_hold_a_chain_near_its_greatest_pull() -> None:
    """Near 1.5 all nodes are at their bounds, those near the weaker end from the first leg: if all of them slid on,
    nothing would hold the chain, and no halving of the step changes that.
    """
    history, ratio = _pulled_over_a_quarter(24, 1.5218787687182387)
    last = history[-1]
    assert len(history) == 9
    assert last.certificate.passed
    assert last.contact_status[4:].tolist() == ["slip"] * 21
    np.testing.assert_allclose(last.normal_force[5:-1] / last.normal_force[4:-2], ratio, rtol=1e-4)


@pytest.mark.slow
def test_a_chain_pulled_harder_than_friction_holds_says_what_may_help() -> None:
    """The greatest pull is about exp(0.3 pi/2) = 1.602."""
    words = r"load factor 1.75: .*down to 1/16 converge: take more steps, or a larger tolerance= if only rounding"
    with pytest.raises(cq.NotConverged, match=words) as caught:
        _pulled_over_a_quarter(8, 1.9)
    assert caught.value.history[-1].load_factor == 1.5


@pytest.mark.slow
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


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("dimension", "steps"), [(3, 1), (3, 3), (2, 3)])
def test_coefficients_of_zero_are_no_friction_on_the_way_and_leave_zero_forces(dimension: int, steps: int) -> None:
    """In steps a node slips off a ball: its tangent is indefinite, which friction would not stand in space."""
    fixed = np.zeros((5, dimension))
    fixed[:, :2] = [[0, 1], [-2, 1], [2, 1], [0, 3], [0, 1]]
    fixed[4, -1] += 2 if dimension == 3 else -2
    post = cq.NonlinearTruss(fixed, [[0, i] for i in range(1, 5)], 2.0, 1.0, law="engineering")
    body = cq.Supported(post, held=list(range(dimension, 5 * dimension)))
    ball = (cq.Circle if dimension == 2 else cq.Sphere)([0.01, 0.4, 0.02][:dimension], 0.3)
    geometry, load = cq.ObstacleContact(fixed[:1], ball), np.zeros(dimension)
    load[1] = -6.0
    smooth = cq.large_deformation(body, [load], geometry, steps=steps)
    zero = cq.large_deformation(body, [load], geometry, steps=steps, friction=0.0)
    np.testing.assert_array_equal(zero.displacements, smooth.displacements)
    assert zero.notes == smooth.notes
    assert zero[-1].friction_force.tolist() == [[0.0] * (dimension - 1)]
    assert zero[-1].slip.shape == (1, dimension - 1)
    assert zero[-1].certificate.passed
