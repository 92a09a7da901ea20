"""Methods from outside are methods like ours."""

from __future__ import annotations

import pytest

import contactqp as cq
from contactqp.model.solution import Answer, Candidate
from contactqp.solving import methods as registry
from contactqp.solving.methods import Method, Settings, register


def doubled(problem: cq.ContactProblem, settings: Settings) -> Candidate:
    """Twice the right force."""
    del settings
    right = cq.solve(problem)
    return Candidate(Answer(right.displacement, 2 * right.normal_force, None, right.tie_force))


def test_a_method_of_ones_own_is_listed_and_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
    register(Method(name="doubled", kind="test", solve=doubled))
    assert cq.methods()[-1].name == "doubled"
    wall = cq.ContactProblem(stiffness=[[1.0]], load=[2.0], normal=[[1.0]], gap=[1.0])
    with pytest.raises(cq.NotCertified):
        cq.solve(wall, method="doubled", condense=False)


def test_a_name_that_is_taken_is_refused() -> None:
    with pytest.raises(cq.InvalidProblem, match="got 'penalty', which another one has"):
        register(Method(name="penalty", kind="test", solve=doubled))
