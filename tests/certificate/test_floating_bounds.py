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


@pytest.mark.parametrize("far", [1e-2, 1e2, 1e5])
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


@pytest.mark.parametrize("far", [1e-2, 1e2, 1e5])
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


@pytest.mark.parametrize("far", [1e16, 1e22, 1e24, 1e34, 1e60])
@pytest.mark.parametrize("frictional", [False, True])
def test_no_motion_is_so_large_that_it_hides_what_is_wrong(far: float, frictional: bool) -> None:
    """Two masses on a spring are wedged apart by two: moved as far as that, both alike, they are penetrated by two."""
    K = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    law = dict(tangent=[[0.0, 0.0, 1.0]], friction=0.25) if frictional else {}
    wedge = cq.ContactProblem(K, [0.0, 0.0, 1.0], [[1.0, -1.0, 0.0]], [-2.0], **law)
    friction = [[0.5]] if frictional else None
    beside = 0.5 if frictional else 1.0
    for force in (2.0, 2.02, 0.0):
        assert not cq.certify(wedge, [far, far, beside], [force], friction).passed
    assert cq.certify(wedge, [2.0**40, 2.0**40 + 2.0, beside], [2.0], friction).passed


def test_a_motion_that_a_tie_asks_for_without_forces_is_right() -> None:
    """A mechanism between two contacts that touch, moved by a tie alone: all forces are zero, exactly.

    What refinement left of its strain, 1e-25, was held against a tolerance of zero.
    """
    side, turned = np.array([-3.0, 1.0, 0.0, 0.0, 3.0, -1.0, 0.0, 0.0]), np.zeros(8)
    turned[[1, 3]] = 4.0, -4.0
    problem = cq.ContactProblem(
        stiffness=np.outer(side, side) + np.outer(turned, turned),
        load=np.zeros(8),
        normal=[[-2.0, 0, 0, 0, 2.0, 0, 0, 0], [-3.0, 1.0, 0, 0, 0, 0, 0, 0]],
        gap=[0.0, 0.0],
        tie=[[0, 1.0, 0, 0, 0, 0, -2.0, 0], [0, 0, 2.0, 2.0, 0, 0, 0, 0]],
        tie_value=[-1.0, 0.0],
    )
    u = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0])
    assert cq.certify(problem, u).passed
    assert cq.certify(problem, u, [0.0, 0.0], None, [0.0, 0.0]).passed
    for pushed, held in (([1e-9, 0.0], [0.0, 0.0]), ([0.0, 1e-15], [0.0, 0.0]), ([0.0, 0.0], [1e-12, 0.0])):
        assert not cq.certify(problem, u, pushed, None, held).passed
    assert not cq.certify(problem, u + 1e-6 * np.eye(8)[1]).passed


def test_a_contact_that_no_rigid_motion_moves_carries_nothing_of_what_rounding_leaves() -> None:
    """A lattice of springs with two rigid motions, neither of which moves unknown 1, where a contact grazes."""
    K = np.zeros((7, 7))
    springs = {(0, 4): -68, (0, 5): -6, (0, 6): -6, (1, 2): -28, (1, 3): -28, (1, 4): 28, (2, 3): 28, (2, 4): -28}
    for (i, j), k in (springs | {(2, 6): -224, (3, 4): -28, (3, 5): -528, (5, 6): 6}).items():
        K[i, j] = K[j, i] = k
    K += np.diag([74, 46, 252, 556, 96, 534, 230])
    load = [-32.5, 0.75, -234.5, 451.5, 45.25, -463.5, 222.5]
    rows = np.zeros((3, 7))
    rows[[0, 0, 1, 2, 2], [1, 4, 1, 1, 4]] = -1, 1, 1, -0.5, 0.5
    solution = cq.solve(cq.ContactProblem(K, load, rows, [-0.375, -0.5, 0.1875]))
    assert solution.normal_force == pytest.approx([0.75, 0.0, 0.0], abs=1e-14)
    assert solution.certificate.proven
    assert np.max(solution.certificate.force_bound) < 1e-12


def _grazing(push: float) -> cq.ContactProblem:
    """A stiffness of rank one under 5242880 at contact 0 and `push` at contact 1; gaps 0, 0, 8.5e-8, 0."""
    stretch = np.array([1.0, 1.0, 2.0, -2.0])
    return cq.ContactProblem(
        stiffness=np.outer(stretch, stretch),
        load=[15728638.012695312, -1.98730468750 + 2 * push, 10485756.025390625, 3.974609375 - push],
        normal=[[3.0, 0.0, 2.0, 0.0], [0.0, 2.0, 0.0, -1.0], [-3.0, 0.0, 0.0, 0.0], [3.0, -1.0, 1.0, 0.0]],
        gap=[6.01171875, -1.998046875, -5.999999915249646, 6.0048828125],
    )


@pytest.mark.parametrize("power", [-40, -37, -34, -31, -29])
def test_bounds_of_forces_contain_what_a_load_leaves_out_of_balance(power: int) -> None:
    """A force of 2^-29 beside one of 5e6 is within rounding of a balance without it, which does not make it zero."""
    push = 2.0**power
    u = [2.0, 2.0**-10, 0.005859375, 2.0]
    problem = _grazing(push)
    without = cq.certify(problem, u, [5242880.0, 0.0, 0.0, 0.0])
    assert without.force_bound is None or without.force_bound[1] >= push
    exact = cq.certify(problem, u, [5242880.0, push, 0.0, 0.0])
    assert exact.passed
    assert exact.force_bound is not None
    assert exact.force_bound.max() < 1e-3 * push


