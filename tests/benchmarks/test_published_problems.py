"""The thirty published problems of friction by what is tried where nothing is asked for: solved to 1e-8, or refused."""

from __future__ import annotations

import pytest

import contactqp as cq
from benchmarks.friction_runs import DEFAULT, SOLVED, Published, Run, run_ours
from tests.exchange.published import SURVEY, needs_data, published

pytestmark = needs_data
TIME_LIMIT = 60.0
# 463 contacts with 743 independent directions, mu = 1, W unsymmetric by 2e-3: more than a minute.
HARD = ("RockPile_tob1.dat",)
# Seconds each; the others reach every kind too.
LONG = (
    "fc2d_granularflowonwall_02020_00213.dat",
    "Spheres-i099-356-679.hdf5",
    "Capsules-i100-889.dat",
    "Capsules-i125-1213.hdf5",
    "FrictionContactProblem00237.dat",
)


def _slow(name: str) -> object:
    return pytest.param(name, marks=pytest.mark.slow) if name in LONG else name


def solved(name: str, time_limit: float) -> Run:
    return run_ours(Published(name, cq.local_form_of(cq.read_problem(published(name)))), DEFAULT, time_limit)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", [_slow(name) for name in SURVEY if name not in HARD])
def test_a_published_problem_is_solved(name):
    run = solved(name, TIME_LIMIT)
    assert run.error <= SOLVED
    assert run.claimed
    assert run.seconds <= TIME_LIMIT


def test_these_are_at_least_28():
    assert len(SURVEY) == 30
    assert len(SURVEY) - len(HARD) >= 28


@pytest.mark.slow
@pytest.mark.parametrize("name", HARD)
# What is left to go on with: nearer than no forces, whose error is 1, by as much as the time of any machine allows.
@pytest.mark.parametrize(("time_limit", "error"), [(1.0, 0.5), (TIME_LIMIT, 1e-2)])
def test_what_is_not_solved_in_time_is_refused(name, time_limit, error):
    run = solved(name, time_limit)
    assert run.solved or not run.claimed
    assert not run.wrong
    assert run.claimed or run.remark == "NotConverged"
    assert run.error < error
