"""What the enclosed energy rests on where K does not see everything."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import hilbert
from scipy.optimize import linprog

import contactqp as cq
from contactqp.certificate.bounds import REDUNDANT, Bounds, error_failures
from contactqp.certificate.energy_bounds import (
    _of_conflict,
    _taken_by_constraints,
    energy_bounds,
)
from contactqp.certificate.messages import energy_failures
from contactqp.certificate.uniqueness import unique_on
from contactqp.linalg.convexity import diagonal_dominance
from contactqp.linalg.equilibration import REACH, equilibrated, reach
from contactqp.linalg.extended import ExtendedAnswer
from contactqp.linalg.sparse_saddle import ClosedState, SparseSaddle
from contactqp.model.solution import Answer
from tests.linalg.test_crossover import corner, exact_energy


def problem_of(K: np.ndarray) -> cq.ContactProblem:
    n = len(K)
    return cq.ContactProblem(K, np.zeros(n), np.eye(1, n), [1.0])


def test_a_dominant_row_beside_one_that_is_not_has_nothing_to_spare() -> None:
    """K (1, -2) = 0, though the first row is dominant by one."""
    K = np.zeros((3, 3))
    K[:2, :2] = [[2.0, 1.0], [1.0, 0.5]]
    K[2, 2] = 3.0
    assert diagonal_dominance(problem_of(K)) == pytest.approx([0.0, 0.0, 3.0])


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(20))
def test_what_is_left_of_the_stiffness_is_semidefinite(seed: int) -> None:
    random = np.random.default_rng(seed)
    B = random.normal(size=(8, 8)) * (random.random((8, 8)) < 0.2)
    K = B.T @ B + np.diag(random.choice([0.0, 0.5, 4.0], 8))
    dominance = diagonal_dominance(problem_of(K))
    assert np.all(dominance >= 0)
    assert np.min(np.linalg.eigvalsh(K - np.diag(dominance))) > -1e-12


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("spread", [1e-9, 1e-5, 1e-2])
def test_errors_are_relative_to_the_energy_norms_where_nothing_is_condensed(seed: int, spread: float) -> None:
    """|u - u*|_K / |u*|_K and |l - l*|_W / |l*|_W, W = E K^-1 E', of answers spoiled everywhere, in any units."""
    rng = np.random.default_rng(seed)
    side = 24
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side))
    one, n = sp.identity(side), side * side
    unit = 2.0 ** rng.integers(-30, 30)
    K = sp.csr_matrix(sp.kron(one, chain) + sp.kron(chain, one)) * unit
    rows = sp.vstack([sp.identity(n), 3.0 * sp.identity(n, format="csr")[::5]], format="csr")
    gap = 0.02 * (1 + 0.3 * rng.random(n))
    problem = cq.ContactProblem(K, np.full(n, 1e-3 * unit), rows, np.r_[gap, 3.0 * gap[::5]])
    truth = cq.solve(problem, condense=True)
    assert 20 < np.count_nonzero(truth.normal_force) < n
    u = truth.displacement * (1 + spread * rng.normal(size=n))
    force = truth.normal_force * (1 + spread * rng.normal(size=problem.contacts))
    found = energy_bounds(problem, Answer(u, force, None, np.zeros(0)))

    def strain(v: np.ndarray) -> float:
        return float(np.sqrt(v @ (K @ v)))

    def response(push: np.ndarray) -> float:
        load = rows.T @ push
        return float(np.sqrt(load @ np.linalg.solve(K.toarray(), load)))

    error = strain(u - truth.displacement) / strain(truth.displacement)
    pushed = response(force - truth.normal_force) / response(truth.normal_force)
    assert found.energy_error is not None
    assert found.force_error is not None
    assert error * (1 - 1e-6) <= found.energy_error <= error * (1 + 1e-3) + 1e-9
    assert pushed * (1 - 1e-6) <= found.force_error <= pushed * (1 + 1e-3) + 1e-9


def test_the_error_of_a_strain_is_relative_to_strain_where_something_moves_freely() -> None:
    """The first unknown has no stiffness and makes room for the contact: the others are where the load alone takes
    them, and the strain of the answer is off by a hundredth.
    """
    K = np.diag([0.0, 11.0, 10.0, 8.0])
    free = np.array([0.0, 1.0, -0.5, 0.25])
    problem = cq.ContactProblem(K, K @ free, [[-1.0, 0.5, 0.0, 0.5]], [0.625])
    answer = free * 0.99
    certificate = cq.certify(problem, answer, [0.0])
    strain = np.sqrt((answer - free) @ K @ (answer - free) / (free @ K @ free))
    assert certificate.energy_error >= strain * (1 - 1e-12)
    assert certificate.energy_error <= 2 * strain


