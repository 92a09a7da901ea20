"""Bounds are never below the true error: small problems whose errors are known by hand, in the corners of rounding."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from benchmarks.judging import exact_truth
from benchmarks.problem_families import family
from contactqp.certificate import bounds as bounds_module
from contactqp.certificate.admissible_pair import Undecided, of_penetration
from contactqp.certificate.figures import force_norm
from contactqp.linalg.condensation import condense
from contactqp.linalg.extended import extend
from contactqp.linalg.refinement import polish

CHAIN = 100.0 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])


def chain(**changes):
    """Three nodes that float, the first held by a tie, the others before walls; pushed against both."""
    data = dict(stiffness=CHAIN, load=[0.0, 3.0, 5.0], normal=[[0, 1, 0], [0, 0, 1]], gap=[0.01, 0.02], tie=[[1, 0, 0]])
    return cq.ContactProblem(**(data | changes))


def test_forces_of_bodies_that_only_ties_hold_are_bounded_in_their_tied_compliance():
    problem = chain()
    force, tie = np.array([3.0, 4.0]), np.array([1.0])
    W = np.array([[1.0, 1.0], [1.0, 2.0]]) / 100  # by hand: the first node is the ground
    change = np.array([1e-3, -2e-3])
    certificate = cq.certify(problem, [0.0, 0.01, 0.02], force + change, tie_force=tie)
    error = np.sqrt(change @ W @ change) / np.sqrt(force @ W @ force)
    assert error * (1 - 1e-12) <= certificate.force_error <= 1.001 * error
    assert cq.certify(problem, [0.0, 0.01, 0.02], force, tie_force=tie).passed


def test_with_and_without_ties_the_larger_force_error_is_the_bound():
    K = CHAIN + np.diag([100.0, 0.0, 0.0])
    problem = chain(stiffness=K)
    force, change = np.array([3.0, 4.0]), np.array([2e-3, -2e-3])
    certificate = cq.certify(problem, [0.0, 0.01, 0.02], force + change, tie_force=[1.0])
    E = np.array([[0, 1, 0], [0, 0, 1.0]])
    for W in (E @ np.linalg.solve(K, E.T), np.array([[1.0, 1.0], [1.0, 2.0]]) / 100):
        assert certificate.force_error >= np.sqrt(change @ W @ change) / np.sqrt(force @ W @ force) * (1 - 1e-12)


def test_a_large_free_motion_does_not_hide_a_small_strain():
    """Moved by 2 along the motion that nothing resists, strained by 1e-13: v'Kv drowns in the rounding of Kv."""
    problem = cq.ContactProblem(CHAIN, [1.0, 0.0, -1.0], [[0, 0, 1.0]], [10.0])
    truth = np.array([0.01, 0.0, -0.01])
    moved = truth + 2.0 + np.array([0.0, 1e-13, 0.0])
    strain = np.diff(moved - truth)  # exact: numbers of like size are subtracted
    error = np.sqrt(100 * strain @ strain / (truth @ CHAIN @ truth))
    certificate = cq.certify(problem, moved, [0.0])
    assert error <= certificate.energy_error <= 100 * error
    assert certificate.passed


def braced_square(stiffness: float) -> np.ndarray:
    """Four nodes, every two joined by a bar: rigid motions cost no energy but that of rounded numbers."""
    points, K = np.array([[0, 0], [1, 0], [0, 1], [1, 1.0]]), np.zeros((8, 8))
    for a in range(4):
        for b in range(a):
            along = (points[a] - points[b]) / np.hypot(*(points[a] - points[b]))
            row = np.zeros(8)
            row[2 * a : 2 * a + 2], row[2 * b : 2 * b + 2] = along, -along
            K += stiffness * np.outer(row, row)
    return K


