"""Bounds are never below the true error: small problems whose errors are known by hand, in the corners of rounding."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from benchmarks.judging import exact_truth
from benchmarks.problem_families import family
from contactqp.certificate import bounds as bounds_module
from contactqp.certificate.admissible_pair import Undecided, of_penetration
from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.figures import force_norm
from contactqp.linalg import refinement
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


@pytest.mark.parametrize("force", [1e-320, 1e-200])
def test_forces_whose_squares_are_zero_have_a_norm(force):
    """No division of nothing by nothing; a warning would fail here."""
    problem = cq.ContactProblem(stiffness=[[3.0, 0.0], [0.0, 5.0]], load=[6.0, 0.0], normal=[[0.0, 1.0]], gap=[0.5])
    norm, rounding = force_norm(problem, condense(problem), extend(np.array([force])))
    assert 0 <= norm < 1e-160
    assert 0 <= rounding < 1e-160


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


@pytest.mark.slow
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
        assert any("motions as near_null_space" in words for words in judged.failures) is not passes
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "load", "normal", "gap"),
    [
        ([[0.00028363423687720893]], [-5760662.127126414], [[-2.0], [-2.0], [-1.0], [1.0]], [1.75, 2.0, 0.75, -0.75]),
        pytest.param(
            np.diag([1.0627454264025057e-10, 4.051794463099469e-09, 1.1429291458224893e-10]),
            [-2.969065350633095, 2.6991503187598584, 2.159320255005878],
            [[-1, 0, 1], [-1, -1, 0], [-1, 1, 1], [-1, 2, 2], [-1, 1, 0], [-1, 2, 1]],
            [0.25, 0.5, -0.25, -0.5, -0.125, -0.75],
            marks=pytest.mark.slow,
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


@pytest.mark.sampled(2)
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


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(8))
def test_bounds_of_printed_forces_are_not_below_the_error_by_a_rounding(seed: int) -> None:
    """The error of a printed force is the difference of two numbers, and the bound was the same difference, rounded."""
    random = np.random.default_rng(seed)
    B = random.integers(-3, 4, (3, 3)).astype(float)
    problem = cq.ContactProblem(
        B @ B.T + np.eye(3), random.integers(-9, 10, 3), random.integers(-2, 3, (3, 3)), [0, 0, 0]
    )
    solution = cq.solve(problem)
    truth, _ = exact_truth(problem, solution)
    assert truth is not None
    for figures in (4, 5, 6, 7, 8):
        printed = np.array([float(f"{force:.{figures}e}") for force in solution.normal_force])
        bound = cq.certify(problem, solution.displacement, printed).force_bound
        if bound is not None:
            exact = [Fraction(int(truth.force[i, 0].p), int(truth.force[i, 0].q)) for i in range(3)]
            errors = [abs(Fraction(one) - force) for one, force in zip(printed, exact, strict=True)]
            assert all(error <= Fraction(most) for error, most in zip(errors, bound, strict=True))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("weight", "ahead"), [(1e-4, -2.1), (0.1, 3.1)])
def test_ties_that_move_bodies_without_a_force_are_proven(weight: float, ahead: float) -> None:
    """The plan of a double integrator whose states cost nothing: it drifts, no thrust is needed, and energy is zero."""
    steps, drift, thrust = 3, np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([0.005, 0.1])
    rows, values = np.zeros((2 * steps, 3 * steps)), np.zeros(2 * steps)
    values[:2] = drift @ [ahead, 1.0]
    for k in range(steps):
        here = slice(2 * k, 2 * k + 2)
        rows[here, here], rows[here, 2 * steps + k] = np.eye(2), -thrust
        if k:
            rows[here, 2 * k - 2 : 2 * k] = -drift
    bound = np.r_[np.full(2 * steps, 5.0), np.ones(steps)]
    stiffness = np.diag(np.r_[np.zeros(2 * steps), np.full(steps, weight)])
    plan = cq.ContactProblem.from_qp(stiffness, np.zeros(3 * steps), A=rows, b=values, lb=-bound, ub=bound)
    solution = cq.solve(plan)
    assert solution.displacement[2 * steps :] == pytest.approx(np.zeros(steps), abs=1e-15)
    assert solution.certificate.proven
    thrusting = (
        solution.displacement
        + np.linalg.lstsq(np.vstack([rows, np.eye(3 * steps)[-1:]]), np.r_[np.zeros(2 * steps), 1e-3], rcond=None)[0]
    )
    assert not cq.certify(plan, thrusting, solution.normal_force, tie_force=solution.tie_force).passed


@pytest.mark.parametrize("load", [[60.0, -100.0], [60.0, 100.0], [1e-9, -1e9]], ids=["pushed", "lifted", "pushed hard"])
def test_the_certificate_of_a_solution_takes_its_refined_answer_with_bounds_as_sharp_and_as_right(load, monkeypatch):
    """A small answer refined to far below the rounding of doubles is not refined again; another load's or copy's is."""
    sweeps, refined = [], refinement._refined
    monkeypatch.setattr(refinement, "_refined", lambda *given, **more: sweeps.append(1) or refined(*given, **more))
    problem = cq.ContactProblem([[59803.0, 6883.1], [6883.1, 77443.0]], load, [[0.0, -1.0]], [1e-3])
    solution = cq.solve(problem)
    assert len(sweeps) == 1
    fresh = cq.certify(problem, solution.displacement, solution.normal_force)
    assert len(sweeps) == 2
    truth, _ = exact_truth(problem, solution)
    wrong = Fraction(float(solution.normal_force[0])) - Fraction(int(truth.force[0, 0].p), int(truth.force[0, 0].q))
    found = solution.certificate
    assert found.proven
    assert abs(wrong) <= Fraction(float(found.force_bound[0]))
    assert found.energy_error == pytest.approx(fresh.energy_error, rel=1e-3, abs=1e-27)
    assert found.force_bound == pytest.approx(fresh.force_bound, rel=0.1)
    assert not certificate_of(problem.replace(load=[1.0, -2.0]), solution.answer).passed
    assert len(sweeps) > 2
