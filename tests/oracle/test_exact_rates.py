"""Derivatives of exact answers are those of the answers nearby, to the last digit, and those in doubles agree."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from tests.analysis.test_derivatives_with_friction import STEP, at_borders, directions, drawn, moved


def test_the_bar_and_the_wall() -> None:
    bar = cq.exact(cq.ContactProblem([[157500.0]], [300.0], [[1.0]], [0.0009765625]))
    assert bar.derivative("normal_force", "gap", [1]).value.tolist() == [Fraction(-157500)]
    third = cq.exact(cq.ContactProblem([[3.0]], [2.0], [[1.0]], [1.0]))
    assert third.derivative("displacement", "load", [Fraction(1, 7)]).value.tolist() == [Fraction(1, 21)]
    touching = cq.exact(cq.ContactProblem([[2.0]], [4.0], [[1.0]], [2.0]))
    found = touching.derivative("normal_force", "load", [1.0])
    assert (found.value, found.left.tolist(), found.right.tolist(), found.exists) == (None, [0], [1], False)
    # f = 2, u = 1/3 until the load is 3 and the wall is touched: J = -f^2/6, and no force but K u = f.
    found = third.derivative("energy", "load", [1])
    assert (found.value, found.reach) == (Fraction(-2, 3), (math.inf, Fraction(1)))
    assert third.derivative("energy", "stiffness", [[1]]).value == Fraction(2, 9)  # f^2/(2 K^2)
    assert third.derivative("reaction", "load", [1]).value.tolist() == [0]
    assert bar.derivative("reaction", "load", [1]).value.tolist() == [1]  # the wall takes it
    assert bar.derivative("reaction", "stiffness", [[1024]]).value.tolist() == [-1]


def test_redundant_contacts_leave_what_follows_from_the_displacement() -> None:
    twice = cq.exact(cq.ContactProblem([[2.0, -1.0], [-1.0, 2.0]], [4.0, 1.0], [[1.0, 0.0]] * 2, [1.0, 1.0]))
    assert twice.derivative("displacement", "load", [0, 1]).value.tolist() == [0, Fraction(1, 2)]
    assert twice.derivative("reaction", "load", [0, 1]).value.tolist() == [Fraction(1, 2), 0]
    found = twice.derivative("normal_force", "load", [0, 1])
    assert (found.value, found.reach, "not unique" in found.reason) == (None, None, True)
    assert twice.derivative("displacement", "gap", [1, 0]).value is None


@pytest.mark.parametrize("problems", [2, pytest.param(12, marks=pytest.mark.slow)])
@pytest.mark.parametrize("border", [False, True])
def test_rates_are_differences_of_exact_answers_and_those_in_doubles(border: bool, problems: int) -> None:
    rng, seen, reached, step = np.random.default_rng(21), 0, 0, Fraction(STEP)
    for _ in range(problems):
        problem = at_borders(rng) if border else drawn(rng)
        solution, answer = cq.solve(problem), cq.exact(problem)
        if solution.certificate.uniqueness:
            continue
        for name, direction in directions(rng, problem).items():
            if name == "friction" and np.any(problem.friction < STEP * direction):
                continue
            ahead = cq.exact(moved(problem, name, STEP * direction))
            for of in ("displacement", "normal_force", "friction_force", "gap", "reaction"):
                found, doubles = answer.derivative(of, name, direction), solution.derivative(of, name, direction)
                if found.right is None or doubles.right is None:
                    assert border
                    continue
                if found.reach is not None:  # the doubles' is that of the same event
                    assert doubles.reach == pytest.approx([float(step) for step in found.reach], rel=1e-9)
                    reached += min(found.reach) < math.inf
                if name in ("load", "gap", "slip_origin") and of not in ("gap", "reaction"):
                    difference = (getattr(ahead, of) - getattr(answer, of)) / step
                    assert np.ravel(found.right).tolist() == np.ravel(difference).tolist()
                exactly = np.array([float(x) for x in np.ravel(found.right)])
                assert np.ravel(doubles.right) == pytest.approx(exactly, rel=1e-12, abs=1e-12)
                assert found.exists == doubles.exists
                seen += 1
    assert seen > 25 * problems // 3
    assert reached > 5 * problems // 3


def test_bad_arguments_are_one_clear_error() -> None:
    bar = cq.exact(cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0]))
    for arguments, message in (
        (("mass", "load", [1]), "of: expected one of"),
        (("gap", "mass", [1]), "with_respect_to: expected one of"),
        (("gap", "load", [1, 2]), r"direction: expected shape \(1,\)"),
        (("gap", "load", [float("nan")]), "direction: expected finite"),
    ):
        with pytest.raises(cq.InvalidProblem, match=message):
            bar.derivative(*arguments)
    enclosed = cq.exact(cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0]), enclose=True)
    with pytest.raises(cq.Unsupported, match="rational answers"):
        enclosed.derivative("gap", "load", [1])