@pytest.mark.sampled(6)
@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e6])
@pytest.mark.parametrize("strained", [True, False])
def test_a_right_answer_elsewhere_along_a_free_motion_is_right(strained: bool, unit: float) -> None:
    """Two seats carry the body and let it slide: the energy that rounding gives a shift is no error; a strain is."""
    load, seats = np.zeros(8), np.zeros((2, 8))
    load[[1, 3, 5, 7] if strained else [1, 3]] = -500.0 * unit
    seats[0, 1] = seats[1, 3] = -1.0
    problem = cq.ContactProblem(braced_square(2.1e8 * unit), load, seats, [1e-3, 1e-3])
    found = cq.solve(problem)
    for shift in (1e-6, 1e-3, 1.0):
        moved = found.displacement.copy()
        moved[::2] += shift
        assert cq.certify(problem, moved, found.normal_force).passed
        moved[4] += 1e-6 * np.max(abs(found.displacement[1::2]))  # 1e-6 of the fall, as a strain
        assert not cq.certify(problem, moved, found.normal_force).passed
        moved[4] = found.displacement[4] + shift
        assert not cq.certify(problem, moved, found.normal_force * [1 + 2e-6, 1 - 2e-6]).passed
    note = cq.certify(problem, found.displacement + np.tile([1.0, 0.0], 4), found.normal_force).notes
    assert any("motions that nothing resists" in line for line in note) == strained  # nothing to be relative to


def test_a_candidate_far_away_does_not_make_the_truth_small() -> None:
    """A candidate that has moved by 1e6 rounds away the strain of the truth; the truth's own is known all the same."""
    problem = cq.ContactProblem(braced_square(1e2), np.tile([0.0, -1e-9], 4), np.eye(8)[[1, 3]] * -1.0, [1e-5, 1e-5])
    truth = cq.solve(problem)
    far = truth.displacement + 5e6 * np.tile([0.3, 1.0], 4)
    far[4] += 1e-6
    apart = far - truth.displacement
    strain = np.sqrt(apart @ problem.stiffness @ apart)
    size = np.sqrt(truth.displacement @ problem.stiffness @ truth.displacement)
    found = cq.certify(problem, far, truth.normal_force)
    assert size > 0
    assert found.energy_error >= 0.5 * strain / size > 1e3
    assert not found.passed


def test_what_is_open_or_closed_by_rounding_is_in_the_bounds():
    """Penetrated by one unit in the last place: the force that closes it, 2 * 2^-53, is the error of none."""
    problem = cq.ContactProblem([[2.0]], [2.0], [[1.0]], [1.0 - 2.0**-53])
    certificate = cq.certify(problem, [1.0], [0.0])
    assert certificate.force_bound[0] >= 2.0**-52
    assert certificate.force_error >= np.sqrt(0.5) * 2.0**-52
    assert certificate.energy_error >= 2.0**-53
    assert certificate.passed


def test_the_closed_contacts_are_searched_for_where_corrections_of_the_set_go_in_circles():
    """Nearly redundant contacts and an answer with no force: the bound is the error, not the gap of energies."""
    n = 6
    K = np.diag(np.full(n, 2.0)) - np.eye(n, k=1) - np.eye(n, k=-1)
    rng = np.random.default_rng(3)
    rows = np.ones((n, n)) + 1e-5 * rng.normal(size=(n, n))
    problem = cq.ContactProblem(K, rng.normal(size=n) + 1.0, rows, 0.1 + 1e-6 * rng.normal(size=n))
    solution = cq.solve(problem)
    free = np.linalg.solve(K, problem.load)
    error = free - solution.displacement
    true = np.sqrt(error @ K @ error) / np.sqrt(solution.displacement @ K @ solution.displacement)
    certificate = cq.certify(problem, free, np.zeros(n))
    assert certificate.energy_error == pytest.approx(true, rel=1e-6)
    assert not certificate.passed


def test_a_displacement_that_doubles_cannot_hold_is_refused():
    """A body moved by 5 onto a spring of 1e13 by a force of 0.1: rounding 5 to doubles strains it by percents."""
    K = np.zeros((3, 3))
    K[0, 0] = 2.0**43
    K[1:, 1:] = 2.0**47 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    problem = cq.ContactProblem(K, [0.0, 0.0, -0.1], [[1.0, -1.0, 0.0]], [5.0])
    at = np.array([-0.1 / 2**43, -5.0, -5.0])  # 5.0000000000000114 in truth, and a strain of 7e-16
    certificate = cq.certify(problem, at, [0.1])
    assert certificate.energy_error > 1e-6
    assert not certificate.passed


