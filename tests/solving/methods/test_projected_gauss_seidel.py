"""Projected Gauss-Seidel."""

from __future__ import annotations

import numpy as np
import pytest

from contactqp.errors import NotConverged, Unsupported
from contactqp.model.problem import ContactProblem
from contactqp.solving.methods import find
from contactqp.solving.methods.complementarity import solve_projected_gauss_seidel
from contactqp.solving.methods.method import Settings
from tests.solving.methods.static_examples import EXAMPLES, HELD, REPEATED_TIES, SUPPORTED, Example, require_answer


def test_the_registry_entry_promises_what_the_method_does() -> None:
    sweeps = find("projected-gauss-seidel")
    assert sweeps.exact
    assert not sweeps.semidefinite
    assert sweeps.scale
    assert sweeps.polish
    assert not sweeps.sparse


@pytest.mark.sampled(3)
@pytest.mark.parametrize("example", [e for e in EXAMPLES if e.name != "floating"], ids=lambda example: example.name)
def test_projected_gauss_seidel_arrives(example: Example) -> None:
    candidate = solve_projected_gauss_seidel(example.problem, Settings(tolerance=1e-12))
    assert candidate.claimed, candidate.status
    assert candidate.history[-1] <= 1e-12
    require_answer(example, candidate, 1e-10)


def test_projected_gauss_seidel_stopped_early_claims_nothing() -> None:
    coupled = ContactProblem(stiffness=[[2.0, -1.9], [-1.9, 2.0]], load=[5.0, 5.0], normal=np.eye(2), gap=np.zeros(2))
    candidate = solve_projected_gauss_seidel(coupled, Settings(max_iter=4))
    assert not candidate.claimed
    assert len(candidate.history) == 4
    assert all(later < earlier for earlier, later in zip(candidate.history, candidate.history[1:], strict=False))
    assert solve_projected_gauss_seidel(coupled, Settings()).claimed


def test_projected_gauss_seidel_says_that_it_cannot_float() -> None:
    with pytest.raises(Unsupported, match="lemke"):
        solve_projected_gauss_seidel(HELD, Settings())


def test_supports_as_ties_hold_the_bodies() -> None:
    # Every displacement that the ties name is zero without contact: only rounding of it is left to compare with.
    for example in SUPPORTED:
        require_answer(example, solve_projected_gauss_seidel(example.problem, Settings()), 1e-8)


def test_ties_that_repeat_and_ties_that_contradict() -> None:
    require_answer(REPEATED_TIES, solve_projected_gauss_seidel(REPEATED_TIES.problem, Settings()), 1e-8)
    with pytest.raises(NotConverged, match="tie 1 contradicts"):
        solve_projected_gauss_seidel(REPEATED_TIES.problem.replace(tie_value=[0.5, -1.1]), Settings())
