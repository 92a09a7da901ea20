"""`time_limit` is that of the call: of what comes before a method, of each of its steps, and of what polishes."""

from __future__ import annotations

import time
from typing import Any

import pytest

import contactqp as cq
from contactqp.certificate import certificate
from contactqp.linalg import condensation
from contactqp.model import arrays
from tests.blocks_in_space import fresh, on_paraboloid
from tests.solving.friction.problems import rough_truss
from tests.solving.friction.space import block

PROBLEMS = {"frictionless": on_paraboloid((5, 5, 3)), "plane": rough_truss(), "space": block([1.0, 0.0])}


@pytest.mark.parametrize("name", PROBLEMS)
def test_no_time_at_all_says_so_and_what_was_not_begun(name: str) -> None:
    with pytest.raises(cq.NotConverged, match="stopped at the time limit of 1e-09 s, before the stiffness was condens"):
        cq.solve(fresh(PROBLEMS[name]), time_limit=1e-9)


@pytest.mark.parametrize("name", PROBLEMS)
def test_what_comes_before_the_method_counts(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Condensing takes longer than the call may: the method never begins."""
    problem, made = fresh(PROBLEMS[name]), condensation.Condensation.__init__

    def slowly(self: Any, *arguments: Any) -> None:
        made(self, *arguments)
        time.sleep(0.3)

    monkeypatch.setattr(condensation.Condensation, "__init__", slowly)
    began = time.perf_counter()
    with pytest.raises(cq.NotConverged, match=r"time limit of 0\.2"):
        cq.solve(problem, time_limit=0.2)
    assert time.perf_counter() - began < 1.5


@pytest.mark.sampled(3)
@pytest.mark.parametrize("unit", [1.0, 2.0**-100])
@pytest.mark.parametrize("name", PROBLEMS)
def test_what_was_found_is_certified_however_long_that_takes(
    name: str, unit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time is up when certificates begin, those in units near one and in the problem's own alike."""
    problem = PROBLEMS[name]
    if unit != 1.0:
        problem = problem.replace(stiffness=problem.stiffness * unit, load=problem.load * unit)
    cq.solve(problem)
    judged = certificate._judged

    def late(*arguments: Any) -> cq.Certificate:
        time.sleep(0.6)
        return judged(*arguments)

    monkeypatch.setattr(certificate, "_judged", late)
    assert cq.solve(problem, time_limit=0.5).certificate.passed


def test_an_earlier_end_stays_within_a_later_one() -> None:
    with arrays.within_time(1e-9), arrays.within_time(60.0), pytest.raises(cq.NotConverged, match="of 1e-09 s"):
        arrays.refuse_late("more")
    with arrays.within_time(1e-9), arrays.in_any_time():
        arrays.refuse_late("more")
    arrays.refuse_late("more")
    assert arrays.seconds_left() is None