def test_no_strain_but_that_of_rounding_is_no_error():
    """A spring whose ends a tie moves together has no energy in truth; its printed stiffness has 1e-34 of it."""
    K = [[2e-4, -0.2], [-0.2, 200.0]]
    problem = cq.ContactProblem(K, [0.0, 0.0], -np.eye(2)[::-1], [0.0, 0.0], tie=[[0.01, 10.0]], tie_value=[0.1])
    solution = cq.solve(problem)
    assert solution.displacement == pytest.approx([5.0, 0.005], rel=1e-12)
    assert solution.certificate.passed
    strained = solution.displacement + np.array([1e-4, -1e-7])
    assert not cq.certify(problem, strained, solution.normal_force, tie_force=solution.tie_force).passed


def test_a_floating_body_is_found_behind_a_stiffness_that_rounding_hides():
    """Condensed onto its ends, a chain of springs 1e9 around one of 14 keeps 14 to eight digits: a pivot of 3e-8."""
    springs = np.array([4.6875e5, 9.63e6, 9.65e8, 8.25e6, 7.59e8, 13.625, 3.6875e6])
    K = np.zeros((9, 9))
    for i, k in enumerate(springs):
        K[i : i + 2, i : i + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    K[8, 8] = 100.0
    load = np.zeros(9)
    load[0], load[8] = 2.0, -1.0
    rows = np.zeros((2, 9))
    rows[0, 0], rows[1, 7], rows[1, 8] = -1.0, 1.0, -1.0
    problem = cq.ContactProblem(K, load, rows, [1.0, 0.25])
    assert condense(problem).rigid.count == 1
    assert cq.solve(problem).normal_force == pytest.approx([0.0, 2.0], rel=1e-13)


@pytest.mark.parametrize("force", [1e-320, 1e-200])
def test_forces_whose_squares_are_zero_have_a_norm(force):
    """No division of nothing by nothing; a warning would fail here."""
    problem = cq.ContactProblem(stiffness=[[3.0, 0.0], [0.0, 5.0]], load=[6.0, 0.0], normal=[[0.0, 1.0]], gap=[0.5])
    norm, rounding = force_norm(problem, condense(problem), extend(np.array([force])))
    assert 0 <= norm < 1e-160
    assert 0 <= rounding < 1e-160


def _floating_triangle(stiffness: float, gap: float, force: float) -> cq.ContactProblem:
    """Three bars at odd angles, loaded where they land: K z of a rigid motion is rounding, and u* only moves."""
    at = np.array([[0.0, 0.0], [1.3, 0.1], [0.4, 0.9]])
    K = np.zeros((6, 6))
    for i, j in ((0, 1), (1, 2), (0, 2)):
        d = np.concatenate([at[i] - at[j], at[j] - at[i]]) / np.linalg.norm(at[i] - at[j])
        K[np.ix_([2 * i, 2 * i + 1, 2 * j, 2 * j + 1], [2 * i, 2 * i + 1, 2 * j, 2 * j + 1])] += np.outer(d, d)
    rows = np.zeros((2, 6))
    rows[0, 1] = rows[1, 3] = -1.0
    load = np.array([0.0, -1.0, 0.0, -0.7, 0.0, 0.0]) * force
    return cq.ContactProblem(stiffness * K, load, rows, [gap, 1.001 * gap])


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("stiffness", "gap", "force"),
    [(3.1e2, 1e-6, 1e-3), (3.1e2, -0.02, 1e3), (3.1e2, 0.83, 1e6), (7.7e10, 1e-6, 1e3), (7.7e10, -1e-9, 1.0)],
)
def test_a_body_whose_stiffness_is_singular_to_rounding_only_may_move_without_strain(stiffness, gap, force):
    problem = _floating_triangle(stiffness, gap, force)
    for method in ("active-set", "clarabel"):
        solution = cq.solve(problem, method)
        assert solution.normal_force == pytest.approx([force, 0.7 * force], rel=1e-9)
        assert solution.certificate.proven
    u, push = solution.displacement, solution.normal_force
    strained = u + np.array([0.0, 0.0, 0.0, 0.0, 1e-6 * max(abs(gap), force / stiffness), 0.0])
    assert not cq.certify(problem, strained, push).passed
    assert not cq.certify(problem, u, push * [1.0, 1 + 1e-5]).passed


