"""Which answers are compared, and that failures, missing methods and methods that cannot stay apart.

The shifted geometric mean: by hand, and a failure costs.

Medians over cases: exact, of cases that can be put beside each other, failures among them.

Claimed solved and was right, side by side: counted by hand, nothing that fails is left out.

Performance profiles: by hand, with ties, and failures stay in the denominator.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from contactqp.study import rows
from contactqp.study.curves import knob_text
from contactqp.study.rows import Row
from contactqp.study.statistics import (
    LIMIT,
    Route,
    compared_cases,
    median_cases,
    median_limit,
    median_rows,
    method_rates,
    overview,
    profile,
    ratios,
    route_times,
    shifted_geometric_mean,
    solved,
)
from tests.study.statistics_examples import gave_up, right, study, wrong


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


def test_shifted_means_by_hand() -> None:
    # shifted by 1: 2, 4, 8, geometric mean 4
    assert shifted_geometric_mean([1.0, 3.0, 7.0], shift=1.0) == pytest.approx(3.0)
    assert shifted_geometric_mean([1.0, 4.0], shift=0.0) == pytest.approx(2.0)


def test_a_failure_counts_as_the_limit() -> None:
    assert shifted_geometric_mean([math.inf], limit=8.0) == pytest.approx(8.0)
    assert shifted_geometric_mean([1.0, math.inf], shift=0.0, limit=4.0) == pytest.approx(2.0)
    assert shifted_geometric_mean([1e-3, math.inf]) > shifted_geometric_mean([1e-3, LIMIT / 2])


def test_the_clock_stops_at_the_limit() -> None:
    assert shifted_geometric_mean([5.0], limit=4.0) == pytest.approx(4.0)


SETTING: dict[str, Any] = dict(variant="raw", knob="tolerance", knob_value=1e-3)


def _three(*values: float) -> list[Row]:
    return [
        right(case, "m", value, error_force=10 * value, **SETTING) for case, value in zip("abc", values, strict=False)
    ]


def test_the_middle_of_three() -> None:
    (middle,) = median_rows(_three(3.0, 1.0, 2.0))
    assert (middle.seconds, middle.error_force, middle.knob_value, middle.variant) == (2.0, 20.0, 1e-3, "raw")


def test_failures_are_not_dropped_from_medians() -> None:
    one = [*_three(3.0, 1.0), gave_up("c", "m", **SETTING), right("c", "n", 1.0)]
    two = [*_three(3.0), *(gave_up(case, "m", **SETTING) for case in "bc"), *(right(case, "n", 1.0) for case in "bc")]
    assert median_cases([*one, right("a", "n", 1.0), right("b", "n", 1.0)]) == ("a", "b", "c")
    assert median_rows([*one, right("a", "n", 1.0), right("b", "n", 1.0)])[0].seconds == 3.0  # of 1, 3 and infinity
    assert median_rows([*two, right("a", "n", 1.0)])[0].error_force is None


def test_absolute_errors_and_settings_of_few_cases_are_left_out() -> None:
    rows = [*_three(3.0, 1.0, 2.0), right("d", "m", 1.0, error_measure="λ absolute (the truth is zero)", **SETTING)]
    assert median_cases(rows) == ("a", "b", "c")
    rows.append(right("a", "m", 1.0, variant="raw", knob="tolerance", knob_value=1e-9))
    assert [row.knob_value for row in median_rows(rows)] == [1e-3]
    rows.append(right("a", "m", 1.0, knob="penalty", knob_value=1e3))
    assert [row.knob for row in median_rows(rows)] == ["tolerance"]


def test_what_was_tried_on_all_unknowns_of_one_case_is_no_failure_on_the_others() -> None:
    rows = [right(case, "m", 1.0, condensed="yes") for case in "abc"]
    assert [times.route.whole for times in route_times([*rows, right("a", "m", 2.0, condensed="no")])] == [False]
    everywhere = [right(case, "m", 2.0, condensed="no") for case in "abc"]
    assert [times.route.whole for times in route_times([*rows, *everywhere])] == [False, True]


def test_penalties_are_laid_together_as_multiples_of_the_contact_stiffness() -> None:
    cases = (("a", 1e3, 9.96, 1.0), ("b", 7e8, 10.03, 3.0), ("c", 2e-5, 10.0, 2.0))
    rows = [
        right(case, "penalty", seconds, knob="penalty", knob_value=value, knob_stiffnesses=multiple)
        for case, value, multiple, seconds in cases
    ]
    (middle,) = median_rows(rows)
    assert (middle.seconds, middle.knob_value, middle.knob_stiffnesses) == (2.0, None, 10.0)
    assert knob_text(middle, "") == "penalty = 10 contact stiffnesses"


def test_the_limit_is_a_median_too_and_is_known_of_all_cases_or_not_at_all() -> None:
    limits = dict(a=1e-3, b=5e-3, c=2e-3)
    rows = [replace(row, linear_solve_seconds=limits[row.case]) for row in _three(3.0, 1.0, 2.0)]
    assert median_limit(rows) == 2e-3
    assert median_limit([*rows[:2], replace(rows[2], linear_solve_seconds=None)]) is None


def test_rates_by_hand() -> None:
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


def test_profiles_of_two_solvers() -> None:
    found = ratios({"a": [1.0, 4.0, np.inf], "b": [3.0, np.inf, np.inf]})
    assert [list(values) for values in found.values()] == [[1.0, 1.0, np.inf], [3.0, np.inf, np.inf]]
    assert list(profile(found["a"], np.array([1.0, 10.0]))) == [2 / 3, 2 / 3]
    assert list(profile(found["b"], np.array([1.0, 2.9, 3.0]))) == [0.0, 0.0, 1 / 3]


def test_both_of_a_tie_are_fastest() -> None:
    found = ratios({"a": [2.0, 5.0], "b": [2.0, 1.0]})
    assert list(profile(found["a"], np.array([1.0, 5.0]))) == [0.5, 1.0]
    assert list(profile(found["b"], np.array([1.0]))) == [1.0]


def test_failures_are_not_dropped_from_profiles() -> None:
    found = ratios({"a": [1.0, np.inf, np.inf, np.inf], "b": [1.0, 1.0, 1.0, 1.0]})
    assert profile(found["a"], np.array([1e12]))[0] == 0.25
