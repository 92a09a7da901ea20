"""Load paths with friction in space, in steps: a block on a leash, whose slip turns; history, energy.

A block pressed by N is pulled by a spring k whose end moves. While it slides the spring is mu N / k = L long and points
along the slip: the block follows its end like a dog on a leash. Where the end moves straight on, the angle a between
spring and way falls as tan(a/2) ~ exp(-s/L) with the way s of the end (a tractrix), and the block's own way is
L log(sin a0 / sin a). Where the end goes round a circle of radius R the block comes to go round one of
sqrt(R^2 - L^2). A step is one recursion: u + (p - u) (1 - L / |p - u|) where the end p is further away than L.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis import friction_step
from tests.solving.friction.space import block, direction, elastic_block

# mu N = 3 and k = 2.
LEASH = 1.5
PRESS = np.array([0.0, 0.0, -10.0])


def pulled(ends: np.ndarray) -> list[np.ndarray]:
    """Pressed, then the spring's end at each of some points."""
    return [PRESS, *(PRESS + np.append(2.0 * np.asarray(end), 0.0) for end in ends)]


def led(ends: np.ndarray, steps: int) -> cq.History:
    return cq.follow_path(block([0.0, 0.0]), pulled(ends), steps=steps)


def recursion(ends: np.ndarray, steps: int) -> np.ndarray:
    """Where the block is after every step of the legs after the first."""
    at, places = np.zeros(2), []
    for start, end in zip([np.zeros(2), *ends[:-1]], ends, strict=True):
        for i in range(steps):
            away = start + (i + 1) / steps * (end - start) - at
            far = np.linalg.norm(away)
            at = at + away * max(0.0, 1.0 - LEASH / far)
            places.append(at)
    return np.array(places)


SQUARE = np.array([[4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [0.0, 0.0]])


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 5, pytest.param(16, marks=pytest.mark.slow)])
def test_round_a_square_every_step_is_the_law_of_that_step(steps: int) -> None:
    history = led(SQUARE, steps)
    places = history.displacements[1 + steps :]
    np.testing.assert_allclose(places[:, :2], recursion(SQUARE, steps), atol=1e-12)
    np.testing.assert_allclose(places[:, 2], 0.0, atol=1e-15)
    assert all(solution.certificate.passed for solution in history)
    slid = [s for s in history if s.contact_status[0] == "slip"]
    assert len(slid) > 3 * steps // 2
    for solution in slid:
        s, force = solution.slip[0], solution.friction_force[0]
        np.testing.assert_allclose(force, 3.0 * s / np.linalg.norm(s), atol=1e-12)


@cache
def round_one_corner(steps: int) -> cq.History:
    return led(SQUARE[:2], steps)


@pytest.mark.slow
def test_after_a_corner_the_slip_turns_along_a_tractrix() -> None:
    """From a = 90 degrees on; steps are off by their size, to first order."""
    errors = []
    for steps in (20, 40):
        leg = round_one_corner(steps).friction_forces[-steps:, 0]
        way = 4.0 * np.arange(1, steps + 1) / steps
        # The first leg ends with the spring along x, straight behind its end.
        angle = 2 * np.arctan(np.exp(-way / LEASH))
        found = np.arctan2(leg[:, 0], leg[:, 1])
        errors.append(np.max(abs(found - angle)))
    assert errors[1] < 0.05
    np.testing.assert_allclose(errors[0] / errors[1], 2.0, rtol=0.15)


@pytest.mark.slow
def test_small_steps_slip_along_the_velocity_long_after_a_corner() -> None:
    ends = np.array([[4.0, 0.0], [4.0, 16.0]])
    last = led(ends, 30)[-1]
    np.testing.assert_allclose(last.friction_force[0], [0.0, 3.0], atol=1e-3 * 3.0)
    assert abs(last.friction_force[0, 0]) > 0, "exp(-16 / 1.5), not zero"


@pytest.mark.slow
def test_what_a_corner_dissipates() -> None:
    """mu N times the block's way: 4 - L on the first leg, L log(1 / sin a) on the second."""
    angle = 2 * np.arctan(np.exp(-4.0 / LEASH))
    way = 4.0 - LEASH + LEASH * np.log(1.0 / np.sin(angle))
    off = []
    for steps in (20, 40):
        energies = round_one_corner(steps).energies
        dissipated = np.array([one.dissipated for one in energies])
        assert np.all(np.diff(dissipated) >= 0)
        off.append(abs(dissipated[-1] - 3.0 * way))
    assert off[1] < 0.01 * 3.0 * way
    assert off[1] < 0.6 * off[0]


@pytest.mark.slow
def test_round_a_circle() -> None:
    """R = 2.5, L = 1.5: the block comes to go round a circle of radius 2, its spring tangent to it."""
    corners = 48
    around = 2.5 * np.array([direction(a) for a in np.linspace(0.0, 4 * np.pi, 2 * corners + 1)])
    history = led(around, 1)
    radius = np.linalg.norm(history.displacements[-corners:, :2], axis=1)
    # A step of angle h: |u|^2 = R^2 - L^2 to first order in h.
    np.testing.assert_allclose(radius, 2.0, rtol=0.06)
    np.testing.assert_allclose(history.displacements[2:, :2], recursion(around, 1), atol=1e-11)
    inward = np.sum(history.friction_forces[-1, 0] * history.displacements[-1, :2])
    assert abs(inward) < 0.25 * 3.0 * 2.0


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.0, 0.7, -2.4])
def test_a_jenkins_loop_in_any_direction(angle: float) -> None:
    """Amplitude D = 4: a loop costs 4 mu N (D - mu N / k) = 30, whatever the steps."""
    t = direction(angle)
    for steps in (1, 7):
        history = led(np.array([4.0 * t, -4.0 * t, 4.0 * t]), steps)
        at = [history.energies[i * steps].dissipated for i in (2, 4)]
        np.testing.assert_allclose(at[1] - at[0], 30.0, rtol=1e-12)
        np.testing.assert_allclose(history[-1].displacement[:2], 2.5 * t, rtol=1e-12, atol=1e-14)
    kinds = [event.kind for event in history.events]
    assert kinds == ["closed", "slip", "stick", "slip", "stick", "slip"]


