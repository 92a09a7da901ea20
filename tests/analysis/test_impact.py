"""Impact against closed forms: rods at walls, bouncing and sliding blocks, colliding bodies."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from tests.analysis.motions import GAP, LENGTH, SPEED, WAVE, brick, rod_at_wall, rod_matrices, sliding_block, thrown_rod

# Scheme, Courant number, its arguments.
GOOD: list[Any] = [
    ("moreau-jean", 1.0, {}),
    ("modified-mass", 1.0, {}),
    ("modified-mass-central", 0.5, {}),
    ("paoli-schatzman", 1.0, {}),
    ("deuflhard-krause-ertel", 1.0, {}),
]
TOUCH, RELEASE, FORCE = GAP / SPEED, GAP / SPEED + 2 * LENGTH / WAVE, SPEED * 30.0


@pytest.fixture(scope="module", params=GOOD, ids=[name for name, _, _ in GOOD])
def thrown(request: pytest.FixtureRequest) -> tuple[cq.MotionHistory, float]:
    name, courant, knobs = request.param
    return thrown_rod(name, courant=courant, **knobs)


def times_of(history: cq.MotionHistory, kind: str) -> list[float]:
    return [event.time for event in history.events if event.kind == kind]


def test_a_thrown_rod_touches_and_leaves_in_time(thrown: tuple[cq.MotionHistory, float]) -> None:
    history, step = thrown
    assert times_of(history, "closed")[0] == pytest.approx(TOUCH, abs=1.001 * step)
    # The front that releases it is smeared over a few elements: half of it has come within a step.
    left = history.times[np.flatnonzero(history.normal_forces[:, 0] > FORCE / 2)[-1]]
    assert left == pytest.approx(RELEASE, abs=1.001 * step)
    assert times_of(history, "opened")[-1] == pytest.approx(RELEASE, abs=3.001 * step)
    assert [event.name for event in history.events[:1]] == ["contact 0"]


def test_a_thrown_rod_pushes_with_rho_c_v(thrown: tuple[cq.MotionHistory, float]) -> None:
    history, _ = thrown
    plateau = (history.times > TOUCH + 0.1) & (history.times < RELEASE - 0.1)
    np.testing.assert_allclose(history.normal_forces[plateau, 0], FORCE, rtol=0.01)


def test_a_thrown_rod_keeps_its_energy_and_its_speed(thrown: tuple[cq.MotionHistory, float]) -> None:
    history, step = thrown
    energies = history.energies
    assert energies[-1].total == pytest.approx(energies[0].total, rel=0.01)
    # Momentum is what the wall has given: exactly, whatever the scheme.
    mass = history.motion.scheme.body.mass
    impulse = np.sum(history.normal_forces) * step
    gained = np.sum(mass @ (history.velocities[-1] - history.velocities[0]))
    assert gained == pytest.approx(impulse, rel=1e-10)
    # The projection of Deuflhard, Krause and Ertel loses 1.2 % of it.
    assert gained == pytest.approx(2 * SPEED * LENGTH, rel=0.015)
    for energy in energies:
        assert energy.total == pytest.approx(
            energies[0].total + energy.work - energy.dissipated - energy.impact + energy.drift, abs=1e-7
        )
    assert abs(energies[-1].drift) < 1e-6


def test_a_rod_gains_no_energy_in_moreau_and_jeans_scheme() -> None:
    totals = np.array([energy.total for energy in thrown_rod("moreau-jean")[0].energies])
    assert np.all(np.diff(totals) < 1e-9 * totals[0])


@pytest.mark.parametrize(("scheme", "order"), [("moreau-jean", 0.45), ("modified-mass", 0.6), ("paoli-schatzman", 0.9)])
def test_displacements_converge(scheme: str, order: float) -> None:
    """The last displacement against the exact field u = 10 min(tau, xi/c, 2L/c - tau), then back: free flight."""
    errors = []
    for elements in (50, 100, 200, 400):
        history, step = thrown_rod(scheme, elements, duration=1.5)
        tau = history.times[-1] - RELEASE
        errors.append(np.max(abs(history.displacements[-1] - (-GAP + SPEED * tau))))
        assert step == LENGTH / elements / WAVE
    slope = np.polyfit(np.log([50, 100, 200, 400]), np.log(errors), 1)[0]
    assert slope < -order, errors


def test_the_trapezoidal_rule_blows_up_and_says_so() -> None:
    history, _ = thrown_rod("newmark")
    energies = history.energies
    assert energies[-1].total > 10 * energies[0].total
    # The energy comes from the contact forces, in free flight it is kept.
    assert -energies[-1].impact > 9 * energies[0].total
    assert abs(energies[-1].drift) < 1e-9 * energies[-1].total
    plateau = history.normal_forces[(history.times > 0.6) & (history.times < 1.1), 0]
    assert plateau.max() > 2 * FORCE
    assert plateau.min() == 0.0


def test_backward_euler_loses_what_it_loses_without_contact() -> None:
    energies = thrown_rod("backward-euler")[0].energies
    assert energies[-1].total < 0.9 * energies[0].total
    assert energies[-1].impact == pytest.approx(0.0, abs=1e-9)
    assert energies[-1].drift == pytest.approx(energies[-1].total - energies[0].total)


def test_penalty_overlaps_by_its_force_and_blows_up_when_stiff() -> None:
    soft, _ = thrown_rod("penalty", courant=0.5, penalty=9000.0)
    assert soft.energies[-1].total == pytest.approx(500.0, rel=0.01)
    overlap = -GAP - soft.displacements[:, 0]
    np.testing.assert_allclose(np.maximum(overlap, 0.0), soft.normal_forces[:, 0] / 9000.0, atol=1e-12)
    assert overlap.max() > 0.03
    with pytest.warns(cq.TimeStepWarning, match=r"0\.00333333 is unstable with all contacts closed.* up to 0\.00"):
        stiff, _ = thrown_rod("penalty", penalty=9000.0)
    assert stiff.energies[-1].total > 10 * stiff.energies[0].total
    assert stiff.notes


def test_a_rod_under_gravity_bounces_and_comes_back() -> None:
    """Doyen, Ern and Piperno's second benchmark: period 16 L/c, contacts [1, 5/3] and [11/3, 13/3]."""
    problem, mass = rod_at_wall(100, gravity=10.0)
    step = LENGTH / 100 / WAVE
    still = np.zeros(101)
    history = cq.impact(problem, mass, still, still, 16 * LENGTH / WAVE, step, "modified-mass")
    assert times_of(history, "closed")[0] == pytest.approx(1.0, abs=2 * step)
    opened = np.array(times_of(history, "opened"))
    assert np.min(abs(opened - 5 / 3)) < 6 * step  # the front is smeared
    assert history.energies[-1].total - history.energies[-1].work == pytest.approx(0.0, abs=0.01 * 500)
    free = history.times < 1.0
    np.testing.assert_allclose(history.displacements[free, 0], -5 * history.times[free] ** 2, atol=1e-3)
    # After a period it is where it was.
    assert np.max(abs(history.displacements[-1])) < 0.05 * GAP


