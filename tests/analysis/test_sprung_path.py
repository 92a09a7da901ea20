"""Load paths with friction by the textbook's methods: contact springs and their sliders, and multipliers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactqp as cq
from tests.analysis.friction_paths import ORDERS, WEIGHTS, pulled, truss_from_rest
from tests.analysis.test_friction_events import balance, events, random_body
from tests.solving.friction.problems import TOUCH, two_masses
from tests.solving.friction.test_contact_springs import require_same

CLOSING = 458394666339 / 639328600000
SPRINGS: list[tuple[str, dict[str, Any]]] = [
    ("penalty", {"penalty": 1e4}),
    ("perturbed-lagrangian", {"perturbation": 1e4}),
]
MODES: list[dict[str, Any]] = [{"steps": 1}, {"steps": 9}, {"events": "exact"}, {"events": "exact", "steps": 5}]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("steps", [None, 1, *(pytest.param(steps, marks=pytest.mark.slow) for steps in (7, 12))])
@pytest.mark.parametrize(("method", "options"), SPRINGS)
def test_two_masses_on_springs(method: str, options: dict[str, Any], steps: int | None) -> None:
    """Example 2.19: 2.6773125 N, 7.848 N and, let go, 6.645375 N of 12 N, whatever the number of steps."""
    corners = [WEIGHTS, pulled(12.0), WEIGHTS]
    history = cq.follow_path(two_masses(0.0), corners, steps, "exact", method, **options)
    times = [event.time for event in history.events if event.kind == "slip"]
    assert [event.contact for event in history.events if event.kind == "slip"] == [1, 0, 1]
    assert times == pytest.approx([1 + 2.6773125 / 12, 1 + 7.848 / 12, 3 - 6.645375 / 12], rel=1e-14)
    assert len(history) == len(set(history.times)) >= 7
    at = dict(zip(history.times.tolist(), history, strict=True))
    for time, place, friction in (
        (times[0], [2.04375e-5, 2.4525e-4], [0.204375, 2.4525]),
        (times[1], [4.905e-4, 5.886e-3], [4.905, 2.4525]),
        (2.0, [4.6425e-3, 1.419e-2], [4.905, 2.4525]),
        (times[2], [4.601625e-3, 1.36995e-2], [4.49625, -2.4525]),
        (3.0, [3.9975e-3, 6.45e-3], [-1.545, -2.4525]),
    ):
        solution = at[time]
        assert solution.displacement.shape == (4,)
        np.testing.assert_allclose(solution.displacement[:2], place, rtol=1e-12)
        np.testing.assert_allclose(solution.friction_force[:, 0], friction, rtol=1e-12)
        np.testing.assert_allclose(solution.normal_force, [19.62, 9.81], rtol=1e-12)
    assert history[-1].method == f"{method} by exact events"
    assert history[-1].contact_status.tolist() == ["stick", "slip"]


@pytest.mark.slow
@pytest.mark.parametrize("steps", [8, 25])
@pytest.mark.parametrize(("method", "options"), SPRINGS)
def test_two_masses_on_springs_in_steps(method: str, options: dict[str, Any], steps: int) -> None:
    history = cq.follow_path(two_masses(0.0), [WEIGHTS, pulled(12.0), WEIGHTS], steps, method=method, **options)
    np.testing.assert_allclose(history[-1].displacement[:2], [3.9975e-3, 6.45e-3], rtol=1e-12)
    np.testing.assert_allclose(history[-1].friction_force[:, 0], [-1.545, -2.4525], rtol=1e-12)
    slips = [event.time for event in history.events if event.kind == "slip"]
    exactly = (1 + 2.6773125 / 12, 1 + 7.848 / 12, 3 - 6.645375 / 12)
    assert slips == [next(time for time in history.times if time >= event) for event in exactly]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("mode", MODES)
def test_a_truss_that_sticks_on_springs_hangs_where_it_touched(mode: dict[str, Any]) -> None:
    """u = (TOUCH, -1 mm) + (K + beta 1)^-1 (1 - t) f: the slider is anchored at the load at which the gap closes."""
    K, beta, load = np.array([[59803.0, 6883.1], [6883.1, 77443.0]]), 1e6, np.array([60.0, -100.0])
    history = cq.follow_path(truss_from_rest(0.8), [load], method="penalty", penalty=beta, **mode)
    touched = np.array([TOUCH, -1e-3])
    end = touched + np.linalg.solve(K + beta * np.eye(2), (1 - CLOSING) * load)
    np.testing.assert_allclose(history[-1].displacement, end, rtol=1e-12)
    np.testing.assert_allclose(history[-1].problem.slip_origin, [[TOUCH]], rtol=1e-12)
    assert [event.kind for event in history.events] == ["closed"]
    if "events" in mode:
        assert history.events[0].time == pytest.approx(CLOSING, rel=1e-14)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_every_solution_is_what_the_method_makes_of_its_problem(seed: int, mode: dict[str, Any]) -> None:
    problem, loads = random_body(seed)
    rng = np.random.default_rng(seed)
    springs = dict(
        zip(("penalty", "tangential_penalty"), 10.0 ** rng.uniform(1, 4, (2, problem.contacts)), strict=True)
    )
    history = cq.follow_path(problem, loads, method="penalty", **springs, **mode)
    for solution in history:
        require_same(cq.solve(solution.problem, "penalty", **springs), solution, 1e-9)
        assert np.all(solution.problem.gap == problem.gap)
    pressed = max(history, key=lambda solution: np.max(solution.normal_force))
    assert np.max(pressed.normal_force) > 0
    origins = [pressed.problem.slip_origin + by for by in (0.1, -0.1)]  # beyond its cone one of them changes nothing
    others = [cq.solve(pressed.problem.replace(slip_origin=origin), "penalty", **springs) for origin in origins]
    with pytest.raises(AssertionError):
        assert [require_same(other, pressed, 1e-9) for other in others]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_energy_is_in_bodies_and_springs(seed: int) -> None:
    """Elastic energy is 1/2 u'Ku + 1/2 sum l_N^2 / beta + l_T^2 / beta_T, and the balance needs both."""
    problem, loads = random_body(seed)
    beta, beta_T = 30.0, 20.0
    history = cq.follow_path(problem, loads, events="exact", method="penalty", penalty=beta, tangential_penalty=beta_T)
    assert balance(history) < 1e-12
    dissipated = np.array([one.dissipated for one in history.energies])
    assert np.all(np.diff(dissipated) >= 0)
    bodies, springs = [], []
    for solution in history:
        u, friction = solution.displacement, solution.friction_force
        bodies.append(u @ problem.stiffness @ u / 2)
        springs.append(np.sum(solution.normal_force**2) / beta / 2 + np.sum(friction**2) / beta_T / 2)
    elastic = np.array([one.elastic for one in history.energies])
    np.testing.assert_allclose(elastic, np.add(bodies, springs), rtol=1e-11, atol=1e-13 * max(elastic))
    assert max(springs) > 1e-4 * max(elastic)


