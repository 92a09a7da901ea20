"""Paths, motions, large deformations and many load cases look at the clock before each step and return what is done."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis import friction_events, friction_path, history, load_path, many_loads
from contactqp.analysis.large import constrained_newton, path_equations
from contactqp.analysis.motion import time_stepping
from tests.clocks import Clock
from tests.solving.friction.problems import rough_truss

BARS = cq.ContactProblem(
    stiffness=[[157500.0, 0.0], [0.0, 315000.0]], load=[300.0, 0.0], normal=[[1.0, -1.0]], gap=[1e-3]
)
ROUGH = rough_truss()


def moved() -> object:
    return cq.impact(BARS, np.eye(2), np.zeros(2), np.array([1.0, 0.0]), 0.001, 0.0001)


MODULES = {
    "path": (load_path, lambda: cq.follow_path(BARS, loads=[BARS.load], steps=10), "the step to t = 0.3"),
    "friction": (friction_path, lambda: cq.follow_path(ROUGH, loads=[ROUGH.load], steps=10), "the step to t = 0.3"),
    "motion": (time_stepping, moved, "it was taken"),
}


def late_at(call: int) -> Callable[[str], None]:
    """Return what refuses to go on when it is asked for the `call`-th time."""
    asked: list[str] = []

    def refuse(what: str) -> None:
        asked.append(what)
        if len(asked) >= call:
            raise cq.NotConverged(f"stopped at the time limit, before {what}")

    return refuse


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", MODULES)
def test_the_steps_that_were_in_time_are_returned(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module, run, what = MODULES[name]
    whole = run()
    monkeypatch.setattr(module, "refuse_late", late_at(3))
    with pytest.raises(cq.NotConverged, match=f"before {what}") as caught:
        run()
    steps = caught.value.history
    assert len(steps) == 3  # the start and two steps
    for one, other in zip(steps, whole, strict=False):
        np.testing.assert_array_equal(one.displacement, other.displacement)


@pytest.mark.parametrize(
    ("module", "problem"), [(history, BARS), (friction_events, ROUGH)], ids=["frictionless", "friction"]
)
def test_events_are_found_one_by_one_in_time(
    module: object, problem: cq.ContactProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cq.follow_path(problem, loads=[problem.load], events="exact").events
    monkeypatch.setattr(module, "refuse_late", late_at(1))
    with pytest.raises(cq.NotConverged, match="before the next event was found") as caught:
        cq.follow_path(problem, loads=[problem.load], events="exact")
    assert len(caught.value.history) == 1


def test_newton_steps_of_large_deformations_are_taken_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = cq.load_scene("cases/von_mises_truss.toml")
    for module in (constrained_newton, path_equations):
        monkeypatch.setattr(module, "refuse_late", late_at(2))
    with pytest.raises(cq.NotConverged, match="before the next step of Newton's method"):
        cq.run(scene)


@pytest.mark.parametrize("name", ["path", "exact path", "friction", "motion"])
def test_a_time_limit_is_that_of_the_call_and_not_of_each_step(name: str) -> None:
    """Each of very many steps is far within the limit, and all of them together far beyond."""
    limit = {"time_limit": 0.1}
    back_and_forth = [sign * BARS.load for sign in (1.0, -1.0)] * 2_000
    run = {
        "path": lambda: cq.follow_path(BARS, [BARS.load], steps=300_000, **limit),
        "exact path": lambda: cq.follow_path(BARS, back_and_forth, events="exact", **limit),
        "friction": lambda: cq.follow_path(ROUGH, [ROUGH.load], steps=300_000, **limit),
        "motion": lambda: cq.impact(BARS, np.eye(2), np.zeros(2), np.array([1.0, 0.0]), 30.0, 1e-4, **limit),
    }[name]
    with pytest.raises(cq.NotConverged, match=r"stopped at the time limit of 0\.1 s") as caught:
        run()
    assert len(caught.value.history) < 40_000
    with pytest.raises(cq.InvalidProblem, match="time_limit"):
        cq.follow_path(BARS, [BARS.load], time_limit=-1.0)


def test_a_time_limit_is_that_of_all_cases(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of the cases may have held a limit of its own, and all of them taken as many times as long."""
    bar, solved = cq.ContactProblem([[2.0]], [0.0], [[1.0]], [1.0]), many_loads.solve

    def slowly(*arguments: object, **options: object) -> cq.Solution:
        found = solved(*arguments, **options)
        clock.passes(60.0)
        return found

    monkeypatch.setattr(many_loads, "solve", slowly)
    many = cq.solve_many(bar, loads=[[float(i)] for i in range(5)], time_limit=100.0)
    assert many.passed.tolist() == [True, True, False, False, False]
    assert many.failures[4] == "stopped at the time limit of 100 s, before this case was solved"
    assert np.isnan(many.normal_force[4]).all()
    with pytest.raises(cq.InvalidProblem, match="time_limit"):
        cq.solve_many(bar, loads=[[1.0]], time_limit=-1.0)


def test_influence_functions_are_used_with_a_time_limit_too() -> None:
    """Each case was solved by itself: thirty times as long as without a limit."""
    bar = cq.ContactProblem([[2.0]], [0.0], [[1.0]], [1.0])
    many = cq.solve_many(bar, loads=0.5 + np.arange(float(many_loads.MANY_CASES))[:, None], time_limit=600.0)
    assert many.passed.all()
    assert many.work.routes == (f"influence functions: {many_loads.MANY_CASES} of {many_loads.MANY_CASES} cases",)
