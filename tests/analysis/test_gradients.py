"""Gradients and Jacobians are off by no more than their bounds, which are not much more than that."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.analysis import gradients
from contactqp.analysis.derivatives import QUANTITIES
from contactqp.analysis.rate_systems import RateSystem
from contactqp.analysis.rates import Linearised

PARAMETERS = ("load", "gap", "tie_value", "stiffness", "rows", "friction", "slip_origin")


def drawn(rng: np.random.Generator, friction: float) -> cq.ContactProblem:
    """A problem of thirds, which no double is, so that all products with weights are rounded."""
    n, m = int(rng.integers(3, 5)) + 2 * (friction > 0), int(rng.integers(1, 3))
    shape = rng.integers(-3, 4, (n, n))
    rows = [np.where(rng.random((m, n)) < 0.7, rng.integers(1, 4, (m, n)) / 3, 0.0) for _ in range(2)]
    for one in rows:
        one[:, 0] += 0.5
    K = shape @ shape.T / 3 + np.diag(rng.integers(2, 6, n))
    tangential = dict(tangent=rows[1], friction=np.full(m, friction)) if friction else {}
    return cq.ContactProblem(
        (K + K.T) / 2, rng.integers(1, 10, n) / 3, rows[0], rng.integers(0, 3, m) / 4,
        tie=rng.integers(1, 3, (1, n)) / 3, tie_value=[0.1], **tangential,
    )  # fmt: skip


def units(problem: cq.ContactProblem, parameter: str) -> Iterator[tuple[Any, np.ndarray, int]]:
    """Yield each entry of a parameter, the direction that changes it, and how many entries that changes."""
    of_matrix = dict(stiffness=problem.stiffness, rows=problem.normal)
    if parameter not in of_matrix:
        shape = np.shape(getattr(problem, parameter))
        for place in np.ndindex(shape):
            yield place, np.eye(int(np.prod(shape)))[np.ravel_multi_index(place, shape)].reshape(shape), 1
        return
    entries = sp.coo_array(of_matrix[parameter])
    for i, j in zip(entries.row.tolist(), entries.col.tolist(), strict=True):
        direction = np.zeros(entries.shape)
        direction[i, j] = 1.0
        if parameter == "stiffness":
            direction[j, i] = 1.0
        yield (i, j), direction, int(direction.sum())


def errors(solution: cq.Solution, answer: Any, of: str, parameter: str, weights: Any) -> list[tuple[Fraction, float]]:
    """Return the errors of a gradient, held against Fractions, and their bounds."""
    found, bound = solution.pullback(of, weights, parameter, return_bound=True)
    if sp.issparse(found):
        found, bound = found.toarray(), bound.toarray()
    pairs = []
    for place, direction, changed in units(solution.problem, parameter):
        true = answer.derivative(of, parameter, direction).value
        products = [Fraction(float(w)) * Fraction(x) for w, x in zip(np.ravel(weights), np.ravel(true), strict=True)]
        exact = sum(products, Fraction()) / changed
        pairs.append((abs(Fraction(float(found[place])) - exact), float(bound[place])))
    return pairs


def hold(parts: dict[Any, list[Fraction]], problem: cq.ContactProblem, weights: Any, of: str) -> None:
    """Hold the gradients of a quantity by all parameters against their bounds, and keep the parts that they fill."""
    solution, answer = cq.solve(problem), cq.exact(problem)
    given = np.resize(weights, np.shape(problem.load if of == "reaction" else getattr(solution, of)))
    for parameter in PARAMETERS if problem.frictional else PARAMETERS[:5]:
        for error, bound in errors(solution, answer, of, parameter, given):
            assert error <= Fraction(bound), (of, parameter)
            if bound > 0:
                parts.setdefault((of, parameter), []).append(error / Fraction(bound))


@pytest.mark.parametrize("seed", [9, pytest.param(8, marks=pytest.mark.slow)])
def test_bounds_of_reactions_hold_against_fractions(seed: int) -> None:
    rng, parts = np.random.default_rng(seed), {}
    hold(parts, drawn(rng, 0.0), rng.integers(-4, 5, 9) / 3, "reaction")
    assert max(parts["reaction", "load"]) > Fraction(1, 10)


@pytest.mark.slow
@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("friction", [0.0, 0.125])
def test_bounds_hold_against_fractions_and_those_of_a_tenth_would_not(friction: float, sparse: bool) -> None:
    rng, parts = np.random.default_rng(7), {}
    for _ in range(4):
        problem = drawn(rng, friction)
        problem = problem.replace(stiffness=sp.csr_array(problem.stiffness)) if sparse else problem
        for of in QUANTITIES:
            if friction or of not in ("friction_force", "slip"):
                hold(parts, problem, rng.integers(-4, 5, 9) / 3, of)
    assert len(parts) >= (50 if friction else 25)
    for of in ("displacement", "reaction"):
        for parameter in ("load", "stiffness"):
            found = parts[of, parameter]
            assert sum(part > Fraction(1, 10) for part in found) >= len(found) // 40, (of, parameter)


def test_what_the_data_in_doubles_lack_belongs_to_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reaction's weights come by products with the stiffness, whose rounding the inverse may enlarge by far."""
    K = np.array([[1e8 + 1 / 3, -1e8], [-1e8, 1e8 + 1 / 3]])
    problem = cq.ContactProblem(K, [1 / 3, 2.0], [[1.0, 1.0]], [100.0])
    answer = cq.exact(problem)
    below = errors(cq.solve(problem), answer, "reaction", "load", np.array([1 / 3, 0.7]))
    assert all(error <= Fraction(bound) for error, bound in below)
    monkeypatch.setattr(RateSystem, "with_more", lambda _, solved, *__: solved)
    below = errors(cq.solve(problem), answer, "reaction", "load", np.array([1 / 3, 0.7]))
    assert any(error > Fraction(bound) for error, bound in below)


