"""Bounds of bodies that float: rigid motions hide no strain, and the rounding of a stiffness along them is no force."""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.certificate.figures import force_norm
from contactqp.linalg.condensation import condense
from contactqp.linalg.extended import extend
from tests.certificate.test_bounds import CHAIN


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


def _chain(springs: list[float]) -> np.ndarray:
    """Return the stiffness of springs in a row, the first at a wall, each sum of two rounded."""
    k = np.array(springs)
    return np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)


@pytest.mark.slow
def test_a_stiffness_that_resists_a_motion_by_no_more_than_its_rounding_proves_nothing_along_it():
    """Springs of 1 and 1e13 by turns: doubles hold what resists the softest motion to a few percent."""
    K, f = _chain([1.0, 1e13] * 30), np.random.default_rng(3).normal(size=60)
    problem = cq.ContactProblem(K, f, np.eye(60)[[30, 59]], [0.5, 1.0])
    truth = np.array([float(force) for force in cq.exact(problem).normal_force])
    taken = cq.solve(problem)
    assert np.max(abs(taken.normal_force - truth)) > 0.5 * np.max(truth)  # of the doubles as they stand
    judged = taken.certificate
    assert judged.passed
    assert (judged.proven, judged.force_bound, judged.force_error, judged.basis) == (False, None, None, "figures")
    assert "no more than the rounding of its entries" in judged.reasons[0]
    assert "whether it is rounding that resists them is not known" in judged.notes[-1]
    firmly = problem.replace(stiffness=_chain([1.0, 1e10] * 30))
    solution = cq.solve(firmly)
    assert solution.certificate.proven
    truth = np.array([float(force) for force in cq.exact(firmly).normal_force])
    assert np.all(abs(solution.normal_force - truth) <= solution.certificate.force_bound)
    driven = problem.replace(load=np.ones(60), normal=-problem.normal)
    with pytest.raises(cq.NoEquilibrium, match="nor the stiffness by more than the rounding of its entries"):
        cq.solve(driven)


def _element(length: float) -> np.ndarray:
    """Return the stiffness of a beam element of unit bending stiffness."""
    a, b = 6 * length, length**2
    return np.array([[12, a, -12, a], [a, 4 * b, -a, 2 * b], [-12, -a, 12, -a], [a, 2 * b, -a, 4 * b]]) / length**3


def _cantilever(stub: float) -> cq.ContactProblem:
    """Return a cantilever whose last element is short, pressed to a stop 0.01 below its tip: 0.97 is right."""
    K = np.zeros((6, 6))
    K[:4, :4] += _element(1 - stub)
    K[2:, 2:] += _element(stub)
    return cq.ContactProblem(K[2:, 2:], [0.0, 0.0, -1.0, 0.0], [[0.0, 0.0, -1.0, 0.0]], [0.01])


@pytest.mark.sampled(4)
@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("hint", [None, np.ones((4, 1))])
def test_a_held_body_that_rounding_hides_is_not_taken_for_a_floating_one(hint, friction):
    """A stub of 1e-5 has entries of 1e16, whose rounding is as large as the stiffness at the tip, which is 3."""
    problem = _cantilever(1e-5).replace(near_null_space=hint)
    if friction:
        beside = np.pad(problem.stiffness, (0, 1))
        beside[4, 4] = 1.0
        unknowns, hint = np.eye(5), None if hint is None else np.ones((5, 1))
        rows = dict(normal=-unknowns[[2]], tangent=unknowns[[4]], friction=0.3, near_null_space=hint)
        problem = cq.ContactProblem(beside, np.append(problem.load, 0.1), gap=[0.01], **rows)
    taken = cq.solve(problem)
    assert taken.normal_force == pytest.approx([1.0])  # as if it floated
    assert taken.certificate.force_bound is None
    assert not taken.certificate.proven
    if not friction:
        assert taken.certificate.basis == "figures"
        assert taken.certificate.reasons
        assert all("an array of shape (n, 0)" in reason for reason in taken.certificate.reasons)
    truth = float(cq.exact(problem).normal_force[0])
    assert truth == pytest.approx(0.97, rel=1e-5)
    solution = cq.solve(problem.replace(near_null_space=np.zeros((problem.dimension, 0))))
    assert solution.normal_force == pytest.approx([truth], rel=1e-15)
    assert solution.certificate.proven or friction


def test_a_body_that_floats_is_refused_where_none_is_said_to_float():
    problem = cq.ContactProblem(_chain([0.0, 2.0, 3.0]), [0.0, 0.0, 1.0], [[1.0, 0.0, 0.0]], [0.5])
    assert cq.solve(problem).normal_force == pytest.approx([1.0])
    with pytest.raises(cq.NotCertified):
        cq.solve(problem.replace(near_null_space=np.zeros((3, 0))))