def test_forces_that_balance_the_rounding_of_a_stiffness_with_the_load_are_refused():
    """Moved by 0.83 m, bars of 7.7e10 leave 1e-5 N of rounding, and loads of 1e-3 N would be carried to a percent."""
    problem = _floating_triangle(7.7e10, 0.83, 1e-3)
    solution = cq.solve(problem)
    assert solution.normal_force == pytest.approx([1e-3, 0.7e-3], rel=1e-12)
    assert "zero along the rigid motions" in solution.certificate.notes[-1]
    rounding = problem.stiffness @ solution.displacement
    carried = np.linalg.lstsq(problem.normal.toarray().T, problem.load - rounding, rcond=None)[0]
    assert abs(np.sum(carried) - 1.7e-3) > 1e-6 * 1.7e-3
    refused = cq.certify(problem, solution.displacement, carried)
    assert any("balance: the forces on a body do not balance" in failure for failure in refused.failures)


@pytest.mark.parametrize("contrast", [1.0, 1e6, 1e12])
@pytest.mark.parametrize("springs", [3, 60])
def test_the_norm_of_forces_on_a_floating_chain_is_right_to_its_rounding(springs, contrast):
    """Two contacts press a chain from both ends: |d|_W^2 = d^2 sum 1/k, whichever precision its residuals need."""
    k = np.geomspace(1.0, contrast, springs)
    K = sp.lil_matrix((springs + 1, springs + 1))
    for i, stiffness in enumerate(k):
        K[i : i + 2, i : i + 2] += stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    ends = np.zeros((2, springs + 1))
    ends[0, 0], ends[1, -1] = -1.0, 1.0
    problem = cq.ContactProblem(
        K.tocsc(), np.zeros(springs + 1), ends, [0.0, 0.0], near_null_space=np.ones((springs + 1, 1))
    )
    way = condense(problem)
    assert way.rigid.count == 1
    for force in (1.0, 1e-9, 1.0):  # the first tells how refinement goes on, the others know
        norm, rounding = force_norm(problem, way, extend(np.full(2, force)))
        truth = force * np.sqrt(np.sum(1 / k))
        assert abs(norm - truth) <= rounding + 1e-14 * truth
        assert rounding <= 1e-6 * truth


def test_a_load_that_misses_balance_by_1e_11_is_carried_by_the_stop_that_it_drives_to():
    """A free bar in tension, pulled a little more to the one side: its stop is half a length away."""
    net = 2.0**-36
    problem = cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [1.0, net - 1.0], [[1.0, 0.0]], [0.5])
    assert cq.solve(problem).normal_force == pytest.approx([net], rel=1e-9)
    assert not cq.certify(problem, [0.5, -0.5], [0.0]).passed
    rounding = problem.replace(load=[1.0, 2.0**-52 - 1.0])  # no load of doubles balances better
    assert cq.solve(rounding).normal_force == pytest.approx([0.0], abs=2.0**-51)


def test_a_tension_of_rounding_that_is_dropped_is_carried_elsewhere():
    """K u + l = f with l = (2, -d); without tension the solution has (2 - d, 0), and not (2, 0)."""
    K, d = np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]), 2.0**-50
    problem = cq.ContactProblem(K, [3.0, -1.0 - d, 0.0], np.eye(2, 3), [0.0, -1.0])
    certificate = cq.certify(problem, [0.0, -1.0, -1.0], [2 + 2 * d, d])  # (3 d, d) from the solution
    W = np.array([[5.0, -1.0], [-1.0, 2.0]]) / 9  # of the free chain
    error, size = np.array([3 * d, d]), np.array([2 - d, 0.0])
    assert certificate.force_error >= np.sqrt(error @ W @ error / (size @ W @ size))
    assert certificate.force_bound[0] >= 3 * d
    assert certificate.passed