def test_noise_of_a_displacement_drives_nothing_where_nothing_loads_the_body() -> None:
    """A lattice that floats but for ties, without a load: what another code left of zero is refined to zero."""
    K = np.zeros((8, 8))
    springs = {
        (0, 1): -126,
        (0, 2): 368,
        (0, 6): 126,
        (0, 7): 126,
        (1, 5): 31.5,
        (1, 6): 126,
        (1, 7): 126,
        (3, 7): 4.25,
    }
    for (i, j), k in (springs | {(2, 3): 3.125, (2, 4): 3.125, (2, 5): -3.125, (3, 4): -3.125, (3, 5): 3.125}).items():
        K[i, j] = K[j, i] = -k
    K[4, 5] = K[5, 4] = -3.125
    K[3, 7] = K[7, 3] = -4.25
    K[4, 6] = K[6, 4] = -1.0
    K[6, 7] = K[7, 6] = 126.0
    K += np.diag([494, 157.5, 371.125, 7.375, 57.375, 34.625, 127, 130.25])
    rows = np.zeros((5, 8))
    rows[[0, 1, 2, 3, 4], [3, 5, 2, 0, 5]] = 1, 1, -1, -1, 4
    tie = [[2, 1, 1, 1, 0, 1, 1, 0], [0.5, -0.5, 1, -0.5, 0.5, 1, 0.5, 0.5]]
    problem = cq.ContactProblem(
        K, np.zeros(8), rows, [0.6220703125, 1.353515625, 0.30517578125, 0.0, 1.501953125], tie=tie, tie_value=[0, 0]
    )
    noise = np.array([0.0, 1.06e-16, -1.73e-17, -2.45e-15, 4.54e-16, -1.28e-15, 3.63e-15, -3.42e-15])
    assert cq.certify(problem, noise, np.zeros(5), tie_force=np.zeros(2)).proven
    assert not cq.certify(problem, noise, [0.0, 0.0, 0.0, 1e-3, 0.0], tie_force=np.zeros(2)).passed


def test_what_rounding_strains_along_a_motion_that_a_tie_asks_for_is_no_error() -> None:
    """Nothing is strained; the answer differs from the middle of all by a motion that the tie holds."""
    problem = cq.ContactProblem(
        stiffness=[[4608.0, -3072.0, 0, 0], [-3072.0, 2048.0, 0, 0], [0.0] * 4, [0.0] * 4],
        load=np.zeros(4),
        normal=[[2.0, -1.0, -3.0, 2.0], [-2.0, 2.0, 3.0, -1.0]],
        gap=[9.0, -7.0],
        tie=[[0.0, 0.0, 0.0, 2.0]],
        tie_value=[2.0],
    )
    u = np.array([0.0, 0.0, -2.0, 1.0])
    assert cq.certify(problem, u).passed
    for strained in (1e-6, 1e-11):
        assert not cq.certify(problem, u + np.array([strained, 0.0, 0.0, 0.0])).passed


def test_forces_of_ties_are_held_against_a_contact_at_unknowns_without_stiffness() -> None:
    """The contact carries the load, and the tie nothing: a rounding of its force was compared with itself."""
    K = np.zeros((5, 5))
    K[np.ix_([0, 2], [0, 2])] = [[4.0, -8.0], [-8.0, 16.0]]
    problem = cq.ContactProblem(
        K, [0, 0, 0, 4.0, 4.0], [[0, 0, 0, 2.0, 2.0]], [-2.0], tie=[[-1.0, 2.0, -1.0, 1.0, 2.0]], tie_value=[-0.75]
    )
    u = [2.0, 1.625, 1.0, -1.0, 0.0]
    for tie_force in (0.0, -2.8e-16, None):
        assert cq.certify(problem, u, [2.0], tie_force=None if tie_force is None else [tie_force]).passed
    assert not cq.certify(problem, u, [2.0], tie_force=[1e-8]).passed
    assert not cq.certify(problem, u, [2.0 + 1e-8], tie_force=[0.0]).passed


FREE: dict[str, tuple[dict[str, object], str]] = {
    "a spring that floats": (dict(stiffness=[[1, -1], [-1, 1]], load=[1, -1], normal=[[1, 0]], gap=[5]), "energy"),
    "a spring that a force holds": (
        dict(stiffness=[[1, -1], [-1, 1]], load=[1, 1], normal=[[1, 0]], gap=[5]),
        "displacement",
    ),
    "a spring that touches": (dict(stiffness=[[1, -1], [-1, 1]], load=[1, -1], normal=[[1, 0]], gap=[0.5]), "energy"),
    "a spring between walls that touch": (
        dict(stiffness=[[1, -1], [-1, 1]], load=[1, -1], normal=[[1, 0], [-1, 0]], gap=[0.5, -0.5]),
        "displacement",
    ),
    "an unknown without stiffness": (dict(stiffness=[[1, 0], [0, 0]], load=[1, 0], normal=[[1, 0]], gap=[5]), "energy"),
}


@pytest.mark.parametrize("condense", [True, False])
@pytest.mark.parametrize("what", FREE)
def test_a_displacement_is_determined_where_no_motion_is_free(what: str, condense: bool) -> None:
    data, determined = FREE[what]
    problem = cq.ContactProblem(**{name: np.array(part, dtype=float) for name, part in data.items()})
    assert bool(cq.exact(problem).free_motions) == (determined == "energy")
    certificate = cq.solve(problem, condense=condense).certificate
    assert certificate.proven
    assert certificate.determined == determined
