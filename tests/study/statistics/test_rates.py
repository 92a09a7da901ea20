"""Claimed solved and was right, side by side: counted by hand, nothing that fails is left out."""

from __future__ import annotations

from contactqp.study.statistics import compared_cases, method_rates
from tests.study.statistics.examples import right, study, wrong


def test_by_hand() -> None:
    ours, theirs, absent = method_rates(study(), compared_cases(study()))
    assert (theirs.own, theirs.claimed, theirs.right, theirs.silently_wrong, theirs.unsupported) == (4, 2, 1, 1, 1)
    assert (theirs.certifiable, theirs.certified, theirs.cases) == (0, 0, 3)
    assert (ours.own, ours.certifiable, ours.certified, ours.wrong_but_passed) == (0, 3, 3, 0)
    assert (absent.installed, absent.own, absent.certifiable, absent.cases) == (False, 0, 0, 3)


def test_all_cases_by_default() -> None:
    assert [rates.certifiable for rates in method_rates(study())] == [4, 0, 0]


def test_a_wrong_answer_that_passes_is_counted() -> None:
    (found,) = method_rates([wrong("a", "m", 1.0, verdict="wrong but passed"), right("b", "m", 1.0)])
    assert (found.wrong_but_passed, found.certified, found.right) == (1, 2, 1)


def test_an_answer_is_right_by_what_was_asked() -> None:
    loose = right("a", "m", 1.0, variant="raw", error_judged=1e-2, error_asked=1e-1)
    tight = right("a", "m", 1.0, variant="raw", error_judged=1e-2, flag_wrong=True)
    (found,) = method_rates([loose, tight])
    assert (found.own, found.claimed, found.right, found.silently_wrong) == (2, 2, 1, 1)


def test_who_promises_nothing_claims_nothing() -> None:
    (found,) = method_rates([right("a", "penalty", 1.0, promises_exact=False)])
    assert (found.own, found.claimed) == (0, 0)
