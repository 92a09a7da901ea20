"""Linear programs: their energy is enclosed, and what costs more or does not balance is refused."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

import contactqp as cq
from contactqp.linalg.equilibration import balanced, equilibrated
from contactqp.model.solution import Answer, Candidate


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


@pytest.mark.sampled(12)
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


@pytest.mark.sampled(8)
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


def few_quadratic_terms(seed: int, size: int = 150) -> tuple[cq.ContactProblem, float]:
    """A linear program with a few quadratic terms whose least energy is known, in units of other people, and that.

    Bounds, free and fixed unknowns, redundant ties, vertices at which more meets than the unknowns tell apart, and
    more than one of them best. Rows and unknowns are scaled by no powers of two: redundant ties conflict by rounding.
    """
    rng = np.random.default_rng(seed)

    def rows(count: int, width: int, per: int) -> sp.csr_matrix:
        at = np.repeat(np.arange(count), per), rng.integers(0, width, count * per)
        return sp.csr_matrix((rng.choice([-2.0, -1.0, 1.0, 3.0], count * per), at), shape=(count, width))

    A, G = rows(size // 3, size, 4), rows(size // 3, size, 4)
    A = sp.csr_matrix(sp.vstack([A, rows(size // 20, A.shape[0], 3) @ A]))
    kind = rng.choice(["free", "fixed", "below", "both"], size, p=[0.1, 0.05, 0.55, 0.3])
    lb, ub = np.zeros(size), np.full(size, np.inf)
    lb[kind == "free"] = -np.inf
    ub[kind == "both"] = rng.integers(1, 9, np.sum(kind == "both"))
    ub[kind == "fixed"] = 0.0
    x, reduced = rng.integers(-5, 6, size).astype(float), np.zeros(size)
    lower = (kind != "free") & ((rng.random(size) < 0.6) | (kind == "fixed"))
    x = np.where(lower, 0.0, np.where(kind == "free", x, np.minimum(abs(x), ub)))
    reduced[lower] = rng.integers(0, 4, np.sum(lower))
    active = rng.random(G.shape[0]) < 0.6
    force = np.where(active, rng.integers(0, 4, G.shape[0]), 0).astype(float)
    h = G @ x + np.where(active, 0.0, rng.integers(1, 9, G.shape[0]))
    P = np.zeros(size)
    P[rng.choice(size, 6, replace=False)] = rng.choice([1.0, 2.0, 10.0], 6)
    q = -P * x + reduced - A.T @ rng.integers(-4, 5, A.shape[0]).astype(float) - G.T @ force
    D, R, S = (10.0 ** rng.uniform(-power, power, count) for power, count in ((3, size), (4, len(h)), (4, A.shape[0])))
    arrays = dict(P=sp.diags(D * P * D), q=D * q, G=sp.diags(R) @ G @ sp.diags(D), h=R * h)
    arrays |= dict(A=sp.diags(S) @ A @ sp.diags(D), b=S * (A @ x), lb=lb / D, ub=ub / D)
    return cq.ContactProblem.from_qp(**arrays), float(0.5 * x @ (P * x) + q @ x)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_degenerate_program_in_mixed_units_has_its_energy_enclosed(seed: int) -> None:
    """Multipliers that press against each other, and forces of 1e-17 that nothing carries, took the digits of it."""
    problem, least = few_quadratic_terms(seed)
    solution = cq.solve(problem)
    assert solution.certificate.passed, solution.certificate
    assert solution.certificate.energy_bounds is not None
    lower, upper = solution.certificate.energy_bounds
    size = max(abs(least), 0.5 * solution.displacement @ (problem.stiffness @ solution.displacement))
    assert upper - lower <= 1e-9 * size
    assert lower - 1e-9 * size <= least <= upper + 1e-9 * size


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(3))
def test_balanced_units_make_entries_alike_and_give_answers_back(seed: int) -> None:
    """Units of unknowns and rows of 2^-24 to 2^24, which maxima of rows alone do not undo; nothing is rounded."""
    problem, _ = few_quadratic_terms(seed)
    rng = np.random.default_rng(seed)
    D, R, S = (
        sp.diags(2.0 ** rng.integers(-24, 25, size)) for size in (problem.dimension, problem.contacts, problem.ties)
    )
    other = cq.ContactProblem(
        sp.csr_array(D @ problem.stiffness @ D),
        D @ problem.load,
        sp.csr_array(R @ problem.normal @ D),
        R @ problem.gap,
        tie=sp.csr_array(S @ problem.tie @ D),
        tie_value=S @ problem.tie_value,
    )
    spreads = [np.std(np.log2(abs(units(other)[0].tie.data))) for units in (balanced, equilibrated)]
    assert max(spreads) < 1
    twin, scaling = balanced(other)
    u, force, tie = (rng.normal(size=size) for size in (other.dimension, other.contacts, other.ties))
    answer = Answer(u, force, None, tie)
    given = scaling.scale(answer)
    back = scaling.unscale(Candidate(given))
    for name in ("displacement", "normal_force", "tie_force"):
        assert np.array_equal(getattr(answer, name), getattr(back.answer, name))
    force = other.stiffness @ answer.displacement - other.load
    assert twin.stiffness @ given.displacement - twin.load == pytest.approx(
        scaling.unknowns * force / scaling.force, rel=1e-12
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("cost", [1e-3, 1e-9])
def test_small_costs_of_a_motion_without_end_are_told_beside_large_ones(cost: float) -> None:
    # Goods that are bought and sold again at a small profit, beside a transport whose costs are ordinary ones.
    random = np.random.default_rng(4)
    costs = np.append(random.integers(1, 9, 9) * 1.0, [-cost, 0.0])
    rows = np.zeros((6, 11))
    for i in range(3):
        rows[i, 3 * i : 3 * i + 3] = 1.0
        rows[3 + i, i:9:3] = 1.0
    rows[0, 9:] = 1.0, -1.0
    rows, units = rows * 10.0 ** random.integers(-4, 5, 6)[:, None], 10.0 ** random.integers(-3, 4, 11)
    supply = rows[:, :9].sum(axis=1)
    program = cq.ContactProblem.from_qp(np.zeros((11, 11)), costs * units, A=rows * units, b=supply, lb=np.zeros(11))
    with pytest.raises(cq.NoEquilibrium, match=r"the energy falls for ever: unknown (9|10) by .*unknown (9|10) by"):
        cq.solve(program)
    balanced = np.where(np.arange(11) == 9, 0.0, costs)
    assert cq.solve(program.replace(load=-balanced * units)).certificate.passed


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_is_imposed_lengths_are_those_that_the_load_moves(seed: int) -> None:
    """Circulations within 1e5: in lengths of 1e-6 their few stiff arcs yielded as if they had no stiffness."""
    rng, nodes, arcs = np.random.default_rng(seed), 30, 150
    tail = rng.integers(0, nodes, arcs)
    head = (tail + rng.integers(1, nodes, arcs)) % nodes
    incidence = sp.csr_matrix((np.ones(arcs), (tail, np.arange(arcs))), (nodes, arcs))
    incidence = incidence - sp.csr_matrix((np.ones(arcs), (head, np.arange(arcs))), (nodes, arcs))
    stiff = rng.choice(arcs, 12, replace=False)
    P, cost = np.zeros(arcs), -rng.integers(0, 8, arcs).astype(float)
    P[stiff] = rng.integers(1, 9, 12) / 4.0
    capacity = rng.integers(1, 100, arcs) * 1000.0
    program = cq.ContactProblem.from_qp(
        sp.diags(P), cost, A=incidence, b=np.zeros(nodes), lb=np.zeros(arcs), ub=capacity
    )
    scaling = equilibrated(program)[1]
    assert scaling.length * np.max(scaling.unknowns) > 1e-3
    solution = cq.solve(program)
    assert solution.certificate.proven
    lower, upper = solution.certificate.energy_bounds
    assert upper - lower <= 1e-14 * abs(lower)
    raw = cq.solve(program, "clarabel").raw
    assert solution.energy == pytest.approx(program.energy(raw.displacement), rel=1e-7)


@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", range(6))
def test_constraints_alone_are_met_without_forces(seed: int) -> None:
    """No energy and no load: any displacement within the constraints is an answer, and no force is needed."""
    rng, n = np.random.default_rng(seed), 8
    A, G, x = rng.integers(-3, 4, (3, n)), rng.integers(-3, 4, (6, n)), rng.integers(-2, 3, n)
    h, lb = G @ x + rng.integers(0, 2, 6), x - rng.integers(0, 3, n)
    solution = cq.solve(cq.ContactProblem.from_qp(np.zeros((n, n)), np.zeros(n), G, h, A, A @ x, lb))
    u = solution.displacement
    assert solution.certificate.proven
    assert not np.any(np.concatenate([solution.normal_force, solution.tie_force]))
    assert np.all(np.concatenate([G @ u - h, lb - u]) <= 1e-12)
    assert A @ u == pytest.approx(A @ x, abs=1e-12)


def test_forces_that_balance_the_load_prove_without_a_program_that_nothing_is_driven(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """min 1/2 x'Hx - q'x + sum t with |x| <= t is solved by x if q = H x + s, s = sign(x), or less where x = 0.

    The answer meets some rows to rounding only, and a linear program in all unknowns, which with dense H took fifty
    times as long as the answer, looked for a load that drives a motion.
    """
    random = np.random.default_rng(0)
    X, one, none = random.standard_normal((5, 10)), np.eye(10), np.zeros((10, 10))
    x = np.where(np.arange(10) < 3, random.standard_normal(10), 0.0)
    q = X.T @ X @ x + np.where(x != 0, np.sign(x), random.uniform(-0.9, 0.9, 10))
    P, rows = np.block([[X.T @ X, none], [none, none]]), np.block([[one, -one], [-one, -one]])
    program = cq.ContactProblem.from_qp(P, np.append(-q, np.ones(10)), rows, np.zeros(20))
    monkeypatch.setattr("contactqp.linalg.existence._program", lambda *_, **__: pytest.fail("a linear program"))
    solution = cq.solve(program)
    assert solution.certificate.proven
    assert solution.displacement[:10] == pytest.approx(x, abs=1e-12)
