"""Condition numbers and predicted errors, against closed forms and against what is measured."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from contactqp.solving.methods import find
from contactqp.study.stability import problem_axes
from contactqp.study.stability.condition import predict
from contactqp.study.stability.stability_cells import find_axis, stability_row
from contactqp.study.stability.stability_charts import best_penalty_of_truss
from contactqp.study.stability.stability_report import safe_ranges


def test_21684_is_one_ulp_of_the_gap_times_beta() -> None:
    exact = Fraction(100000000000000000000, 4611686018427387904)
    assert best_penalty_of_truss().quantum(1e20) == exact
    assert np.spacing(problem_axes.GAP) == 2.0**-62
    solution = cq.solve(problem_axes.truss(), method="penalty", penalty=1e20)
    assert Fraction(float(solution.normal_force[0])) == exact
    row = stability_row("penalty", 1e20, "penalty")
    assert row.largest_force == float(exact)
    assert f"{row.largest_force:.3f}" == "21.684"


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
