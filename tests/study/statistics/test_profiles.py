"""Performance profiles: by hand, with ties, and failures stay in the denominator."""

from __future__ import annotations

import numpy as np

from contactqp.study.statistics import profile, ratios


def test_profiles_of_two_solvers() -> None:
    found = ratios({"a": [1.0, 4.0, np.inf], "b": [3.0, np.inf, np.inf]})
    assert [list(values) for values in found.values()] == [[1.0, 1.0, np.inf], [3.0, np.inf, np.inf]]
    assert list(profile(found["a"], np.array([1.0, 10.0]))) == [2 / 3, 2 / 3]
    assert list(profile(found["b"], np.array([1.0, 2.9, 3.0]))) == [0.0, 0.0, 1 / 3]


def test_both_of_a_tie_are_fastest() -> None:
    found = ratios({"a": [2.0, 5.0], "b": [2.0, 1.0]})
    assert list(profile(found["a"], np.array([1.0, 5.0]))) == [0.5, 1.0]
    assert list(profile(found["b"], np.array([1.0]))) == [1.0]


def test_failures_are_not_dropped() -> None:
    found = ratios({"a": [1.0, np.inf, np.inf, np.inf], "b": [1.0, 1.0, 1.0, 1.0]})
    assert profile(found["a"], np.array([1e12]))[0] == 0.25