@pytest.mark.slow
def test_the_bound_of_a_stiff_chain_beside_a_bare_unknown_counts_the_rounding_of_its_strain():
    """Of a chain of 5.6e7 on springs of 800 doubles know |u|_K to ten digits; the bound is above the error."""
    K = np.zeros((4, 4))
    K[:3, :3] = [[55837106, -55836672, 0], [-55836672, 55836674.421875, -1.15625], [0, -1.15625, 881.15625]]
    normal = np.array([[-0.5, 0.0, -0.25, 1.25], [0.25, 0.75, 1.0, -1.0]])
    problem = cq.ContactProblem(
        stiffness=K, load=[-41877.88384375, 41750.320410156, 0.0, 0.234375], normal=normal, gap=[1.25, 0.3125]
    )
    right = cq.exact(problem)
    u, exact_K = np.array(right.displacement), np.array([[Fraction(x) for x in row] for row in K.tolist()])
    doubles, pushed = u.astype(float), np.array(right.normal_force).astype(float)
    for seed in range(20):
        off = np.random.default_rng(seed).normal(size=4) * 1e-6 + 1e-3 * doubles
        judged = cq.certify(problem, doubles + off, pushed)
        v = np.array([Fraction(x) for x in (doubles + off).tolist()]) - u
        square = (v @ exact_K @ v) / (u @ exact_K @ u)
        assert Fraction(judged.energy_error) ** 2 >= square * (1 - Fraction(1, 10**14))


@pytest.mark.parametrize("length", [1.0, 4.0**10], ids=["metres", "micrometres"])
def test_where_nothing_is_strained_and_all_is_seen_the_error_is_an_energy(length: float) -> None:
    """A spring of 4 between two walls that touch: u* = 0, and 1e-3 beside it costs |du|_K = 2e-3, whatever pushes."""
    walls = np.array([[1.0], [-1.0]])
    problem = cq.ContactProblem([[4.0]], [100.0 * length], walls, [0.0, 0.0])
    found = energy_bounds(
        problem, Answer(np.array([1e-3 * length]), np.array([100.0 * length, 0.0]), None, np.zeros(0))
    )
    assert found.energy_error == pytest.approx(2e-3 * length, rel=1e-12)
    assert (found.energy_scale, found.by_energy) == (0.0, False)


@pytest.mark.parametrize("length", [1.0, 4.0**10], ids=["metres", "micrometres"])
def test_where_nothing_is_strained_and_not_all_is_seen_the_error_is_relative_to_the_work_of_the_load(
    length: float,
) -> None:
    """A load of 2 takes two joined boards, loose against each other, 3 down to a stop beside a spring at rest.

    f'u* = 6, so energies are relative to sqrt(12); strained by 1e-3 alone the spring costs |du|_K = 2e-3.
    """
    K = np.diag([4.0, 0.0, 0.0])
    tie = np.array([[0.0, 1.0, 1.0]])
    problem = cq.ContactProblem(
        K, [0.0, 2.0, 2.0], [[0.0, 1.0, 1.0]], [3.0 * length], tie=tie, tie_value=[3.0 * length]
    )
    answer = Answer(np.array([1e-3, 1.0, 2.0]) * length, np.array([0.0]), None, np.array([2.0]))
    found = energy_bounds(problem, answer)
    assert found.by_energy
    assert found.energy_error is not None
    assert 2e-3 * length / np.sqrt(12.0 * length) <= found.energy_error <= 2.01e-3 * length / np.sqrt(12.0 * length)


