"""The five classical enforcements against the course chapter's exact numbers, and the active-set loop around them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import example, given, settings
from hypothesis import strategies as st

import contactqp as cq
from contactqp.errors import InvalidProblem, NotConverged
from contactqp.methods import augmented_lagrangian, lagrange_multiplier, master_slave, penalty, perturbed_lagrangian
from contactqp.methods.augmented_lagrangian import solve_augmented_lagrangian
from contactqp.methods.lagrange_multiplier import solve_lagrange_multiplier
from contactqp.methods.master_slave import choose_slaves, solve_master_slave, transformation
from contactqp.methods.method import Settings
from contactqp.methods.penalty import solve_penalty
from contactqp.methods.perturbed_lagrangian import solve_perturbed_lagrangian
from contactqp.methods.textbook_algebra import independent_rows, solve_linear
from contactqp.problem import ContactProblem
from contactqp.solution import Candidate
from tests.methods.static_examples import (
    DEPENDENT,
    EXAMPLES,
    REPEATED_TIES,
    SUPPORTED,
    TRUSS,
    TRUSS_FORCE,
    TWO_BARS,
    Example,
    bar,
    ratio,
    require_answer,
    require_near,
)

MODULES = (master_slave, lagrange_multiplier, penalty, perturbed_lagrangian, augmented_lagrangian)
CLASSICAL = tuple(method for module in MODULES for method in module.METHODS)
EXACT = {
    "master-slave": (solve_master_slave, {}),
    "lagrange-multiplier": (solve_lagrange_multiplier, {}),
    "augmented, default": (solve_augmented_lagrangian, {}),
    "augmented, 0": (solve_augmented_lagrangian, {"penalty": 0.0}),
    "augmented, 10": (solve_augmented_lagrangian, {"penalty": 10.0}),
}
PENALISED = {
    "penalty": (solve_penalty, "penalty"),
    "perturbed-lagrangian": (solve_perturbed_lagrangian, "perturbation"),
}
UP_TO_1E8 = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8)
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


def answer(name: str, problem: ContactProblem, **changes: object) -> Candidate:
    solve, options = EXACT[name]
    return solve(problem, Settings(options=options, **changes))


def penalised(name: str, problem: ContactProblem, stiffness: object) -> Candidate:
    solve, option = PENALISED[name]
    return solve(problem, Settings(options={option: stiffness}))


def sparse(problem: ContactProblem) -> ContactProblem:
    return problem.replace(stiffness=sp.csc_array(problem.stiffness))


def test_the_registry_entries_promise_what_the_methods_do() -> None:
    entries = {method.name: method for method in CLASSICAL}
    assert {name for name, method in entries.items() if method.exact} == {
        "master-slave",
        "lagrange-multiplier",
        "augmented-lagrangian",
    }
    assert entries["penalty"].required == ("penalty",)
    assert entries["perturbed-lagrangian"].required == ("perturbation",)
    assert not any(method.scale or method.polish for method in CLASSICAL), "textbook matrices in the user's own numbers"


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
@pytest.mark.parametrize("name", EXACT)
def test_exact_methods_return_the_exact_numbers(name: str, example: Example) -> None:
    for problem in (example.problem, sparse(example.problem)):
        candidate = answer(name, problem)
        assert candidate.claimed, candidate.status
        require_answer(example, candidate, 1e-12)


@pytest.mark.parametrize(
    "wrong",
    [
        {"normal_force": [-95.0]},
        {"normal_force": [95.0 * (1 + 1e-9)]},
        {"normal_force": [np.nan]},
        {"displacement": [ratio(41, 31500), -ratio(19, 63000)]},
        {"tie_force": [0.0]},
    ],
)
def test_the_comparison_with_the_exact_numbers_can_fail(wrong: dict[str, list[float]]) -> None:
    example = next(example for example in EXAMPLES if example.name == "2.13")
    right = answer("lagrange-multiplier", example.problem)
    candidate = dataclasses.replace(right, **{name: np.array(value) for name, value in wrong.items()})
    with pytest.raises(AssertionError):
        require_answer(example, candidate, 1e-12)


# Closed forms of the penalised problem at P = 300 kN: the force is the exact one times beta / (beta + S), with S the
# stiffness that the contact feels; the displacements follow from equilibrium.
@pytest.mark.parametrize("beta", UP_TO_1E8)
@pytest.mark.parametrize("name", PENALISED)
def test_one_bar_penalised(name: str, beta: float) -> None:
    candidate = penalised(name, bar(300.0), beta)
    force = beta * 142.5 / (beta + 157500)
    require_near("force", candidate.normal_force, [force], 1e-10)
    require_near("displacement", candidate.displacement, [(300 - force) / 157500], 1e-10)


@pytest.mark.parametrize("beta", UP_TO_1E8)
@pytest.mark.parametrize("name", PENALISED)
def test_truss_penalised(name: str, beta: float) -> None:
    candidate = penalised(name, TRUSS, beta)
    felt = 77443 - 6883.1**2 / 59803
    force = beta * TRUSS_FORCE / (beta + felt)
    d1z = -1e-3 - force / beta
    require_near("force", candidate.normal_force, [force], 1e-10)
    require_near("displacement", candidate.displacement, [(60 - 6883.1 * d1z) / 59803, d1z], 1e-10)


@pytest.mark.parametrize(
    ("beta", "force"),
    [
        (1e3, ratio(95, 106)),
        (1e5, ratio(1900, 41)),
        (1e6, ratio(19000, 221)),
        (1e8, ratio(1900000, 20021)),
    ],
)
@pytest.mark.parametrize("name", PENALISED)
def test_two_bars_penalised(name: str, beta: float, force: float) -> None:
    candidate = penalised(name, TWO_BARS, beta)
    require_near("force", candidate.normal_force, [force], 1e-10)
    require_near("displacement", candidate.displacement, [(300 - force) / 157500, force / 315000], 1e-10)


@pytest.mark.parametrize("name", PENALISED)
def test_ties_stay_exact_beside_springs(name: str) -> None:
    tied = next(example for example in EXAMPLES if example.name == "tied and touching").problem
    candidate = penalised(name, tied, 8.0)
    # 2 u + 8 (u - 1/5) = 1 for the common displacement u; the tie carries u of the second unknown.
    require_near("displacement", candidate.displacement, [0.26, 0.26], 1e-12)
    require_near("force", candidate.normal_force, [0.48], 1e-12)
    require_near("tie force", candidate.tie_force, [0.26], 1e-12)


# Table 2.1: beta [kN/m], d1x [mm], d1z [mm], R_z [kN], five digits as printed.
TABLE_2_1 = [
    (1e3, "1.1632", "-1.3896", "0.38963"),
    (1e4, "1.1586", "-1.3492", "3.4916"),
    (1e5, "1.1381", "-1.1713", "17.127"),
    (1e6, "1.1216", "-1.0281", "28.101"),
    (1e7, "1.1187", "-1.0030", "30.025"),
    (1e8, "1.1184", "-1.0003", "30.232"),
    (1e20, "1.1184", "-1.0000", "21.684"),
]


@pytest.mark.parametrize(("beta", "d1x", "d1z", "force"), TABLE_2_1)
def test_table_2_1_row_by_row(beta: float, d1x: str, d1z: str, force: str) -> None:
    candidate = penalised("penalty", TRUSS, beta)
    assert candidate.claimed, candidate.status
    printed = [f"{1e3 * candidate.displacement[0]:.5g}", f"{1e3 * candidate.displacement[1]:.5g}"]
    assert [float(value) for value in printed] == [float(d1x), float(d1z)]
    assert float(f"{candidate.normal_force[0]:.5g}") == float(force)


def test_last_row_of_table_2_1_is_one_last_place_of_the_gap_times_beta() -> None:
    candidate = penalised("penalty", TRUSS, 1e20)
    assert candidate.normal_force[0] == 1e20 * np.spacing(1e-3) == 1e20 * 2.0**-62


def test_perturbed_lagrangian_keeps_the_force_that_penalty_loses() -> None:
    candidate = penalised("perturbed-lagrangian", TRUSS, 1e20)
    assert f"{candidate.normal_force[0]:.4f}" == "30.2550"
    require_near("force", candidate.normal_force, [TRUSS_FORCE], 1e-12)


@pytest.mark.parametrize("stiffness", UP_TO_1E8)
@pytest.mark.parametrize("problem", [bar(300.0), TRUSS, TWO_BARS], ids=["2.5", "2.10", "2.13"])
def test_perturbed_lagrangian_is_penalty(problem: ContactProblem, stiffness: float) -> None:
    spring = penalised("penalty", problem, stiffness)
    multiplier = penalised("perturbed-lagrangian", problem, stiffness)
    # beta times a gap of last place ulp(1e-3) is 2e-11 kN at 1e8: the only difference.
    rounding = 10 * np.finfo(float).eps * (1 + stiffness * 1e-3 / spring.normal_force[0])
    require_near("force", multiplier.normal_force, spring.normal_force, rounding)
    require_near("displacement", multiplier.displacement, spring.displacement, 1e-14)


def test_the_sign_printed_in_eq_2_29_is_a_negative_spring() -> None:
    printed = np.array([[157500.0, 1.0], [1.0, 1 / 157500.0]])
    with pytest.raises(NotConverged):
        solve_linear("printed", printed, np.array([300.0, 1e-3]))
    require_near("force", penalised("perturbed-lagrangian", bar(300.0), 157500.0).normal_force, [71.25], 1e-14)


@pytest.mark.parametrize("beta", [0.0, *UP_TO_1E8])
@pytest.mark.parametrize("example", [e for e in EXAMPLES if e.name[:2] == "2."], ids=lambda example: example.name)
def test_simultaneous_augmented_lagrangian_is_exact_for_every_beta(example: Example, beta: float) -> None:
    candidate = solve_augmented_lagrangian(example.problem, Settings(options={"penalty": beta}))
    require_answer(example, candidate, 1e-12)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_uzawa_arrives(example: Example) -> None:
    candidate = solve_augmented_lagrangian(example.problem, Settings(tolerance=1e-11, options={"update": "uzawa"}))
    assert candidate.claimed, candidate.status
    assert candidate.history[-1] <= 1e-11
    require_answer(example, candidate, 1e-9)


def test_uzawa_converges_at_the_rate_of_theory() -> None:
    # S = (1/157500 + 1/315000)^-1 = 105000 kN/m; beta = 105000 halves the error at every iteration.
    candidate = solve_augmented_lagrangian(TWO_BARS, Settings(options={"update": "uzawa", "penalty": 105000.0}))
    rates = np.array(candidate.history[2:]) / np.array(candidate.history[1:-1])
    assert len(rates) > 20
    np.testing.assert_allclose(rates[:10], 0.5, rtol=0.15)
    np.testing.assert_allclose(rates[10:20], 0.5, rtol=1e-3)


def test_uzawa_ends_where_gaps_are_zero() -> None:
    """Two weights joined by a spring rest on the floor: what is left of their penetration is all that they move."""
    K = [[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]
    resting = ContactProblem(K, [0.5, -3.0, -1.0], [[0.0, -1, 0], [0.0, 0, -1]], [0.0, 0.0])
    candidate = solve_augmented_lagrangian(resting, Settings(options={"update": "uzawa"}))
    assert candidate.claimed, candidate.status
    require_near("forces", candidate.normal_force, [2.75, 1.0], 1e-9)
    require_near("displacement", candidate.displacement, [0.25, 0.0, 0.0], 1e-12)


def test_uzawa_stopped_early_claims_nothing() -> None:
    candidate = solve_augmented_lagrangian(TWO_BARS, Settings(max_iter=3, options={"update": "uzawa"}))
    assert not candidate.claimed
    assert len(candidate.history) == 3
    assert "stopped after 3" in candidate.status


BAD_STIFFNESS = [0.0, -1.0, np.nan, np.inf, "stiff", [1.0, 2.0], None]


@pytest.mark.parametrize("value", BAD_STIFFNESS)
@pytest.mark.parametrize("name", PENALISED)
def test_a_penalty_that_is_none_is_refused(name: str, value: object) -> None:
    with pytest.raises(InvalidProblem, match="expected a positive finite number"):
        penalised(name, TRUSS, value)


@pytest.mark.parametrize("options", [{"penalty": -1.0}, {"penalty": 0.0, "update": "uzawa"}, {"update": "newton"}])
def test_augmented_lagrangian_refuses_wrong_options(options: dict[str, object]) -> None:
    with pytest.raises(InvalidProblem, match="expected"):
        solve_augmented_lagrangian(TRUSS, Settings(options=options))


@pytest.mark.parametrize("name", PENALISED)
def test_one_spring_stiffness_per_contact(name: str) -> None:
    two = ContactProblem(stiffness=[[1.0]], load=[10.0], normal=[[1.0], [1.0]], gap=[0.0, 0.0])
    candidate = penalised(name, two, [2.0, 7.0])
    require_near("displacement", candidate.displacement, [1.0], 1e-14)
    require_near("forces", candidate.normal_force, [2.0, 7.0], 1e-14)


def test_springs_that_drown_the_stiffness_are_refused_in_words() -> None:
    # K + 1e22 [[1, -1], [-1, 1]] is singular in floating point: nothing of K is left beside last places of 2e6.
    with pytest.raises(NotConverged, match="stiffness is lost"):
        penalised("penalty", TWO_BARS, 1e22)


@pytest.mark.parametrize("problem_of", [lambda p: p, sparse], ids=["dense", "sparse"])
@pytest.mark.parametrize("name", [*EXACT, *PENALISED])
def test_bodies_that_nothing_holds_are_no_garbage(name: str, problem_of: object) -> None:
    loose = ContactProblem(stiffness=[[1, -1], [-1, 1]], load=[-1.0, 0.0], normal=[[1.0, 0.0]], gap=[0.0])
    problem = problem_of(loose)
    with pytest.raises(NotConverged, match="nothing stops the body that the load drives off contact 0"):
        answer(name, problem) if name in EXACT else penalised(name, problem, 1.0)


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


@pytest.mark.parametrize("name", EXACT)
def test_a_cycle_is_left_one_contact_at_a_time(name: str) -> None:
    candidate = answer(name, CYCLING)
    assert candidate.claimed
    assert "one contact at a time after" in candidate.status
    require_near("displacement", candidate.displacement, [0.0, 0.0], 1e-14, largest=1.0)
    require_near("load", CYCLING.normal.T @ candidate.normal_force, CYCLING.load, 1e-14)
    assert np.all(candidate.normal_force >= 0)


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
    assert independent_rows(rows).tolist() == [0, 1, 4]


def test_master_slave_carries_the_load_term_that_eq_2_20_lacks() -> None:
    """u = {0, 1}, m = {2}, s = {3}, 2 d_m - 3 d_s = 5/7; the printed right-hand side gives 3058/7147 and so on."""
    problem = ContactProblem(
        stiffness=[[7, -2, 1, -1], [-2, 9, -3, 2], [1, -3, 8, -2], [-1, 2, -2, 6]],
        load=[3, -1, 4, 2],
        normal=np.zeros((0, 4)),
        gap=[],
        tie=[[0, 0, 2, -3]],
        tie_value=[5 / 7],
    )
    right = [ratio(11657, 28588), ratio(4869, 28588), ratio(21289, 28588), ratio(3693, 14294)]
    printed = [ratio(3058, 7147), ratio(856, 7147), ratio(5241, 7147)]
    displacement = answer("master-slave", problem).displacement
    require_near("displacement", displacement, right, 1e-13)
    assert np.max(np.abs(displacement[:3] - printed)) > 1e-2


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


@pytest.mark.parametrize("name", [*EXACT, *PENALISED])
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), length=st.floats(-6, 6), force=st.floats(-6, 6))
def test_change_of_units(name: str, seed: int, length: float, force: float) -> None:
    problem, L, F = random_problem(seed), 10.0**length, 10.0**force
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
