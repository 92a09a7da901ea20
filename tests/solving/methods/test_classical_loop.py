"""The active-set loop around the classical enforcements, and its linear algebra: ties, cycles, loose bodies, units."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

import contactqp as cq
from contactqp.errors import NotConverged
from contactqp.linalg.condensation import condense
from contactqp.linalg.existence import conflict
from contactqp.model.problem import ContactProblem
from contactqp.solving.methods.augmented_lagrangian import solve_augmented_lagrangian
from contactqp.solving.methods.master_slave import choose_slaves, transformation
from contactqp.solving.methods.method import Settings
from contactqp.solving.methods.textbook_algebra import rows_independent_of_earlier, solve_linear
from tests.solving.methods.enforcements import EXACT, PENALISED, answer, penalised, sparse
from tests.solving.methods.static_examples import (
    DEPENDENT,
    REPEATED_TIES,
    SUPPORTED,
    TWO_BARS,
    Example,
    ratio,
    require_answer,
    require_near,
)

# The active-set loop as the textbook has it goes round and round among these four planes (the answer is u = 0).
CYCLING = ContactProblem(
    stiffness=np.eye(2),
    load=[4.0, 1.0],
    normal=[[1.0, -2.0], [1.0, -1.0], [-2.0, 0.0], [2.0, 1.0]],
    gap=[0.0, 1.0, 1.0, 0.0],
)
# Contacts where gap and force both vanish: rounding must not drive them in and out.
GRAZING = (
    ContactProblem([[6.0, 0, 4], [0, 7, 1], [4, 1, 10]], [-3.0, 0.0, 2.0], np.eye(3), [-2.0, 0.0, 0.0]),
    ContactProblem([[15.0, -8, 1], [-8, 9, -6], [1, -6, 10]], [0.0, 6.0, 9.0], np.eye(3), np.zeros(3)),
    ContactProblem([[15.0, 1, 0], [1, 15, 4], [0, 4, 20]], [0.0, 8.0, -9.0], np.eye(3), np.zeros(3)),
)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("problem_of", [lambda p: p, sparse], ids=["dense", "sparse"])
@pytest.mark.parametrize("name", [*EXACT, *PENALISED])
def test_bodies_that_nothing_holds_are_no_garbage(name: str, problem_of: object) -> None:
    loose = ContactProblem(stiffness=[[1, -1], [-1, 1]], load=[-1.0, 0.0], normal=[[1.0, 0.0]], gap=[0.0])
    problem = problem_of(loose)
    with pytest.raises(NotConverged, match="nothing stops the body that the load drives off contact 0"):
        answer(name, problem) if name in EXACT else penalised(name, problem, 1.0)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", EXACT)
def test_floating_chain_of_two_bodies(name: str) -> None:
    # Two bodies joined by a spring of 1, the right one pushed against a wall: nothing else holds them.
    chain = ContactProblem(stiffness=[[1, -1], [-1, 1]], load=[1.0, 1.0], normal=[[0.0, 1.0]], gap=[0.5])
    require_answer(Example("chain", chain, (1.5, 0.5), (0.0, 2.0)), answer(name, chain), 1e-12)


@pytest.mark.parametrize("name", EXACT)
def test_ties_that_repeat_and_ties_that_contradict(name: str) -> None:
    require_answer(REPEATED_TIES, answer(name, REPEATED_TIES.problem), 1e-13)
    with pytest.raises(NotConverged, match="tie 1 contradicts"):
        answer(name, REPEATED_TIES.problem.replace(tie_value=[0.5, -1.1]))


@pytest.mark.parametrize("name", EXACT)
def test_ties_that_follow_from_others_with_weights_of_zero_do_not_contradict_them(name: str) -> None:
    """Rows 3 and 4 follow from 0 to 2. Row 3 has no part of row 0, the only one with a value: its weight is rounding.

    K = I makes u the shortest solution of A u = b.
    """
    rows = [[1, 1, 0, -1], [1, 0, -1, -1], [0, -2, -1, 1], [-1, -2, 0, 2], [2, 5, 1, -4]]
    tied = ContactProblem(np.eye(4), np.zeros(4), np.eye(4)[[0]], [9.0], tie=rows, tie_value=[3 / 32, 0, 0, 0, 3 / 32])
    found = answer(name, tied)
    np.testing.assert_allclose(found.displacement, np.linalg.pinv(tied.tie.toarray()) @ tied.tie_value, atol=1e-14)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("example", SUPPORTED, ids=lambda example: example.name)
# A beta of 10 beside a stiffness of 1e-7 takes eight digits of it.
@pytest.mark.parametrize("name", [name for name in EXACT if name != "augmented, 10"])
def test_supports_as_ties_hold_the_bodies(name: str, example: Example) -> None:
    require_answer(example, answer(name, example.problem), 1e-12)


@pytest.mark.parametrize("name", EXACT)
def test_multipliers_beside_a_large_stiffness_meet_their_ties(name: str) -> None:
    # Without refinement the tie of 1 beside springs of 1e9 is met to their rounding only.
    random = np.random.default_rng(3)
    springs = 10.0 ** random.uniform(0, 9, 8)
    K = np.diag(springs) + np.diag(np.append(springs[1:], 0.0)) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    tied = ContactProblem(K, random.standard_normal(8), np.eye(8)[[7]], [9.0], tie=[np.eye(8)[2] - 0.3 * np.eye(8)[6]])
    candidate = answer(name, tied)
    assert abs(tied.tie @ candidate.displacement) <= 1e-14 * (abs(tied.tie) @ abs(candidate.displacement))


@pytest.mark.parametrize("name", EXACT)
def test_contact_in_tension_goes_out(name: str) -> None:
    # The free solution penetrates both contacts; closing both pulls at the first.
    lever = ContactProblem(stiffness=[[6.0, -2.0], [-2.0, 2.0]], load=[3.0, 2.0], normal=np.eye(2), gap=[1.0, 1.0])
    candidate = answer(name, lever)
    assert candidate.history == (2.0, 1.0, 0.0)
    require_answer(Example("lever", lever, (ratio(5, 6), 1.0), (0.0, ratio(5, 3))), candidate, 1e-12)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", EXACT)
def test_a_cycle_is_left_one_contact_at_a_time(name: str) -> None:
    candidate = answer(name, CYCLING)
    assert candidate.claimed
    assert "one contact at a time after" in candidate.status
    require_near("displacement", candidate.displacement, [0.0, 0.0], 1e-14, largest=1.0)
    require_near("load", CYCLING.normal.T @ candidate.normal_force, CYCLING.load, 1e-14)
    assert np.all(candidate.normal_force >= 0)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("problem", GRAZING)
@pytest.mark.parametrize("name", EXACT)
def test_grazing_contacts_are_no_cycle(name: str, problem: ContactProblem) -> None:
    for unit in (1.0, 1e-7, 1e5):
        assert answer(name, problem.replace(load=unit * problem.load, gap=unit * problem.gap)).claimed


def test_the_loop_stops_where_it_is_told() -> None:
    stopped = answer("lagrange-multiplier", TWO_BARS, max_iter=1)
    assert not stopped.claimed
    assert "stopped after 1 iterations" in stopped.status
    assert not answer("lagrange-multiplier", TWO_BARS, time_limit=0.0).claimed


def test_a_warm_start_saves_the_free_solution() -> None:
    cold = answer("lagrange-multiplier", TWO_BARS)
    warm = answer("lagrange-multiplier", TWO_BARS, warm_start=cold)
    assert (cold.iterations, warm.iterations) == (2, 1)
    assert warm.normal_force == pytest.approx(95.0, rel=1e-14)


def test_dependent_rows_bind_where_they_are_violated() -> None:
    candidate = answer("master-slave", DEPENDENT)
    require_near("forces", candidate.normal_force, [0.0, 110.625], 1e-13)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("form", [np.asarray, sp.csc_array], ids=["dense", "sparse"])
def test_unsymmetric_systems_are_singular_or_not_whatever_their_units(form: object) -> None:
    """Rows and columns scaled apart by 1e-9 to 1e9: one is regular, its twin has a row that is twice another."""
    random = np.random.default_rng(8)
    for _ in range(20):
        matrix = random.standard_normal((6, 6))
        rows, columns = 10.0 ** random.uniform(-9, 9, (2, 6))
        scaled, x = rows[:, None] * matrix * columns, random.standard_normal(6) / columns
        require_near("x", solve_linear("free", form(scaled), scaled @ x) * columns, x * columns, 1e-9)
        matrix[3] = 2 * matrix[1]
        with pytest.raises(NotConverged, match="singular"):
            solve_linear("free", form(rows[:, None] * matrix * columns), rows)


def test_independent_rows_keep_the_first_of_dependent_ones() -> None:
    rows = sp.csr_array([[1.0, 0, 0], [0, 1, 0], [1, 1, 0], [2, 0, 0], [1, 1, 1e-9], [0, 0, 5.0]])
    assert rows_independent_of_earlier(rows).tolist() == [0, 1, 4]


def test_slaves_and_their_transformation_satisfy_the_constraints() -> None:
    rows = sp.csr_array([[1.0, -1.0, 0, 0], [0, 1e-9, 2.0, 1.0]])
    slaves = choose_slaves(rows)
    assert 2 in slaves, "the largest coefficient is the pivot, not one of 1e-9"
    B, offset = transformation(rows, np.array([3.0, 4.0]), slaves)
    np.testing.assert_allclose((rows @ B).toarray(), 0, atol=1e-15)
    np.testing.assert_allclose(rows @ offset, [3.0, 4.0], rtol=1e-14)


def random_problem(seed: int) -> ContactProblem:
    random = np.random.default_rng(seed)
    n, m = int(random.integers(1, 9)), int(random.integers(0, 6))
    k = int(random.integers(0, 3)) if n > 3 else 0
    B = random.standard_normal((n, n))
    return ContactProblem(
        stiffness=B @ B.T + np.eye(n),
        load=3 * random.standard_normal(n),
        normal=random.standard_normal((m, n)),
        gap=random.uniform(0, 1, m),
        tie=random.standard_normal((k, n)),
        tie_value=0.1 * random.standard_normal(k),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
@example(seed=134387)  # its ties and contacts conflict
def test_the_answer_satisfies_signorini(name: str, seed: int) -> None:
    problem = random_problem(seed)
    try:
        candidate = answer(name, problem)
    except NotConverged:  # right if nothing satisfies the constraints, which is proven otherwise
        with pytest.raises(cq.NoEquilibrium):
            cq.solve(problem)
        return
    assert candidate.claimed, candidate.status
    u, force, nu = candidate.displacement, candidate.normal_force, candidate.tie_force
    gap = problem.gap - problem.normal @ u
    residual = problem.stiffness @ u + problem.normal.T @ force + problem.tie.T @ nu - problem.load
    size = 1 + np.max(np.abs(u)) + np.max(np.abs(force), initial=0) + np.max(np.abs(nu), initial=0)
    assert np.max(np.abs(residual)) <= 1e-10 * size
    assert np.max(np.abs(np.minimum(gap, force)), initial=0) <= 1e-10 * size
    assert np.max(np.abs(problem.tie @ u - problem.tie_value), initial=0) <= 1e-10 * size


@pytest.mark.slow
@pytest.mark.parametrize("name", [*EXACT, *PENALISED])
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), length=st.floats(-6, 6), force=st.floats(-6, 6))
@example(seed=33133, length=0.0, force=0.0)  # two ties leave no room for three contacts
def test_change_of_units(name: str, seed: int, length: float, force: float) -> None:
    problem, L, F = random_problem(seed), 10.0**length, 10.0**force
    assume(conflict(problem, condense(problem)) is None)
    other = problem.replace(
        stiffness=problem.stiffness * (F / L),
        load=problem.load * F,
        gap=problem.gap * L,
        tie_value=problem.tie_value * L,
    )
    if name in PENALISED:
        here, there = penalised(name, problem, 50.0), penalised(name, other, 50.0 * F / L)
    elif name == "augmented, 10":
        here = answer(name, problem)
        there = solve_augmented_lagrangian(other, Settings(options={"penalty": 10.0 * F / L}))
    else:
        here, there = answer(name, problem), answer(name, other)
    assert here.claimed == there.claimed
    require_near("displacement", there.displacement / L, here.displacement, 1e-9)
    require_near("forces", there.normal_force / F, here.normal_force, 1e-9, 1 + np.max(np.abs(problem.load)))
