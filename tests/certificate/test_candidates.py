"""Of very many contacts only candidates are condensed onto; the answer and its proof are those of all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.certificate import subset_bounds
from contactqp.linalg import iteration
from contactqp.linalg.condensation import condense

LINKS = 40


@pytest.fixture(autouse=True)
def few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six contact unknowns are many, three the first candidates."""
    monkeypatch.setattr(iteration, "MANY", 6)
    monkeypatch.setattr(subset_bounds, "FIRST", 3)
    monkeypatch.setattr(subset_bounds, "LAYERS", 1)


def string_over_floor(gap: np.ndarray, load: float = 0.02) -> cq.ContactProblem:
    """A string of unit springs held at both ends, pressed onto a floor under every node."""
    K = sp.diags([np.full(LINKS, 2.0), np.full(LINKS - 1, -1.0), np.full(LINKS - 1, -1.0)], [0, 1, -1])
    return cq.ContactProblem(stiffness=K, load=np.full(LINKS, load), normal=np.eye(LINKS), gap=gap)


def all_at_once(problem: cq.ContactProblem) -> cq.Solution:
    fresh = problem.replace(stiffness=problem.stiffness)
    subset_bounds.take_all(fresh)
    return cq.solve(fresh)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "gap",
    [
        np.full(LINKS, 1.0),
        1.0 + 0.01 * np.arange(LINKS) % 0.07,
        np.where(np.arange(LINKS) % 2, 0.5, 1.5),
        np.where(np.arange(LINKS) < 8, 1.0, np.linspace(1.0, 3.0, LINKS)),
    ],
    ids=["flat", "saw", "teeth", "ramp"],
)
def test_candidates_give_the_answer_of_all_contacts(gap: np.ndarray) -> None:
    problem = string_over_floor(gap)
    some, reference = cq.solve(problem), all_at_once(problem)
    np.testing.assert_allclose(some.normal_force, reference.normal_force, rtol=0, atol=1e-15)
    np.testing.assert_allclose(some.displacement, reference.displacement, rtol=1e-15)
    assert some.certificate.proven
    assert some.certificate.passed
    assert list(some.contact_status) == list(reference.contact_status)
    assert some.work.retained < reference.work.retained