def test_bounds_of_an_unknown_end_what_a_residual_may_gain() -> None:
    """-2 <= x <= 6, y >= -1, z free, 2 w = 8: towards a bound as far as that, away from all of them REACH."""
    size, limits = 4, dict(ub=np.array([6.0, np.inf, np.inf, np.inf]), lb=np.array([-2.0, -1.0, -np.inf, -np.inf]))
    problem = cq.ContactProblem.from_qp(np.zeros((size, size)), np.zeros(size), A=[[0, 0, 0, 2.0]], b=[8.0], **limits)
    u, far = np.array([5.0, 0.0, 10.0, 4.0]), REACH * np.array([15.0, 10.0, 20.0, 14.0])
    assert reach(problem, u, np.ones(size)) == pytest.approx([1.0, far[1], far[2], 0.0], abs=1e-14)
    assert reach(problem, u, -np.ones(size)) == pytest.approx([7.0, 1.0, far[2], 0.0], abs=1e-14)
    assert np.all(reach(problem, u + 10.0, np.ones(size)) >= 0.0)


def test_an_unknown_that_runs_away_hides_no_penetration() -> None:
    """Where the truth does not move, the solution nearest to a wrong answer was one with a bare unknown at 1e22."""
    own = np.array(
        [4129.859375, 4130.9140625, 4130.0703125, 4131.5625, 4133.40625, 4133.625, 4132.859375, 4130.09375, 0]
    )
    beside = np.array([1.859375, 1.0546875, 0.0, 1.5625, 2.859375, 2.765625, 2.09375, 0.0])
    K = (np.diag(own) - np.diag(beside, 1) - np.diag(beside, -1)) / 4096
    normal, unit = np.zeros((3, 9)), np.eye(9)
    normal[0], normal[1], normal[2] = (unit[i] / 2 - unit[j] / 2 for i, j in ((2, 4), (0, 7), (8, 1)))
    load = 0.6875 * (unit[0] - unit[7]) + 0.5625 * (unit[2] - unit[4])
    problem = cq.ContactProblem(K, load, normal, [0.0, 0.0, 1536.0], tie=[unit[0]], tie_value=[0.0])
    right = cq.solve(problem)
    assert right.normal_force == pytest.approx([1.125, 1.375, 0.0])
    ignored = cq.solve(problem.with_contacts(np.array([1, 2]))).displacement
    found = cq.certify(problem, ignored, [0.0, 1.375, 0.0], tie_force=[0.0])
    assert not found.passed
    assert found.force_bound is None or found.force_bound[0] >= 1.125 * (1 - 1e-9)
    assert found.energy_error is None or found.energy_error > 1.0


@pytest.mark.sampled(4)
@pytest.mark.parametrize("part", [0.0, 1e-8, 3e-6, 1e-5])
def test_the_displacement_of_a_slender_beam_is_judged_where_its_energy_is(part: float) -> None:
    """Its factors tell that it is held, though forces move it as far as they move what nothing holds."""
    count = 500
    h = 1.0 / count
    element = 1.0 / h**3 * np.array([
        [12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
        [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h],
    ])  # fmt: skip
    K = np.zeros((2 * count + 2,) * 2)
    for k in range(count):
        K[2 * k : 2 * k + 4, 2 * k : 2 * k + 4] += element
    K, load = K[2:, 2:], np.tile([-h, 0.0], count)
    stop = np.zeros((1, 2 * count))
    stop[0, -2] = -1.0
    problem = cq.ContactProblem(sp.csr_array(K), load, stop, [0.05])
    solution = cq.solve(problem)
    x = np.arange(1, count + 1) * h
    bump = np.column_stack([np.sin(np.pi * x) ** 4, 4 * np.pi * np.sin(np.pi * x) ** 3 * np.cos(np.pi * x)]).ravel()
    u = solution.displacement
    u = u + part * np.sqrt(u @ (K @ u) / (bump @ (K @ bump))) * bump
    known = energy_bounds(problem, Answer(u, solution.normal_force, None, np.zeros(0)))
    assert known.by_energy
    assert known.apart == pytest.approx(part, rel=1e-2, abs=1e-8)
    assert any(error_failures(known, 1e-6, 0.0)) is (part > 1e-6)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(12))
