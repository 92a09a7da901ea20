"""The contact patch test: a constant pressure between meshes that do not match (Taylor & Papadopoulos 1991)."""

from itertools import pairwise

import numpy as np
import pytest

import contactqp as cq
from tests.elements.blocks import block

PRESSURE, POISSON = 2.0, 0.3
MODULI = (10.0, 30.0)


def patch(lower, upper, pairing, exposed=None):
    """Two blocks under the uniaxial stress -PRESSURE along the last axis: relative errors of pressure and displacement.

    All nodes but those of the contact surfaces carry the forces of the constant stress, K u; `exposed` are those of the
    lower block's contact surface that the pressure puts on it directly.
    """
    d, height = lower.points.shape[1], upper.points[:, -1].min()
    n = lower.points.size + upper.points.size
    K, u, f, held = np.zeros((n, n)), np.zeros(n), np.zeros(n), []
    sinking = 0.0
    for body, modulus in zip((lower, upper), MODULI, strict=True):
        foot = body.points.min(axis=0)
        motion = POISSON * PRESSURE / modulus * (body.points - foot)
        motion[:, -1] = -PRESSURE / modulus * (body.points[:, -1] - foot[-1]) - sinking
        sinking = PRESSURE / modulus * height
        at = body.unknowns.ravel()
        K[np.ix_(at, at)] = body.stiffness(modulus, POISSON)
        u[at] = motion.ravel()
        force = (K[np.ix_(at, at)] @ u[at]).reshape(body.points.shape)
        force[body.nodes(d - 1, height)] = 0
        f[at] = force.ravel()
        held += [body.unknowns[body.nodes(a, foot[a]), a] for a in range(d - 1)]
    if exposed is not None:
        f[lower.unknowns[:, -1]] -= exposed
    held = np.concatenate([*held, lower.unknowns[lower.nodes(d - 1, 0.0), -1]])
    A = np.eye(n)[held]
    solution = cq.solve(
        cq.ContactProblem(stiffness=K, load=f, normal=pairing.normal, gap=pairing.gap, tie=A, tie_value=A @ u)
    )
    assert solution.certificate.passed
    error = np.abs(pairing.pressure(solution.normal_force) - PRESSURE).max() / PRESSURE
    return error, np.abs(solution.displacement - u).max() / np.abs(u).max()


def two_blocks(d, below, above, simplices=(False, False), distortion=0.0):
    lower = block([0.0] * d, [1.0] * (d - 1) + [0.5], below, simplices[0])
    upper = block([0.0] * (d - 1) + [0.5], [1.0] * d, above, simplices[1], first=lower.points.size)
    for body, n, seed in ((lower, below, 0), (upper, above, 1)):
        inner = (np.abs(body.points[:, :-1] - 0.5) < 0.499).all(axis=1)
        offset = np.random.default_rng(seed).uniform(-1, 1, (inner.sum(), d - 1)) / n[0]
        body.points[inner, :-1] += distortion * offset
    return lower, upper


CASES = {
    "2D": (2, (5, 2), (7, 3)),
    "2D triangles": (2, (4, 2), (7, 1), (True, True)),
    "2D both": (2, (3, 2), (8, 1), (True, False)),
    "hexahedra": (3, (2, 2, 1), (3, 3, 1)),
    "tetrahedra": (3, (2, 2, 1), (3, 3, 1), (True, True)),
    "tetrahedra on hexahedra": (3, (2, 3, 1), (3, 2, 1), (False, True)),
    "distorted tetrahedra": (3, (3, 3, 1), (4, 4, 1), (True, True), 0.2),
    "distorted hexahedra": (3, (3, 3, 1), (4, 4, 1), (False, False), 0.2),
    "nearly folded hexahedra": (3, (3, 3, 1), (4, 4, 1), (False, False), 0.4),
}


@pytest.mark.sampled(12)
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("slave_is_lower", [False, True])
def test_the_mortar_transmits_a_constant_pressure(case, slave_is_lower):
    lower, upper = two_blocks(*CASES[case])
    d = lower.points.shape[1]
    surfaces = [upper.surface(d - 1, 0.5, "upper"), lower.surface(d - 1, 0.5, "lower")]
    slave, master = surfaces[::-1] if slave_is_lower else surfaces
    pairing = cq.pair_mortar(slave, master)
    np.testing.assert_allclose(pairing.area.sum(), 1, rtol=1e-13)
    assert max(patch(lower, upper, pairing)) < 1e-10


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", ["2D", "hexahedra", "tetrahedra"])
def test_node_to_segment_does_not(case):
    """So the patch test can fail: pressures are 5 % off and more."""
    lower, upper = two_blocks(*CASES[case])
    d = lower.points.shape[1]
    pairing = cq.pair_node_to_segment(upper.surface(d - 1, 0.5, "upper"), lower.surface(d - 1, 0.5, "lower"))
    assert min(patch(lower, upper, pairing)) > 0.02