@pytest.mark.slow
@pytest.mark.parametrize("penalty", [1e3, 1e5])
def test_stiff_springs_lose_no_work_where_slip_turns_to_stick(penalty: float) -> None:
    problem, loads = random_body(3)
    history = cq.follow_path(problem, loads, events="exact", method="penalty", penalty=penalty)
    assert any(event.kind == "stick" for event in history.events)
    assert balance(history) < 1e-10


def test_springs_that_rounding_cannot_tell_from_rigid_contact_are_refused() -> None:
    """At 1e20 a path would lose its equilibrium to rounding, which is no snap."""
    for options in ({"penalty": 1e20}, {"penalty": 1e6, "tangential_penalty": 1e20}):
        with pytest.raises(cq.Unsupported, match=r"penalty of floor is .* times the stiffness of the bodies"):
            cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], method="penalty", **options)


@pytest.mark.slow
def test_energy_of_the_two_masses() -> None:
    """Unloaded, 12 N let go: dissipated mu m g times what the sliders slid, by the corners of the chapter's path."""
    history = cq.follow_path(
        two_masses(0.0), [WEIGHTS, pulled(12.0), WEIGHTS], events="exact", method="penalty", penalty=1e4
    )
    first, second = 4.6425e-3 - 4.905e-4, 1.419e-2 - 2.4525e-4
    back = (1.419e-2 - 2.4525e-4) - (6.45e-3 + 2.4525e-4)
    np.testing.assert_allclose(history.energies[-1].dissipated, 4.905 * first + 2.4525 * (second + back), rtol=1e-12)
    assert balance(history) < 1e-13