def test_what_an_unbalanced_force_may_gain_is_bounded_by_the_constraints_that_stop_it(seed: int) -> None:
    """No admissible point gains more, and the bound is what the best of them gains: the linear program's own value."""

    rng = np.random.default_rng(seed)
    n, m, k = 8, 12, int(rng.integers(0, 3))
    u = rng.integers(-3, 4, n).astype(float)
    E, A = rng.integers(-3, 4, (m, n)).astype(float), rng.integers(-2, 3, (k, n)).astype(float)
    rows = np.vstack([E, np.eye(n), -np.eye(n)])  # within a box, so that all motions are stopped
    gap = np.r_[E @ u + rng.integers(0, 2, m), u + 4.0, 4.0 - u]
    load = rng.integers(-5, 6, n) * 1e-3
    problem = cq.ContactProblem(np.zeros((n, n)), load, rows, gap, tie=A, tie_value=A @ u)
    answer = ExtendedAnswer.of(Answer(u, np.zeros(len(rows)), None, np.zeros(k)))
    state = ClosedState.of(problem, rows @ u == gap, answer)
    most = -linprog(-load, A_ub=rows, b_ub=gap - rows @ u, A_eq=A, b_eq=np.zeros(k), bounds=(None, None)).fun
    bound = _taken_by_constraints(state, diagonal_dominance(problem))
    assert bound >= most * (1 - 1e-12)
    assert bound == pytest.approx(most, rel=1e-9, abs=1e-15)


@pytest.mark.slow
def test_a_stationary_point_whose_elastic_energy_is_negative_has_no_bounds() -> None:
    """K is 1e-14 short of semidefinite, which its own rounding could be: at rest the energy is less than at K u = f."""
    z = np.array([0.0, 1.0, -1.0, 2.0, 2.0])
    across = np.eye(5) - np.outer(z, z) / (z @ z)
    K = across @ np.diag([3.0, 5.0, 7.0, 9.0, 4.0]) @ across
    K = (K + K.T) / 2 - 1e-14 * np.outer(z, z)
    problem = cq.ContactProblem(K, z / 3, np.eye(1, 5), [5.0])
    u = np.linalg.solve(K, z / 3)
    exact = [[Fraction(entry) for entry in row] for row in K.tolist()]
    moved = [Fraction(entry) for entry in u.tolist()]
    assert sum(a * row[j] * moved[j] for a, row in zip(moved, exact, strict=True) for j in range(5)) < 0
    found = energy_bounds(problem, Answer(u, np.zeros(1), None, np.zeros(0)))
    assert found.energy_bounds is None
    assert found.energy_error is None
    with pytest.raises(cq.ContactQPError):
        cq.solve(problem)


@pytest.mark.slow
@pytest.mark.parametrize("shift", [0.1, 1.0 / 3.0, 7.3])
def test_the_rounding_of_a_rigid_motion_is_no_negative_energy(shift: float) -> None:
    """A chain between bounds that only asks to be straight: u' K u is zero, and its rounding has either sign."""
    n = 40
    D = np.diff(np.eye(n), axis=0)
    tie = np.zeros((1, n))
    tie[0, :3] = 1.0
    chain = cq.ContactProblem(D.T @ D, np.zeros(n), np.eye(n), np.full(n, 8.0), tie=tie, tie_value=[3 * shift])
    straight = np.full(n, shift)
    assert energy_bounds(chain, Answer(straight, np.zeros(n), None, np.zeros(1))).energy_bounds is not None
    assert cq.solve(chain, condense=False).certificate.proven


def test_what_is_left_of_a_solution_is_in_the_distance_from_it() -> None:
    """A soft spring, found to a part of the largest strain, beside stiff ones and an unknown without stiffness."""
    stiffness = 2.0 ** np.array([-18, -6, -48, -6])
    K = np.diag([*stiffness * [1.0, 1.25, 1.0, 1.0], 0.0])
    E = [[0, 0, 1 / 64, 1 / 32, 0], [0, 16, 0, 0, 8], [0, 0, 0, 0, -1 / 1024]]
    problem = cq.ContactProblem(K, [24 * stiffness[0], 0, 0, 0, -3], E, [1, 0, 0])
    moved = np.array([2.6286, 0.01161, 0.79602, -1.36299, -1.20789])
    answer = Answer(np.array([24.0, 0, 0, 0, 0]) + moved, np.array([0.0, 0.0, 3072.0]), None, np.zeros(0))
    error = np.sqrt(moved @ K @ moved / (24.0**2 * stiffness[0]))
    bound = energy_bounds(problem, answer).energy_error
    assert bound is not None
    assert error <= bound <= 1.00001 * error