def test_a_stretched_rod_let_go_repeats_itself() -> None:
    """The rod of Dabaghi, Petrov, Pousin and Renard: u(1) = 0, u0 = (1 - x)/2, wall at 0; period 3, contact [1, 2]."""
    n = 100
    ones = np.ones(n)
    K = sp.csc_matrix(sp.diags([np.r_[1.0, 2 * np.ones(n - 1)], -ones[1:], -ones[1:]], [0, 1, -1]) * n)
    M = sp.diags(np.r_[0.5, np.ones(n - 1)] / n)
    rows = sp.csr_matrix(([-1.0], ([0], [0])), shape=(1, n))
    problem = cq.ContactProblem(stiffness=K, load=np.zeros(n), normal=rows, gap=[0.0])
    start = 0.5 - 0.5 * np.arange(n) / n
    history = cq.impact(problem, M, start, np.zeros(n), 3.0, 1 / n, "moreau-jean")
    assert history.energies[0].total == pytest.approx(1 / 8)
    assert history.energies[-1].total == pytest.approx(1 / 8, rel=0.01)
    assert times_of(history, "closed")[0] == pytest.approx(1.0, abs=2.001 / n)
    assert times_of(history, "opened")[-1] == pytest.approx(2.0, abs=3.001 / n)
    plateau = (history.times > 1.2) & (history.times < 1.8)
    np.testing.assert_allclose(history.normal_forces[plateau, 0], 0.5, rtol=0.01)
    assert np.max(abs(history.displacements[-1] - start)) < 0.025


