"""Which answers are compared, and that failures, missing methods and methods that cannot stay apart."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from contactqp.study import rows
from contactqp.study.statistics import Route, compared_cases, overview, route_times, solved
from tests.study.statistics.examples import gave_up, right, study, wrong


def test_cases_that_every_method_was_put_to() -> None:
    assert compared_cases(study()) == ("a", "b", "c")
    assert compared_cases([row for row in study() if row.method == "ours"]) == ("a", "b", "c", "alone")


def test_without_a_truth_nothing_is_compared() -> None:
    assert compared_cases([replace(row, error_judged=None) for row in study()]) == ()


def test_times_are_those_of_the_fastest_right_answer() -> None:
    ours, theirs = route_times(study())
    assert (ours.route, ours.seconds) == (Route("ours"), (1e-3, 3e-3, 7e-3))
    assert (ours.solved, ours.failed, ours.unsupported) == (3, 0, 0)
    assert (theirs.route, theirs.seconds) == (Route("theirs", "raw"), (4e-3, math.inf, math.inf))
    assert (theirs.solved, theirs.failed, theirs.unsupported) == (1, 1, 1)


def test_means_by_hand() -> None:
    # shifted by 1 ms: 2, 4, 8 ms; and 5 ms with two failures at 10 s
    ours, theirs = overview(study()).means
    assert ours == pytest.approx(3e-3)
    assert theirs == pytest.approx((5e-3 * 10.001**2) ** (1 / 3) - 1e-3)


@pytest.mark.parametrize(
    ("row", "is_solved"),
    [
        (right("a", "m", 1.0), True),
        (right("a", "m", 1.0, verdict=rows.REFUSED), True),  # by the truth, whatever the certificate says
        (right("a", "m", 1.0, verdict=rows.NOT_CONVERGED), False),
        (right("a", "m", 1.0, error_judged=2e-6), False),
        (right("a", "m", 1.0, error_judged=2e-6, error_allowed=3e-6), True),
        (right("a", "m", 1.0, error_judged=None), False),  # not finite
        (wrong("a", "m", 1.0), False),
        (gave_up("a", "m"), False),
    ],
)
def test_solved_means_a_small_true_error(row: rows.Row, is_solved: bool) -> None:
    assert solved(row) is is_solved


def test_all_unknowns_are_a_route_of_their_own_where_fewer_would_do() -> None:
    condensable = [right("a", "m", 1.0, condensed="yes"), right("a", "m", 5.0, condensed="no")]
    nothing_inside = [right("b", "m", 2.0)]
    usual, whole = route_times([*condensable, *nothing_inside])
    assert (usual.route, usual.seconds) == (Route("m"), (1.0, 2.0))
    assert (whole.route, whole.seconds) == (Route("m", whole=True), (5.0, 2.0))
    assert str(whole.route) == "m, all unknowns"
