"""Linear programs: their energy is enclosed, and what costs more or does not balance is refused."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

import contactqp as cq


def transport(seed: int, sources: int = 6, sinks: int = 7) -> cq.ContactProblem:
    """Carry goods from sources to sinks for the least cost: K = 0, and degenerate as integers make it."""
    rng = np.random.default_rng(seed)
    supply, demand = np.full(sources, float(sinks)), np.full(sinks, float(sources))
    rows = sp.vstack([sp.kron(sp.identity(sources), np.ones(sinks)), sp.kron(np.ones(sources), sp.identity(sinks))])
    cost = rng.integers(1, 10, sources * sinks).astype(float)
    size = sources * sinks
    nothing = sp.csr_matrix((size, size))
    return cq.ContactProblem.from_qp(nothing, cost, A=rows, b=np.r_[supply, demand], lb=np.zeros(size))


def least_cost(problem: cq.ContactProblem) -> float:
    program = problem.to_qp()
    found = linprog(program.q, A_eq=program.A, b_eq=program.b, bounds=(0.0, None))
    return float(found.fun)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(12))
def test_a_linear_program_has_its_energy_enclosed(seed: int) -> None:
    problem = transport(seed)
    solution = cq.solve(problem)
    certificate = solution.certificate
    assert certificate.passed, certificate
    least = least_cost(problem)
    assert solution.energy == pytest.approx(least, rel=1e-12)
    assert certificate.energy_bounds is not None
    lower, upper = certificate.energy_bounds
    assert lower <= least * (1 + 1e-9)
    assert upper >= least * (1 - 1e-9)
    assert upper - lower <= 1e-9 * least


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(8))
def test_a_feasible_answer_that_costs_more_is_refused(seed: int) -> None:
    """Moved along a cycle of four, everything stays met, and the multipliers are those of the truth."""
    problem = transport(seed)
    solution = cq.solve(problem)
    u = solution.displacement.reshape(6, 7).copy()
    carried = np.argwhere(u > 0.5)
    first = carried[0]
    second = next(other for other in carried if other[0] != first[0] and other[1] != first[1])
    moved = 1e-3
    u[tuple(first)] -= moved
    u[tuple(second)] -= moved
    u[first[0], second[1]] += moved
    u[second[0], first[1]] += moved
    cost = problem.energy(u.ravel()) - solution.energy
    answer = dict(normal_force=solution.normal_force, tie_force=solution.tie_force)
    assert cq.certify(problem, displacement=u.ravel(), **answer).passed == (abs(cost) < 1e-9)


def test_multipliers_that_do_not_balance_are_refused() -> None:
    problem = transport(3)
    solution = cq.solve(problem)
    tie = solution.tie_force.copy()
    tie[2] += 1e-6
    answer = dict(displacement=solution.displacement, normal_force=solution.normal_force, tie_force=tie)
    assert not cq.certify(problem, **answer).passed