@pytest.mark.slow
def test_pushed_less_than_its_bound_in_many_directions_it_has_not_moved() -> None:
    around = np.array([1.4 * direction(a) for a in np.linspace(0, 2 * np.pi, 9)])
    history = led(around, 2)
    np.testing.assert_allclose(history.displacements, 0.0, atol=1e-15)
    assert history.energies[-1].dissipated == 0.0
    assert [event.kind for event in history.events] == ["closed"]


def test_lifted_and_put_down_elsewhere_it_is_anchored_there() -> None:
    """Gap 1/10 from the start, spring upwards of 5: put down at (1, 1), where it then sticks."""
    K = np.diag([2.0, 2.0, 5.0])
    above = block([0.0, 0.0], gap=[0.1], stiffness=K)
    over, down = np.array([2.0, 2.0, 0.0]), np.array([2.0, 2.0, -10.0])
    history = cq.follow_path(above, [over, down, np.array([4.0, 2.0, -10.0])], steps=3)
    np.testing.assert_allclose(history[6].displacement, [1.0, 1.0, -0.1], rtol=1e-12)
    np.testing.assert_allclose(history[6].friction_force, 0.0, atol=1e-12)
    np.testing.assert_allclose(history[-1].displacement, [1.0, 1.0, -0.1], rtol=1e-12)
    np.testing.assert_allclose(history[-1].friction_force, [[2.0, 0.0]], atol=1e-12)


def test_lifted_off_the_floor_and_put_down_it_is_anchored_where_it_lands() -> None:
    """Gap 0 at the start, so that no gap tells how far it is held off: it lands at (3, 2)/2 halfway, and sticks."""
    lying = block([0.0, 0.0], gap=[0.0], stiffness=np.diag([2.0, 2.0, 5.0]))
    history = cq.follow_path(lying, [np.array([2.0, 2.0, 5.0]), np.array([4.0, 2.0, -5.0])], steps=1)
    np.testing.assert_allclose(history[-1].problem.slip_origin, [[1.5, 1.0]], rtol=1e-12)
    np.testing.assert_allclose(history[-1].displacement, [1.5, 1.0, 0.0], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(history[-1].friction_force, [[1.0, 0.0]], rtol=1e-12, atol=1e-12)


@pytest.fixture(scope="module")
def dragged() -> cq.History:
    """An elastic block pressed, pushed along x, then along y as well, then back: 25 contacts."""
    problem = elastic_block((4, 4, 2))
    corners = [elastic_block((4, 4, 2), push=push).load for push in ((0, 0), (0.006, 0), (0.006, 0.006), (0, 0))]
    return cq.follow_path(problem, corners, steps=4)


@pytest.mark.slow
def test_an_elastic_block_factorises_once_and_loses_energy_only(dragged: cq.History) -> None:
    assert sum(solution.work.factorisations for solution in dragged) == 1
    assert all(solution.certificate.passed for solution in dragged)
    dissipated = [one.dissipated for one in dragged.energies]
    assert np.all(np.diff(dissipated) >= 0)
    assert dissipated[-1] > 0
    for before, now in pairwise(dragged):
        sticks = (now.normal_force > 0) & (before.normal_force > 0)
        place = (before.problem.tangent @ before.displacement).reshape(-1, 2)
        np.testing.assert_allclose(now.problem.slip_origin[sticks], place[sticks], atol=1e-15)


@pytest.mark.slow
def test_each_step_starts_from_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method takes fewer iterations from the forces of the step before than from none."""
    problem = elastic_block((4, 4, 2))
    corners = [elastic_block((4, 4, 2), push=(s, s / 2)).load for s in (0.004, 0.0044)]
    real, started = friction_step.solve, []

    def solve(one: cq.ContactProblem, method: str, **options: object) -> cq.Solution:
        started.append(options["warm_start"])
        return real(one, method, **options)

    monkeypatch.setattr(friction_step, "solve", solve)
    history = cq.follow_path(problem, corners, steps=4)
    assert started[0] is None
    assert all(isinstance(one, cq.Solution) for one in started[1:])
    last = history[-1]
    cold, warm = cq.solve(last.problem), cq.solve(last.problem, warm_start=history[-2])
    assert warm.work.iterations < cold.work.iterations
    np.testing.assert_allclose(warm.displacement, cold.displacement, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize(("lift", "searched"), [(0.0, False), (50.0, True)])
def test_where_a_body_that_nothing_holds_closes_is_not_searched_for(
    lift: float, searched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a spring off the plane any load drives the block onto it; with one it arrives at a load."""
    real, widened = friction_step.solve, []

    def solve(one: cq.ContactProblem, method: str, **options: object) -> cq.Solution:
        widened.append(one.gap[0] > 1.0)
        return real(one, method, **options)

    monkeypatch.setattr(friction_step, "solve", solve)
    stiffness = np.diag([2.0, 2.0, lift])
    history = cq.follow_path(block([0.0, 0.0], stiffness=stiffness, gap=[0.1]), [PRESS], steps=1)
    assert any(widened) is searched
    np.testing.assert_allclose(history[-1].normal_force, [10.0 - 0.1 * lift])
