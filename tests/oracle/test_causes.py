"""Causes that the corpus does not have, each by an example in closed form, and each beside one that it is not."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from benchmarks.problem_families import family
from contactqp.oracle.diagnosis import diagnosis
from contactqp.oracle.judged_answer import JudgedAnswer
from tests.examples import seeded_problem
from tests.solving.friction.space import block, several


def causes(judged: cq.JudgedAnswer) -> set[str]:
    assert not judged.passed
    return {finding.kind for finding in judged.findings if finding.cause}


@pytest.fixture
def right() -> cq.Solution:
    return cq.solve(seeded_problem(3, 12, 8).replace(units={"length": "mm", "force": "kN"}))


def test_one_factor_on_forces_or_displacements_is_recognised(right: cq.Solution) -> None:
    problem, u, force = right.problem, right.displacement, right.normal_force
    assert causes(cq.certify(problem, -u, force)) == {"displacement-sign"}
    assert causes(cq.certify(problem, -u, -force)) == {"sign"}
    assert causes(cq.certify(problem, u, 2 * np.pi * force)) == {"radian"}
    assert causes(cq.certify(problem, u, 1.7 * force)) == {"scaled"}
    assert causes(cq.certify(problem, 1e3 * u, -force)) == {"sign", "unit"}
    assert causes(cq.certify(problem, 1e-3 * u, 1e-3 * force)) == {"unit"}


def test_units_are_told_from_the_units_of_the_problem(right: cq.Solution) -> None:
    problem, u, force = right.problem, right.displacement, right.normal_force
    assert "metres instead of millimetres?" in cq.certify(problem, 1e-3 * u, force).diagnosis
    assert "N instead of kN?" in cq.certify(problem, u, 1e3 * force).diagnosis
    assert "pound-force" in cq.certify(problem, u, force / 4.4482216153).diagnosis
    nameless = problem.replace(units={})
    assert "millimetres instead of metres?" in cq.certify(nameless, 1e3 * u, force).diagnosis


def test_an_interior_point_that_stopped_early() -> None:
    """u_i + l_i = f_i, l_i (g_i - u_i) = 1e-4 for each of four springs of stiffness one."""
    load, gap, mu = np.array([2.0, 1.5, 0.2, 3.0]), np.array([1.0, 1.0, 1.0, 0.5]), 1e-4
    problem = cq.ContactProblem(stiffness=np.eye(4), load=load, normal=np.eye(4), gap=gap)
    free = load - gap
    force = free / 2 + np.sqrt(free**2 / 4 + mu)
    judged = cq.certify(problem, load - force, force)
    assert "barrier" in causes(judged)
    assert "0.0001" in judged.diagnosis
    spoiled = force * [1.0, 1.0, 1.5, 1.0]
    assert "barrier" not in causes(cq.certify(problem, load - spoiled, spoiled))


def test_springs_that_also_pull() -> None:
    problem = seeded_problem(3, 12, 8)
    E, beta = problem.normal.toarray(), 1e4
    u = np.linalg.solve(np.asarray(problem.stiffness) + beta * E.T @ E, problem.load + beta * E.T @ problem.gap)
    force = beta * (E @ u - problem.gap)
    assert np.any(force < 0)
    judged = cq.certify(problem, u, force)
    assert "bilateral-springs" in causes(judged)
    assert "about 1e+04" in judged.diagnosis


@pytest.mark.slow
def test_a_pyramid_for_the_cone() -> None:
    """mu N = 3 on each axis: pushed by (4, 5) on springs of 2 the block slides by (0.5, 1)."""
    problem = block([4.0, 5.0])
    judged = cq.certify(problem, [0.5, 1.0, 0.0], [10.0], [[3.0, 3.0]])
    assert causes(judged) == {"pyramid"}
    other = cq.certify(problem, [0.5, 1.1, 0.0], [10.0], [[3.0, 2.8]])
    assert "pyramid" not in causes(other)


def test_friction_that_pushes_along() -> None:
    """Pushed by 4 along x on a spring of 2, mu N = 3 the wrong way: u = 3.5 instead of 0.5."""
    judged = cq.certify(block([4.0, 0.0]), [3.5, 0.0, 0.0], [10.0], [[-3.0, 0.0]])
    assert causes(judged) == {"friction-reversed"}
    assert "friction-reversed" not in causes(cq.certify(block([4.0, 0.0]), [3.4, 0.0, 0.0], [10.0], [[-2.8, 0.0]]))


def test_one_tangent_of_the_opposite_sign() -> None:
    known = several(2)
    wrong = known.answer() | {"friction_force": known.friction_force * [1.0, -1.0]}
    assert causes(cq.certify(known.problem, **wrong)) == {"tangent-sign"}


def test_overlaps_taken_as_closed_gaps() -> None:
    problem = seeded_problem(3, 12, 8)
    assert np.any(problem.gap < 0)
    other = cq.solve(problem.replace(gap=np.maximum(problem.gap, 0.0)))
    assert causes(cq.certify(problem, other.displacement, other.normal_force)) == {"overlap-ignored"}


def test_tie_values_of_zero() -> None:
    problem = family("tied_chains", 2)
    assert np.any(problem.tie_value)
    other = cq.solve(problem.replace(tie_value=0 * problem.tie_value))
    judged = cq.certify(problem, other.displacement, other.normal_force, tie_force=other.tie_force)
    assert "tie-value-ignored" in causes(judged)


def test_what_is_left_out_of_large_problems_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = seeded_problem(3, 12, 8)
    E, m = problem.normal.toarray(), 8
    system = np.block([[np.asarray(problem.stiffness), E.T], [E, np.zeros((m, m))]])
    glued = np.linalg.solve(system, np.concatenate([problem.load, problem.gap]))
    assert causes(cq.certify(problem, glued[:12], glued[12:])) == {"bilateral"}
    monkeypatch.setattr(diagnosis, "LARGEST_OF_OTHER_ROWS", 10)
    judged = cq.certify(problem, glued[:12], glued[12:])
    assert causes(judged) == set()
    assert "not-examined" in {finding.kind for finding in judged.findings}
    assert "not examined, the problem being large (12 unknowns, 8 contacts)" in judged.diagnosis


def test_a_wrong_sign_is_named_where_no_right_answer_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    import contactqp.oracle.judged_answer as module

    def gives_up(*_: object) -> None:
        raise cq.NotConverged("gave up")

    problem = seeded_problem(3, 12, 8)
    solution = cq.solve(problem)
    monkeypatch.setattr(module, "right_answer", gives_up)
    for wrong, kind in ((-solution.normal_force, "sign"), (1e3 * solution.normal_force, "unit")):
        judged = cq.certify(problem, solution.displacement, wrong)
        assert causes(judged) == {kind}
        assert judged.right is None
        assert judged.why_not == "NotConverged: gave up"
        if kind == "sign":
            assert judged.contacts[0].figure == "tension"
            assert judged.contacts[0].right_gap is None
    nothing = cq.certify(problem, solution.displacement, 1.3 * solution.normal_force)
    assert causes(nothing) == set()


def test_what_is_left_unasked_is_said_and_asked_for_more_operations() -> None:
    problem = family("tied_chains", 2)
    other = cq.solve(problem.replace(tie_value=0 * problem.tie_value))
    judged = cq.certify(problem, other.displacement, other.normal_force, tie_force=other.tie_force)
    assert not judged.passed
    hurried = [finding for finding in judged.findings_within(1.0) if finding.kind == "not-examined"]
    assert len(hurried) == 1
    assert "not examined after 1 operations: whether it is the right answer to" in hurried[0].text
    assert "findings_within(operations) of what certify returns asks more" in hurried[0].text
    at_leisure = judged.findings_within(1e11)
    assert "tie-value-ignored" in {finding.kind for finding in at_leisure}
    assert "not-examined" not in {finding.kind for finding in at_leisure}
    with pytest.raises(cq.InvalidProblem, match="operations: expected a positive"):
        judged.findings_within(-1.0)


def test_questions_that_no_answer_is_found_to_take_a_second_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = family("tied_chains", 2)
    other = cq.solve(problem.replace(tie_value=0 * problem.tie_value))
    asked = []

    def in_vain(*_: object, **__: object) -> None:
        asked.append(1)
        raise cq.NotConverged("a long search")

    monkeypatch.setattr(diagnosis, "solve", in_vain)
    judged = cq.certify(problem, other.displacement, other.normal_force, tie_force=other.tie_force)
    assert "not-examined" in {finding.kind for finding in judged.findings}
    assert 1 <= len(asked) <= 2


def chain() -> tuple[cq.ContactProblem, np.ndarray]:
    """Nine unknowns that stop at one wall each, and the areas of these: whole ones, and halves at both ends."""
    K = np.diag(np.full(9, 2.0)) - np.diag(np.ones(8), 1) - np.diag(np.ones(8), -1)
    area = np.array([0.5, *np.ones(7), 0.5])
    return cq.ContactProblem(stiffness=K, load=np.arange(3.0, 12.0), normal=np.eye(9), gap=np.full(9, 0.5)), area


def penalised(stiffness: np.ndarray) -> JudgedAnswer:
    problem, _ = chain()
    u = np.linalg.solve(np.asarray(problem.stiffness) + np.diag(stiffness), problem.load + stiffness * problem.gap)
    assert np.all(u > problem.gap)
    return cq.certify(problem, displacement=u, normal_force=stiffness * (u - problem.gap))


def test_few_springs_are_a_penalty() -> None:
    judged = penalised(1e4 * chain()[1])
    assert judged.findings[0].kind == "penalty"
    assert "penalty of 5e+03 to 1e+04, few different ones" in judged.diagnosis


def test_printed_springs_are_few_too() -> None:
    noise = 1 + 1e-3 * np.random.default_rng(3).uniform(-1, 1, 9)
    assert penalised(1e4 * chain()[1] * noise).findings[0].kind == "penalty"


def test_springs_of_any_stiffness_are_not_few() -> None:
    judged = penalised(1e4 * np.geomspace(1, 20, 9))
    assert "few different ones" not in judged.diagnosis


def test_inexact_forces_are_no_pressures() -> None:
    problem, _ = chain()
    right = cq.solve(problem)
    force = right.normal_force * np.where(np.arange(9) < 5, 1.0, 1.0001)
    judged = cq.certify(problem, displacement=right.displacement, normal_force=force)
    assert not judged.passed
    assert "pressure" not in [finding.kind for finding in judged.findings]


@pytest.mark.slow
def test_other_questions_are_answered_once_for_each_problem(
    right: cq.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second answer to a problem is held against what the first was, and one under another load is not."""
    asked: list[str] = []
    solved = diagnosis._solved
    monkeypatch.setattr(diagnosis, "_solved", lambda *each: asked.append(each[1].text) or solved(*each))
    problem, heavier = right.problem, right.problem.replace(load=3.0 * right.problem.load)
    for given, there in ((problem, heavier), (heavier, problem), (problem, heavier)):
        asked.clear()
        touching = cq.solve(given.replace(gap=0 * given.gap))
        for _ in range(2):
            assert "gap-ignored" in causes(cq.certify(given, touching.displacement, touching.normal_force))
        assert asked
        assert len(asked) == len(set(asked))
        assert "gap-ignored" not in causes(cq.certify(there, touching.displacement, touching.normal_force))
