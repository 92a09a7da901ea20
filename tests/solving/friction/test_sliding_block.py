"""A block that slides to rest: implicit steps in velocity, each of them a contact problem with K = M."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq

FRICTION, GRAVITY, START, MASS = 0.3, 9.81, 1.0, 2.0
STOP = START / (FRICTION * GRAVITY)
DISTANCE = START**2 / (2 * FRICTION * GRAVITY)


def slide(time_step: float, steps: int) -> tuple[np.ndarray, list[str], float]:
    """Velocities after each step, statuses, and the work of friction: M v' + E' dt l = M v + dt f, E_N v' <= 0."""
    block = cq.ContactProblem(
        stiffness=MASS * np.eye(2),
        load=np.zeros(2),
        normal=[[0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0]],
        friction=FRICTION,
    )
    velocities, statuses, work = [np.array([START, 0.0])], [], 0.0
    for _ in range(steps):
        before = velocities[-1]
        solution = cq.solve(block.replace(load=MASS * before + time_step * np.array([0.0, -MASS * GRAVITY])))
        assert solution.friction_force is not None
        velocities.append(solution.displacement)
        statuses.append(str(solution.contact_status[0]))
        work += float(solution.friction_force[0, 0]) * (before[0] + solution.displacement[0]) / 2
    return np.array(velocities), statuses, work


@pytest.mark.sampled(3)
@pytest.mark.parametrize("steps", [1, 7, 50])
def test_it_stops_where_it_must(steps: int) -> None:
    """In steps that end where it stops, the mean velocity of a step is exact: v0^2 / (2 mu g) = 0.169895 m."""
    time_step = STOP / steps
    velocities, statuses, work = slide(time_step, steps + 3)
    np.testing.assert_allclose(velocities[: steps + 1, 0], START * (1 - np.arange(steps + 1) / steps), atol=1e-14)
    np.testing.assert_allclose(time_step * (velocities[:-1, 0] + velocities[1:, 0]).sum() / 2, DISTANCE, rtol=1e-13)
    assert round(DISTANCE, 6) == 0.169895
    assert np.all(abs(velocities[steps + 1 :]) < 1e-14), "and it stays there"
    assert statuses[-1] == "stick"
    assert work == pytest.approx(MASS * START**2 / 2, rel=1e-12), "friction takes all of its energy"


@pytest.mark.slow
def test_the_last_step_is_all_that_is_wrong() -> None:
    """Where it stops within a step, the distance is off by at most mu g dt^2 / 8: the mean velocity of that step."""
    for steps in (3.3, 7.5, 49.9):
        time_step = STOP / steps
        velocities, _, _ = slide(time_step, int(steps) + 2)
        moved = time_step * (velocities[:-1, 0] + velocities[1:, 0]).sum() / 2
        assert 0 < abs(moved - DISTANCE) <= FRICTION * GRAVITY * time_step**2 / 8 * (1 + 1e-12)


def rests_in_space(angle: float, beyond: float, unit: float) -> cq.ContactProblem:
    """Return a block of one node on a rough floor in a turned frame, pulled by more than friction holds."""
    frame = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    pull = 0.5 * (1 + beyond) * np.array([np.cos(angle), np.sin(angle)])
    rows = [[0.0, 0.0, -1.0]] @ frame.T, np.eye(2, 3) @ frame.T
    return cq.ContactProblem(
        np.zeros((3, 3)), unit * (frame @ [*pull, -1.0]), rows[0], [0.0], tangent=rows[1], friction=0.5
    )


@pytest.mark.sampled(16)
@pytest.mark.parametrize("part", [1e-8, 1e-7, 1e-6, 1e-5])
@pytest.mark.parametrize(("angle", "unit"), [(1.234, 1e5), (0.0, 1.0), (0.3, 1e-6), (2.5, 1.0)])
def test_what_pulls_by_little_more_than_friction_holds_is_told_in_space(angle: float, unit: float, part: float) -> None:
    """Polygons about the circle were too coarse: 1e-7 beyond the limit took seconds, and proved nothing."""
    problem = rests_in_space(angle, part, unit)
    with pytest.raises(cq.NoEquilibrium, match="what slides by s counts as lifted by mu s") as proven:
        cq.solve(problem)
    motion = proven.value.proof.motion
    slid = 0.5 * np.linalg.norm(problem.tangent @ motion)
    assert (problem.normal @ motion)[0] + slid <= 1e-14
    assert problem.load @ motion > 0
    solution = cq.solve(rests_in_space(angle, -part, unit))
    assert solution.certificate.passed
    assert solution.contact_status.tolist() == ["stick"]


def pulled_from_a_sleeve(nodes: int, pull: float, across: int) -> cq.ContactProblem:
    """Return a bar whose nodes an overlap presses against a sleeve with 1 N each; it slides along 1 or 2 axes."""
    d = across + 1
    bar = 100 * (np.diag([1.0, *[2.0] * (nodes - 2), 1.0]) - np.eye(nodes, k=1) - np.eye(nodes, k=-1))
    along, one = np.diag([1.0] * across + [0.0]), np.eye(nodes)
    return cq.ContactProblem(
        stiffness=np.kron(bar, along) + 100 * np.kron(one, np.eye(d) - along),
        load=np.append(np.zeros(nodes * d - d), [pull, *[0.0] * across]),
        normal=-np.kron(one, np.eye(d)[-1:]),
        gap=np.full(nodes, -0.01),
        tangent=np.kron(one, np.eye(d)[:across]),
        friction=FRICTION,
        units=cq.Units(length="m", force="N"),
    )


@pytest.mark.parametrize(
    ("nodes", "across"),
    [(5, 1), (12, 1), pytest.param(6, 2, marks=pytest.mark.slow), pytest.param(12, 2, marks=pytest.mark.slow)],
)
def test_a_pull_beyond_what_friction_carries_says_so_with_both_forces(nodes: int, across: int) -> None:
    """Friction carries mu times 1 N a node; a bare count of combinations or steps would not tell what is wrong."""
    assert cq.solve(pulled_from_a_sleeve(nodes, 0.9 * FRICTION * nodes, across)).certificate.passed
    beyond = 1.3 * FRICTION * nodes
    with pytest.raises(cq.NotConverged, match=f"the load pulls with {beyond:.4g} N and friction carries .* N") as found:
        cq.solve(pulled_from_a_sleeve(nodes, beyond, across))
    carried = float(str(found.value).partition("friction carries ")[2].split()[0])
    assert carried < beyond
    if across == 1:
        assert carried == pytest.approx(FRICTION * nodes, rel=1e-3)
        assert "unknown 0 by +1, unknown 2 by +1" in str(found.value)
    assert "lower the load" in str(found.value)
