"""The shifted geometric mean: by hand, and a failure costs."""

from __future__ import annotations

import math

import pytest

from contactqp.study.statistics import LIMIT, shifted_geometric_mean


def test_by_hand() -> None:
    # shifted by 1: 2, 4, 8, geometric mean 4
    assert shifted_geometric_mean([1.0, 3.0, 7.0], shift=1.0) == pytest.approx(3.0)
    assert shifted_geometric_mean([1.0, 4.0], shift=0.0) == pytest.approx(2.0)


def test_a_failure_counts_as_the_limit() -> None:
    assert shifted_geometric_mean([math.inf], limit=8.0) == pytest.approx(8.0)
    assert shifted_geometric_mean([1.0, math.inf], shift=0.0, limit=4.0) == pytest.approx(2.0)
    assert shifted_geometric_mean([1e-3, math.inf]) > shifted_geometric_mean([1e-3, LIMIT / 2])


def test_the_clock_stops_at_the_limit() -> None:
    assert shifted_geometric_mean([5.0], limit=4.0) == pytest.approx(4.0)