def _rounded_bar(first: float, second: float, load: float, rows: list[float], gap: float) -> cq.ContactProblem:
    """Two springs whose sum is rounded: K z of the rigid motion z is a force at the middle node."""
    K = np.array([[first, -first, 0.0], [-first, first + second, -second], [0.0, -second, second]])
    return cq.ContactProblem(K, [load, 0.0, -load], [rows], [gap])


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("first", "second"), [(0.1, 0.2), (0.3, 0.6), (0.7, 0.1), (1.1, 2.2)])
@pytest.mark.parametrize("moved", [1e5, 1e7])
def test_the_rounding_of_a_stiffness_along_a_large_rigid_motion_takes_nothing_from_the_error(first, second, moved):
    """v = z + a strain of known energy, z'Kz < 0 or > 0 by rounding; and v is the error, or the solution itself."""
    problem = _rounded_bar(first, second, 1e-3, [0.0, 0.0, 1.0], 1e9)
    truth = np.array([1e-3 / first, 0.0, -1e-3 / second])
    strain = np.array([2.0**-8, 0.0, -(2.0**-9)])
    error = np.sqrt(first * strain[0] ** 2 + second * strain[2] ** 2) / np.sqrt(1e-6 / first + 1e-6 / second)
    certificate = cq.certify(problem, truth + strain + 2.0 ** np.round(np.log2(moved)), [0.0])
    assert error * (1 - 1e-5) <= certificate.energy_error <= error * (1 + 1e3 * moved * 1e-8)

    stopped = _rounded_bar(first, second, 1e-3, [1.0, 0.0, 0.0], -(2.0 ** np.round(np.log2(moved))))
    at = truth - truth[0] + stopped.gap[0]
    certificate = cq.certify(stopped, at + strain - strain[0], [0.0])
    assert certificate.energy_error >= error * (1 - 1e-5)


@pytest.mark.parametrize("far", [1e12, 1e16])
def test_a_displacement_that_is_lost_says_nothing_against_forces_that_are_right(far):
    K = np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    problem = cq.ContactProblem(K, [1.0, 2.0, 1.0], np.eye(3), [0.5, 0.5, 0.5])
    certificate = cq.certify(problem, far * np.array([1.0, -1.3, 0.7]), [1.0, 2.0, 1.0])
    assert certificate.force_error <= 1e-15
    assert certificate.energy_error >= far
    assert not certificate.passed
    wrong = cq.certify(problem, far * np.array([1.0, -1.3, 0.7]), [1.0, 2.0 + 1e-6, 1.0 - 1e-6])
    assert wrong.force_error >= 1e-7


@pytest.mark.parametrize(
    ("unknown", "row"),
    [((1.0, 1.0, 1.0), 1.0), ((2.0**9, 2.0**-13, 2.0**-20), 2.0**-24), ((2.0**-20, 2.0**15, 2.0**9), 2.0**19)],
)
def test_a_force_on_a_floating_body_is_judged_beside_the_largest_in_any_units(unknown, row: float) -> None:
    """A bar under 1e5 at both ends leans on a stop with 1.125: off by 1e-5 it passed where unknowns had other units.

    The energy norm of forces on what floats has the rigid response in it, which depends on the units of unknowns.
    """
    d = np.asarray(unknown)
    K = 1e6 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    problem = cq.ContactProblem(
        stiffness=K / np.outer(d, d), load=np.array([1e5 + 1.125, 0.0, -1e5]) / d,
        normal=np.array([[1.0, 0.0, 0.0]]) / d * row, gap=[0.0],
    )  # fmt: skip
    right = cq.solve(problem)
    assert right.normal_force * row == pytest.approx([1.125], rel=1e-10)
    forged = cq.certify(problem, right.displacement, right.normal_force * (1 + 1.1e-5))
    assert not forged.passed
    assert any("the force of contact 0" in failure and "1.1e-05" in failure for failure in forged.failures)