@pytest.mark.slow
def test_a_long_clamped_beam_is_right_where_no_body_is_said_to_float():
    """At 8000 elements rounding of the entries is as large as what resists the tip; the force is 3/8 - 3/100."""
    n, h = 8000, 1 / 8000
    at = 2 * np.arange(n)[:, None] + np.arange(4)
    entries = np.tile(_element(h).ravel(), n), (np.repeat(at, 4, axis=1).ravel(), np.tile(at, (1, 4)).ravel())
    K = sp.coo_array(entries, shape=(2 * n + 2, 2 * n + 2)).tocsr()[2:, 2:]
    load = np.tile([-h, 0.0], n)
    load[-2] = -h / 2
    tip = sp.csr_array(([-1.0], ([0], [2 * n - 2])), shape=(1, 2 * n))
    problem = cq.ContactProblem(K, load, tip, [0.01])
    solution = cq.solve(problem.replace(near_null_space=np.zeros((2 * n, 0))))
    assert solution.certificate.proven
    assert solution.normal_force == pytest.approx([0.345], rel=1e-7)
    unstated = cq.certify(problem, solution.displacement, solution.normal_force)
    assert not unstated.proven


@pytest.mark.sampled(8)
@pytest.mark.parametrize("soft", [1e-3, 0.3, 1.1])
@pytest.mark.parametrize("far", [1e-2, 1.0, 1e2])
def test_a_chain_that_a_tie_moves_rigidly_is_right_though_rounding_strains_its_soft_springs(soft, far):
    """Without a load nothing is strained; what rounding of stiff springs strains soft ones by was called an error."""
    K = _chain([0.0, 1.3e4, soft, 0.7e4, 0.8e4, 1.7 * soft, 1.9e4])
    assert any(math.fsum(row) for row in K)
    problem = cq.ContactProblem(K, np.zeros(7), np.eye(7)[[5]], [2 * far], tie=np.eye(7)[[2]], tie_value=[far])
    solution = cq.solve(problem)
    assert solution.certificate.proven
    assert solution.displacement == pytest.approx(np.full(7, far), rel=1e-9)
    bent = solution.displacement + 1e-4 * far * np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])  # a soft spring
    assert not cq.certify(problem, bent, [0.0], tie_force=[0.0]).passed


def _far_chain(far: float) -> tuple[cq.ContactProblem, np.ndarray]:
    """Return a free chain of uneven springs that rests far away on two masses, and its forces, in rationals."""
    k = [0.731, 0.0417, 3.77, 1.93, 0.611]
    K = _chain([0.3, *k])
    K[0, 0] = k[0]
    load, rows = -1e-3 * np.array([0.31, 0.77, 0.13, 0.59, 0.41, 0.23]), -np.eye(6)[[0, 4]]
    f = [Fraction(float(value)) for value in load]
    between = [1 / Fraction(value) for value in k[:4]]
    carried = sum(between[i] * sum(f[1 : i + 1]) for i in range(4)) / sum(between)  # by the first spring: no stretch
    last = -(f[4] + f[5] + sum(f[1:4]) - carried)
    return cq.ContactProblem(K, load, rows, [far, far]), np.array([float(-sum(f) - last), float(last)])


@pytest.mark.sampled(3)
@pytest.mark.parametrize("far", [1e2, 1e-2, 1e5])
def test_what_rounding_of_the_stiffness_pushes_is_in_the_bounds_unless_the_motions_are_stated(far):
    problem, truth = _far_chain(far)
    assert np.sum(truth) == pytest.approx(2.44e-3, rel=1e-12)
    free = cq.solve(problem)
    assert free.certificate.proven == (far < 1e5)  # a note says what is taken as rounding there
    if far < 1e5:
        assert np.all(abs(free.normal_force - truth) <= free.certificate.force_bound + 1e-15 * truth)
    stated = cq.solve(problem.replace(near_null_space=np.ones((6, 1))))
    assert stated.certificate.proven
    assert stated.normal_force == pytest.approx(truth, rel=1e-13 if far > 1 else 1e-12)


@pytest.mark.parametrize("friction", [False, True])
def test_stated_motions_are_exact_where_rounding_balances_itself(friction):
    """Two springs of one rounding: what the stiffness makes of the motion has no resultant, but parts two contacts."""
    k = np.array([1.0, 1.0]) * (1 + 2.0**-52)
    K = _chain([0.0, *k])
    K[1, 1], K[0, 0], K[2, 2] = 2.0 + 2.0**-50, k[0] - 2.0**-52, k[1] - 2.0**-52  # K z = (-e, 2e, -e), e = 2^-52
    assert [math.fsum(row) for row in K] == [-(2.0**-52), 2.0**-51, -(2.0**-52)]
    load, far = -1e-3 * np.array([1.0, 2.0, 3.0]), 1e6
    problem = cq.ContactProblem(K, load, -np.eye(3), np.full(3, far), near_null_space=np.ones((3, 1)))
    if friction:
        across = np.hstack([np.zeros((3, 3)), np.eye(3)])
        K, rows = (
            np.block([[K, np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]]),
            np.hstack([-np.eye(3), np.zeros((3, 3))]),
        )
        motion = np.vstack([np.ones((3, 1)), np.zeros((3, 1))])
        forces = {"tangent": across, "friction": 0.3, "near_null_space": motion}
        problem = cq.ContactProblem(K, np.append(load, np.full(3, 1e-5)), rows, np.full(3, far), **forces)
    assert cq.solve(problem).normal_force == pytest.approx(-load, rel=1e-12)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("far", [1e2, 1e-2, 1e5])
