"""Programs of control and smoothing are solved in all units of their unknowns and rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import interior_point, least_norm
from contactqp.linalg.equilibration import _units_of_bodies, _units_of_programs, equilibrated
from contactqp.linalg.extended import ExtendedAnswer
from contactqp.linalg.factorization import solved_between_diagonals
from contactqp.linalg.sparse_saddle import ClosedState, Effort
from contactqp.solving.methods import Settings, find
from tests.linalg.test_crossover import wide


def double_integrator(steps: int) -> dict[str, Any]:
    """Return a body that is brought to rest at zero from 3, with bounded force and speed; in each step force, place,
    speed, of which the speed costs nothing.
    """
    A, B, start = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]]), np.array([3.0, 0.0])
    eye, back = sp.eye_array(steps), sp.eye_array(steps, k=-1)
    moves = sp.kron(eye, np.hstack([-B, np.eye(2)])) + sp.kron(back, np.hstack([np.zeros((2, 1)), -A]))
    value = np.concatenate([A @ start, np.zeros(2 * steps - 2)])
    limit = np.tile([1.0, 5.0, 0.5], steps)
    P = sp.diags_array(np.tile([0.01, 1.0, 0.0], steps))
    return dict(P=P, q=np.zeros(3 * steps), A=sp.csr_array(moves), b=value, lb=-limit, ub=limit)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("unit", [1e-7, 1e7])
@pytest.mark.parametrize("steps", [20, 50])
def test_control_in_other_units_is_proven_and_has_the_same_energy(steps: int, unit: float) -> None:
    """Ties were met to 5e-9, and the answer refused, with unknowns in 1e7 of these units, and rows in their own."""
    given = double_integrator(steps)
    of_rows = 10.0 ** np.random.default_rng(5).uniform(-5, 5, len(given["b"]))
    changed = dict(
        P=given["P"] * unit**2, q=given["q"], A=sp.diags_array(of_rows) @ given["A"] * unit, b=of_rows * given["b"],
        lb=given["lb"] / unit, ub=given["ub"] / unit,
    )  # fmt: skip
    plain, solution = (cq.solve(cq.ContactProblem.from_qp(**one)) for one in (given, changed))
    assert plain.certificate.proven
    assert solution.certificate.proven
    assert solution.energy == pytest.approx(plain.energy, rel=1e-12)
    assert solution.displacement * unit == pytest.approx(plain.displacement, rel=1e-7, abs=1e-9)


def test_a_chain_on_springs_over_many_decades_keeps_its_own_units() -> None:
    """At a unit diagonal of K its rows would have entries of 1e-6 beside one, and rounding of these would conflict."""
    rng = np.random.default_rng([17, 12])
    springs, rows = np.exp2(rng.integers(-43, 1, 614).astype(float)), 598
    E = sp.diags_array([np.ones(rows), -2.0 * np.ones(rows)], offsets=[0, 1], shape=(rows, 614)).tocsr()
    u, force = rng.integers(-4, 5, 614).astype(float), np.ldexp(rng.integers(1, 9, rows), rng.integers(-43, 1, rows))
    problem = cq.ContactProblem(sp.diags_array(springs).tocsr(), springs * u + E.T @ force, E, E @ u)
    given, factors = abs(sp.csr_matrix(problem.normal)), _units_of_bodies(problem)
    entries = (sp.diags_array(factors[1]) @ given @ sp.diags_array(factors[0])).tocsr()
    assert np.min(entries.data) == pytest.approx(0.5)
    assert cq.certify(problem, u, force).proven


def in_units(problem: cq.ContactProblem, base: float, seed: int) -> tuple[cq.ContactProblem, float]:
    """A linear program with unknowns, energy and rows in powers of a base as units; the factor of its energy."""
    rng = np.random.default_rng(seed)
    D = base ** rng.integers(-3, 8, problem.dimension).astype(float)
    energy = base ** float(rng.integers(-3, 4))
    R, S = (base ** rng.integers(-3, 4, size).astype(float) for size in (problem.contacts, problem.ties))
    normal, tie = R[:, None] * problem.normal.toarray() * D, S[:, None] * problem.tie.toarray() * D
    of_ties = dict(tie=tie, tie_value=S * problem.tie_value)
    nothing = np.zeros((len(D), len(D)))
    return cq.ContactProblem(nothing, energy * D * problem.load, normal, R * problem.gap, **of_ties), energy


def minimum_cut(side: int, capacities: np.ndarray) -> cq.ContactProblem:
    """Potentials of a grid of nodes, from one to zero, and the flow that each edge would carry for their difference."""
    node = np.arange(side * side).reshape(side, side)
    ends = np.vstack([np.column_stack([a.ravel(), b.ravel()]) for a, b in
                      ((node[:-1], node[1:]), (node[:, :-1], node[:, 1:]))])  # fmt: skip
    count, edges = side * side, len(ends)
    across = np.zeros((edges, count))
    across[np.arange(edges), ends[:, 0]], across[np.arange(edges), ends[:, 1]] = 1.0, -1.0
    rows = np.vstack([np.hstack([sign * across, -np.eye(edges)]) for sign in (1.0, -1.0)])
    bounds = np.hstack([np.vstack([np.eye(count), -np.eye(count)]), np.zeros((2 * count, edges))])
    load = np.concatenate([np.zeros(count), -capacities[:edges]])
    gap = np.concatenate([np.zeros(2 * edges), np.repeat([1.0, 0.0], count)])
    tie = np.zeros((2, count + edges))
    tie[0, 0] = tie[1, count - 1] = 1.0
    size = count + edges
    return cq.ContactProblem(np.zeros((size, size)), load, np.vstack([rows, bounds]), gap, tie=tie, tie_value=[1.0, 0])


@pytest.mark.parametrize("base", [2.0, 10.0])
def test_a_program_has_the_entries_of_its_own_units_in_all_units(base: float) -> None:
    """Entries of one were up to 2^20 apart beside each other, so that a cut of 144 nodes took 15 s in other units."""
    problem = minimum_cut(4, np.random.default_rng(1).integers(1, 9, 24).astype(float))
    plain, other = (equilibrated(one)[0] for one in (problem, in_units(problem, base, 5)[0]))
    for name in ("normal", "tie"):
        logs = [np.log2(abs(getattr(twin, name).data)) for twin in (plain, other)]
        assert np.max(abs(logs[0] - logs[1])) <= 1.0


@pytest.mark.slow
def test_what_rounding_of_units_decides_is_not_proven() -> None:
    """Of transports, ties that follow from others are independent of them where units are no powers of two.

    In rational numbers their rounding then costs a tenth of the energy; in units of 1e-3 to 1e7 it was hidden by the
    largest of the lengths, and less energy was proven.
    """
    rows = np.vstack([np.kron(np.eye(3), np.ones(5)), np.kron(np.ones(3), np.eye(5))])
    random = np.random.default_rng(1)
    carried, costs = random.integers(0, 5, 15).astype(float), random.integers(1, 20, 15).astype(float)
    plain = cq.ContactProblem(np.zeros((15, 15)), -costs, -np.eye(15), np.zeros(15), tie=rows, tie_value=rows @ carried)
    problem, energy = in_units(plain, 10.0, 1005)
    expected, rounded, solution = cq.solve(plain), cq.exact(problem), cq.solve(problem)
    assert expected.certificate.proven
    assert expected.energy == 274.0
    assert float(rounded.energy) == pytest.approx(290.0 * energy, rel=1e-9)
    assert solution.energy == pytest.approx(274.0 * energy, rel=1e-12)
    assert not solution.certificate.proven


@pytest.mark.slow
def test_corrections_end_where_rounding_makes_a_set_of_contacts_recur(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their dual active set went round for minutes, until its budget was spent: 900 steps lead to the solution."""
    monkeypatch.setattr(least_norm, "PRODUCTS", 1e8)  # 4480 steps
    twin = equilibrated(wide(14, 60, 0.0))[0]
    found = find("clarabel").solve(twin, Settings(1e-9)).answer
    closed = found.normal_force > twin.gap - twin.normal @ found.displacement
    state = least_norm.by_corrections(ClosedState.of(twin, closed, ExtendedAnswer.of(found)), effort := Effort())
    assert state.holds
    assert 0 < effort.corrected < 2000


