"""Lemke's pivoting."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

import contactqp as cq
from contactqp.errors import NotConverged
from contactqp.model.problem import ContactProblem
from contactqp.solving.methods import find
from contactqp.solving.methods.complementarity import Complementarity, basic_solution, lemke_basis, solve_lemke
from contactqp.solving.methods.method import Settings
from tests.examples import block_between
from tests.solving.methods.static_examples import (
    EXAMPLES,
    HELD,
    REPEATED_TIES,
    SUPPORTED,
    TWO_BARS,
    Example,
    require_answer,
    require_near,
)

# Two bodies joined by a spring and a third loose one, each against its own obstacle and against each other.
LOOSE = ContactProblem(
    stiffness=[[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]],
    load=[2.0, 1.0, 1.0],
    normal=[[1.0, 0, 0], [0, 1, 0], [0, -1, 1]],
    gap=[0.5, 0.2, 0.1],
)


def test_the_registry_entry_promises_what_the_method_does() -> None:
    lemke = find("lemke")
    assert lemke.exact
    assert lemke.semidefinite
    assert lemke.scale
    assert lemke.polish
    assert not lemke.sparse


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
@pytest.mark.parametrize("form", [np.asarray, sp.csc_array], ids=["dense", "sparse"])
def test_lemke_returns_the_exact_numbers(example: Example, form: object) -> None:
    candidate = solve_lemke(example.problem.replace(stiffness=form(example.problem.stiffness)), Settings())
    assert candidate.claimed, candidate.status
    require_answer(example, candidate, 1e-12)


def test_lemke_holds_floating_bodies_by_contact() -> None:
    candidate = solve_lemke(LOOSE, Settings())
    # The third leans on the second with 1, so contacts 0 and 1 carry 4 together; the spring of 1 is squeezed by 0.3.
    require_answer(Example("loose", LOOSE, (0.5, 0.2, 0.3), (1.7, 1.3, 1.0)), candidate, 1e-13)


def test_lemke_leaves_undriven_motions_at_rest() -> None:
    # The second unknown has no stiffness, no contact and no load.
    idle = ContactProblem(stiffness=[[1.0, 0], [0, 0]], load=[2.0, 0.0], normal=[[1.0, 0.0]], gap=[0.5])
    require_answer(Example("idle", idle, (0.5, 0.0), (1.5, 0.0)), solve_lemke(idle, Settings()), 1e-14)
    with pytest.raises(NotConverged, match="no contact and no tie resists"):
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


def test_supports_as_ties_hold_the_bodies() -> None:
    # Every displacement that the ties name is zero without contact: only rounding of it is left to compare with.
    for example in SUPPORTED:
        require_answer(example, solve_lemke(example.problem, Settings()), 1e-12)


def test_ties_that_repeat_and_ties_that_contradict() -> None:
    require_answer(REPEATED_TIES, solve_lemke(REPEATED_TIES.problem, Settings()), 1e-12)
    with pytest.raises(NotConverged, match="tie 1 contradicts"):
        solve_lemke(REPEATED_TIES.problem.replace(tie_value=[0.5, -1.1]), Settings())


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


@pytest.mark.parametrize(("elements", "ratio"), [(16, 2.0), (24, 1.5), (24, 2.0), (48, 1.2)])
def test_a_floating_beam_of_elements_that_grow_shorter_rests_on_its_ends(elements: int, ratio: float) -> None:
    """Condensed to three unknowns its stiffness is so soft that rounding hid one of its two rigid motions."""
    n, lengths = elements, ratio ** -np.arange(elements)
    K = np.zeros((2 * n + 2, 2 * n + 2))
    for i, h in enumerate(lengths):
        bent = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
        bent += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
        K[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += np.array(bent) / h**3
    load, rows = np.zeros(2 * n + 2), np.zeros((3, 2 * n + 2))
    load[:-1:2], rows[[0, 1, 2], [0, n, 2 * n]] = -1.0, -1.0
    beam = cq.ContactProblem(stiffness=K, load=load, normal=rows, gap=[0.0, 1e3, 0.0])
    solution = cq.solve(beam, "lemke")
    right = np.sum(np.append(0, np.cumsum(lengths))) / np.sum(lengths)
    np.testing.assert_allclose(solution.normal_force, [n + 1 - right, 0.0, right], rtol=1e-9, atol=0)