@pytest.mark.parametrize("scheme", ["moreau-jean", "modified-mass", "deuflhard-krause-ertel", "newmark"])
def test_momentum_is_exchanged_exactly(scheme: str) -> None:
    """Two equal rods, one at rest: the other stops and hands over its speed."""
    K, M = rod_matrices(50, lumped=False)
    both = sp.block_diag([K, K], format="csc"), sp.block_diag([M, M], format="csc")
    rows = np.zeros((1, 102))
    rows[0, [50, 51]] = 1.0, -1.0  # the right end of the first against the left end of the second
    problem = cq.ContactProblem(stiffness=both[0], load=np.zeros(102), normal=rows, gap=[1.0])
    velocity = np.r_[np.full(51, SPEED), np.zeros(51)]
    history = cq.impact(problem, both[1], np.zeros(102), velocity, 1.0, LENGTH / 50 / WAVE, scheme)
    momenta = np.array([both[1] @ v for v in history.velocities])
    np.testing.assert_allclose(momenta.sum(axis=1), SPEED * LENGTH, rtol=1e-12)
    if scheme == "newmark":
        return  # its energy does not hand over cleanly
    first, second = momenta[-1, :51].sum(), momenta[-1, 51:].sum()
    assert first == pytest.approx(0.0, abs=0.02 * SPEED * LENGTH)
    assert second == pytest.approx(SPEED * LENGTH, rel=0.02)