@pytest.mark.slow
@pytest.mark.parametrize("refined", [True, False])
def test_a_rounded_answer_has_the_gradients_of_the_exact_one(refined: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Products with a displacement that is off by 1e-10 are off, unless its refinement is taken instead."""
    known = gradients._answer

    def doubles(linearised: Linearised, bounded: bool) -> Any:
        off = replace(known(linearised, True).displacement, value=linearised.solution.displacement)
        return replace(known(linearised, bounded), displacement=off)

    if not refined:
        monkeypatch.setattr(gradients, "_answer", doubles)
    rng, outside = np.random.default_rng(3), 0
    for _ in range(4):
        problem = drawn(rng, 0.0)
        solution, answer = cq.solve(problem), cq.exact(problem)
        rounded = replace(solution.answer, displacement=solution.displacement * (1 + 1e-10))
        solution = replace(solution, answer=rounded)
        pairs = errors(solution, answer, "displacement", "stiffness", np.ones(problem.dimension))
        outside += any(error > Fraction(bound) for error, bound in pairs)
    assert outside == (0 if refined else 4)


def test_jacobians_have_bounds_whichever_way_they_are_formed() -> None:
    problem = drawn(np.random.default_rng(2), 0.25)
    solution, answer = cq.solve(problem), cq.exact(problem)
    for of, parameter in (("normal_force", "load"), ("displacement", "gap"), ("displacement", "friction")):
        found, bound = solution.jacobian(of, parameter, return_bound=True)
        assert found == pytest.approx(solution.jacobian(of, parameter), abs=1e-14)
        assert found.shape == bound.shape
        for k, (_, direction, _) in enumerate(units(problem, parameter)):
            true = answer.derivative(of, parameter, direction).value
            for one, exact, apart in zip(found[:, k], np.ravel(true), bound[:, k], strict=True):
                assert abs(Fraction(float(one)) - exact) <= Fraction(float(apart))


def test_where_slips_turn_in_space_gradients_have_bounds() -> None:
    block = dict(stiffness=np.diag([2.0, 3.0, 5.0]), normal=[[0.0, 0.0, -1.0]], gap=[0.0], friction=0.3)
    problem = cq.ContactProblem(load=[5.0, 1.0, -10.0], tangent=np.eye(3)[:2], **block)
    slips, sticks = cq.solve(problem), cq.solve(problem.replace(load=[1.0, 0.5, -10.0]))
    assert slips.contact_status.tolist() == ["slip"]
    assert sticks.contact_status.tolist() == ["stick"]
    weights = np.ones((1, 2))
    assert np.all(slips.pullback("friction_force", weights, "load", return_bound=True)[1] <= 1e-15)
    assert np.all(slips.jacobian("displacement", "load", return_bound=True)[1] <= 1e-15)
    found, bound = sticks.pullback("friction_force", weights, "load", return_bound=True)
    assert found.tolist() == [1.0, 1.0, 0.0]
    assert np.all(bound <= 1e-14)


def test_a_system_whose_refinement_leads_nowhere_has_no_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = cq.solve(drawn(np.random.default_rng(2), 0.25))
    solve = RateSystem.solve

    def lost(self: RateSystem, right: Any, transposed: bool = False, bounded: bool = True) -> Any:
        solved = solve(self, right, transposed, bounded)
        return type(solved)(solved.found, None, False)

    monkeypatch.setattr(RateSystem, "solve", lost)
    assert Linearised(solution).system is not None
    with pytest.raises(cq.InvalidProblem, match="the gradient of displacement by load does not exist: the linear syst"):
        solution.pullback("displacement", np.ones(solution.problem.dimension), "load")


@pytest.mark.parametrize("at_once", [1, 3, 2**14])
def test_products_on_a_pattern_are_those_of_all_entries(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many entries are filled at a time, rows without any among them."""
    monkeypatch.setattr(gradients, "AT_ONCE", at_once)
    rng = np.random.default_rng(1)
    rows = sp.csr_array(np.array([[1.0, 0, 2, 0], [0, 0, 0, 0], [3, 4, 5, 6], [0, 7, 0, 0], [0, 0, 0, 0]]))
    (a, c), (b, d) = rng.standard_normal((2, 5)), rng.standard_normal((2, 4))
    found = gradients._products(rows, [(a, b), (c, d)])
    assert np.array_equal(found.toarray(), (np.outer(a, b) + np.outer(c, d)) * (rows.toarray() != 0))
