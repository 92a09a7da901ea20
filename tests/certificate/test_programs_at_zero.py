"""Linear programs whose least cost is zero: what cancels, or stays at the origin, is beside its terms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

import contactqp as cq


@pytest.mark.parametrize(
    ("cost", "supply", "demand"),
    [
        ([0, 1, 1, 0, 0, 3, 1, 0, 1], [1, 1, 2], [1, 3, 0]),  # no term of the cost, and prices that cancel
        ([2, -1, 1, 1, -4, 2, 3, 3, 4], [1, 1, 1], [1, 1, 1]),  # 1 + 3 - 4
    ],
)
def test_plans_whose_cost_cancels_are_judged_beside_its_terms(
    cost: list[int], supply: list[int], demand: list[int]
) -> None:
    """Transport plans that cost nothing, and no plan costs less, as HiGHS finds, too.

    What is left of sums that cancel is rounding, or zero, beside which all rounding is infinite.
    """
    rows = np.vstack([np.kron(np.eye(3), np.ones(3)), np.kron(np.ones(3), np.eye(3))])
    plan = cq.ContactProblem.from_qp(np.zeros((9, 9)), cost, A=rows, b=[*supply, *demand], lb=np.zeros(9))
    least = linprog(cost, A_eq=rows, b_eq=[*supply, *demand])
    assert abs(least.fun) < 1e-12
    answer = cq.solve(plan)
    assert answer.certificate.proven
    assert answer.energy == pytest.approx(0.0, abs=1e-12)
    dearer = np.outer(supply, demand).ravel() / sum(supply)  # admissible, and costs more
    assert np.dot(cost, dearer) > 0.1
    assert not cq.certify(plan, dearer, answer.normal_force, tie_force=answer.tie_force).passed


def test_a_program_that_ends_at_zero_has_no_length_beside_a_bound_that_stays_open() -> None:
    """Its vertex is the origin, where more constraints meet than there are unknowns: 1e-36 is no length of any row."""
    rows = [
        [0.0, -2.0, 1.0, 2.0, 0.0, -2.0, 2.0, -2.0],
        [-2.0, -2.0, 1.0, -1.0, 2.0, 1.0, 2.0, 2.0],
        [1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -2.0, 1.0],
        [1.0, 1.0, -1.0, 2.0, 0.0, -1.0, 1.0, 1.0],
        [-2.0, -1.0, 2.0, 1.0, 1.0, 2.0, 0.0, 1.0],
        [0.0, 2.0, -1.0, 0.0, 1.0, -2.0, 1.0, -2.0],
        [-2.0, 1.0, 0.0, -1.0, 1.0, 2.0, -2.0, 0.0],
        [0.0, -2.0, -2.0, 0.0, 2.0, 1.0, -2.0, 2.0],
    ]
    cost, limits = [-1.0, 0.0, 2.0, -2.0, 1.0, -1.0, -2.0, -2.0], [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    program = cq.ContactProblem.from_qp(np.zeros((8, 8)), cost, G=rows, h=limits, lb=np.zeros(8))
    assert linprog(cost, A_ub=rows, b_ub=limits).fun == 0
    solution = cq.solve(program)
    assert abs(solution.displacement).max() < 1e-30
    assert solution.certificate.proven
    moved = np.full(8, 1e-6)
    assert not cq.certify(program, moved, solution.normal_force).passed
    assert not cq.certify(program, solution.displacement, 1.001 * solution.normal_force).passed