@pytest.mark.parametrize("restitution", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("scheme", ["moreau-jean", "paoli-schatzman"])
def test_a_rigid_ball_comes_back_with_its_part_of_the_speed(scheme: str, restitution: float) -> None:
    ball = cq.ContactProblem(stiffness=[[0.0]], load=[0.0], normal=[[1.0]], gap=[1.0])
    history = cq.impact(ball, [2.0], [0.0], [4.0], 1.0, 0.01, scheme, restitution=restitution)
    assert history.velocities[-1, 0] == pytest.approx(-4.0 * restitution, abs=1e-12)
    assert history.energies[-1].impact == pytest.approx(16.0 * (1 - restitution**2), abs=1e-9)
    assert history.displacements.max() <= 1.0 + 0.04  # overlap of a step at most


@pytest.mark.parametrize("scheme", ["moreau-jean", "backward-euler", "paoli-schatzman"])
def test_a_sliding_block_stops_after_v_over_mu_g(scheme: str) -> None:
    block = sliding_block()
    history = cq.impact(block, [2.0, 2.0], [0.0, 0.0], [1.0, 0.0], 0.5, 1e-3, scheme)
    assert times_of(history, "stick")[0] == pytest.approx(1 / (0.3 * 9.81), abs=2e-3)
    assert history.displacements[-1, 0] == pytest.approx(1 / (2 * 0.3 * 9.81), abs=1e-3)
    assert history.velocities[-1, 0] == pytest.approx(0.0, abs=1e-12)
    sliding = history.times < 0.33
    assert history.friction_forces is not None
    np.testing.assert_allclose(history.friction_forces[sliding][2:, 0, 0], 0.3 * 2 * 9.81, rtol=1e-9)
    energies = history.energies
    assert energies[-1].dissipated == pytest.approx(1.0, abs=5e-3)
    assert [event.kind for event in history.events if event.time < 0.3] == ["closed", "slip"]


def test_the_friction_of_moreau_and_jean_takes_all_kinetic_energy() -> None:
    history = cq.impact(sliding_block(), [2.0, 2.0], [0.0, 0.0], [1.0, 0.0], 0.5, 1e-3)
    assert history.energies[-1].dissipated == pytest.approx(1.0, abs=1e-12)
    assert history[200].slip[0, 0] == pytest.approx(1e-3 * history.velocities[199:201, 0].mean(), rel=1e-12)
    assert history[200].contact_status.tolist() == ["slip"]
    assert history[450].contact_status.tolist() == ["stick"]


def test_a_block_that_bounces_ever_less_comes_to_rest() -> None:
    """Rebounds shrink by e until they drown in what gravity does within a step; the block slides on and stops."""
    history = cq.impact(sliding_block(), [2.0, 2.0], [0, 0], [3.0, 1.0], 2.0, 1e-3, restitution=0.7)
    assert history.velocities[-1].tolist() == [0.0, 0.0]
    # Friction takes mu times what the floor gives, m (g t - 1) in all: 3 = 0.3 (g t - 1).
    assert times_of(history, "stick")[-1] == pytest.approx((3.0 / 0.3 + 1.0) / 9.81, abs=2e-3)
    # The flight of a rebound lasts 2 v / g, each e of the one before.
    opened, closed = times_of(history, "opened"), times_of(history, "closed")
    assert closed[1] - closed[0] == pytest.approx(2 * 0.7 * 1.0 / 9.81, abs=2e-3)
    assert len(opened) > 5


def test_in_space_friction_opposes_the_velocity() -> None:
    block = cq.ContactProblem(
        stiffness=np.zeros((3, 3)),
        load=[0.0, 0.0, -9.81],
        normal=[[0.0, 0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        friction=0.3,
    )
    history = cq.impact(block, np.ones(3), np.zeros(3), [0.6, 0.8, 0.0], 0.4, 2e-3)
    way = history.displacements[-1]
    np.testing.assert_allclose(way[:2] / np.linalg.norm(way), [0.6, 0.8], atol=1e-9)
    assert np.linalg.norm(way) == pytest.approx(1 / (2 * 0.3 * 9.81), abs=2e-3)


def test_a_block_at_rest_stays_at_rest() -> None:
    for scheme in ("moreau-jean", "newmark", "deuflhard-krause-ertel", "backward-euler", "paoli-schatzman"):
        history = cq.impact(sliding_block(), [2.0, 2.0], [0.0, 0.0], [0.0, 0.0], 0.1, 1e-2, scheme)
        np.testing.assert_allclose(history.displacements, 0.0, atol=1e-15)
        np.testing.assert_allclose(history.normal_forces[1:], 2 * 9.81, rtol=1e-12)


def test_a_load_that_depends_on_time() -> None:
    mass = cq.ContactProblem(stiffness=[[0.0]], load=[0.0], normal=[[1.0]], gap=[100.0])
    history = cq.impact(mass, [2.0], [0.0], [0.0], 1.0, 0.01, load=lambda t: [6.0 * t])
    # Moreau and Jean take the mean of both ends: v = int f / m is exact for a load that is linear in time.
    assert history.velocities[-1, 0] == pytest.approx(1.5, rel=1e-12)
    assert history.energies[-1].work == pytest.approx(history.energies[-1].kinetic, rel=1e-12)


def test_ties_hold_and_have_their_forces() -> None:
    """Two masses tied into one: each half of the load, the tie carries the difference."""
    problem = cq.ContactProblem(
        stiffness=np.zeros((2, 2)),
        load=[3.0, 0.0],
        normal=[[0.0, 1.0]],
        gap=[10.0],
        tie=[[1.0, -1.0]],
        tie_value=[0.5],
    )
    for scheme in ("moreau-jean", "newmark", "backward-euler", "deuflhard-krause-ertel", "paoli-schatzman"):
        history = cq.impact(problem, [1.0, 2.0], [0.5, 0.0], [0.0, 0.0], 1.0, 0.1, scheme)
        np.testing.assert_allclose(history.displacements @ [1.0, -1.0], 0.5, rtol=1e-12)
        np.testing.assert_allclose(history.tie_forces[1:, 0], 2.0, rtol=1e-9)
    with pytest.raises(cq.InvalidProblem, match=r"tie 0 is missed by 0\.5"):
        cq.impact(problem, [1.0, 2.0], [0.0, 0.0], [0.0, 0.0], 1.0, 0.1)


def test_going_on_from_a_history_is_the_same_motion() -> None:
    whole = thrown_rod("moreau-jean", duration=1.2)[0]
    half = thrown_rod("moreau-jean", duration=0.8)[0]
    resumed = half.resume(0.4)
    assert np.array_equal(resumed.displacements, whole.displacements)
    assert len(half) == 241
    assert resumed.times[-1] == whole.times[-1]
    assert resumed.events == whole.events
    assert resumed[-1].work.factorisations == 1
    with pytest.raises(cq.InvalidProblem, match="duration: expected a positive number, got -1"):
        half.resume(-1)


@pytest.mark.parametrize("method", ["clarabel", "osqp", "lemke", "projected-gauss-seidel"])
def test_any_method_solves_the_small_problems(method: str) -> None:
    first = thrown_rod("moreau-jean", 40, duration=0.7)[0]
    other = thrown_rod("moreau-jean", 40, duration=0.7, method=method)[0]
    np.testing.assert_allclose(other.normal_forces, first.normal_forces, atol=1e-9 * FORCE)


def test_redundant_contacts_share_the_force() -> None:
    ball = cq.ContactProblem(stiffness=[[0.0]], load=[3.0], normal=[[1.0], [1.0]], gap=[1.0, 1.0])
    history = cq.impact(ball, [2.0], [0.0], [4.0], 1.0, 0.01)
    np.testing.assert_allclose(history.normal_forces[-1].sum(), 3.0, rtol=1e-9)
    assert history[-1].certificate.passed


@pytest.mark.parametrize("scheme", ["moreau-jean", "newmark", "deuflhard-krause-ertel", "paoli-schatzman"])
def test_in_a_stack_each_contact_carries_what_is_above(scheme: str) -> None:
    mass = np.arange(1.0, 6.0)
    rows = np.eye(5, k=-1) - np.eye(5)  # block i on block i - 1, the first on the floor
    stack = cq.ContactProblem(np.zeros((5, 5)), -9.81 * mass, rows, np.zeros(5))
    history = cq.impact(stack, mass, np.zeros(5), np.zeros(5), 0.5, 0.01, scheme)
    np.testing.assert_allclose(history.normal_forces[-1], 9.81 * np.cumsum(mass[::-1])[::-1], rtol=1e-12)
    assert not history.displacements.any()


def test_newtons_cradle_hands_on_all_speed() -> None:
    rows = np.eye(4, 5) - np.eye(4, 5, k=1)
    balls = cq.ContactProblem(np.zeros((5, 5)), np.zeros(5), rows, np.full(4, 0.1))
    history = cq.impact(balls, np.ones(5), np.zeros(5), [1.0, 0, 0, 0, 0], 1.0, 0.01, restitution=1.0)
    np.testing.assert_allclose(history.velocities[-1], [0, 0, 0, 0, 1.0], atol=1e-14)
    assert [event.contact for event in history.events if event.kind == "closed"] == [0, 1, 2, 3]


@pytest.mark.parametrize("seed", range(6))
def test_random_motions_pass_wherever_they_are_looked_at(seed: int) -> None:
    """Any stiffness, mass, rows, friction and ties: every step that is looked at has its certificate."""
    rng = np.random.default_rng(seed)
    n, m, width = 6, 3, 1 + seed % 2
    root, tie = rng.normal(size=(n, 4)), rng.normal(size=n)
    problem = cq.ContactProblem(
        stiffness=root @ root.T,
        load=rng.normal(size=n),
        normal=rng.normal(size=(m, n)),
        gap=rng.uniform(0, 0.05, m),
        tangent=rng.normal(size=(width * m, n)),
        friction=rng.choice([0.0, 0.3, 1.0], size=m),
        tie=tie[None],
    )
    velocity = rng.normal(size=n)
    velocity -= tie * (tie @ velocity) / (tie @ tie)
    touched = 0
    for scheme in ("moreau-jean", "newmark", "deuflhard-krause-ertel", "backward-euler", "paoli-schatzman"):
        history = cq.impact(problem, rng.uniform(1, 2, n), np.zeros(n), velocity, 1.0, 0.05, scheme)
        assert all(history[k].certificate.passed for k in range(0, 21, 4)), scheme
        touched += int(np.count_nonzero(history.normal_forces))
    assert touched > 10


@pytest.mark.parametrize("scheme", ["newmark", "paoli-schatzman"])
def test_a_block_that_friction_holds_stays_where_it_is(scheme: str) -> None:
    """Pushed by 0.8 of what friction can hold, on the plane or up to a rounding above it."""
    block = sliding_block(friction=0.5, gravity=10.0).replace(load=[8.0, -20.0])
    for height in (0.0, 1e-16):
        history = cq.impact(block.replace(gap=[1.0]), [2.0, 2.0], [0.0, height - 1.0], [0.0, 0.0], 0.1, 0.01, scheme)
        np.testing.assert_allclose(history.displacements[:, 0], 0.0, atol=1e-15)
        assert history.friction_forces is not None
        np.testing.assert_allclose(history.friction_forces[2:, 0, 0], 8.0, rtol=1e-9)
        np.testing.assert_allclose(history.normal_forces[2:, 0], 20.0, rtol=1e-9)


def test_friction_from_the_start_is_of_second_order_in_newmarks_scheme() -> None:
    block = sliding_block(friction=0.1, gravity=10.0).replace(load=[8.0, -20.0])
    history = cq.impact(block, [2.0, 2.0], [0.0, 0.0], [1.0, 0.0], 0.5, 0.01, "newmark")
    np.testing.assert_allclose(history.displacements[:, 0], history.times + 1.5 * history.times**2, atol=1e-12)


def test_a_block_rests_though_another_unknown_has_no_mass() -> None:
    K = np.zeros((3, 3))
    K[1:, 1:] = [[1.0, -1.0], [-1.0, 1.0]]
    block = cq.ContactProblem(K, [-10.0, 0, 0], [[-1.0, 0, 0]], [0.0])
    history = cq.impact(block, [1.0, 1.0, 0.0], np.zeros(3), np.zeros(3), 0.1, 0.01, "newmark")
    np.testing.assert_allclose(history.normal_forces[:, 0], 10.0, rtol=1e-12)


def test_a_tie_of_unknowns_without_mass_has_its_whole_force() -> None:
    """A chain whose first node lies on the ground and is held sideways against a pull of 4 in all, at rest."""
    chain = np.diag([1.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1)
    load, row = np.tile([1.0, -1.0], 4), np.eye(8)
    problem = cq.ContactProblem(np.kron(100 * chain, np.eye(2)), load, -row[1:2], [0.0], tie=row[:1])
    rest = cq.solve(problem)
    for scheme in ("modified-mass", "newmark"):
        history = cq.impact(problem, np.ones(8), rest.displacement, np.zeros(8), 0.05, 1e-3, scheme)
        np.testing.assert_allclose(history.tie_forces[1:, 0], 4.0, rtol=1e-9)
        np.testing.assert_allclose(history.normal_forces[2:, 0], 4.0, rtol=1e-9)


def test_a_tie_of_a_mass_to_an_unknown_without_is_unsupported() -> None:
    K = np.zeros((4, 4))
    K[:3, :3] = 100 * np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    problem = cq.ContactProblem(K, [0, 0, 0, -10.0], [[-1.0, 0, 0, 0]], [0.0], tie=[[1.0, 0, 0, -1.0]])
    with pytest.raises(cq.Unsupported, match="modified-mass: tie 0 acts on unknowns with mass and on others without"):
        cq.impact(problem, np.ones(4), np.zeros(4), np.zeros(4), 0.1, 0.01, "modified-mass")


@pytest.mark.parametrize("scheme", ["moreau-jean", "newmark", "deuflhard-krause-ertel", "backward-euler"])
def test_a_body_that_fits_exactly_between_walls_stays_there(scheme: str) -> None:
    """Walls on both sides: what presses them together has no bound but rounding."""
    rng = np.random.default_rng(0)
    for _ in range(6):
        way, load = rng.normal(size=3), 10 * rng.normal(size=3)
        walls = np.outer([rng.uniform(0.1, 3.0), -rng.uniform(0.1, 3.0), 1.7], way)
        body = cq.ContactProblem(np.zeros((3, 3)), load, walls, np.zeros(3))
        mass = np.full(3, rng.uniform(0.1, 3.0))
        history = cq.impact(
            body, mass, np.zeros(3), np.zeros(3), 0.1, 0.01, scheme, load=lambda t, f=load: f * np.cos(40 * t)
        )
        np.testing.assert_allclose(history.displacements @ way, 0.0, atol=1e-12)
        assert history.displacements.any()


@pytest.mark.parametrize(("friction", "corners"), [(0.3, 4), (1.5, 4), (0.3, 8), (1.5, 8)])
def test_a_brick_thrown_on_a_plane_comes_to_rest(friction: float, corners: int) -> None:
    """What four or eight redundant contacts press against each other is rounding where the brick comes to rest."""
    spin = [1.0, 0.5, -1.0, 0.3, 0.2, 0.5]
    history = cq.impact(brick(friction, corners), [1, 1, 1, 0.4, 0.4, 0.6], np.zeros(6), spin, 0.5, 5e-3)
    assert not history.velocities[-1].any()
    assert np.sum(history.normal_forces[-1]) == pytest.approx(10.0)
    assert history[-1].certificate.passed
    assert abs(history.energies[-1].drift) < 1e-12


@pytest.mark.parametrize("scheme", ["moreau-jean", "modified-mass-central", "deuflhard-krause-ertel"])
def test_a_motion_is_pickled_and_copied(scheme: str) -> None:
    pull = lambda t: np.full(11, -t)  # noqa: E731
    problem, mass = rod_at_wall(10, gap=0.05)
    history = cq.impact(problem, mass, np.zeros(11), np.full(11, -SPEED), 0.1, 0.01, scheme, load=pull)
    twin = pickle.loads(pickle.dumps(history))
    assert isinstance(twin, cq.MotionHistory)
    for name in ("displacements", "velocities", "normal_forces", "tie_forces", "times"):
        np.testing.assert_array_equal(getattr(twin, name), getattr(history, name))
    assert (twin.energies, twin.events, twin.notes) == (history.energies, history.events, history.notes)
    assert twin[-1].certificate.passed
    with pytest.raises(cq.Unsupported, match="pickled cannot be resumed"):
        twin.resume(0.1)
    for other in (copy.copy(history), copy.deepcopy(history)):
        np.testing.assert_array_equal(other.resume(0.1).displacements, history.resume(0.1).displacements)


def test_a_mass_let_go_on_a_contact_spring_swings_about_its_weight() -> None:
    """u = -m g / beta (1 - cos omega t), of second order; central differences keep its energy exactly."""
    errors = []
    for step in (0.02, 0.01, 0.005):
        ball = cq.ContactProblem([[0.0]], [-10.0], [[-1.0]], [0.0])
        history = cq.impact(ball, [1.0], [0.0], [0.0], 1.2, step, "penalty", penalty=25.0)
        errors.append(np.max(abs(history.displacements[:, 0] + 0.4 * (1 - np.cos(5 * history.times)))))
        drifts = [energy.drift for energy in history.energies]
        # 1/2 v'M v+ is that of the start, 0, less m (h g)^2 / 8.
        np.testing.assert_allclose(drifts[1:], -12.5 * step**2, atol=1e-12)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(
    "scheme",
    ["moreau-jean", "modified-mass", "paoli-schatzman", "deuflhard-krause-ertel", "newmark", "backward-euler"],
)
def test_the_certificate_of_an_instant_is_of_what_the_history_holds(scheme: str) -> None:
    """A state that is changed after the run fails at that instant: nothing is solved again to be certified."""
    history = thrown_rod(scheme, 20, duration=0.7)[0]
    pushing = int(np.flatnonzero(history.normal_forces[:, 0])[2])
    assert history[pushing - 1].certificate.passed
    history.motion.states[pushing].normal_force[0] *= 1.001
    assert not history[pushing].certificate.passed