def without_forces(size: int) -> cq.ContactProblem:
    """A chain of bare unknowns between 1 and 2, each a little longer than the next, and stiff ones that may make up.

    The least energy is zero: x_i = x_0 a_0 / a_i is within the bounds and leaves the stiff unknowns where they are.
    """
    a, rows = 10.0 + 2.0 * np.arange(size) / size, size - 1
    chain = sp.diags([a[:-1], -a[1:]], [0, 1], shape=(rows, size))
    stiff = sp.diags([2.0 * np.ones(rows), -np.ones(rows - 1), -np.ones(rows - 1)], [0, 1, -1])
    return cq.ContactProblem.from_qp(
        sp.block_diag([sp.csr_matrix((size, size)), stiff]),
        np.zeros(size + rows),
        A=sp.hstack([chain, sp.identity(rows)]),
        b=np.zeros(rows),
        lb=np.repeat([1.0, 0.0], [size, rows]),
        ub=np.repeat([2.0, 1.5], [size, rows]),
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", ["active-set", "clarabel"])
def test_forces_that_rounding_leaves_where_there_are_none_are_beside_nothing(method: str) -> None:
    """Forces of 1e-48 were compared with each other, and the answer refused for being off by a tenth of them."""
    problem = without_forces(100)
    solution = cq.solve(problem, method)
    assert solution.certificate.passed
    assert solution.energy == pytest.approx(0.0, abs=1e-25)


def test_a_force_where_there_are_none_is_refused() -> None:
    problem = without_forces(30)
    solution = cq.solve(problem)
    force = solution.normal_force.copy()
    force[[0, -1]] += 1e-8
    assert not cq.certify(problem, solution.displacement, force, tie_force=solution.tie_force).passed


@pytest.mark.parametrize(("ends", "unique"), [(2.0, True), (1.0, False)])
def test_a_soft_chain_is_told_from_a_free_one_by_refinement(
    monkeypatch: pytest.MonkeyPatch, ends: float, unique: bool
) -> None:
    """A membrane's third factors, of a saddle point with a smaller diagonal, took the memory of a linear solve."""
    n, nearer = 600, []
    K = sp.diags_array([-np.ones(n - 1), np.r_[ends, np.full(n - 2, 2.0), ends], -np.ones(n - 1)], offsets=[-1, 0, 1])
    problem = equilibrated(cq.ContactProblem(K, np.zeros(n), np.eye(1, n), [1.0]))[0]
    monkeypatch.setattr("contactqp.certificate.uniqueness.SparseSaddle", nearer_saddle(nearer))
    state = ClosedState.of(problem, np.zeros(1, dtype=bool), ExtendedAnswer.at_rest(problem))
    assert unique_on(state).displacement is unique
    assert len(nearer) == 1 - unique


def nearer_saddle(made: list[float]) -> Callable[..., SparseSaddle]:
    """Saddle points that are listed as they are made."""

    def counted(problem: cq.ContactProblem, closed: np.ndarray, regularisation: float) -> SparseSaddle:
        made.append(regularisation)
        return SparseSaddle(problem, closed, regularisation)

    return counted


@pytest.mark.slow
def test_differences_of_thousands_of_unknowns_have_forces_of_their_own() -> None:
    """Isotonic regression: blocks of equal values by pooling (Barlow and others 1972), forces by sums."""
    n = 6000
    data = np.linspace(0.0, 3.0, n) + np.random.default_rng(3).normal(size=n)
    blocks: list[tuple[float, int]] = []
    for value in data:
        blocks.append((value, 1))
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            (last, many), (before, more) = blocks.pop(), blocks.pop()
            blocks.append(((last * many + before * more) / (many + more), many + more))
    fit = np.concatenate([np.full(size, value) for value, size in blocks])
    rows = sp.diags_array([np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n)).tocsr()
    problem = cq.ContactProblem(sp.eye_array(n).tocsr(), data, rows, np.zeros(n - 1))
    force = np.maximum(np.cumsum(data - fit)[:-1], 0.0)
    found = energy_bounds(problem, Answer(fit, force, None, np.zeros(0)))
    assert found.force_bound is not None
    assert not found.reasons
    assert np.max(found.force_bound) < 1e-10 * np.max(force)
    pushing = int(np.argmax(force))
    twice = problem.replace(normal=sp.vstack([rows, rows[[pushing]]]), gap=np.zeros(n))
    half = np.append(force, 0.0)
    half[[pushing, -1]] = force[pushing] / 2
    shared = Answer(fit, half, None, np.zeros(0))
    assert energy_bounds(twice, shared).reasons == (f"force_bound: {REDUNDANT}",)


def test_an_energy_that_is_more_than_nothing_is_judged_by_itself() -> None:
    """Forces on soft unknowns made 12 nothing beside an energy of 2698, and an answer above it by that passed."""
    wide = Bounds(energy_bounds=(2698.0, 2710.0), energy_size=2698.0, by_energy=True)
    assert list(energy_failures(wide, 1e-9, 12.5))
    assert not list(energy_failures(replace(wide, energy_bounds=(2698.0, 2698.0 + 1e-6)), 1e-9, 12.5))
    assert not list(energy_failures(replace(wide, energy_bounds=(0.0, 1e-3), energy_size=1e-4), 1e-9, 12.5))


def test_wide_bounds_beside_a_conflict_refuse() -> None:
    """Rows that conflict by rounding leave bounds of the energy beside, which tell a wrong answer all the same."""
    wide = Bounds(energy_bounds=(2586.0, 2897.0), energy_size=2742.0, by_energy=True)
    assert list(energy_failures(_of_conflict(wide, 4.5e-19, near=True), 1e-9, 0.0))


def test_bounds_of_the_energy_are_rounded_outward() -> None:
    """Both ends were one double beneath J* by 7e-17, and the energy of an answer lay outside of its own bounds."""
    rows = np.round(hilbert(8) * 2**20) / 2**20
    load = rows @ np.ones(8)
    solution = cq.solve(cq.ContactProblem.from_qp(np.zeros((8, 8)), load, G=-rows, h=-load))
    least, found = sum(Fraction(x) for x in load.tolist()), solution.certificate.energy_bounds
    assert found is not None
    assert Fraction(found[0]) < least < Fraction(found[1])
    assert found[0] < solution.energy < found[1]
    assert found[1] - found[0] < 1e-14 * abs(solution.energy)


@pytest.mark.parametrize("seed", [1, 13, 56, 205])
def test_a_least_energy_of_zero_is_no_reason_to_refuse(seed: int) -> None:
    """No unknown with a cost is moved, so that all terms of the energy vanish: one in four of these was refused.

    The energies are compared with the largest load times the largest length that ties impose; `cq.exact` has 0 for all.
    """
    rng = np.random.default_rng(seed)
    unknowns = int(rng.integers(12, 30))
    ties = np.zeros((unknowns // 3, unknowns))
    for row in ties:
        at = rng.choice(unknowns, 4, replace=False)
        row[at] = np.round(rng.uniform(-9, 9, 4) * 10.0 ** rng.integers(-5, 4, 4), 6)
    moved = rng.random(unknowns) < 0.4
    x = np.round(rng.uniform(0, 100, unknowns), 1) * moved
    cost = np.where(moved, 0.0, np.round(rng.uniform(0, 10, unknowns), 1))
    nothing = np.zeros((unknowns, unknowns))
    program = cq.ContactProblem.from_qp(nothing, cost, A=ties, b=np.round(ties @ x, 6), lb=np.zeros(unknowns))
    solution = cq.solve(program)
    lower, upper = solution.certificate.energy_bounds
    assert solution.certificate.proven
    assert lower <= 0.0 <= upper
    assert abs(solution.energy) <= upper < 1e-9
    i = int(np.flatnonzero(cost)[0])
    wrong = np.where(np.arange(unknowns) == i, 1e-3, solution.displacement)
    assert not cq.certify(program, wrong, solution.normal_force, tie_force=solution.tie_force).passed


@pytest.mark.parametrize("far", [1e4, 1e8])
def test_a_far_wall_does_not_hide_that_a_vertex_meets_planes_apart(far: float) -> None:
    """Nine planes that conflict by rounding do so by less than 1e-20 of the way to a wall, and three of them do not."""
    problem, point, forces = corner(0)
    point, gap = point.copy(), problem.gap.copy()
    point[-1] = gap[-1] = far
    farther = problem.replace(gap=gap)
    certificate = cq.certify(farther, point, forces)
    assert certificate.passed
    assert certificate.proven
    assert certificate.energy_bounds is not None
    lower, upper = (Fraction(bound) for bound in certificate.energy_bounds)
    exact = exact_energy(problem) - Fraction(far)
    rounding = Fraction(2) ** -52 * abs(exact)
    assert lower - rounding <= exact <= upper + rounding
    assert upper - lower <= Fraction(1, 10**13) * abs(exact)
    assert not cq.certify(farther, point * (1 + 1e-6), forces).passed