def test_with_friction_as_well(far):
    """The masses move across, too, on springs of their own, and stick there."""
    chain, truth = _far_chain(far)
    K, across = np.kron(np.diag([1.0, 0.0]), chain.stiffness), np.eye(12)[[6, 10]]
    K[6:, 6:] = np.eye(6)
    load, rows = np.append(chain.load, np.full(6, 1e-5)), np.hstack([chain.normal.toarray(), np.zeros((2, 6))])
    problem = cq.ContactProblem(K, load, rows, chain.gap, tangent=across, friction=0.3)
    solution = cq.solve(problem)
    forces = {"normal_force": solution.normal_force, "friction_force": solution.friction_force}
    judged = cq.certify(problem, solution.displacement, **forces)
    assert judged.passed
    assert judged.proven == (far < 1e5)
    if far < 1e5:
        assert np.all(abs(solution.normal_force - truth) <= judged.force_bound + 1e-15 * truth)
    else:
        assert "whether springs or rounding resist the rigid motions" in judged.reasons[0]


@pytest.mark.sampled(4)
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


def _rounded_bar(first: float, second: float, load: float, rows: list[float], gap: float) -> cq.ContactProblem:
    """Two springs whose sum is rounded: K z of the rigid motion z is a force at the middle node."""
    K = np.array([[first, -first, 0.0], [-first, first + second, -second], [0.0, -second, second]])
    return cq.ContactProblem(K, [load, 0.0, -load], [rows], [gap])


@pytest.mark.slow
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


def test_a_body_that_others_carry_along_by_a_tie_leaves_the_bounds() -> None:
    """A bar, pulled against a wall behind a gap, carries a chain on a hinge; rounding of K is all that loads the chain.

    That was taken for all of the forces there, and no bound was claimed: of a frame with a hinge in most directions.
    """
    first, second = 1.1586165330508720e-3, 8.3246273244156168e-4
    K = np.zeros((4, 4))
    K[0, 0] = 1e-3
    K[1:, 1:] = [[first, -first, 0.0], [-first, first + second, -second], [0.0, -second, second]]
    assert np.any(K[1:, 1:].sum(axis=1) != 0)
    wall, hinge = np.eye(1, 4), np.array([[1.0, -1.0, 0.0, 0.0]])
    problem = cq.ContactProblem(K, [0.2, 0.0, 0.0, 0.0], wall, [142.0], tie=hinge, tie_value=[0.0])
    found = cq.solve(problem)
    assert found.normal_force == pytest.approx([0.2 - 0.142], rel=1e-12)
    assert found.certificate.proven, found.certificate
    assert found.certificate.force_bound <= 1e-12


@pytest.mark.parametrize(("load", "proven"), [(1e-3, False), (1e12, True)])
def test_a_pushed_body_whose_stiffness_may_be_rounding_is_proven_beside_far_larger_forces_only(
    load: float, proven: bool
) -> None:
    """A chain of 1e10 on a spring of two units of its last digit is pushed aside by 1: 3.8e-6 or nothing holds it."""
    K = np.diag([1e5, 1e10, 1e10])
    K[1, 2] = K[2, 1] = -1e10
    K[1, 1] += 4e-6
    held = K[1, 1] - 1e10
    rows, gap = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), [0.0, -1.0]
    problem = cq.ContactProblem(K, [load, 0.0, 0.0], rows, gap)
    found = cq.solve(problem)
    assert found.certificate.passed
    assert found.certificate.proven == proven
    assert (abs(found.normal_force - [load, held]).max() <= 1e-9 * load) == proven


def test_stated_motions_replace_those_recognised_beside_soft_springs() -> None:
    """A chain of springs from 1e-6 to 1e6 is pushed against a wall: the wall carries the push whole.

    What eigenvectors recognise as rigid is mixed with its soft motions, and the wall's force was off by up to 4e-5,
    also where the motion was stated.
    """
    wrong = 0
    for seed in range(40):
        random = np.random.default_rng(seed)
        springs = random.permutation(10.0 ** np.linspace(-6, 6, 13))
        place, K = random.permutation(14), np.zeros((14, 14))
        for spring, ends in zip(springs, np.stack([place[:-1], place[1:]], axis=1), strict=True):
            K[np.ix_(ends, ends)] += spring * np.array([[1, -1], [-1, 1]])
        load, wall = np.eye(14)[place[-1]], np.eye(14)[place[:1]]
        recognised = cq.solve(cq.ContactProblem(K, load, wall, [0.0]))
        wrong += abs(recognised.normal_force[0] - 1) > 1e-6
        assert abs(recognised.normal_force[0] - 1) <= 1e-6 or not recognised.certificate.proven
        stated = cq.solve(cq.ContactProblem(K, load, wall, [0.0], near_null_space=np.ones((14, 1))))
        assert stated.normal_force == pytest.approx([1.0], rel=1e-12)
        assert stated.certificate.proven, stated.certificate
    assert wrong > 0
