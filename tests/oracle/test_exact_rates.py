"""Derivatives of exact answers are those of the answers nearby, to the last digit, and those in doubles agree."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from benchmarks.problem_families import family
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
    found = twice.derivative("displacement", "gap", [1, 0])  # the other stays where it is, and one comes nearer
    assert (found.value, found.left.tolist(), found.right.tolist()) == (None, [1, Fraction(1, 2)], [0, 0])
    found = twice.derivative("displacement", "gap", [2, 2])
    assert (found.value.tolist(), found.reach) == ([2, 1], (math.inf, 1))  # the force is 9/2 - 3/2 u
    # By e > 0 the second row is longer and bears all: u = 1 / (1 + e); by e < 0 the first does.
    found = twice.derivative("displacement", "rows", [[0, 0], [1, 0]])
    assert (found.left.tolist(), found.right.tolist()) == ([0, 0], [-1, Fraction(-1, 2)])
    # Two walls that clamp a body bear any force, and leave it no room.
    clamped = cq.exact(cq.ContactProblem([[2.0]], [1.0], [[1.0], [-1.0]], [0.0, 0.0]))
    assert clamped.derivative("displacement", "load", [1]).value.tolist() == [0]
    assert clamped.derivative("displacement", "gap", [1, 1]).left is None
    assert "cannot change" in clamped.derivative("displacement", "gap", [1, 1]).reason


def test_what_may_share_later_keeps_touching() -> None:
    """Two springs and a stop on both, which bears nothing yet, go on as it takes over what one of them lacks."""
    problem = cq.ContactProblem(np.eye(2), [2.0, 1.0], [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.0, 0.0, 0.0])
    answer, solution = cq.exact(problem), cq.solve(problem)
    for direction, reach in (([1.0, -1.0], 1), ([-1.0, -1.0], 1), ([-2.0, 0.0], 1), ([1.0, 0.0], math.inf)):
        found = answer.derivative("displacement", "load", direction)
        assert (found.value.tolist(), found.reach[1]) == ([0, 0], reach)
        doubles = solution.derivative("displacement", "load", direction)
        assert doubles.reach == pytest.approx([float(step) for step in found.reach])


@pytest.mark.slow
@pytest.mark.parametrize(("family_name", "seed"), [("linear_programs", 1), ("shared_with_ties", 5)])
def test_events_of_redundant_contacts_are_those_of_exact_answers(family_name: str, seed: int) -> None:
    """Goods carried by four ways, whose many multipliers a few take; a body moves far, and a gap keeps its width."""
    problem = family(family_name, seed)
    solution, answer, rng, seen = cq.solve(problem), cq.exact(problem, enclose=False), np.random.default_rng(seed), 0
    for _ in range(4):
        direction = rng.integers(-3, 4, problem.dimension) * np.max(abs(problem.load))
        found = solution.derivative("displacement", "load", direction)
        true = answer.derivative("displacement", "load", direction)
        if found.reach is not None and true.reach is not None:
            assert found.reach == pytest.approx([float(step) for step in true.reach], rel=1e-9)
            seen += 1
    assert seen >= 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_linear_programs_with_many_multipliers_have_the_rates_of_exact_answers(seed: int) -> None:
    problem, rng = family("linear_programs", seed), np.random.default_rng(seed)
    solution, answer = cq.solve(problem), cq.exact(problem, enclose=False)
    turned = problem.normal.toarray() * rng.integers(-2, 3, problem.normal.shape)
    for name, direction in (("gap", rng.integers(-3, 4, problem.contacts)), ("rows", turned)):
        for of in ("displacement", "normal_force", "reaction", "energy"):
            found, true = (one.derivative(of, name, direction) for one in (solution, answer))
            assert (found.right is None, found.exists) == (true.right is None, true.exists), (of, name, found.reason)
            for side, exactly in ((found.left, true.left), (found.right, true.right)):
                if exactly is not None:
                    assert np.ravel(side) == pytest.approx(np.ravel(exactly).astype(float), rel=1e-12, abs=1e-12)


def test_forces_of_contacts_are_unique_beside_ties_that_are_not() -> None:
    twice = cq.ContactProblem(
        [[2.0, -1.0], [-1.0, 2.0]], [4.0, 1.0], [[1.0, 0.0]], [1.0], tie=[[0.0, 1.0], [0.0, 2.0]], tie_value=[0.25, 0.5]
    )
    solution, answer = cq.solve(twice), cq.exact(twice)
    for found in (
        solution.derivative("normal_force", "load", [1.0, 3.0]),
        answer.derivative("normal_force", "load", [1, 3]),
    ):
        assert (found.value.tolist(), tuple(map(float, found.reach))) == ([1.0], (2.25, math.inf))  # l = f - 2 + 1/4
    for found in (solution.derivative("tie_force", "load", [1.0, 3.0]), answer.derivative("tie_force", "load", [1, 3])):
        assert (found.value, "redundant" in found.reason) == (None, True)
    held = cq.ContactProblem(
        np.diag([2.0, 2.0]), [4.0, 1.0], [[1.0, 0.0]] * 2, [1.0, 1.0], tie=[[0.0, 1.0]], tie_value=[0.25]
    )
    for found in (one.derivative("tie_force", "load", [1.0, 3.0]) for one in (cq.solve(held), cq.exact(held))):
        assert found.value.tolist() == [3.0]


def shared(rng: np.random.Generator) -> cq.ContactProblem:
    """A problem whose rows repeat, add up, and clamp, around an answer whose forces are small numbers."""
    n, m = int(rng.integers(2, 4)), int(rng.integers(3, 6))
    shape = rng.integers(-2, 3, (n, n))
    K = shape @ shape.T + np.diag(rng.integers(1, 4, n))
    E = rng.integers(-1, 2, (m, n)).astype(float)
    E[~E.any(axis=1), 0] = 1.0
    E[1] = E[0] * rng.choice([1.0, 2.0, -1.0])
    E[2] = E[0] + E[-1] if (E[0] + E[-1]).any() else E[0]
    u = rng.integers(-4, 5, n) / 2
    apart = rng.random(m) < 0.2
    force = np.where(apart, 0, rng.integers(0, 3, m))
    tie = E[-1:] + E[:1] if rng.random() < 0.3 else np.zeros((0, n))
    return cq.ContactProblem(K, K @ u + E.T @ force, E, E @ u + np.where(apart, 0.5, 0.0), tie=tie, tie_value=tie @ u)


@pytest.mark.parametrize("problems", [2, pytest.param(60, marks=pytest.mark.slow)])
def test_rates_at_redundant_contacts_are_differences_of_exact_answers(problems: int) -> None:
    rng, step = np.random.default_rng(8), Fraction(STEP)
    compared = refused = one_sided = kinks = by_rows = 0
    for _ in range(problems):
        problem = shared(rng)
        answer, solution = cq.exact(problem, enclose=False), cq.solve(problem)
        n, m, k = problem.dimension, problem.contacts, problem.ties
        along = dict(load=rng.integers(-2, 3, n), gap=rng.integers(-2, 3, m), tie_value=rng.integers(-1, 2, k))
        for name, direction in (along | dict(rows=rng.integers(-1, 2, (m, n)))).items():
            if not direction.size:
                continue
            for of in ("displacement", "reaction", "normal_force", "gap"):
                found = answer.derivative(of, name, direction)
                doubles = solution.derivative(of, name, direction.astype(float))
                for side, other in ((found.left, doubles.left), (found.right, doubles.right)):
                    assert (side is None) == (other is None), (name, of, found.reason, doubles.reason)
                    if side is not None:
                        exactly = np.array([float(x) for x in side])
                        assert other == pytest.approx(exactly, rel=1e-12, abs=1e-12)
                if found.left is None or found.right is None:
                    refused, one_sided = refused + 1, one_sided + (found.left is not found.right)
                    continue
                assert found.exists == doubles.exists
                compared, kinks = compared + 1, kinks + (not found.exists)
                if of != "displacement":
                    continue
                for sign, side in ((1, found.right), (-1, found.left)):
                    size = sign * (step if name != "rows" else step**2)  # along rows the answer is curved
                    of_problem = "normal" if name == "rows" else name
                    changed = getattr(problem, of_problem) + float(size) * direction
                    there = cq.exact(problem.replace(**{of_problem: changed}), enclose=False).displacement
                    quotient = (there - answer.displacement) / size
                    if name != "rows":
                        assert quotient.tolist() == side.tolist()
                    else:
                        by_rows += 1
                        assert quotient.astype(float) == pytest.approx(side.astype(float), rel=1e-9, abs=1e-9)
    assert min(compared // 6, refused // 5, one_sided, kinks // 3, by_rows) >= problems


@pytest.mark.slow
@pytest.mark.parametrize(
    ("border", "problems"),
    [(True, 2), (False, 12), (True, 12)],
)
def test_rates_are_differences_of_exact_answers_and_those_in_doubles(border: bool, problems: int) -> None:
    rng, seen, reached, untold, step = np.random.default_rng(21), 0, 0, 0, Fraction(STEP)
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
                if found.reach is not None and doubles.reach is None:  # at a border whose rows depend on each other
                    assert border
                    untold += 1
                elif found.reach is not None:  # the doubles' is that of the same event
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
    assert untold <= reached // 4


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
