"""A solver on the gallery: right, wrong and failing ones, whatever they return."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.testing import assert_contact_solution, assert_multipliers, check_solver, problem, problems


def without_signs(problem: cq.ContactProblem) -> tuple[Any, Any]:
    """All contacts glued: right where all are closed, tension where not."""
    m = problem.contacts
    K, E = np.asarray(problem.stiffness), problem.normal.toarray()
    glued = np.block([[K, E.T], [E, np.zeros((m, m))]])
    x = np.linalg.solve(glued, np.concatenate([problem.load, problem.gap]))
    return x[: problem.dimension], x[problem.dimension :]


@pytest.mark.parametrize("one_in", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_our_own_solver_is_right_on_every_kind(one_in: int) -> None:
    report = check_solver(cq.solve) if one_in == 1 else check_solver(cq.solve, problems()[::one_in])
    assert report.passed, report
    assert len(report.verdicts) > 40 // one_in
    assert str(report).splitlines()[-1] == f"{len(report.verdicts)} right, 0 wrong, 0 failed"


def test_a_wrong_solver_is_told_where_and_why() -> None:
    report = check_solver(without_signs, [problem("bar-and-wall"), problem("bar-short-of-wall")])
    assert [one.verdict for one in report.verdicts] == ["right", "wrong"]
    assert not report.passed
    assert [one.name for one in report.wrong] == ["bar-short-of-wall"]
    assert "tension" in report.wrong[0].why
    assert str(report).splitlines()[-1] == "1 right, 1 wrong, 0 failed"
    assert "bar-short-of-wall" in report.table()


@pytest.mark.slow
def test_what_plain_elimination_makes_of_stiff_problems() -> None:
    """The true contacts closed and one system solved in doubles: digits are lost as docs/guide/testing.md says."""

    def plain(known: Any) -> Any:
        problem, closed = known.problem, np.array([gap == 0 for gap in known.exact.gap])
        K, E = np.asarray(problem.stiffness), problem.normal.toarray()[closed]
        count, force = len(E), np.zeros(problem.contacts)
        saddle = np.block([[K, E.T], [E, np.zeros((count, count))]])
        x = np.linalg.solve(saddle, np.concatenate([problem.load, problem.gap[closed]]))
        force[closed] = x[len(K) :]
        return x[: len(K)], force

    for difficulty, passes, refused in (("easy", 1e-6, None), ("moderate", 1e-4, 1e-11), ("hard", None, 1e-7)):
        for known in problems("stiff", difficulty, count=2):
            u, force = plain(known)
            if passes is not None:
                assert_contact_solution(known, u, force, rtol=passes)
            assert_multipliers(known, force, rtol=1e-5)
            if refused is not None:
                with pytest.raises(AssertionError):
                    assert_contact_solution(known, u, force, rtol=refused)
            found = cq.solve(known.problem)
            assert_contact_solution(known, found.displacement, found.normal_force)


def test_a_solver_may_raise_or_return_nothing() -> None:
    def broken(problem: cq.ContactProblem) -> Any:
        if problem.contacts == 1:
            raise ZeroDivisionError("no pivot")
        return None

    report = check_solver(broken, [problem("bar-and-wall"), problem("wedge")])
    assert [(one.verdict, one.why) for one in report.verdicts] == [
        ("failed", "ZeroDivisionError: no pivot"),
        ("failed", "returned None"),
    ]
    assert report.wrong == ()
    assert not report.passed


@pytest.mark.parametrize(
    ("returned", "word"),
    [
        ("tuple", ""),
        ("mapping", ""),
        ("forces alone", ""),
        ("list", ""),
        ("five parts", "returned 5 parts"),
        ("other names", "returned 'u'"),
        ("a number", "returned a int"),
        ("too short", "expected shape"),
    ],
)
def test_what_a_solver_may_return(returned: str, word: str) -> None:
    known = problem("bar-and-wall")
    u, force = known.displacement, known.normal_force
    answer: Any = {
        "tuple": (u, force),
        "mapping": {"displacement": u, "normal_force": force},
        "forces alone": {"normal_force": force},
        "list": [u, force],
        "five parts": (u, force, None, None, None),
        "other names": {"u": u},
        "a number": 7,
        "too short": (u[:0], force),
    }[returned]
    (one,) = check_solver(lambda _: answer, [known]).verdicts
    assert one.verdict == ("wrong" if word else "right")
    assert word in one.why


def test_the_sign_of_compression_is_an_argument() -> None:
    def turned(problem: cq.ContactProblem) -> Any:
        found = cq.solve(problem)
        return found.displacement, -found.normal_force, found.friction_force, found.tie_force

    chosen = problems("well-posed", count=2)
    assert check_solver(turned, chosen, compression="negative").passed
    assert not check_solver(turned, chosen).passed