@pytest.mark.sampled(2)
@pytest.mark.parametrize("pairing_of", [cq.pair_node_to_segment, cq.pair_mortar])
def test_both_do_where_meshes_match(pairing_of):
    lower, upper = two_blocks(3, (3, 2, 1), (3, 2, 1))
    assert max(patch(lower, upper, pairing_of(upper.surface(2, 0.5), lower.surface(2, 0.5)))) < 1e-12


def hat_integrals(nodes, low, high):
    """int N_i over [low, high] of the piecewise linear hats at ascending nodes, by Simpson between all corners."""
    corners = np.unique(np.clip([*nodes, low, high], low, high))
    total = np.zeros(len(nodes))
    for a, b in pairwise(corners):
        for x, w in ((a, 1 / 6), ((a + b) / 2, 4 / 6), (b, 1 / 6)):
            total += w * (b - a) * np.array([np.interp(x, nodes, e) for e in np.eye(len(nodes))])
    return total


@pytest.mark.sampled(6)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("edges", [(0.3, 0.85), (0.25, 0.8), (0.25 - 1e-3, 0.75 + 1e-9)])
def test_a_slave_surface_covered_in_part_transmits_a_constant_pressure(d, edges):
    """A punch narrower than its foundation, the slave: the rest of the foundation carries the pressure itself."""
    low, high = edges
    n = 5 if d == 2 else 4
    lower = block([0.0] * d, [1.0] * (d - 1) + [0.5], [n] * (d - 1) + [1])
    upper = block([low] * (d - 1) + [0.5], [high] * (d - 1) + [1.0], [3] * (d - 1) + [1], first=lower.points.size)
    slave = lower.surface(d - 1, 0.5, "foundation")
    pairing = cq.pair_mortar(slave, upper.surface(d - 1, 0.5, "punch"))
    np.testing.assert_allclose(pairing.area.sum(), (high - low) ** (d - 1), rtol=1e-12)
    nodes = np.linspace(0, 1, n + 1)
    full, covered = hat_integrals(nodes, 0, 1), hat_integrals(nodes, low, high)
    if d == 3:
        full, covered = np.outer(full, full).ravel(), np.outer(covered, covered).ravel()
    exposed = np.zeros(len(lower.points))
    exposed[lower.nodes(d - 1, 0.5)] = PRESSURE * (full - covered)
    assert max(patch(lower, upper, pairing, exposed)) < 1e-10


def test_a_barely_covered_node_hands_its_part_to_its_neighbour():
    """0.001 of a facet is covered: its far node has no row, and the areas still sum to what is covered."""
    slave = block([0.0, 0.0], [1.0, 0.5], [5, 1]).surface(1, 0.5)
    points = np.array([[0.8, 0.5], [0.199, 0.5]])
    punch = cq.Surface(points, np.array([[1, 0]]), np.arange(100, 104).reshape(2, 2), "punch")
    pairing = cq.pair_mortar(slave, punch)
    x = pairing.points[:, 0]
    assert np.allclose(sorted(x), [0.2, 0.4, 0.6, 0.8])
    np.testing.assert_allclose(pairing.area[np.argsort(x)], [0.101, 0.2, 0.2, 0.1], rtol=1e-12)
    assert len(pairing.unpaired) == 2


def test_friction_rows_slide_by_the_motion_of_the_bodies():
    """Sliding the upper block over the lower one by (3, -2) um is that slip in every contact, and closes no gap."""
    lower, upper = two_blocks(3, (2, 2, 1), (3, 3, 1))
    pairing = cq.pair_mortar(
        upper.surface(2, 0.5), lower.surface(2, 0.5), dimension=lower.points.size + upper.points.size
    )
    u = np.zeros(pairing.normal.shape[1])
    u[upper.unknowns] = [3e-6, -2e-6, 0]
    slip = (pairing.tangent @ u).reshape(-1, 2)
    np.testing.assert_allclose(np.linalg.norm(slip, axis=1), np.hypot(3e-6, 2e-6), rtol=1e-13)
    np.testing.assert_allclose(slip, np.tile(slip[0], (len(slip), 1)), rtol=1e-12)
    np.testing.assert_allclose(pairing.normal @ u, 0, atol=1e-20)
