"""Combinations near the best iterate, tried where no algorithm of the local form comes to an answer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.linalg.condensation import condense
from contactqp.solving import friction_runs
from contactqp.solving.friction import algorithms, contact_form, tresca
from contactqp.solving.methods import Settings, find


def held_by_friction_alone() -> cq.ContactProblem:
    """Two contacts in space; nothing but their friction could hold the first unknown, and it is too little."""
    return cq.ContactProblem(
        stiffness=np.array([[0, 0, 0, 0], [0, 7, 0, 0], [0, 0, 9, 4], [0, 0, 4, 5]], dtype=float),
        load=np.array([0.68, 0.96, 0.57, -0.72]),
        normal=np.array([[0, 1, 0, 0], [0, 4, 0, 0]], dtype=float),
        gap=np.array([0.0, 0.3]),
        tangent=np.array([[-4, 6, 2, 3], [-2, 2, 1, 0], [-4, 6, 2, 3], [-2, 2, 1, 0]]) / 4,
        friction=np.full(2, 0.125),
    )


def test_that_friction_cannot_hold_it_is_proven() -> None:
    with pytest.raises(cq.NoEquilibrium, match=r"whichever contacts close.*proven in rational numbers"):
        cq.solve(held_by_friction_alone())


@pytest.fixture
def _unproven(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the proof that there is no equilibrium, for what is tried where there is none."""
    monkeypatch.setattr(contact_form, "refuse_unbalanced_in_space", lambda *_: None)


def refusal(time_limit: float | None = None) -> str:
    with pytest.raises(cq.NotConverged) as refused:
        cq.solve(held_by_friction_alone(), time_limit=time_limit)
    return str(refused.value)


@pytest.mark.slow
@pytest.mark.usefixtures("_unproven")
def test_every_combination_is_tried_where_there_is_time() -> None:
    assert "all 9 combinations, refined from there, fail as well" in refusal()


@pytest.mark.slow
@pytest.mark.usefixtures("_unproven")
def test_operations_are_counted_and_not_timed_and_what_was_tried_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_form, "NEARBY_OPERATIONS", 2e7)
    said = refusal()
    assert "the 2 nearest of 9 combinations fail as well; their budget of operations is spent" in said
    assert "a time_limit [s] takes its place and tries more" in said


@pytest.mark.slow
@pytest.mark.usefixtures("_unproven")
def test_a_limit_of_time_counts_instead_where_one_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_form, "NEARBY_OPERATIONS", 1.0)
    assert "all 9 combinations, refined from there, fail as well" in refusal(time_limit=600.0)


def test_no_driven_motion_is_looked_for_where_no_body_floats(monkeypatch: pytest.MonkeyPatch) -> None:
    # Of ten contacts, of which nearly all slide, that took a tenth of the solution.
    n = 20
    K = 2.5 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    rows = dict(normal=-np.eye(n)[::2], gap=np.zeros(n // 2), tangent=np.eye(n)[1::2], friction=0.3)
    problem = cq.ContactProblem(stiffness=K, load=np.tile([-1.0, 2.0], n // 2), **rows)
    monkeypatch.setattr(tresca, "refuse_driven_motion", lambda *_: pytest.fail("a driven motion was looked for"))
    solution = cq.solve(problem, algorithm="tresca")
    assert "slip" in solution.contact_status


def test_few_contacts_in_the_plane_take_few_tresca_problems_before_their_combinations_are_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[int | None] = []
    original = friction_runs.ALGORITHMS["tresca"]

    def recorded(*given_to: Any) -> Any:
        given.append(given_to[-1].max_iter)
        raise cq.NotConverged("of the test")

    monkeypatch.setitem(friction_runs.ALGORITHMS, "tresca", replace(original, on_bodies=recorded))
    monkeypatch.setattr(friction_runs, "TRESCA_AT_ONCE", friction_runs.ALGORITHMS["tresca"])
    block = cq.ContactProblem(np.eye(2), [0.1, -1.0], [[0.0, -1.0]], [0.0], tangent=[[1.0, 0.0]], friction=0.5)
    assert cq.solve(block).certificate.passed
    with pytest.raises(cq.NotConverged, match="of the test"):
        cq.solve(block, max_iter=70, algorithm="tresca")
    assert given == [friction_runs.STEPS_BEFORE_LISTING, 70]


@pytest.mark.usefixtures("_unproven")
def test_steps_that_the_caller_limits_are_those_of_every_algorithm_that_is_tried(monkeypatch) -> None:
    """A diagnosis that allowed 20 steps for each of its questions took 20 s over a problem of seven contacts."""
    limits = []

    def fails(*arguments: Any) -> None:
        limits.append(next(one for one in arguments if isinstance(one, Settings)).max_iter)
        raise cq.NotConverged("not this time")

    monkeypatch.setattr(algorithms, "run_algorithm", fails)
    with pytest.raises(cq.NotConverged):
        cq.solve(held_by_friction_alone(), max_iter=5)
    assert max(limits) == 5
    assert len(limits) > 3


def test_combinations_are_not_listed_where_steps_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of seven contacts in the plane there are 16384, which take ten seconds."""

    def fails(*_: Any) -> None:
        raise cq.NotConverged("not this time")

    monkeypatch.setattr(friction_runs, "_by", fails)
    monkeypatch.setattr(friction_runs, "_listed", lambda *_: pytest.fail("combinations were listed"))
    down, along = np.tile([0.0, -1.0], (4, 1)), np.tile([1.0, 0.0], (4, 1))
    block = cq.ContactProblem(np.eye(2), [0.1, -1.0], down, np.zeros(4), tangent=along, friction=0.3)
    with pytest.raises(cq.NotConverged, match="not this time"):
        cq.solve(block, max_iter=5)


def test_contacts_that_are_listed_in_the_plane_are_spared_the_long_attempts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of eight contacts without an answer they took a third of its seconds, and all combinations follow anyhow."""
    tried: list[str] = []

    def fails(*given: Any) -> None:
        tried.append(given[1].name)
        raise cq.NotConverged("not this time")

    monkeypatch.setattr(algorithms, "run_algorithm", fails)
    for contacts, long in ((8, 0), (9, 1)):
        down, along = np.tile([0.0, -1.0], (contacts, 1)), np.tile([1.0, 0.0], (contacts, 1))
        block = cq.ContactProblem(np.eye(2), [0.1, -1.0], down, np.zeros(contacts), tangent=along, friction=0.3)
        tried.clear()
        with pytest.raises(cq.NotConverged):
            contact_form.solve_on_contacts(block, condense(block), find("active-set"), Settings(), None)
        assert tried.count("admm") == 1 + long
