"""The two ways of taking a step, and finding where a contact closes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis import friction_step
from contactqp.analysis.friction_step import Anchors, State, step_to
from tests.analysis.friction_paths import WEIGHTS, pulled, rolling_block, truss_from_rest
from tests.public_objects import CASES
from tests.solving.friction.problems import TOUCH, two_masses


def never(*_: object, **__: object) -> None:
    raise cq.NotConverged("not this time")


@pytest.mark.slow
def test_where_newton_fails_solve_takes_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    loads = [WEIGHTS, pulled(12.0), WEIGHTS]
    quick = cq.follow_path(two_masses(0.0), loads, steps=4)
    monkeypatch.setattr(friction_step, "search", never)
    slow = cq.follow_path(two_masses(0.0), loads, steps=4)
    assert {solution.method for solution in slow[1:]} != {solution.method for solution in quick[1:]}
    np.testing.assert_allclose(slow.displacements, quick.displacements, atol=1e-15)
    assert slow.events == quick.events
    stuck = cq.follow_path(truss_from_rest(0.8), [[60.0, -100.0]], steps=3)
    np.testing.assert_allclose(stuck[-1].displacement[0], TOUCH, rtol=1e-13)


def test_an_answer_that_the_certificate_refuses_is_refused_when_it_is_looked_at() -> None:
    history = cq.follow_path(truss_from_rest(0.3), [[60.0, -100.0]], steps=4)
    step = history._solutions._steps[-1]
    wrong = replace(step, found=replace(step.found, status=-step.found.status))
    with pytest.raises(cq.NotCertified, match="friction"):
        wrong.finish()
    assert history[-1].certificate.passed


def _stuck_in_space(problem: cq.ContactProblem, *_: object, **__: object) -> cq.Solution:
    """Infinite friction: closed contacts are tied to their slip origin in both directions."""
    smooth = cq.ContactProblem(problem.stiffness, problem.load, problem.normal, problem.gap)
    solution = cq.solve(smooth)
    closed = np.flatnonzero(solution.normal_force > 0)
    friction = np.zeros(problem.slip_origin.shape)
    for _round in range(3):
        rows = np.concatenate([2 * closed, 2 * closed + 1])
        tied = cq.ContactProblem(
            problem.stiffness,
            problem.load,
            problem.normal,
            problem.gap,
            tie=problem.tangent[rows],
            tie_value=problem.slip_origin.ravel()[rows],
        )
        solution = cq.solve(tied)
        friction.ravel()[:] = 0.0
        friction.ravel()[rows] = solution.tie_force
        closed = np.flatnonzero(solution.normal_force > 0)
    status = np.where(solution.normal_force > 0, "stick", "open")
    answer = replace(solution.answer, friction_force=friction)
    return replace(solution, problem=problem, answer=answer, contact_status=status)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("steps", [1, 4])
def test_two_tangential_directions_are_anchored_where_they_close(steps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps know nothing of the plane: a node over a floor in space, both tangents held where it came down."""
    K = np.array([[4.0, 1.0, 0.5], [1.0, 5.0, -0.5], [0.5, -0.5, 3.0]])
    load = np.array([1.0, -2.0, -3.0])
    problem = cq.ContactProblem(
        K, np.zeros(3), [[0.0, 0.0, -1.0]], [0.4], tangent=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], friction=100.0
    )
    free = np.linalg.solve(K, load)
    touching = -0.4 / free[2]
    assert 0 < touching < 1
    monkeypatch.setattr(friction_step, "solve", _stuck_in_space)
    history = cq.follow_path(problem, [load], steps=steps)
    np.testing.assert_allclose(history[-1].displacement, touching * free, rtol=1e-12)
    np.testing.assert_allclose(history[-1].friction_force[0], (load - K @ (touching * free))[:2], rtol=1e-11)
    assert [event.kind for event in history.events] == ["closed"]
    assert history.energies[-1].dissipated == pytest.approx(0.0, abs=1e-15)