# A lattice of eight unknowns that one spring holds: it turns and slides freely.
LATTICE = np.array(
    [
        [819600, 400, -819200, 0, 0, 0, -400, -400],
        [400, 6416, 0, 0, 0, -6016, -400, -400],
        [-819200, 0, 819205.75, -5.75, -5.75, 5.75, 0, 0],
        [0, 0, -5.75, 92165.75, 5.75, -5.75, 0, -92160],
        [0, 0, -5.75, 5.75, 7557.9208984375, -5.75, -7552, 0],
        [0, -6016, 5.75, -5.75, -5.75, 6021.75, 0, 0],
        [-400, -400, 0, 0, -7552, 0, 7952, 400],
        [-400, -400, 0, -92160, 0, 0, 400, 92560],
    ]
)


def test_no_rigid_motion_that_leaves_a_gap_penetrated_bounds_forces_of_the_wrong_sign():
    """A rigid motion meets either contact alone, and both strain it: what is not met counts, pushing or not."""
    normal = np.zeros((2, 8))
    normal[0, [1, 2]], normal[1, [2, 5]] = (-1, 1), (-1, 1)
    problem = cq.ContactProblem(LATTICE, np.zeros(8), normal, [0.1484375, -0.3896484375])
    right = cq.solve(problem)
    assert np.all(right.normal_force > 1000)
    certificate = cq.certify(problem, right.displacement, -right.normal_force)
    assert not certificate.passed
    assert np.all(certificate.force_bound >= 2 * right.normal_force * (1 - 1e-9))


def test_what_refinement_leaves_of_opposite_contacts_is_no_conflict_and_more_is():
    """Node 0 is held between walls that do not move, one of them twice; 2e-26 is left of the gap."""
    K = np.array([[28.0, 7, 20, 9], [7, 15, 6, 3], [20, 6, 25, 1], [9, 3, 1, 30]])
    normal = np.array([[-1.0, 0, 0, 0], [1, 0, 0, 0], [-1, 0, 0, 0]])
    load = [-5.49951171875, -10.25, -7.0625, 20.0]
    tie = dict(tie=[[-1, 1.5, 1, -1], [0, -1, 0.5, 1]], tie_value=[-0.8125, 1.6875])
    problem = cq.ContactProblem(K, load, normal, [0.625, -0.625, 0.625], **tie)
    condensation = condense(problem)
    on_set, _, _ = polish(problem, condensation, np.array([1]), 3)
    excess, length = np.array([2e-26, 0.0, 2e-26]), np.full(3, 1.25)
    settled = replace(on_set, nothing=np.full(5, 1e-22))
    assert of_penetration(problem, condensation, settled, excess, length) < 1e-24
    with pytest.raises(Undecided, match=r"conflict by 1\.6e-26 of their lengths"):
        of_penetration(problem, condensation, replace(on_set, nothing=np.full(5, 1e-30)), excess, length)


def test_where_constraints_conflict_the_certificate_of_any_answer_says_so() -> None:
    walls = cq.ContactProblem([[2.0]], [0.0], [[1.0], [-1.0]], [0.5, -0.55])
    conflict = "no displacement satisfies these constraints together: contact 0, contact 1"
    by_penalty = cq.solve(walls, method="penalty", penalty=1e3)
    for certificate in (by_penalty.certificate, cq.certify(walls, [0.5], [0.0, 0.0])):
        assert not certificate.passed
        assert any(conflict in failure for failure in certificate.failures)


@pytest.mark.parametrize("load", [[0.0, 2.447265625, -121896961.8, 121896961.0, -1.4], [0.0, 0.0, -1.2e8, 1.2e8, 0.0]])
def test_a_chain_that_its_tie_alone_holds_has_no_norm_of_forces_without_it(load: list[float]) -> None:
    """One link is 8e7 times stiffer than the others, so that K, which is singular, has all its pivots."""
    springs = np.array([1.03125, 2.953125, 81264640.0, 1.296875])
    links = np.diff(np.eye(5), axis=0)
    problem = cq.ContactProblem(
        links.T @ np.diag(springs) @ links, load, [[0.0, 0.0, 0.0, 1.0, 0.0]], [0.875],
        tie=[[1.0, 1.0, 1.0, -1.0, 0.5]], tie_value=[-0.625],
    )  # fmt: skip
    truth = cq.exact(problem)
    u, force, tie = (np.array(part, float) for part in (truth.displacement, truth.normal_force, truth.tie_force))
    assert force[0] > 0.1
    assert cq.certify(problem, u, force, tie_force=tie).passed
    forged = cq.certify(problem, u, force * (1 + 1e-5), tie_force=tie)
    assert any("force_error" in failure for failure in forged.failures)


