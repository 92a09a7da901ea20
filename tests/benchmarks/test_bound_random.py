"""Bounds are not below the true errors of random candidates, nor far above, and the count sees it if they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import bound_random
from benchmarks.bound_random import Judged


@pytest.fixture(scope="module")
def reports() -> list[Judged]:
    return bound_random.run(400, jobs=1, each=15)


@pytest.mark.slow
def test_no_bound_is_below_the_true_error_and_half_are_within_ten_times(reports: list[Judged]) -> None:
    assert len(reports) == 400
    assert len({one.family for one in reports}) >= 25
    assert sum(len(one.bounds) for one in reports) > 800
    assert list(bound_random.failures(reports)) == []
    found = bound_random.ratios(reports)
    assert set(found) == {"energy_error", "force_error", "force_bound"}
    assert all(np.median(values) <= 10 and len(values) > 100 for values in found.values())


@pytest.mark.slow
def test_candidates_are_of_many_kinds_right_and_wrong(reports: list[Judged]) -> None:
    assert {
        "truth rounded",
        "solver",
        "six digits",
        "noise on u",
        "noise on l",
        "penalty",
        "wrong set",
        "turned sign",
    } <= {one.kind for one in reports}
    passed = [one.passed for one in reports]
    assert 0.1 < np.mean(passed) < 0.9
    solved = [one.passed for one in reports if one.kind == "solver" and one.family == "chain_walls"]
    assert solved
    assert all(solved)


@pytest.mark.slow
def test_a_bound_below_the_true_error_is_counted_and_one_far_above_is(reports: list[Judged]) -> None:
    one = next(one for one in reports for known in one.bounds if known.error > 1e-3)
    small = replace(one, bounds=tuple(replace(known, bound=known.error / 2) for known in one.bounds))
    assert any("below" in line for line in bound_random.failures([small]))
    large = replace(one, bounds=tuple(replace(known, bound=100 * known.largest) for known in one.bounds))
    assert any("in the median" in line for line in bound_random.failures([large]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 15])
def test_forces_are_compared_by_what_they_strain_beside_few_unknowns_without_stiffness(seed: int) -> None:
    reports = bound_random.judged(("paired_inequalities", seed, 40))
    assert len(reports) == 40
    assert any("force_error" in {one.figure for one in report.bounds} for report in reports)
    assert bound_random.below(reports) == []