def test_a_step_that_closes_no_contact_is_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Contacts without an anchor were held far away first, and every such step solved again with its own gaps."""
    K, floor, sideways = np.diag([2.0, 2.0, 3.0]), [[0.0, 0.0, -1.0]], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    problem = cq.ContactProblem(K, np.zeros(3), floor, [1.0], tangent=sideways, friction=0.3)
    solved: list[cq.ContactProblem] = []

    def counting(problem: cq.ContactProblem, *arguments: object, **options: object) -> cq.Solution:
        solved.append(problem)
        return cq.solve(problem, *arguments, **options)

    monkeypatch.setattr(friction_step, "solve", counting)
    history = cq.follow_path(problem, [[1.0, 0.0, -2.0]], steps=4)
    assert history[-1].gap == pytest.approx([1.0 - 2.0 / 3.0])
    assert len(solved) == 5  # the start, and each step
    assert all(one.gap == [1.0] for one in solved)


class _Bent:
    """A gap that falls along a bent line, open until `touch`, and how often it was asked for."""

    def __init__(self, corner: float, touch: float) -> None:
        self.corner, self.touch, self.asked = corner, touch, 0

    def __call__(self, fraction: float, origin: np.ndarray, held_open: np.ndarray) -> State:
        self.asked += 1
        # Slope -1 until the corner, then what reaches zero at `touch`.
        at_corner = 1.0 - self.corner
        gap = 1.0 - fraction
        if fraction > self.corner:
            gap = at_corner * (self.touch - fraction) / (self.touch - self.corner)
        closed = not held_open[0] and gap <= 0
        return State(
            fraction=fraction,
            gap=np.array([0.0 if closed else gap]),
            position=origin if closed else np.array([[10 * fraction]]),
            pushes=np.array([closed]),
            slides=np.array([False]),
            touching=np.array([closed or abs(gap) < 1e-12]),
            overlap=np.array([bool(held_open[0] and gap < -1e-12)]),
            step=None,
        )


@pytest.mark.parametrize(("corner", "touch"), [(0.2, 0.9), (0.2, 0.25), (0.55, 0.56), (0.89, 0.9)])
def test_a_touch_is_found_past_a_kink(corner: float, touch: float) -> None:
    solve = _Bent(corner, touch)
    before = solve(0.0, np.zeros((1, 1)), np.array([True]))
    after = step_to(1.0, before, Anchors(before.position, np.array([False])), solve)
    np.testing.assert_allclose(after.position, 10 * touch, rtol=1e-11)
    assert solve.asked < 20


def test_a_step_whose_algorithms_fail_gives_up_the_search_for_where_contacts_close() -> None:
    """Every load of the search was tried, by every algorithm: minutes for a step of a fraction of a second."""
    bent, asked = _Bent(0.2, 0.9), []

    def solve(fraction: float, origin: np.ndarray, held_open: np.ndarray) -> State:
        asked.append(fraction)
        return never() if np.any(held_open) else bent(fraction, origin, held_open)

    before = bent(0.0, np.zeros((1, 1)), np.array([True]))
    after = step_to(1.0, before, Anchors(before.position, np.array([False])), solve)
    assert len(asked) == friction_step.MOST_FAILED + 1
    assert after.touching[0]
    np.testing.assert_array_equal(after.position, before.position)  # closed from the start of the step on
    assert after.early.tolist() == [True]
    assert not np.any(step_to(1.0, before, Anchors(before.position, np.array([False])), bent).early)


def test_a_path_notes_the_contacts_that_slip_from_a_guess(monkeypatch) -> None:
    """A mass on two springs is pressed down and along; where it lands is not found if no load there is solved."""
    problem = cq.ContactProblem(np.eye(2), [0.0, 0.0], [[0.0, -1.0]], [0.7], tangent=[[1.0, 0.0]], friction=0.5)
    exact = cq.follow_path(problem, [[0.2, -1.0]], steps=2)
    assert not any("compare with smaller steps" in note for note in exact.notes)
    solve = friction_step.PlaneStepper.solve

    def failing(stepper: object, fraction: float, origin: np.ndarray, held_open: np.ndarray) -> State:
        return never() if fraction > 0.5 and np.any(held_open) else solve(stepper, fraction, origin, held_open)

    monkeypatch.setattr(friction_step.PlaneStepper, "solve", failing)
    history = cq.follow_path(problem, [[0.2, -1.0]], steps=2)
    assert any("(contact 0), and where they slip from is a guess" in note for note in history.notes)


@pytest.mark.slow
def test_a_load_that_tips_a_body_over_is_refused_before_contacts_are_searched_for(monkeypatch) -> None:
    """Which of its feet comes down first was searched for, at 30 loads and more, though at the end none holds it."""
    asked, solve = [], friction_step.PlaneStepper.solve
    monkeypatch.setattr(friction_step.PlaneStepper, "solve", lambda *arguments: asked.append(1) or solve(*arguments))
    down, along = [[0.0, -1.0, 1.0], [0.0, -1.0, -1.0], [0.0, -1.0, 0.0]], [[1.0, 0.0, 0.0]] * 3
    block = cq.ContactProblem(np.zeros((3, 3)), np.zeros(3), down, [0.0, 0.01, 1e-3], tangent=along, friction=0.5)
    history = cq.follow_path(block, [[0.2, -1.0, 0.9]], steps=1)
    np.testing.assert_allclose(history[-1].normal_force, [0.9, 0.0, 0.1], rtol=1e-9)
    assert len(asked) <= 5  # what the least load drives all loads drive: that had been asked of thirty
    asked.clear()
    with pytest.raises(cq.NoEquilibrium, match="t = 1: the load drives") as tipped:
        cq.follow_path(block, [[0.2, -1.0, 1.1]], steps=1)
    assert tipped.value.proof is not None
    assert len(asked) <= 2


def test_a_contact_that_does_not_close_keeps_no_anchor() -> None:
    solve = _Bent(0.2, 1.5)
    before = solve(0.0, np.zeros((1, 1)), np.array([True]))
    after = step_to(1.0, before, Anchors(before.position, np.array([False])), solve)
    assert not after.touching[0]
    np.testing.assert_allclose(after.position, 10.0)


def test_a_step_that_fails_says_where() -> None:
    problem, loads = rolling_block(0.3, (6, 2))
    with pytest.raises(cq.NotConverged, match=r"t = 0\.25"):
        cq.follow_path(problem, loads, steps=4, algorithm="tresca", max_iter=1)


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0.0, 1e-17, 1e-13])
def test_a_body_that_lies_on_one_contact_is_anchored_there_whatever_rounding_makes_of_its_gap(gap: float) -> None:
    """Three masses on one middle foot hold each other by bending; the outer feet come down at 0.2 of the load.

    A foot that was open by rounding left the bodies to roll, and positions of 1e-34 let feet of one slide slip apart.
    """
    bending = np.array([1.0, -2.0, 1.0, 0.0])
    down, along = -np.eye(3, 4), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    problem = cq.ContactProblem(
        10.0 * np.outer(bending, bending), np.zeros(4), down, [0.01, gap, 0.01], tangent=along, friction=0.4
    )
    pressed = [-1.0, -1.0, -1.0, 0.0]
    history = cq.follow_path(problem, loads=[pressed, [*pressed[:3], 0.3]], steps=2)
    assert all(solution.certificate.passed for solution in history)
    # Closed feet share the load: the ends give 10 (0.02) = 0.2 less than their weights to the ground.
    np.testing.assert_allclose(history[-1].normal_force, [0.8, 1.4, 0.8], rtol=1e-9)
    np.testing.assert_allclose(history[-1].friction_force.sum(), 0.3, rtol=1e-9)
    assert np.all(history[-1].slip == 0.0)


@pytest.mark.slow
def test_a_cylinder_on_one_node_takes_as_few_solves_in_feet_as_in_millimetres(tmp_path, monkeypatch) -> None:
    """In feet the gap of the middle node is 7e-18: the path took minutes, by steps of 1e-9, for one second."""
    counts = []
    solve = friction_step.PlaneStepper.solve
    monkeypatch.setattr(friction_step.PlaneStepper, "solve", lambda *arguments: counts.append(1) or solve(*arguments))
    text = (CASES / "cattaneo_mindlin_cylinder.toml").read_text("utf-8")
    case = tmp_path / "feet.toml"
    case.write_text(text.replace('length = "mm"', 'length = "ft"'), "utf-8")
    cq.run(cq.load_scene(case))
    assert len(counts) < 150


@pytest.mark.slow
@pytest.mark.parametrize("spring", [0.0, 1e-3])
def test_what_the_load_drives_to_contacts_that_are_held_open_is_not_sought_farther_and_farther(
    spring: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bar lies on its left end; what pulls at the right one turns it until that lies, too, if no spring holds it."""
    K = np.zeros((4, 4))
    K[np.ix_([0, 2], [0, 2])] = [[1.0, -1.0], [-1.0, 1.0]]
    K[3, 3] = spring
    down, along = -np.eye(4)[[1, 3]], np.eye(4)[[0, 2]]
    problem = cq.ContactProblem(K, np.zeros(4), down, [0.0, 0.1], tangent=along, friction=0.3)
    sought: list[cq.ContactProblem] = []

    def counted(one: cq.ContactProblem, *arguments: Any, **options: Any) -> cq.Solution:
        sought.append(one)
        return cq.solve(one, *arguments, **options)

    monkeypatch.setattr(friction_step, "solve", counted)
    stepper = friction_step.SolveStepper(problem, "active-set", {})
    stepper.turn(np.zeros(4), np.array([0.0, -1.0, 0.0, -1.0]))
    held_open = np.array([False, True])
    if spring:
        assert stepper.solve(1.0, np.zeros((2, 1)), held_open).gap[1] == pytest.approx(0.1 - 1 / spring)
    else:
        with pytest.raises(cq.NotConverged, match="drives a body to contacts that are held open"):
            stepper.solve(1.0, np.zeros((2, 1)), held_open)
    assert len(sought) == 2