def test_units_of_dense_rows_are_those_of_sparse_ones() -> None:
    """Means of entries are one in both; sparse factors of a dense pattern took half of the time of a linear program."""
    random = np.random.default_rng(2)
    for shape in ((12, 7), (7, 12)):
        factors = 10.0 ** random.integers(-4, 5, shape[0]), 10.0 ** random.integers(-4, 5, shape[1])
        rows = factors[0][:, None] * random.choice([-2.0, -1.0, 0.5, 1.0], shape) * factors[1]
        problem = cq.ContactProblem(np.zeros((shape[1],) * 2), np.ones(shape[1]), rows, np.ones(shape[0]))
        d, r = _units_of_programs(problem)
        logs = np.log2(abs(rows) * d * r[:, None])
        assert abs(logs.mean(axis=0)).max() < 1e-6
        assert abs(logs.mean(axis=1)).max() < 1e-6


def test_dense_factors_of_the_shorter_side_solve_a_matrix_between_diagonals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a dense pattern nothing of the longer side is factorised."""
    random = np.random.default_rng(3)
    monkeypatch.setattr("contactqp.linalg.factorization.SuperLU", lambda _: pytest.fail("sparse factors of a dense P"))
    for n, m in ((3, 5), (5, 3)):
        P, D, R = random.integers(0, 2, (n, m)) + np.eye(n, m), random.integers(20, 30, n), random.integers(20, 30, m)
        x = random.integers(-9, 9, n + m).astype(float)
        right = np.block([[np.diag(D), P], [P.T, np.diag(R)]]) @ x
        assert solved_between_diagonals((D, R), sp.csc_array(P), right) == pytest.approx(x, abs=1e-12)


def test_the_guess_of_a_backend_that_holds_is_settled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All changes of its contacts were made twice, with a factorisation each: half of the time of dense programs."""
    twin, scaling = equilibrated(minimum_cut(3, np.arange(1.0, 13.0)))
    answer, calls = (
        scaling.scale(find("clarabel").solve(minimum_cut(3, np.arange(1.0, 13.0)), Settings(1e-9)).answer),
        [],
    )
    settled = interior_point.nearest_state
    monkeypatch.setattr(interior_point, "nearest_state", lambda *given: calls.append(1) or settled(*given))
    assert interior_point.solved_from(twin, answer, Effort(), claimed=False).holds
    assert len(calls) == 1
