"""Impact of balls, blocks, stacks and bricks: friction, restitution, rest, ties and loads against closed forms."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import contactqp as cq
from tests.analysis.motions import SPEED, brick, rod_at_wall, sliding_block, times_of


@pytest.mark.sampled(4)
@pytest.mark.parametrize("restitution", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("scheme", ["moreau-jean", "paoli-schatzman"])
def test_a_rigid_ball_comes_back_with_its_part_of_the_speed(scheme: str, restitution: float) -> None:
    ball = cq.ContactProblem(stiffness=[[0.0]], load=[0.0], normal=[[1.0]], gap=[1.0])
    history = cq.impact(ball, [2.0], [0.0], [4.0], 1.0, 0.01, scheme, restitution=restitution)
    assert history.velocities[-1, 0] == pytest.approx(-4.0 * restitution, abs=1e-12)
    assert history.energies[-1].impact == pytest.approx(16.0 * (1 - restitution**2), abs=1e-9)
    assert history.displacements.max() <= 1.0 + 0.04  # overlap of a step at most


@pytest.mark.sampled(4)
@pytest.mark.parametrize("scheme", ["moreau-jean", "paoli-schatzman", "penalty", "newmark", "backward-euler"])
def test_overlap_that_a_scheme_allows_is_told_and_none_where_it_holds_gaps(scheme: str) -> None:
    units, name = cq.Units(length="m", force="N"), "ball on floor"
    ball = cq.ContactProblem([[0.0]], [9.81], [[1.0]], [1.0], units=units, contact_names=[name])
    knobs = {"penalty": {"penalty": 1e4}, "moreau-jean": {"restitution": 0.5}, "paoli-schatzman": {"restitution": 0.5}}
    history = cq.impact(ball, [1.0], [0.0], [0.0], 0.8, 0.01, scheme, **knobs.get(scheme, {}))
    depth = float(max(history.displacements[:, 0]) - 1.0)
    deepest = int(np.argmax(history.displacements[:, 0]))
    said = f"penetrates {name} by {depth:.6g} m"
    if scheme in ("newmark", "backward-euler"):
        assert depth < 1e-12
        assert [note[:18] for note in history.notes] == (["the energy grows b"] if scheme == "newmark" else [])
        return
    assert depth > 1e-3
    (note,) = history.notes
    assert said in note
    assert f"step {deepest}, at {history.times[deepest]:.6g}" in note
    assert any(said in note for note in history[deepest].certificate.notes)
    assert history[0].certificate.notes == ()


@pytest.mark.sampled(3)
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


@pytest.mark.slow
def test_the_friction_of_moreau_and_jean_takes_all_kinetic_energy() -> None:
    history = cq.impact(sliding_block(), [2.0, 2.0], [0.0, 0.0], [1.0, 0.0], 0.5, 1e-3)
    assert history.energies[-1].dissipated == pytest.approx(1.0, abs=1e-12)
    assert history[200].slip[0, 0] == pytest.approx(1e-3 * history.velocities[199:201, 0].mean(), rel=1e-12)
    assert history[200].contact_status.tolist() == ["slip"]
    assert history[450].contact_status.tolist() == ["stick"]


@pytest.mark.slow
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


@pytest.mark.slow
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


def test_redundant_contacts_share_the_force() -> None:
    ball = cq.ContactProblem(stiffness=[[0.0]], load=[3.0], normal=[[1.0], [1.0]], gap=[1.0, 1.0])
    history = cq.impact(ball, [2.0], [0.0], [4.0], 1.0, 0.01)
    np.testing.assert_allclose(history.normal_forces[-1].sum(), 3.0, rtol=1e-9)
    assert history[-1].certificate.passed


@pytest.mark.sampled(2)
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


@pytest.mark.parametrize("count", [2, 3, 6])
def test_masses_that_touch_leave_together_by_newtons_law(count: int) -> None:
    """Momentum and energy: one against count - 1 that move as one. A cradle of balls needs gaps between them."""
    rows = np.eye(count - 1, count) - np.eye(count - 1, count, k=1)
    gap = [0.1, *np.zeros(count - 2)]
    balls = cq.ContactProblem(np.zeros((count, count)), np.zeros(count), rows, gap)
    start = np.zeros(count), np.eye(count)[0]
    history = cq.impact(balls, np.ones(count), *start, 0.5, 0.01, restitution=1.0)
    np.testing.assert_allclose(history.velocities[-1], [2 / count - 1, *[2 / count] * (count - 1)], atol=1e-14)


@pytest.mark.parametrize(
    ("gap", "step", "energy"), [(0.1, 0.01, 0.5), (0.001, 0.01, 3 / 5), (0.001, 0.003, 11 / 18), (0.001, 0.0005, 0.5)]
)
def test_paoli_and_schatzmans_scheme_gains_energy_where_contacts_of_a_ball_close_within_a_step(
    gap: float, step: float, energy: float
) -> None:
    """The energies are those of u+ = -u- + 2 P(u), P the projection onto the gaps, in rational numbers."""
    rows = np.eye(4, 5) - np.eye(4, 5, k=1)
    balls = cq.ContactProblem(np.zeros((5, 5)), np.zeros(5), rows, np.full(4, gap))
    start = np.zeros(5), [1.0, 0, 0, 0, 0]
    history = cq.impact(balls, np.ones(5), *start, 1.0, step, "paoli-schatzman", restitution=1.0)
    assert history.energies[-1].total == pytest.approx(energy, rel=1e-11)
    assert any("the energy grows" in note for note in history.notes) is (energy > 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))])
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


@pytest.mark.sampled(3)
@pytest.mark.parametrize("bodies", [1, pytest.param(6, marks=pytest.mark.slow)])
@pytest.mark.parametrize("scheme", ["moreau-jean", "newmark", "deuflhard-krause-ertel", "backward-euler"])
def test_a_body_that_fits_exactly_between_walls_stays_there(scheme: str, bodies: int) -> None:
    """Walls on both sides: what presses them together has no bound but rounding."""
    rng = np.random.default_rng(0)
    for _ in range(bodies):
        way, load = rng.normal(size=3), 10 * rng.normal(size=3)
        walls = np.outer([rng.uniform(0.1, 3.0), -rng.uniform(0.1, 3.0), 1.7], way)
        body = cq.ContactProblem(np.zeros((3, 3)), load, walls, np.zeros(3))
        mass = np.full(3, rng.uniform(0.1, 3.0))
        history = cq.impact(
            body, mass, np.zeros(3), np.zeros(3), 0.1, 0.01, scheme, load=lambda t, f=load: f * np.cos(40 * t)
        )
        np.testing.assert_allclose(history.displacements @ way, 0.0, atol=1e-12)
        assert history.displacements.any()


@pytest.mark.sampled(2)
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "corners"),
    [(0.3, 4), (1.5, 8), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((1.5, 4), (0.3, 8)))],
)
def test_a_brick_thrown_on_a_plane_comes_to_rest(friction: float, corners: int) -> None:
    """What four or eight redundant contacts press against each other is rounding where the brick comes to rest."""
    spin = [1.0, 0.5, -1.0, 0.3, 0.2, 0.5]
    history = cq.impact(brick(friction, corners), [1, 1, 1, 0.4, 0.4, 0.6], np.zeros(6), spin, 0.5, 5e-3)
    assert not history.velocities[-1].any()
    assert np.sum(history.normal_forces[-1]) == pytest.approx(10.0)
    assert history[-1].certificate.passed
    assert abs(history.energies[-1].drift) < 1e-12


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("scheme", "said"), [("moreau-jean", True), ("modified-mass", False), ("modified-mass-central", False)]
)
def test_the_force_of_an_impact_is_said_to_be_an_impulse_over_a_step(scheme: str, said: bool) -> None:
    """A rod is thrown at a wall; a contact without mass is stopped by no impulse."""
    n = 20
    stiffness = 2000.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    stiffness[0, 0] = stiffness[-1, -1] = 2000.0
    rod = cq.ContactProblem(stiffness, np.zeros(n), -np.eye(1, n), [0.05])
    moved = cq.impact(rod, np.ones(n), np.zeros(n), np.full(n, -1.0), 0.2, 2e-3, scheme)
    assert np.max(moved.normal_forces) > 0
    assert ("is an impulse over one step" in " ".join(str(moved).split())) is said


def test_a_single_mass_takes_numbers_and_its_table_says_how_far_away_it_is() -> None:
    drop = cq.ContactProblem([[0.0]], [-9.81], [[-1.0]], [1.0], units={"length": "m", "force": "N"})
    fall = cq.impact(drop, 1.0, 0.0, 0.0, duration=0.4, time_step=0.1)
    assert str(fall).splitlines()[1].endswith("smallest gap [m]")
    assert np.allclose(fall.displacements[:, 0], -9.81 * fall.times**2 / 2)
    assert str(fall).splitlines()[-1].split()[-1] == f"{1 + fall.displacements[-1, 0]:.6g}"


@pytest.mark.slow
def test_an_elastic_rod_hits_a_wall_with_the_mass_of_its_body() -> None:
    """|v| sqrt(E rho) A = 300 until the wave is back, at 2 L / c = 2/3, as of the rod of springs and masses."""
    mesh = cq.rectangle(10.0, 1.0, (40, 2), "quad4")
    body = cq.Body(mesh, cq.Material(900.0, 0.0, density=1.0), "plane-stress", name="rod")
    structure = cq.Structure([body])
    system = structure.assemble([])
    wall = cq.pair(structure.surface("rod", "left"), cq.Plane([-0.1, 0.0], [1.0, 0.0]))
    start = np.zeros(len(system.free))
    speed = np.tile([-10.0, 0.0], len(mesh.points))
    rod = cq.impact(
        system.problem([wall]), system.mass(), start, speed, duration=0.5, time_step=0.005, scheme="modified-mass"
    )
    assert speed @ (system.mass() @ speed) == pytest.approx(1000.0)
    assert np.median(rod.normal_forces.sum(axis=1)[5:]) == pytest.approx(300.0, rel=0.02)
    light = cq.Structure([cq.Body(mesh, cq.Material(900.0, 0.0), "plane-stress", name="light")])
    with pytest.raises(cq.InvalidProblem, match="light: a mass needs a density"):
        light.mass()


@pytest.mark.parametrize("scheme", ["modified-mass", "newmark"])
def test_bodies_without_any_mass_follow_their_loads(scheme: str) -> None:
    pushed = cq.ContactProblem([[2.0, 0.0], [0.0, 1.0]], [1.0, 0.0], [[1.0, 0.0]], [0.3])
    history = cq.impact(pushed, np.zeros(2), np.zeros(2), np.zeros(2), 1.0, 0.1, scheme=scheme)
    assert history[-1].displacement == pytest.approx([0.3, 0.0])
    assert history[-1].normal_force == pytest.approx([0.4])