def test_forces_on_what_floats_are_measured_where_units_differ_by_1e8():
    """One of two free motions has 1e-8 of its size at an unknown whose unit makes it matter as much."""
    K = np.array([[12 * 2.0**30, -96.0, -(3 * 2.0**18)], [-96.0, 2.0**-20, 2.0**-8], [-(3 * 2.0**18), 2.0**-8, 64.0]])
    K = K[np.ix_([0, 1, 2, 0], [0, 1, 2, 0])]
    problem = cq.ContactProblem(K, np.zeros(4), [[2.0**16, 0.0, 0.0, 0.0]], [1.0])
    assert condense(problem).rigid.count == 2
    norm, uncertain = force_norm(problem, condense(problem), extend(np.ones(1)))
    # What no motion takes of the force is C y, C being columns of K that span the others.
    C = [[Fraction(entry) for entry in K[:, place]] for place in (0, 2)]
    gram = [[sum(a * b for a, b in zip(one, other, strict=True)) for other in C] for one in C]
    work = [column[0] * 2**16 for column in C]
    determinant = gram[0][0] * gram[1][1] - gram[0][1] ** 2
    y = [
        (gram[1][1] * work[0] - gram[0][1] * work[1]) / determinant,
        (gram[0][0] * work[1] - gram[0][1] * work[0]) / determinant,
    ]
    resisted = [y[0] * C[0][i] + y[1] * C[1][i] for i in (0, 2)]
    exact = float(y[0] * resisted[0] + y[1] * resisted[1]) ** 0.5
    assert abs(norm - exact) <= uncertain + 1e-15 * exact
    assert uncertain < 1e-9 * exact


def test_forces_that_the_rounding_of_a_stiffness_shares_out_are_no_better_than_that():
    """Three masses on springs whose sums are rounded, a metre from the ground: how they share 1e-11 N is rounding."""
    spring = [1.7795540617506418, 2.876159240814838]
    K = np.array([[spring[0], -spring[0], 0.0], [-spring[0], sum(spring), -spring[1]], [0.0, -spring[1], spring[1]]])
    assert math.fsum(K[1]) != 0
    for share, passes in ((1e-3, True), (1e-11, False)):
        load = -share * np.array([0.5720798, 0.9743247, 0.6559157])
        problem = cq.ContactProblem(K, load, -np.eye(3), np.ones(3))
        judged = cq.certify(problem, -np.ones(3), -load)
        assert judged.force_error is not None
        assert (judged.force_error <= 1e-6) == passes
        assert judged.passed is passes
        assert any("give the motions as near_null_space" in words for words in judged.failures) is not passes
        stated = problem.replace(near_null_space=np.ones((3, 1)))
        assert cq.solve(stated).normal_force == pytest.approx(-load, rel=1e-12)


def test_contacts_of_a_redundant_set_that_stay_apart_count_in_the_bounds() -> None:
    """A rigid table that weak springs hold stands on four of six feet; the candidate leans on another one."""
    place, gap = np.array([2.548, 1.004, 2.344, 2.776, 2.416, 3.916]), [0.0, 0.02125, 0.0, 0.0, 0.0, 0.024375]
    K = 2.0**-29 * np.diag([1.0, 16.0])
    problem = cq.ContactProblem(K, [-2048.0, 5316.608], np.column_stack([-np.ones(6), place]), gap)
    leaning, force = np.array([0.0458984375, 0.018035888671875]), [1976.1403508778305, 0, 0, 0, 0, 71.85964912225467]
    assert not cq.solve(problem).displacement.any()  # so the error is |u|_K
    certificate = cq.certify(problem, leaning, force)
    assert not certificate.passed
    assert certificate.energy_error >= np.sqrt(leaning @ K @ leaning)