def test_the_candidates_are_widened_where_decoys_lie_nearer() -> None:
    """The nearest floor is beneath the ends, which hardly move; only widening finds the middle."""
    gap = np.full(LINKS, 1.0)
    gap[[0, 1, -2, -1]] = 0.9
    problem = string_over_floor(gap)
    solution = cq.solve(problem)
    np.testing.assert_allclose(solution.normal_force, all_at_once(problem).normal_force, rtol=0, atol=1e-15)
    assert solution.normal_force[LINKS // 2] > 0
    assert solution.work.factorisations > 1


def test_the_next_load_uses_the_candidates_and_their_factorisation() -> None:
    problem = string_over_floor(np.full(LINKS, 1.0), load=0.03)
    first = cq.solve(problem)
    second = cq.solve(problem.replace(load=0.99 * problem.load), warm_start=first)
    assert second.work.factorisations == 0
    assert second.certificate.proven
    np.testing.assert_allclose(
        second.normal_force, all_at_once(problem.replace(load=0.99 * problem.load)).normal_force, atol=1e-15
    )


def test_bounds_hold_for_answers_of_others() -> None:
    problem = string_over_floor(np.full(LINKS, 1.0))
    truth = all_at_once(problem)
    off = truth.normal_force * (1 + 1e-8)
    twin = problem.replace(stiffness=problem.stiffness)
    certificate = cq.certify(twin, truth.displacement, off)
    assert certificate.force_bound is not None
    assert np.all(certificate.force_bound >= abs(off - truth.normal_force) * (1 - 1e-6))
    full = cq.certify(problem, truth.displacement, off, factorization=condense(truth.problem))
    assert certificate.force_error == pytest.approx(full.force_error, rel=1e-6)


@pytest.mark.parametrize("wrong", ["force", "gap", "missing"])
def test_a_wrong_answer_is_refused(wrong: str) -> None:
    problem = string_over_floor(np.full(LINKS, 1.0))
    truth = all_at_once(problem)
    u, force = truth.displacement.copy(), truth.normal_force.copy()
    if wrong == "force":
        force[LINKS // 2] *= 1.01
    elif wrong == "gap":
        u *= 1.001
    else:
        # The equilibrium with one contact left out: consistent, and penetrating where nobody looked.
        kept = np.flatnonzero(np.arange(LINKS) != LINKS // 2)
        without = cq.solve(cq.ContactProblem(problem.stiffness, problem.load, np.eye(LINKS)[kept], problem.gap[kept]))
        u, force = without.displacement, np.insert(without.normal_force, LINKS // 2, 0.0)
    certificate = cq.certify(problem.replace(stiffness=problem.stiffness), u, force)
    assert not certificate.passed


def test_bodies_that_candidates_cannot_hold_take_all_contacts() -> None:
    """A free string falls past the nearest contacts, which are out of its way, onto others."""
    K = sp.diags(
        [np.r_[1.0, np.full(LINKS - 2, 2.0), 1.0], np.full(LINKS - 1, -1.0), np.full(LINKS - 1, -1.0)], [0, 1, -1]
    )
    upward = -np.eye(LINKS)[:10]  # a ceiling, nearer than the floor
    problem = cq.ContactProblem(
        stiffness=K,
        load=np.full(LINKS, 0.01),
        normal=np.vstack([upward, np.eye(LINKS)[10:]]),
        gap=np.r_[np.full(10, 0.1), np.full(LINKS - 10, 1.0)],
    )
    solution = cq.solve(problem)
    assert solution.certificate.proven
    assert solution.normal_force.sum() == pytest.approx(0.01 * LINKS, rel=1e-14)


def test_a_message_names_the_contact_by_its_place_among_all() -> None:
    problem = string_over_floor(np.full(LINKS, 1.0))
    with pytest.raises(cq.NotConverged) as caught:
        cq.solve(problem, "osqp", max_iter=1, polish=False)
    last = caught.value.solution
    assert last is not None
    assert last.normal_force.shape == (LINKS,)
    assert not last.certificate.passed


def test_a_start_of_all_contacts_is_restricted() -> None:
    problem = string_over_floor(np.full(LINKS, 1.0))
    start = all_at_once(problem)
    again = cq.solve(problem, warm_start=replace(start, problem=problem))
    np.testing.assert_allclose(again.normal_force, start.normal_force, atol=1e-15)


def test_a_start_that_is_none_is_refused_as_ever() -> None:
    problem = string_over_floor(np.full(LINKS, 1.0))
    other = cq.solve(cq.ContactProblem(stiffness=[[2.0]], load=[1.0], normal=[[1.0]], gap=[0.1]))
    for wrong in ("x", other):
        with pytest.raises(cq.InvalidProblem, match="warm_start: expected a"):
            cq.solve(problem, warm_start=wrong)


def test_messages_use_the_names_and_units_of_the_problem_at_hand() -> None:
    problem = string_over_floor(np.full(LINKS, 1.0)).replace(contact_names=[f"old{i}" for i in range(LINKS)])
    cq.solve(problem)
    renamed = problem.replace(contact_names=[f"new{i}" for i in range(LINKS)], units={"length": "mm", "force": "kN"})
    few = subset_bounds.among(renamed, subset_bounds.first_candidates(renamed))
    assert few.contact_name(0).startswith("new")
    assert few.units == renamed.units


def test_a_certificate_does_not_widen_what_solves() -> None:
    problem = string_over_floor(np.full(LINKS, 1.0))
    solution = cq.solve(problem)
    cq.certify(problem, solution.displacement, np.maximum(solution.normal_force, 1e-14))
    assert cq.solve(problem).work.retained == solution.work.retained


def test_work_counts_candidates_that_could_not_hold_the_body() -> None:
    K = sp.diags(
        [np.r_[1.0, np.full(LINKS - 2, 2.0), 1.0], np.full(LINKS - 1, -1.0), np.full(LINKS - 1, -1.0)], [0, 1, -1]
    )
    gap = np.r_[np.full(10, 0.1), np.full(LINKS - 10, 1.0)]
    normal = np.vstack([-np.eye(LINKS)[:10], np.eye(LINKS)[10:]])
    problem = cq.ContactProblem(stiffness=K, load=np.full(LINKS, 0.01), normal=normal, gap=gap)
    assert cq.solve(problem).work.factorisations > all_at_once(problem).work.factorisations
