"""Whether local problems have an answer, in rational numbers: as closed forms and the enumeration in floats say."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate import coulomb_law
from contactqp.linalg.measures import lengths
from contactqp.solving.friction.exact_enumeration import has_local_equilibrium


def jammed(normal: float, friction: float = 0.5) -> cq.LocalProblem:
    """A block between two walls that move towards each other by -normal."""
    W = np.zeros((4, 4))
    W[::2, ::2], W[1::2, 1::2] = [[1.0, -1.0], [-1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]
    return cq.LocalProblem(delassus=W, offset=[normal, 0.0, normal, 0.0], friction=friction, dimension=2)


def test_a_jammed_block_has_none_and_a_loose_one_has() -> None:
    assert not has_local_equilibrium(jammed(-0.1))
    assert not has_local_equilibrium(jammed(-1e-300))
    assert has_local_equilibrium(jammed(0.1))
    with pytest.raises(cq.NoEquilibrium, match="proven in rational numbers"):
        cq.solve(jammed(-0.1), algorithm="enumeration")


def test_one_contact_above_the_critical_coefficient() -> None:
    """Slipping on, r_T = -0.8 r_N, the normal compliance 1 - 2 * 0.8 is negative: one answer or three."""
    data = dict(delassus=[[1.0, 2.0], [2.0, 5.0]], friction=0.8, dimension=2)
    assert has_local_equilibrium(cq.LocalProblem(offset=[-7.0, -17.0], **data))
    grid = [(x, y) for x in (-2.0, -1.0, 1.0) for y in (-4.0, -2.0, 0.0, 1.0, 6.0)]
    for offset in grid:
        problem = cq.LocalProblem(offset=offset, **data)
        assert has_local_equilibrium(problem), offset


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(20))
def test_random_problems_with_joints_agree_with_the_enumeration_in_floats(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, p = int(rng.integers(1, 3)), int(rng.integers(0, 2))
    root = rng.normal(size=(2 * m, 2 * m))
    joints = {}
    if p:
        joints = dict(bilateral=rng.normal(size=(2 * m, p)), bilateral_delassus=np.eye(p), bilateral_offset=np.ones(p))
    problem = cq.LocalProblem(
        delassus=root @ root.T, offset=rng.normal(size=2 * m), friction=rng.uniform(0, 2), dimension=2, **joints
    )
    assert has_local_equilibrium(problem) == bool(cq.equilibria(problem))


@pytest.mark.slow
def test_velocities_are_not_lost_beside_forces_of_redundant_contacts() -> None:
    """No state is an equilibrium, in rationals; rounding of W let forces of 1e14 pass, at a velocity of -0.39."""
    W = np.array(
        [
            [1, 0, 0, -1, 0, 0],
            [0, 16, -4, 12, -12, -8],
            [0, -4, 2, -4, 2, 2],
            [-1, 12, -4, 11, -8, -6],
            [0, -12, 2, -8, 10, 6],
            [0, -8, 2, -6, 6, 4],
        ]
    )
    V, R = np.array([[2, 2], [-12, 0], [4, -4], [-12, 2], [8, 4], [6, 0]]), np.diag([14.0, 20.0])
    parts = dict(bilateral=V * 1e60, bilateral_delassus=R * 1e60, bilateral_offset=[-3.0, 1.0])
    problem = cq.LocalProblem(W * 1e60, [-1.0, -5.0, 2.0, 3.0, -1.0, 4.0], [1.0, 0.0, 0.25], 2, **parts)
    forces = [[1.5373838e-46, 1.5373838e-46], [0.0, 0.0], [2.5788375e-46, -6.4470938e-47]]
    certificate = cq.certify_local(problem, forces, [-9.918606e-48, -6.695059e-47])
    assert not certificate.passed
    assert certificate.natural_map > 1e-3
    with pytest.raises(cq.NotConverged):
        cq.solve(problem)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("friction", [1e4, 1e8, 1e12, 1e100])
def test_a_large_coefficient_makes_nothing_of_a_slip_that_is_rounding(friction: float) -> None:
    """W r + q at exact forces slips by some 1e-16, and mu times that was the error of the law."""
    W, q = np.array([[3.0, 1.0], [1.0, 7.0]]), np.array([-1.0, -0.3])
    problem = cq.LocalProblem(W, q, friction, 2)
    force = np.linalg.solve(W, -q)  # sticks: |r_T| is far below mu r_N
    assert cq.certify_local(problem, force).natural_map < 1e-15
    np.testing.assert_allclose(cq.solve(problem).force[0], force, rtol=1e-14)
    printed = [float(f"{value:.6g}") for value in force]
    assert cq.certify_local(problem, printed, tolerance=1e-4).passed
    assert not cq.certify_local(problem, force * [1.0, 1.001], tolerance=1e-5).passed  # it would slip by 3e-4


def test_what_slides_with_a_large_coefficient_passes() -> None:
    """Nothing resists the slip, so that mu r_N stands against it, whatever mu; with less friction it is refused."""
    problem = cq.LocalProblem([[3.0, 0.0], [0.0, 0.0]], [-4.0, 5.0], 1e8, 2)
    assert cq.certify_local(problem, [4 / 3, -4e8 / 3]).passed
    assert not cq.certify_local(problem, [4 / 3, -3.9e8 / 3]).passed
    assert not cq.certify_local(problem, [4 / 3, 4e8 / 3]).passed


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_natural_map_is_the_distance_to_a_projection(dimension: int) -> None:
    """It is computed without differences of forces; where these lose nothing both are the same."""
    rng = np.random.default_rng(dimension)
    force, velocity = rng.normal(size=(2, 3000, dimension))
    friction = rng.choice([0.0, 0.1, 0.5, 1.0, 5.0, 1e3], 3000)
    force[:500], velocity[250:1000] = 0.0, 0.0
    sliding = np.arange(3000) % 3 == 0
    ratio = friction * abs(force[:, 0]) / np.maximum(lengths(force[:, 1:]), 1e-300)
    force[sliding, 1:] *= ratio[sliding, None]
    shifted = force - coulomb_law.de_saxce(velocity, friction)
    expected = force - coulomb_law.onto_cone(shifted, friction)
    np.testing.assert_allclose(coulomb_law.natural_map(force, velocity, friction), expected, atol=1e-11)


def test_the_last_digits_of_large_friction_may_turn_a_slip() -> None:
    """Friction of 1e8 resists a slip of 1, so that its last digit turns the slip by 1e-8; a turn of 1e-6 is refused."""
    direction = np.array([0.6, 0.8])
    W = np.diag([1.0, 2.0, 3.0])
    force = np.concatenate([[1.0], -1e8 * direction])
    problem = cq.LocalProblem(W, np.concatenate([[0.0], direction]) - W @ force, 1e8, 3)
    assert cq.certify_local(problem, force).passed
    turned = np.array([[1.0, -1e-6], [1e-6, 1.0]]) @ force[1:]
    assert not cq.certify_local(problem, [1.0, *turned]).passed


@pytest.mark.parametrize(("along", "status"), [(1e-30, "slip"), (1e-16, "grazing")])
def test_a_contact_that_touches_is_not_open_however_small_its_force(along: float, status: str) -> None:
    """u_N = r_N - 2 r_T + q_N = 0 with r_T = -0.3 r_N: r_N = -q_N / 1.6, beside slips of 1e-16 nothing, but no gap."""
    problem = cq.LocalProblem([[1.0, -2.0], [-2.0, 4.0]], [-2e-31, along], 0.3, 2)
    solution = cq.solve(problem)
    np.testing.assert_allclose(solution.force[0, 0], 1.25e-31, rtol=1e-5)
    assert solution.contact_status.tolist() == [status]
    assert solution.certificate.passed


def test_a_contact_without_velocity_and_force_grazes_and_one_that_parts_is_open() -> None:
    W = np.diag([1.0, 1.0, 2.0, 1.0, 1.0, 1.0])
    problem = cq.LocalProblem(W, [0.0, 1.0, -1.0, 0.0, 1e-3, 0.0], 0.3, 2)
    solution = cq.solve(problem)
    assert solution.contact_status.tolist() == ["grazing", "stick", "open"]
    np.testing.assert_allclose(solution.force[:, 0], [0.0, 0.5, 0.0], rtol=1e-12)