def test_the_certificate_says_how_far_off_springs_are() -> None:
    history = cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], events="exact", method="penalty", penalty=1e6)
    assert [event.kind for event in history.events] == ["closed", "slip"]
    certificate = history[-1].certificate
    assert not certificate.passed
    exact = cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], events="exact")
    assert exact[-1].certificate.passed
    assert certificate.penetration > 1e-3
    np.testing.assert_allclose(history[-1].gap, -history[-1].normal_force / 1e6, rtol=1e-10)
    # Nothing touches before.
    assert history[0].certificate.passed


def test_in_space_by_steps() -> None:
    """Pressed by 8, pulled by (3, 4): l_N = 6, and friction of 3 against the pull (the springs return radially)."""
    problem = cq.ContactProblem(
        10.0 * np.eye(3), np.zeros(3), [[0.0, 0.0, -1.0]], [0.0], tangent=np.eye(3)[:2], friction=0.5
    )
    corners = [[0.0, 0.0, -8.0], [3.0, 4.0, -8.0]]
    history = cq.follow_path(problem, corners, steps=3, method="penalty", penalty=30.0)
    np.testing.assert_allclose(history[-1].displacement, [(3 - 1.8) / 10, (4 - 2.4) / 10, -0.2], rtol=1e-9)
    np.testing.assert_allclose(history[-1].friction_force, [[1.8, 2.4]], rtol=1e-9)
    with pytest.raises(cq.Unsupported, match="two tangential rows"):
        cq.follow_path(problem, corners, events="exact", method="penalty", penalty=30.0)


def test_what_a_path_on_springs_cannot_do_is_refused() -> None:
    def follow(**options: Any) -> None:
        cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], **options)

    with pytest.raises(cq.InvalidProblem, match="penalty has no default"):
        follow(method="penalty")
    with pytest.raises(cq.InvalidProblem, match="expected a positive"):
        follow(method="penalty", penalty=-1.0)
    with pytest.raises(cq.InvalidProblem, match="unknown option 'perturbation'"):
        follow(method="penalty", penalty=1.0, perturbation=1.0)
    with pytest.raises(cq.InvalidProblem, match="tangential_penalty"):
        follow(method="perturbed-lagrangian", perturbation=1.0, tangential_penalty=1.0)
    with pytest.raises(cq.Unsupported, match="systems of stick and slip of its own"):
        follow(method="penalty", penalty=1.0, algorithm="tresca")
    with pytest.raises(cq.InvalidProblem, match="warm_start"):
        follow(method="penalty", penalty=1.0, warm_start=cq.solve(truss_from_rest(0.3)))
    smooth = truss_from_rest(0.3).replace(friction=0.0)
    with pytest.raises(cq.Unsupported, match="approximate by design"):
        cq.follow_path(smooth, [[60.0, -100.0]], events="exact", method="penalty", penalty=1e6)


MULTIPLIERS: list[tuple[str, dict[str, Any]]] = [
    ("lagrange-multiplier", {}),
    ("augmented-lagrangian", {}),
    ("augmented-lagrangian", {"update": "uzawa"}),
    ("master-slave", {}),
]


@pytest.mark.sampled(16)
@pytest.mark.parametrize(("method", "options"), MULTIPLIERS)
@pytest.mark.parametrize("name", ORDERS)
def test_multipliers_follow_their_own_path(name: str, method: str, options: dict[str, Any]) -> None:
    loads, moved, force, ratio = ORDERS[name]
    history = cq.follow_path(truss_from_rest(0.3), loads, steps=7, method=method, **options)
    assert all(solution.method == method for solution in history)
    tolerance = 1e-8 if options else 1e-12
    np.testing.assert_allclose(history[-1].displacement[0], moved, rtol=tolerance)
    np.testing.assert_allclose(history[-1].normal_force[0], force, rtol=tolerance)
    np.testing.assert_allclose(history[-1].friction_force[0, 0], ratio * force, rtol=tolerance, atol=1e-9)


@pytest.mark.sampled(12)
@pytest.mark.parametrize(("method", "options"), MULTIPLIERS)
@pytest.mark.parametrize("steps", [1, 7, 40])
def test_multipliers_stick_where_they_touched(steps: int, method: str, options: dict[str, Any]) -> None:
    history = cq.follow_path(truss_from_rest(0.8), [[60.0, -100.0]], steps=steps, method=method, **options)
    np.testing.assert_allclose(history[-1].displacement[0], TOUCH, rtol=1e-8 if options else 1e-13)
    assert events(history) == [("closed", 0)]