@pytest.mark.parametrize(
    ("stiffness", "load", "normal", "gap"),
    [
        ([[0.00028363423687720893]], [-5760662.127126414], [[-2.0], [-2.0], [-1.0], [1.0]], [1.75, 2.0, 0.75, -0.75]),
        (
            np.diag([1.0627454264025057e-10, 4.051794463099469e-09, 1.1429291458224893e-10]),
            [-2.969065350633095, 2.6991503187598584, 2.159320255005878],
            [[-1, 0, 1], [-1, -1, 0], [-1, 1, 1], [-1, 2, 2], [-1, 1, 0], [-1, 2, 1]],
            [0.25, 0.5, -0.25, -0.5, -0.125, -0.75],
        ),
    ],
)
def test_gaps_are_refined_beside_loads_that_contacts_carry_past_weak_springs(
    stiffness: object, load: list[float], normal: object, gap: list[float]
) -> None:
    """Forces do work on what refinement leaves of gaps, which is to be nothing beside a small energy.

    So it is after other candidates, whose refinement has measured how fast corrections become smaller.
    """
    problem = cq.ContactProblem(stiffness, load, normal, gap)
    count, rows = problem.contacts, problem.normal.toarray()
    for closed in ([i for i in range(count) if chosen >> i & 1] for chosen in range(2**count)):
        held = rows[closed]
        saddle = np.block([[np.asarray(problem.stiffness), held.T], [held, np.zeros((len(closed),) * 2)]])
        answer = np.linalg.lstsq(saddle, np.concatenate([load, np.array(gap)[closed]]), rcond=None)[0]
        force = np.zeros(count)
        force[closed] = answer[problem.dimension :]
        cq.certify(problem, answer[: problem.dimension], force)
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert certificate.energy_error <= 1e-9


@pytest.mark.parametrize("noise", [0.0, 1e-38, 1e-30, 1e-20, 1e-12])
def test_bounds_on_forces_do_not_depend_on_what_rounding_leaves_of_zero(noise: float) -> None:
    """A rigid machine on two of six feet at rest: gaps of 1e-38 are no open contacts."""
    place = np.array([-41.216, 43.84, 24.128, 49.984, 63.808, -9.536])
    gap = [0.028125, 0.0, 0.03875, 0.050625, 0.015, 0.0]
    problem = cq.ContactProblem(
        np.diag([2.0**-22, 2.0**-10]), [-1024.0, -30539.776], np.column_stack([-np.ones(6), -place]), gap
    )
    force = cq.solve(problem).normal_force
    certificate = cq.certify(problem, [noise, 0.0], force)
    assert certificate.passed
    assert np.max(certificate.force_bound) <= 1e-6
    assert cq.certify(problem, normal_force=force).passed


def test_forces_that_a_repaired_pair_does_not_have_are_not_told_from_its_radius(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Were the contact open in the pair that bounds are made of, its force might be of any size up to the radius."""
    problem = cq.ContactProblem(np.diag([4.0, 1.0]), [8.0, 3.0], [[1.0, 0.0]], [1.0])
    right = cq.solve(problem)
    size = right.normal_force[0] / 2  # |l|_W of the one contact, K = 4

    def open_pair(*given):
        return replace(of_bounds(*given), exact=False, force=extend([0.0]), radius=0.55 * size, dual_radius=1.1 * size)

    of_bounds = bounds_module.admissible_pair
    monkeypatch.setattr(bounds_module, "admissible_pair", open_pair)
    judged = cq.certify(problem, right.displacement, [0.0])
    assert not judged.passed
    assert judged.force_error == np.inf


def test_the_truth_is_accepted_where_no_contact_pushes_and_rounding_is_smaller_than_the_radius() -> None:
    problem = family("interference_removed", 191)
    found, _ = exact_truth(problem, cq.solve(problem))
    u, force = found.rounded()
    assert cq.certify(problem, u, force, tie_force=found.tie_force if problem.ties else None).passed
