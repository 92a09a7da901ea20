"""Medians over cases: exact, of cases that can be put beside each other, failures among them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from contactqp.study.rows import Row
from contactqp.study.statistics import median_cases, median_limit, median_rows
from tests.study.statistics.examples import gave_up, right

RUNG: dict[str, Any] = dict(variant="raw", knob="tolerance", knob_value=1e-3)


def _three(*values: float) -> list[Row]:
    return [right(case, "m", value, error_force=10 * value, **RUNG) for case, value in zip("abc", values, strict=False)]


def test_the_middle_of_three() -> None:
    (middle,) = median_rows(_three(3.0, 1.0, 2.0))
    assert (middle.seconds, middle.error_force, middle.knob_value, middle.variant) == (2.0, 20.0, 1e-3, "raw")


def test_failures_are_not_dropped() -> None:
    one = [*_three(3.0, 1.0), gave_up("c", "m", **RUNG), right("c", "n", 1.0)]
    two = [*_three(3.0), *(gave_up(case, "m", **RUNG) for case in "bc"), *(right(case, "n", 1.0) for case in "bc")]
    assert median_cases([*one, right("a", "n", 1.0), right("b", "n", 1.0)]) == ("a", "b", "c")
    assert median_rows([*one, right("a", "n", 1.0), right("b", "n", 1.0)])[0].seconds == 3.0  # of 1, 3 and infinity
    assert median_rows([*two, right("a", "n", 1.0)])[0].error_force is None


def test_absolute_errors_and_rungs_of_few_cases_are_left_out() -> None:
    rows = [*_three(3.0, 1.0, 2.0), right("d", "m", 1.0, error_measure="λ absolute (the truth is zero)", **RUNG)]
    assert median_cases(rows) == ("a", "b", "c")
    rows.append(right("a", "m", 1.0, variant="raw", knob="tolerance", knob_value=1e-9))
    assert [row.knob_value for row in median_rows(rows)] == [1e-3]
    rows.append(right("a", "m", 1.0, knob="penalty", knob_value=1e3))
    assert [row.knob for row in median_rows(rows)] == ["tolerance"]


def test_the_limit_is_a_median_too_and_is_known_of_all_cases_or_not_at_all() -> None:
    limits = dict(a=1e-3, b=5e-3, c=2e-3)
    rows = [replace(row, linear_solve_seconds=limits[row.case]) for row in _three(3.0, 1.0, 2.0)]
    assert median_limit(rows) == 2e-3
    assert median_limit([*rows[:2], replace(rows[2], linear_solve_seconds=None)]) is None
