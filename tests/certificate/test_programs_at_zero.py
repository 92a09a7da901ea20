"""Linear programs whose least cost is zero: what cancels, or stays at the origin, is beside its terms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

import contactqp as cq


@pytest.mark.slow
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


def near_parallel(blocks: int, apart: float) -> np.ndarray:
    """Return the rows of pairs (x_1 + x_2, x_1 + (1 + apart) x_2), of condition number 4 / apart."""
    return np.kron(np.eye(blocks), [[1.0, 1.0], [1.0, 1.0 + apart]])


STIFFNESSES = {"none": (0.0, 0.0), "the first of each pair": (1.0, 0.0), "the second": (0.0, 1.0)}


@pytest.mark.sampled(7)
@pytest.mark.parametrize("blocks", [1, 10])
@pytest.mark.parametrize("exponent", [8, 16, 28])
@pytest.mark.parametrize("stiffness", STIFFNESSES)
@pytest.mark.parametrize("tied", [False, True], ids=["contacts", "ties"])
def test_forces_of_nearly_parallel_rows_are_judged_where_nothing_strains(
    blocks: int, exponent: int, stiffness: str, tied: bool
) -> None:
    """All displacements and forces are 1 and unique, as in rational numbers; the residual of wrong forces is rounding.

    It is so before and after the problem is solved.
    """
    apart = 2.0**-exponent
    rows, ones = near_parallel(blocks, apart), np.ones(2 * blocks)
    K = np.diag(np.tile(STIFFNESSES[stiffness], blocks))
    q = -(rows.T @ ones + K @ ones)
    limits = {"A": rows, "b": rows @ ones} if tied else {"G": rows, "h": rows @ ones}
    problem = cq.ContactProblem.from_qp(K, q, **limits)
    wrong = ones.copy()
    wrong[:2] += np.array([1.0, -1.0]) * min(1e-9 / apart, 0.5)  # out of balance by 1e-9 of a force of two
    if apart == 2.0**-8:
        wrong[:2] = 1.00001, 0.99999

    def judged(forces: np.ndarray) -> cq.Certificate:
        none = np.zeros(0)
        contacts, ties = (none, forces) if tied else (forces, none)
        return cq.certify(problem, ones, contacts, tie_force=ties if tied else None)

    assert not judged(wrong).passed
    assert judged(ones).proven
    answer = cq.solve(problem)
    forces = answer.tie_force if tied else answer.normal_force
    assert answer.certificate.proven
    np.testing.assert_allclose(forces, ones, rtol=1e-6)
    assert not judged(wrong).passed
    assert not any("not unique" in note for note in answer.certificate.notes)


def test_the_energy_of_a_program_of_two_unknowns_is_enclosed() -> None:
    """The least of -x - 2 y over x + y <= 4, 0 <= x <= 3, 0 <= y <= 2.5 is -6.5, at (1.5, 2.5)."""
    program = cq.ContactProblem.from_qp(np.zeros((2, 2)), [-1.0, -2.0], G=[[1, 1]], h=[4], lb=[0, 0], ub=[3, 2.5])
    answer = cq.solve(program)
    lower, upper = answer.certificate.energy_bounds
    assert lower <= -6.5 <= upper
    assert upper - lower <= 1e-12
    np.testing.assert_allclose(answer.displacement, [1.5, 2.5])


def test_the_forces_of_a_part_without_stiffness_are_judged_beside_a_body() -> None:
    """Two nearly parallel rows hold two unknowns without stiffness, beside a spring that is pressed on a stop."""
    rows = np.zeros((3, 3))
    rows[:2, :2], rows[2, 2] = near_parallel(1, 2.0**-24), 1.0
    problem = cq.ContactProblem.from_qp(np.diag([0, 0, 1.0]), -rows.T @ [1, 1, 1], G=rows, h=[2, 2 + 2.0**-24, 0])
    answer = cq.solve(problem)
    np.testing.assert_allclose(answer.normal_force, 1.0, rtol=1e-6)
    assert answer.certificate.proven
    assert not cq.certify(problem, answer.displacement, [1.01, 0.99, 1.0]).passed


@pytest.mark.sampled(4)
@pytest.mark.parametrize("exponent", [16, 25, 28])
@pytest.mark.parametrize("stiff", [False, True], ids=["alone", "beside a spring"])
def test_forces_of_nearly_parallel_rows_are_judged_where_no_length_is_stated(exponent: int, stiff: bool) -> None:
    """Two rows meet at the origin, where nothing moves: no length tells which contacts touch, their forces do."""
    apart = 2.0**-exponent
    rows = np.array([[-1.0, 1.0, 0.0], [-1.0, 1.0 + apart, 0.0]])
    K, beside = np.diag([0.0, 0.0, float(stiff)]), np.array([0.0, 0.0, float(stiff)])
    problem = cq.ContactProblem(K, rows.T @ [2.0, 1.75] + beside, rows, [0.0, 0.0])
    right = cq.certify(problem, beside, [2.0, 1.75])
    assert right.passed
    assert right.proven
    off = 1e-9 / apart  # out of balance by 1e-9, where forces of two meet
    assert not cq.certify(problem, beside, [2.0 + off, 1.75 - off]).passed
    np.testing.assert_allclose(cq.solve(problem).normal_force, [2.0, 1.75], rtol=1e-7)


@pytest.mark.sampled(7)
@pytest.mark.parametrize("tied", [False, True], ids=["contacts", "ties"])
@pytest.mark.parametrize("stiff", [False, True], ids=["no stiffness", "one spring"])
@pytest.mark.parametrize("seed", range(8))
def test_wrong_forces_of_nearly_parallel_rows_are_refused_where_motions_are_free(
    seed: int, stiff: bool, tied: bool
) -> None:
    """Fewer rows than unknowns, two of them 4e-6 apart: what is out of balance by rounding is shared otherwise."""
    random = np.random.default_rng(seed)
    n, m = 5, 3
    rows = random.integers(-3, 4, (m, n)) + 4.0 * np.eye(m, n)
    rows[1] = rows[0]
    rows[1, 4] += 2.0**-18
    K, u = np.diag([0.0] * 4 + [float(stiff)]), np.zeros(n)
    forces = random.integers(1, 17, m) / 8
    limits = dict(tie=rows, tie_value=rows @ u) if tied else {}
    normal, gap = (np.zeros((0, n)), np.zeros(0)) if tied else (rows, rows @ u)
    problem = cq.ContactProblem(K, K @ u + rows.T @ forces, normal, gap, **limits)

    def judged(given: np.ndarray) -> cq.Certificate:
        contacts, ties = (np.zeros(0), given) if tied else (given, None)
        return cq.certify(problem, u, contacts, tie_force=ties)

    assert judged(forces).proven
    assert not judged(forces + np.array([1e-4, -1e-4, 0.0])).passed


@pytest.mark.parametrize("blocks", [1, 5])
def test_costs_that_balance_to_rounding_only_prove_nothing(blocks: int) -> None:
    """Three tied unknowns have costs of 2.8e-17 together in doubles. Rationals have no answer, whether the program is
    condensed or, with more than a dozen unknowns, sparse.
    """
    costs, rows, n = np.tile([0.1, 0.2, -0.3], blocks), np.kron(np.eye(blocks), [[1, -1, 0], [1, 0, -1]]), 3 * blocks
    program = cq.ContactProblem.from_qp(np.zeros((n, n)), costs, A=rows, b=np.zeros(2 * blocks))
    with pytest.raises(cq.NoEquilibrium, match="proven in rational numbers"):
        cq.exact(program, enclose=False)
    certificate = cq.solve(program).certificate
    assert certificate.passed
    assert not certificate.proven
    assert "balance but for 5e-17 of them" in certificate.reasons[0]


@pytest.mark.parametrize("row", [[0.3, 0.7, -0.9], [0.1, 0.7, -1.3]])
def test_a_program_passes_at_bounds_that_carry_the_rounding_of_its_costs(row: list[float]) -> None:
    """Costs are the force 1.1 of each row to rounding, whose 1e-17 bounds of 0.1 carry: the least energy is -6e-17.

    These bounds hold the unknowns, which do not lie far along a free motion: only its work is not excused.
    """
    rows, n = np.kron(np.eye(5), [row]), 15
    costs, bound = np.tile(np.round(np.multiply(-1.1, row), 6), 5), np.full(n, 0.1)
    data = dict(P=np.zeros((n, n)), q=costs, G=rows, h=np.zeros(5), lb=-bound, ub=bound)
    program = cq.ContactProblem.from_qp(**data)
    solution = cq.solve(program)
    assert solution.certificate.passed
    lower, upper = solution.certificate.energy_bounds or (np.inf, -np.inf)
    assert lower <= (least := float(cq.exact(program).energy)) <= upper
    assert -1e-16 < least < 0
    for moved in (1e-7, -1e-7):  # which costs, or penetrates
        other = solution.displacement + moved * np.eye(n)[2]
        assert not cq.certify(program, other, solution.normal_force).passed


@pytest.mark.parametrize("answer", [[1 / 3, 2 / 3, -1 / 3], [0.5, 0.0, 0.0], [1.0, 0.0, 1.0]])
def test_a_refused_answer_proves_nothing_where_rounding_of_costs_leaves_no_minimum(answer: list[float]) -> None:
    """The costs of the first and the last unknown differ by 4e-16, and the energy falls for ever."""
    program = cq.ContactProblem(
        np.zeros((3, 3)), [-1.0 - 2.0**-51, 0.0, -1.0], [[-2.0, -1.0, -1.0], [-1.0, 0.0, -1.0]], [-1.0, 0.0]
    )
    with pytest.raises(cq.NoEquilibrium):
        cq.exact(program)
    assert not cq.certify(program, answer, [0.0, 1.0]).proven
