"""The truths of the stability study, what its axes state, and the errors that condition numbers predict."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.uniqueness import FORCES, POSSIBLE, SEVERAL, UNKNOWN
from contactqp.model.solution import Solution
from contactqp.solving.methods import find
from contactqp.study.stability import problem_axes
from contactqp.study.stability.axis_problem import (
    NO_EQUILIBRIUM,
    ExactAnswer,
    SweptTruth,
    answer_with_closed,
    predict,
    refuse_wrong,
)
from contactqp.study.stability.problem_axes import UNITS
from contactqp.study.stability.stability_cells import AXES, certificate_statement, find_axis, stability_row
from contactqp.study.stability.stability_charts import best_penalty_of_truss
from contactqp.study.stability.stability_report import safe_ranges


@pytest.mark.sampled(8)
@pytest.mark.parametrize("axis", AXES, ids=lambda axis: axis.name)
def test_every_value_has_a_problem_and_the_same_one_every_time(axis) -> None:
    values = axis.values if not axis.name.endswith("contacts") else axis.values[:3]
    assert list(axis.values) == sorted(set(axis.values))
    for value in values:
        posed = axis.pose(value)
        for answer in posed.exact:
            refuse_wrong(posed.problem, answer)
    again, first = axis.pose(values[1]), axis.pose(values[1])
    assert np.array_equal(again.problem.load, first.problem.load)
    assert np.array_equal(again.truth.displacement, first.truth.displacement)


def test_the_truss_has_its_closed_form_and_the_chapters_number() -> None:
    [answer] = problem_axes.pose_penalty_stiffness(1.0).exact
    assert answer == problem_axes.closed_form()
    # Of the printed decimals, 30.2549928366469910 kN; of their doubles the same to rounding.
    printed = Fraction(180933933661, 5980300000)
    assert abs(answer.normal_force[0] / printed - 1) < Fraction(1, 10**15)


@pytest.mark.parametrize("contrast", [1.0, 2.0**20, 2.0**53 - 1])
def test_two_stops_in_a_chain_of_soft_and_stiff_springs(contrast: float) -> None:
    c = Fraction(contrast)
    [answer] = find_axis("stiffness-contrast").pose(contrast).exact
    u0 = c / (1 + c)  # springs 1 and c between the ground and the stop at 1
    u2 = (1 + 2 * c) / (1 + c)
    assert answer.displacement == (u0, 1, u2, 2)
    assert answer.normal_force == (4 - c * (1 - u0) + (u2 - 1), 8 - c * (2 - u2))


def test_a_stack_of_masses_carries_what_is_above() -> None:
    [answer] = find_axis("mass-ratio").pose(1024.0).exact
    assert answer.displacement == (Fraction(-1, 4),) * 8
    assert answer.normal_force == tuple(Fraction(3, 4) * (7 - i + 1024) for i in range(8))


def test_bodies_that_travel_far_meet_with_one_half() -> None:
    for gap in (2.0**-52, 2.0**-20, 1.0, 2.0**20):
        [answer] = find_axis("gap-ratio").pose(gap).exact
        assert answer.displacement == (Fraction(1, 2), 1 + Fraction(gap), 1, Fraction(1, 2))
        assert answer.normal_force == (Fraction(1, 2),)
    [rounded] = find_axis("gap-ratio").pose(2.0**-60).exact  # of the rounded load, as it stands
    assert rounded.normal_force != (Fraction(1, 2),)


def test_two_contacts_of_a_small_angle() -> None:
    for angle in (2.0**-50, 1.0):
        [answer] = find_axis("redundancy").pose(angle).exact
        assert answer == ExactAnswer((Fraction(0), Fraction(-1)), (Fraction(3), Fraction(5)))


def test_a_grazing_contact_carries_what_the_load_exceeds() -> None:
    for distance in (0.5, 2.0**-20):
        [answer] = find_axis("grazing").pose(distance).exact
        excess = Fraction(float(Fraction(35, 16)) * (1 + distance)) - Fraction(35, 16)
        assert answer.normal_force[1] == excess
    assert find_axis("grazing").pose(0.0).exact[0].normal_force[1] == 0
    assert find_axis("grazing").pose(-0.5).closed == (0,)


def test_a_support_that_softens_takes_what_the_wall_does_not() -> None:
    [answer] = find_axis("singular-stiffness").pose(2.0**-10).exact
    assert answer.normal_force[0] == 3 - Fraction(1, 1024) * answer.displacement[0]
    [floating] = find_axis("singular-stiffness").pose(2.0**-60).exact
    assert floating.normal_force == (3,)


def test_past_the_critical_coefficient_there_are_three_answers() -> None:
    assert len(problem_axes.pose_friction(0.75).exact) == 1
    posed = problem_axes.pose_friction(1.5)
    assert len(posed.exact) == 3
    listed = cq.exact_equilibria(posed.problem)
    assert {tuple(e.displacement) for e in listed} == {answer.displacement for answer in posed.exact}
    assert len(posed.truth.others) == 2
    for answer in posed.truth.others:  # each of them is right
        assert posed.truth.errors(answer.displacement, answer.normal_force, None).small
    between = (posed.truth.displacement + posed.truth.others[0].displacement) / 2
    assert not posed.truth.errors(between, posed.truth.normal_force, None).small


def test_below_the_slope_nothing_holds() -> None:
    below, above = problem_axes.pose_incline(1.0 - 2.0**-50), problem_axes.pose_incline(1.0)
    assert not below.exact
    assert below.truth.errors(np.zeros(2), np.array([4.0]), None) == NO_EQUILIBRIUM
    assert above.truth.errors(np.zeros(2), np.array([4.0]), None).small


def test_constructed_strings_agree_with_rational_elimination() -> None:
    for axis in (problem_axes.CONTACTS, problem_axes.CLOSED_CONTACTS):
        for count in (1.0, 10.0):
            posed = axis.pose(count)
            answer = answer_with_closed(posed.problem, posed.closed)
            assert [float(x) for x in answer.displacement] == posed.truth.displacement.tolist()
            assert [float(x) for x in answer.normal_force] == posed.truth.normal_force.tolist()
    large = problem_axes.CONTACTS.pose(1e5)
    assert large.problem.contacts == 100_000
    assert np.count_nonzero(large.truth.normal_force) == 4


def test_the_beam_answers_the_same_in_every_unit() -> None:
    axis, forces = find_axis("unit-systems"), []
    for value, (_, force) in zip(axis.values, UNITS.values(), strict=True):
        forces.append(axis.pose(value).truth.normal_force / force)
    assert np.allclose(forces, forces[0], rtol=1e-13)


def test_a_wrong_answer_is_refused() -> None:
    problem = problem_axes.truss()
    right = problem_axes.closed_form()
    refuse_wrong(problem, right)
    for change in (
        dict(normal_force=(right.normal_force[0] * (1 + Fraction(1, 10**30)),)),
        dict(displacement=(right.displacement[0], right.displacement[1] + Fraction(1, 10**30))),
    ):
        with pytest.raises(ArithmeticError, match="equilibrium"):
            refuse_wrong(problem, dataclasses.replace(right, **change))
    with pytest.raises(ArithmeticError, match="penetrates"):
        answer_with_closed(problem, [])
    posed = problem_axes.pose_friction(1.5)
    slides, sticks, _ = posed.exact
    with pytest.raises(ArithmeticError, match="Coulomb"):
        refuse_wrong(posed.problem.replace(friction=0.1), sticks)
    with pytest.raises(ArithmeticError):
        refuse_wrong(posed.problem, dataclasses.replace(slides, friction_force=(-slides.friction_force[0],)))


def saying(solution: Solution, **said: object) -> Solution:
    return dataclasses.replace(solution, certificate=dataclasses.replace(solution.certificate, **said))


@pytest.fixture
def corner() -> tuple[SweptTruth, Solution]:
    """Two contacts that an angle of 2^-43 tells apart: (0, 8) for (3, 5)."""
    posed = find_axis("redundancy").pose(2.0**-43)
    return posed.truth, cq.solve(posed.problem)


def test_forces_whose_sum_is_right_are_stated(corner: tuple[SweptTruth, Solution]) -> None:
    truth, solution = corner
    assert "redundant" in certificate_statement(truth, solution)
    assert certificate_statement(truth, saying(solution, reasons=(), uniqueness=(FORCES,)))
    assert not certificate_statement(truth, saying(solution, reasons=()))
    assert not certificate_statement(truth, saying(solution, reasons=("force_bound: too many",)))


def test_a_wrong_displacement_is_not_excused_by_redundant_forces(corner: tuple[SweptTruth, Solution]) -> None:
    truth, solution = corner
    assert not certificate_statement(
        truth,
        dataclasses.replace(
            solution, answer=dataclasses.replace(solution.answer, displacement=2 * solution.displacement)
        ),
    )


def test_other_answers_that_are_possible_excuse_nothing() -> None:
    posed = find_axis("friction").pose(0.5)
    solution = cq.solve(posed.problem)
    wrong = dataclasses.replace(
        solution, answer=dataclasses.replace(solution.answer, normal_force=2 * solution.normal_force)
    )
    assert certificate_statement(posed.truth, saying(wrong, uniqueness=(SEVERAL,)))
    for said in (POSSIBLE, UNKNOWN, FORCES):
        assert not certificate_statement(posed.truth, saying(wrong, uniqueness=(said,)))


def test_21684_is_one_ulp_of_the_gap_times_beta() -> None:
    exact = Fraction(100000000000000000000, 4611686018427387904)
    assert best_penalty_of_truss().quantum(1e20) == exact
    assert np.spacing(problem_axes.GAP) == 2.0**-62
    solution = cq.solve(problem_axes.truss(), method="penalty", penalty=1e20)
    assert Fraction(float(solution.normal_force[0])) == exact
    row = stability_row("penalty", 1e20, "penalty")
    assert row.largest_force == float(exact)
    assert f"{row.largest_force:.3f}" == "21.684"


@pytest.mark.slow
def test_the_best_beta_is_the_predicted_one() -> None:
    best = best_penalty_of_truss()
    assert best.penalty == pytest.approx(math.sqrt(76650.7811 * 30.2549928 / 2.0**-62), rel=1e-6)
    assert best.error == pytest.approx(best.error_at(best.penalty), rel=1e-6)
    rows = [stability_row("penalty", beta, "penalty") for beta in problem_axes.VALUES if 1e8 <= beta <= 1e17]
    [found] = safe_ranges(problem_axes.PENALTY_STIFFNESS, rows)
    assert found.best is not None
    assert found.best_value is not None
    assert best.penalty / 10 < found.best_value < best.penalty * 10
    assert best.error / 10 < found.best < best.error * 3
    # On the soft side the prediction is exact, on the stiff side it is the quantum, of which the error is a part.
    for row in rows:
        assert row.error_force is not None
        assert row.predicted_error_force is not None
        assert row.error_force < 2 * row.predicted_error_force + 1e-12
        if row.value <= 1e10:
            assert row.error_force == pytest.approx(row.predicted_error_force, rel=1e-2)


@pytest.mark.slow
def test_perturbed_lagrangian_has_no_valley() -> None:
    soft, stiff = (stability_row("penalty", value, "perturbed-lagrangian") for value in (1e8, 1e20))
    assert soft.error_force == pytest.approx(soft.predicted_modelling, rel=1e-6)
    assert stiff.error_force is not None
    assert stiff.error_force < 1e-13


def test_condition_numbers_of_closed_forms() -> None:
    posed = find_axis("mass-ratio").pose(2.0**60)  # K is diagonal: its condition number is the ratio
    assert predict(posed, find("active-set"), "", None).condition == pytest.approx(2.0**60, rel=1e-12)
    truss = problem_axes.pose_penalty_stiffness(1.0)
    for beta in (1e3, 1e20):  # 2x2: κ = λmax² / det
        K = np.array(problem_axes.STIFFNESS) + np.diag([0.0, beta])
        largest = np.linalg.eigvalsh(K)[-1]
        determinant = float(Fraction(59803) * (Fraction(77443) + Fraction(beta)) - Fraction(6883.1) ** 2)
        found = predict(truss, find("penalty"), "", beta).condition
        assert found == pytest.approx(largest**2 / determinant, rel=1e-9)


def test_a_singular_matrix_has_no_condition_number_and_says_so() -> None:
    floating = find_axis("singular-stiffness").pose(2.0**-60)
    for method in ("active-set", "lemke"):
        found = predict(floating, find(method), "", None)
        assert found.condition is None
        assert "singular" in found.missing
    assert predict(floating, find("lagrange-multiplier"), "", None).condition is not None
    large = find_axis("contacts").pose(1000.0)
    assert "too many" in predict(large, find("active-set"), "", None).missing


def test_skeels_number_predicts_what_an_angle_costs() -> None:
    """Where two stops differ by an angle θ, the last place of a gap moves the corner by 1/θ and the forces by 1/θ²."""
    for angle in (2.0**-10, 2.0**-20):
        found = predict(find_axis("redundancy").pose(angle), find("lagrange-multiplier"), "", None)
        assert found.force_condition is not None
        assert 1 < found.force_condition * angle**2 < 20
