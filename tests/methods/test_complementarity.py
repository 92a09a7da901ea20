"""Lemke's pivoting and projected Gauss-Seidel."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from contactqp.errors import NoEquilibrium, NotConverged, Unsupported
from contactqp.methods.complementarity import (
    METHODS,
    Complementarity,
    basic_solution,
    lemke_basis,
    solve_lemke,
    solve_projected_gauss_seidel,
)
from contactqp.methods.method import Settings
from contactqp.problem import ContactProblem
from tests.examples import block_between
from tests.methods.static_examples import EXAMPLES, HELD, TWO_BARS, Example, require_answer, require_near

# Two bodies joined by a spring and a third loose one, each against its own obstacle and against each other.
LOOSE = ContactProblem(
    stiffness=[[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]],
    load=[2.0, 1.0, 1.0],
    normal=[[1.0, 0, 0], [0, 1, 0], [0, -1, 1]],
    gap=[0.5, 0.2, 0.1],
)


def test_the_registry_entries_promise_what_the_methods_do() -> None:
    lemke, sweeps = METHODS
    assert lemke.exact
    assert lemke.semidefinite
    assert not sweeps.semidefinite
    assert all(method.scale and method.polish and not method.sparse for method in METHODS)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
@pytest.mark.parametrize("form", [np.asarray, sp.csc_array], ids=["dense", "sparse"])
def test_lemke_returns_the_exact_numbers(example: Example, form: object) -> None:
    candidate = solve_lemke(example.problem.replace(stiffness=form(example.problem.stiffness)), Settings())
    assert candidate.claimed, candidate.status
    require_answer(example, candidate, 1e-12)


@pytest.mark.parametrize("example", [e for e in EXAMPLES if e.name != "floating"], ids=lambda example: example.name)
def test_projected_gauss_seidel_arrives(example: Example) -> None:
    candidate = solve_projected_gauss_seidel(example.problem, Settings(tolerance=1e-12))
    assert candidate.claimed, candidate.status
    assert candidate.history[-1] <= 1e-12
    require_answer(example, candidate, 1e-10)


def test_lemke_holds_floating_bodies_by_contact() -> None:
    candidate = solve_lemke(LOOSE, Settings())
    # The third leans on the second with 1, so contacts 0 and 1 carry 4 together; the spring of 1 is squeezed by 0.3.
    require_answer(Example("loose", LOOSE, (0.5, 0.2, 0.3), (1.7, 1.3, 1.0)), candidate, 1e-13)


def test_lemke_leaves_undriven_motions_at_rest() -> None:
    # The second unknown has no stiffness, no contact and no load.
    idle = ContactProblem(stiffness=[[1.0, 0], [0, 0]], load=[2.0, 0.0], normal=[[1.0, 0.0]], gap=[0.5])
    require_answer(Example("idle", idle, (0.5, 0.0), (1.5, 0.0)), solve_lemke(idle, Settings()), 1e-14)
    with pytest.raises(NoEquilibrium, match="no contact and no tie resists"):
        solve_lemke(idle.replace(load=[2.0, 0.1]), Settings())


def test_lemke_leaves_a_block_where_it_may_slide() -> None:
    block = block_between()  # free to slide along its floor, which no load makes it do
    candidate = solve_lemke(block, Settings())
    assert candidate.claimed
    assert candidate.normal_force.sum() == pytest.approx(-block.load.sum(), rel=1e-12)
    assert abs(candidate.displacement[::2].sum()) < 1e-9


def test_lemke_ends_on_a_ray_where_there_is_no_answer() -> None:
    apart = ContactProblem(stiffness=[[1.0]], load=[0.0], normal=[[1.0], [-1.0]], gap=[-1.0, -1.0])
    with pytest.raises(NotConverged, match="ray"):
        solve_lemke(apart, Settings())
    with pytest.raises(NotConverged, match="ray"):
        solve_lemke(HELD.replace(load=[-2.0]), Settings())


def test_lemke_with_contacts_that_all_tie() -> None:
    # Twenty copies of three contacts: every ratio test is a tie, which is where pivoting cycles.
    rows = np.tile([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], (20, 1))
    problem = ContactProblem(stiffness=[[2.0, 1.0], [1.0, 2.0]], load=[3.0, 3.0], normal=rows, gap=np.zeros(60))
    candidate = solve_lemke(problem, Settings())
    require_near("displacement", candidate.displacement, [0.0, 0.0], 1e-12, largest=1.0)
    require_near("load", rows.T @ candidate.normal_force, [3.0, 3.0], 1e-12)
    assert np.all(candidate.normal_force >= -1e-12)


def test_lemke_stopped_early_claims_nothing() -> None:
    candidate = solve_lemke(TWO_BARS, Settings(max_iter=1))
    assert not candidate.claimed
    assert "stopped after 1 pivots" in candidate.status


def test_projected_gauss_seidel_stopped_early_claims_nothing() -> None:
    coupled = ContactProblem(
        stiffness=[[2.0, -1.9], [-1.9, 2.0]], load=[5.0, 5.0], normal=np.eye(2), gap=np.zeros(2)
    )
    candidate = solve_projected_gauss_seidel(coupled, Settings(max_iter=4))
    assert not candidate.claimed
    assert len(candidate.history) == 4
    assert all(later < earlier for earlier, later in zip(candidate.history, candidate.history[1:], strict=False))
    assert solve_projected_gauss_seidel(coupled, Settings()).claimed


def test_projected_gauss_seidel_says_that_it_cannot_float() -> None:
    with pytest.raises(Unsupported, match="lemke"):
        solve_projected_gauss_seidel(HELD, Settings())


def test_supports_as_ties_hold_the_bodies() -> None:
    # K alone is singular; the tie u_0 = 0 is the support.
    bar = ContactProblem(
        stiffness=[[1.0, -1.0], [-1.0, 1.0]], load=[0.0, 3.0], normal=[[0.0, 1.0]], gap=[1.0], tie=[[1.0, 0.0]]
    )
    example = Example("supported", bar, (0.0, 1.0), (0.0, 2.0), (1.0,))
    require_answer(example, solve_lemke(bar, Settings()), 1e-13)
    require_answer(example, solve_projected_gauss_seidel(bar, Settings()), 1e-9)


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_lemke_solves_every_solvable_semidefinite_problem(seed: int) -> None:
    random = np.random.default_rng(seed)
    m = int(random.integers(1, 12))
    factor = random.standard_normal((m, int(random.integers(1, m + 1))))
    skew = random.standard_normal((m, m)) * random.integers(0, 2)
    M = factor @ factor.T + skew - skew.T
    # q is made so that an answer exists: w - M z for some complementary w and z, integers so that ties are exact.
    closed = random.random(m) < 0.5
    z, w = closed * random.integers(0, 3, m), ~closed * random.integers(0, 3, m)
    q = w - M @ z
    lcp = Complementarity(q, M, np.zeros(0, dtype=np.intp))
    basis, _, status = lemke_basis(q, M, limit=10_000)
    w, z = basic_solution(lcp, basis)
    assert status == ""
    size = 1 + np.max(np.abs(q)) + np.max(np.abs(z))
    assert np.max(np.abs(np.minimum(w, z))) <= 1e-8 * size
    assert np.max(np.abs(w - q - M @ z)) <= 1e-8 * size
