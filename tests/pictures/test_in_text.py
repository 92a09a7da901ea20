"""Bars and courses in letters: lengths in proportion, signs and zeros to be seen, any numbers fit their place."""

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from contactqp.scene.tables import ASCII, BLOCKS, bars, course


def test_bars_are_in_proportion_to_the_eighth_of_a_letter():
    assert bars([8, 4, 1, 0.5], 1) == ["█", "▌", "▏", "▏"]
    assert bars([100.0, 50.0, 25.0], 8) == ["████████", "████", "██"]
    assert bars([8, 4, 1], 4, ASCII) == ["####", "##", "#"]


def test_zero_and_negative_values_are_seen():
    assert bars([1, 0], 4) == ["████", "·"]
    assert bars([1, 0, 1e-13], 4, ASCII) == ["####", "0", "0"]  # what rounding leaves is nothing
    assert bars([2, 0, -1], 4) == ["    │████", "    │", "  ██│"]
    assert bars([2, -2], 2, ASCII) == ["  |##", "##|"]
    assert bars([0, 0], 4) == ["·", "·"]
    assert bars([], 4) == []


def test_what_is_no_number_has_no_bar():
    assert bars([1.0, np.nan, np.inf], 2) == ["██", "", ""]


def test_a_course_rises_from_zero_to_the_largest():
    assert course([0, 1, 2, 4, 8], 5) == "·▂▃▅█"
    assert course([0, 1, 2, 4, 8], 5, ASCII) == "0:-+@"
    assert course([-8, -4, 0, 8], 4) == "▁▃·█"
    assert course([0, 0], 5) == "··"
    assert course([], 5) == ""
    assert course([1, np.nan], 2)[1] == "?"


def test_of_values_that_share_a_letter_the_furthest_is_drawn():
    peak = np.zeros(1000)
    peak[503] = 1.0
    line = course(peak, 10)
    assert len(line) == 10
    assert line == "·····█····"


@pytest.mark.parametrize("letters", [BLOCKS, ASCII], ids=["blocks", "ascii"])
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(values=st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=40), width=st.integers(1, 30))
@example(values=[5e-324], width=1)
@example(values=[-1.7e308, 1.7e308], width=2)
def test_any_numbers_fit_their_place(letters, values, width):
    drawn = bars(values, width, letters)
    assert len(drawn) == len(values)
    assert all(len(bar) <= 2 * width + 1 for bar in drawn)
    assert len(course(values, width, letters)) == min(width, len(values))
