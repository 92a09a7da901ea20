"""The five classical enforcements against the course chapter's exact numbers, and what each of them promises."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.errors import InvalidProblem, NotConverged
from contactqp.model.problem import ContactProblem
from contactqp.solving.methods import (
    augmented_lagrangian,
    lagrange_multiplier,
    master_slave,
    penalty,
)
from contactqp.solving.methods.augmented_lagrangian import solve_augmented_lagrangian
from contactqp.solving.methods.method import Settings
from contactqp.solving.methods.textbook_algebra import solve_linear
from tests.solving.methods.enforcements import EXACT, PENALISED, UP_TO_1E8, answer, penalised, sparse
from tests.solving.methods.static_examples import (
    EXAMPLES,
    TRUSS,
    TRUSS_FORCE,
    TWO_BARS,
    Example,
    bar,
    ratio,
    require_answer,
    require_near,
)

MODULES = (master_slave, lagrange_multiplier, penalty, augmented_lagrangian)
CLASSICAL = tuple(method for module in MODULES for method in module.METHODS)


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


@pytest.mark.sampled(19)
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
    changed = dataclasses.replace(right.answer, **{name: np.array(value) for name, value in wrong.items()})
    candidate = dataclasses.replace(right, answer=changed)
    with pytest.raises(AssertionError):
        require_answer(example, candidate, 1e-12)


# Closed forms of the penalised problem at P = 300 kN: the force is the exact one times beta / (beta + S), with S the
# stiffness that the contact feels; the displacements follow from equilibrium.
@pytest.mark.sampled(3)
@pytest.mark.parametrize("beta", UP_TO_1E8)
@pytest.mark.parametrize("name", PENALISED)
def test_one_bar_penalised(name: str, beta: float) -> None:
    candidate = penalised(name, bar(300.0), beta)
    force = beta * 142.5 / (beta + 157500)
    require_near("force", candidate.normal_force, [force], 1e-10)
    require_near("displacement", candidate.displacement, [(300 - force) / 157500], 1e-10)


@pytest.mark.sampled(3)
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


@pytest.mark.sampled(5)
@pytest.mark.parametrize("stiffness", UP_TO_1E8)
@pytest.mark.parametrize("problem", [bar(300.0), TRUSS, TWO_BARS], ids=["2.5", "2.10", "2.13"])
def test_perturbed_lagrangian_is_penalty(problem: ContactProblem, stiffness: float) -> None:
    spring = penalised("penalty", problem, stiffness)
    multiplier = penalised("perturbed-lagrangian", problem, stiffness)
    # beta times a gap of last place ulp(1e-3) is 2e-11 kN at 1e8: the only difference.
    rounding = 10 * np.finfo(float).eps * (1 + stiffness * 1e-3 / spring.normal_force[0])
    require_near("force", multiplier.normal_force, spring.normal_force, rounding)
    # The force moves the bodies by no larger a part.
    require_near("displacement", multiplier.displacement, spring.displacement, rounding)


def test_the_sign_printed_in_eq_2_29_is_a_negative_spring() -> None:
    printed = np.array([[157500.0, 1.0], [1.0, 1 / 157500.0]])
    with pytest.raises(NotConverged):
        solve_linear("printed", printed, np.array([300.0, 1e-3]))
    require_near("force", penalised("perturbed-lagrangian", bar(300.0), 157500.0).normal_force, [71.25], 1e-14)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("beta", [0.0, *UP_TO_1E8])
@pytest.mark.parametrize("example", [e for e in EXAMPLES if e.name[:2] == "2."], ids=lambda example: example.name)
def test_simultaneous_augmented_lagrangian_is_exact_for_every_beta(example: Example, beta: float) -> None:
    candidate = solve_augmented_lagrangian(example.problem, Settings(options={"penalty": beta}))
    require_answer(example, candidate, 1e-12)


@pytest.mark.sampled(4)
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


TEXTBOOK: list[tuple[str, dict[str, Any]]] = [
    ("lagrange-multiplier", {}),
    ("master-slave", {}),
    ("augmented-lagrangian", {}),
    ("augmented-lagrangian", {"update": "uzawa"}),
]


@pytest.mark.sampled(7)
@pytest.mark.parametrize("unit", [2.0**-66, 1.0, 2.0**66])
@pytest.mark.parametrize("load", [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
@pytest.mark.parametrize(("method", "options"), TEXTBOOK)
def test_the_unit_of_force_decides_no_textbook_system(
    method: str, options: dict[str, Any], load: list[float], unit: float
) -> None:
    """u_1 + 2 u_2 = 0 and u_2 <= 0, so that u = (0, 0, f_3); beside soft bodies the rows of the tie are large."""
    data = dict(normal=[[0.0, 2.0, 0.0]], gap=[0.0], tie=[[1.0, 2.0, 0.0]], tie_value=[0.0])
    problem = cq.ContactProblem(unit * np.eye(3), unit * np.array(load), **data)
    exact = cq.exact(problem).doubles
    solution = cq.solve(problem, method=method, **options)
    assert solution.certificate.passed
    np.testing.assert_allclose(solution.displacement, [0.0, 0.0, load[2]], atol=1e-12)
    np.testing.assert_allclose(solution.normal_force, exact.normal_force, rtol=1e-9, atol=1e-12 * unit)
