"""Rows of contacts that are nearly parallel: one force exchanged for the other leaves displacements right to 1e-9."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.bounds import error_failures, force_bound_fails
from contactqp.certificate.energy_bounds import energy_bounds
from contactqp.model.solution import Answer


@pytest.mark.sampled(5)
@pytest.mark.parametrize("exponent", range(18, 30))
def test_a_force_exchanged_for_that_of_a_nearly_parallel_row_is_refused(exponent: int) -> None:
    """Both contacts touch where nothing moves, and the other set of contacts penetrates by less than any rounding.

    The lengths that meet are zero, relative to which nothing is a penetration.
    """
    K = np.array([[105.0, -2.0], [-2.0, 107.0]])
    rows = np.array([[0.0, 1.0], [2.0**-exponent, -1.0]])
    u, right = np.array([-0.5, 0.0]), np.array([3 / 64, 0.25])
    problem = cq.ContactProblem(K, K @ u + rows.T @ right, rows, rows @ u)
    assert cq.certify(problem, u, right).proven
    np.testing.assert_allclose(cq.solve(problem).normal_force, right, rtol=1e-6)
    for wrong in ([0.0, 13 / 64], [0.1, 0.25 + 0.1 - 3 / 64], [0.0, 0.25], [3 / 64, -0.25]):
        moved = np.linalg.solve(K, problem.load - rows.T @ wrong)
        for displacement in (u, moved):
            judged = cq.certify(problem, displacement, wrong)
            assert not judged.passed
            error = abs(np.array(wrong) - right)
            assert judged.force_bound is None or np.all(judged.force_bound >= (1 - 1e-14) * error)


@pytest.mark.sampled(9)
@pytest.mark.parametrize("stiffness", [64.0, 4096.0, 2.0**20])
@pytest.mark.parametrize("exponent", [20, 26, 30])
def test_forces_of_nearly_parallel_rows_are_exact_where_an_unknown_has_no_stiffness(
    stiffness: float, exponent: int
) -> None:
    """Without the second contact its gap is less than 1e-20, which is a quarter of the force over such rows."""
    n = 12
    K = np.zeros((n, n))
    K[2:, 2:] = stiffness * np.eye(n - 2) - 2.0 * (np.eye(n - 2, k=1) + np.eye(n - 2, k=-1))
    rows = np.zeros((4, n))
    rows[0, [4, 6]], rows[2, [11, 4]] = (1.0, -1.0), (1.0, -1.0)
    rows[1, [0, 5]] = rows[3, [0, 5]] = -1.0, 1.0
    rows[3, 4] = 2.0**-exponent
    u, right = np.zeros(n), np.array([0.375, 0.25, 0.15625, 0.4375])
    u[0] = 0.5
    problem = cq.ContactProblem(K, K @ u + rows.T @ right, rows, rows @ u)
    assert cq.certify(problem, u, right).proven
    answer = cq.solve(problem)
    np.testing.assert_allclose(answer.normal_force, right, atol=1e-6)
    assert np.all(answer.certificate.force_bound >= abs(answer.normal_force - right))
    assert not cq.certify(problem, answer.displacement, [0.375, 0.0, 0.15625, 0.6875]).passed


def test_a_bound_contains_the_rounding_of_a_long_motion() -> None:
    """Only a rigid motion of 1e8 moves the second contact and not the first; doubles round its energy to nothing."""
    k = 5e4
    K = np.array([[k, -k, 0.0], [-k, k, 0.0], [0.0, 0.0, 5.0]])
    rows = np.array([[0.0, 0.0, -1.0], [2.0**-27, 0.0, -1.0]])
    u, right = np.array([-0.5, -0.5, -0.25]), np.array([1.5, 0.0])
    problem = cq.ContactProblem(K, K @ u + rows.T @ right, rows, rows @ u)
    for factor in (1.001, 1.1, 0.5):
        judged = cq.certify(problem, u, factor * right)
        assert not judged.passed
        assert judged.force_bound is None or judged.force_bound[0] >= (1 - 1e-14) * abs(factor - 1) * 1.5


def test_a_row_that_hardly_moves_an_unknown_does_not_make_the_size_of_a_problem() -> None:
    """A contact pulls over a gap by 1e-5 of its load, and one with the same row pushes for it.

    Another one moves an unknown without stiffness by 1e-8 of what it moves a spring. The load of that unknown had been
    measured in the scale of this contact, beside which a pull of 1e-5 was nothing.
    """
    K, tie = np.diag([6.5, 0.0]), np.array([[0.5, 1.0]])
    rows = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [1.0, 2.0**-27]])
    u, forces, held = np.array([-0.25, 0.25]), np.array([2.75, 0.0, 0.125, 0.0]), np.array([-0.25])
    load, gap = K @ u + rows.T @ forces + tie.T @ held, rows @ u + np.array([0.0, 0.25, 0.0, 0.0])
    problem = cq.ContactProblem(K, load, rows, gap, tie=tie, tie_value=tie @ u)
    assert cq.certify(problem, u, forces, tie_force=held).proven
    pulled = forces + 9e-6 * np.array([1.0, -1.0, 0.0, 0.0])
    assert cq.certify(problem, u, pulled, tie_force=held).tension > 1e-7


@pytest.mark.parametrize("exponent", [20, 24, 28])
def test_a_force_that_a_nearly_parallel_tie_has_taken_is_refused(exponent: int) -> None:
    """No contact presses then, beside which its force could be compared: that of the tie says what is a force."""
    K, rows = np.diag([1500.0, 1600.0]), np.array([[-1.0, 0.0]])
    K[0, 1] = K[1, 0] = -2.0
    tie = rows + np.array([[0.0, 2.0**-exponent]])
    u, pressed, held = np.array([-0.625, 0.75]), np.array([0.1875]), np.array([-0.625])
    problem = cq.ContactProblem(K, K @ u + rows.T @ pressed + tie.T @ held, rows, rows @ u, tie=tie, tie_value=tie @ u)
    assert cq.certify(problem, u, pressed, tie_force=held).proven
    for displacement in (u, np.linalg.solve(K, problem.load - tie.T @ (held + pressed))):
        assert not cq.certify(problem, displacement, [0.0], tie_force=held + pressed).passed
    assert cq.solve(problem).normal_force == pytest.approx(pressed)


@pytest.mark.parametrize("load", [0.0, 2.0**-53])
def test_costs_of_a_program_that_balance_to_rounding_only_prove_nothing(load: float) -> None:
    """Its energy has no minimum, taken exactly; an answer is not refused for it."""
    program = cq.ContactProblem(np.zeros((2, 2)), [0.75, 0.75 + load], [[1.0, 1.0]], [1.0])
    judged = cq.solve(program).certificate
    assert judged.passed
    assert judged.proven is (load == 0.0)
    assert judged.proven or all("balance but for 7e-17 of them" in reason for reason in judged.reasons)


@pytest.mark.sampled(12)
@pytest.mark.parametrize(
    ("load", "row", "gap"), list(product([1.0, 1e-100, 1e-200, 1e-300, 1e200], [1.0, 1e200], [1.0, 1e-200]))
)
def test_costs_that_balance_to_rounding_beside_a_spring_have_an_answer_or_a_reason_at_any_size(
    load: float, row: float, gap: float
) -> None:
    """Motions and lengths of such sizes are no doubles, nor are their squares."""
    costs = [0.75 * load, 0.75 * load * (1 + 2.0**-52), 1.0]
    problem = cq.ContactProblem(np.diag([0.0, 0.0, 1.0]), costs, [[row, row, 0.0]], [gap])
    try:
        solution = cq.solve(problem)
    except (cq.NotCertified, cq.NoEquilibrium):
        assert (load, row, gap) != (1.0, 1.0, 1.0)  # 16 of 20 are refused for sizes that no doubles have
        return
    assert solution.displacement[2] == pytest.approx(1.0)
    wrong = solution.displacement + np.array([0.0, 0.0, 0.1])
    assert not cq.certify(problem, wrong, solution.normal_force).passed


def test_loads_on_free_bodies_that_balance_to_rounding_are_meant_to_balance() -> None:
    """Two masses pressed together, and a block under pressures whose nodal forces add up to their rounding."""
    K = np.array([[2.0, -2.0], [-2.0, 2.0]])
    for gap, force in ([-0.25], 1.5), ([0.25], 0.5), ([0.75], 0.0):
        pressed = cq.solve(cq.ContactProblem(K, [1.0, 2.0**-53 - 1.0], [[1.0, -1.0]], gap))
        assert pressed.certificate.proven
        assert pressed.normal_force == pytest.approx([force])
    block = cq.Body(cq.rectangle(0.7, 0.35, (8, 4), "quad4"), cq.Material(210e3, 0.3), "plane-strain", name="block")
    structure = cq.Structure([block])
    squeezed = structure.assemble([], [cq.Pressure("block", "top", 3.7), cq.Pressure("block", "bottom", 3.7)])
    walls = [cq.Plane([-7e-8, 0.0], [1.0, 0.0]), cq.Plane([0.7 + 7e-8, 0.0], [-1.0, 0.0])]
    sides = [
        cq.pair(structure.surface("block", side), wall) for side, wall in zip(["left", "right"], walls, strict=True)
    ]
    problem = squeezed.problem(sides)
    assert 0 < abs(problem.load.reshape(-1, 2).sum(axis=0)).max() < 1e-15
    assert cq.solve(problem).certificate.proven


def test_a_force_that_is_unique_beside_redundant_contacts_is_bounded() -> None:
    """A tie and a wall opposite to it share their forces in many ways, but not that of the nearly parallel contact.

    Its force had no bound beside theirs, and the answer without it penetrates by 1e-18 of the lengths that meet.
    """
    K, tie = np.diag([15.3125, 0.63653564453125, 31.75]), np.array([[0.0, 1.0, 0.0]])
    rows = np.array([[0.0, -1.0, 0.0], [-(2.0**-27), 1.0, 0.0]])
    u, pressed, held = np.array([0.0, 0.875, 0.0]), np.array([0.0, 0.171875]), np.array([-0.375])
    problem = cq.ContactProblem(K, K @ u + rows.T @ pressed + tie.T @ held, rows, rows @ u, tie=tie, tie_value=tie @ u)
    cq.solve(problem)
    assert cq.certify(problem, u, pressed, tie_force=held).proven
    assert cq.certify(problem, u, pressed + np.array([0.125, 0.0]), tie_force=held + 0.125).proven  # as right
    for part in (1.0, 0.01):
        forces, taken = np.array([0.0, (1 - part) * pressed[1]]), held + part * pressed[1]
        moved = np.array([(problem.load - rows.T @ forces)[0] / K[0, 0], 0.875, 0.0])
        for displacement in (u, moved):
            judged = cq.certify(problem, displacement, forces, tie_force=taken)
            assert not judged.passed
            assert judged.force_bound is None or judged.force_bound[1] >= part * pressed[1]


@pytest.mark.parametrize("stiffness", [1.0, 2.0**14])
def test_forces_that_nearly_parallel_ties_share_otherwise_are_refused(stiffness: float) -> None:
    """Where the second unknown is stiff the rows are apart by 3e-11 only, and their forces are unique all the same."""
    K, rows = np.diag([1.0, stiffness]), np.array([[-1.0, 0.0]])
    tie = np.array([[1.0, 0.0], [1.0, 2.0**-28]])
    u, held = np.array([0.5, 0.25]), np.array([-0.375, 0.75])
    problem = cq.ContactProblem(K, K @ u + tie.T @ held, rows, [1.0], tie=tie, tie_value=tie @ u)
    assert cq.certify(problem, u, [0.0], tie_force=held).proven
    assert cq.solve(problem).tie_force == pytest.approx(held, rel=1e-6)
    for change in (0.125, 1e-3, -1e-3):
        assert not cq.certify(problem, u, [0.0], tie_force=held + change * np.array([1.0, -1.0])).passed


@pytest.mark.parametrize("loose", [0, 1])
@pytest.mark.parametrize("exponent", [20, 24, 27])
def test_forces_of_nearly_parallel_ties_are_compared_by_energies_too(exponent: int, loose: int) -> None:
    """On sparse systems, and where an unknown has no stiffness: what the ties share otherwise strains nothing."""
    size = 8
    K = 784.0 * np.eye(size) - 2.0 * (np.eye(size, k=1) + np.eye(size, k=-1))
    K[:loose], K[:, :loose] = 0.0, 0.0
    rows, tie = np.zeros((2, size)), np.zeros((2, size))
    rows[0, 6] = rows[1, 1] = 1.0
    tie[:, :5] = 0.5, 1.0, -1.0, 0.5, 1.0
    tie[1, 4] += 2.0**-exponent
    u, pressed, held = np.linspace(-0.5, 0.375, size), np.array([0.3125, 0.0]), np.array([0.25, 0.75])
    problem = cq.ContactProblem(
        K, K @ u + rows.T @ pressed + tie.T @ held, rows, rows @ u + np.array([0.0, 0.5]), tie=tie, tie_value=tie @ u
    )
    for change in (0.0, 1e-8, 0.1, -0.1, 1e-3):
        shared = held + change * np.array([1.0, -1.0])
        found = energy_bounds(problem, Answer(u, pressed, None, shared))
        assert found.proven
        assert any(error_failures(found, 1e-6, 0.0)) is (abs(change) > 1e-6)
        assert cq.certify(problem, u, pressed, tie_force=shared).passed is (abs(change) < 1e-6)


def test_a_force_that_a_tie_holds_is_compared_with_that_of_the_tie_beside_a_large_strain() -> None:
    """The tied bodies feel less of it than 1e-12 of what a load strains, and it had been compared with nothing."""
    K, tie, rows = (
        np.diag([2.0**21, 2.0**20, 2.0**21]),
        np.array([[0.0, 0.0, 1.0]]),
        np.array([[0.0, -(2.0**-27), -1.0]]),
    )
    u, pressed, held = np.array([1.25, 0.25, 0.125]), np.array([0.0703125]), np.array([0.625])
    problem = cq.ContactProblem(K, K @ u + rows.T @ pressed + tie.T @ held, rows, rows @ u, tie=tie, tie_value=tie @ u)
    assert cq.certify(problem, u, pressed, tie_force=held).proven
    assert cq.solve(problem).normal_force == pytest.approx(pressed, rel=1e-5)
    assert not cq.certify(problem, u, 1.001 * pressed, tie_force=held).passed


@pytest.mark.parametrize(("exponent", "stiffness", "others"), [(27, 1024.0, 0), (29, 64.0, 0), (29, 1024.0, 1)])
def test_the_force_error_counts_a_contact_that_a_nearly_parallel_tie_may_carry(
    exponent: int, stiffness: float, others: int
) -> None:
    """The norm of contact forces without ties was bounded as if the tie's force could not be off for them."""
    K, tie = np.diag([stiffness, 4096.0, 32768.0]), np.array([[1.0, 0.0, 2.0**-exponent * (others > 0)]])
    rows = np.array([[1.0, 0.0, 2.0**-exponent * (others == 0)], [0.5, 1.0, 0.0]])[: 1 + others]
    u, pressed, held = np.array([0.125, 0.125, 0.5]), np.array([1.75, 0.5])[: 1 + others], np.array([0.75])
    problem = cq.ContactProblem(K, K @ u + rows.T @ pressed + tie.T @ held, rows, rows @ u, tie=tie, tie_value=tie @ u)
    assert cq.certify(problem, u, pressed, tie_force=held).proven
    missed = 1.75 * np.eye(1 + others)[0]
    judged = cq.certify(problem, u, pressed - missed, tie_force=held + 1.75)
    apart, whole = (np.linalg.norm((rows.T @ forces) / np.sqrt(np.diag(K))) for forces in (missed, pressed))
    assert not judged.passed
    assert judged.force_error is None or judged.force_error >= (1 - 1e-14) * apart / whole


def test_forces_are_compared_with_those_of_the_solution_that_meets_all_rows() -> None:
    """The response was that to forces of a state whose rows were met to 1e-18, which are those of the answer."""
    K, rows = np.diag([330.0, 0.004852294921875, 23.02978515625]), np.array([[1.25, -0.25, -0.5]] * 2)
    rows[1, 0] -= 2.0**-22
    u, right = np.array([-1.0, 0.5, 0.25]), np.array([0.75, 0.078125])
    problem = cq.ContactProblem(K, K @ u + rows.T @ right, rows, rows @ u)
    for wrong in (np.array([0.675, 0.15312500000525214]), np.array([0.375, 0.453125])):
        apart, whole = (np.linalg.norm((rows.T @ forces) / np.sqrt(np.diag(K))) for forces in (wrong - right, right))
        found = energy_bounds(problem, Answer(u, wrong, None, np.zeros(0)))
        assert found.force_error is not None
        assert found.force_error >= (1 - 1e-7) * apart / whole


@pytest.mark.parametrize("part", [0.5, 0.01])
@pytest.mark.parametrize("ties", [0, 1])
def test_a_unique_force_beside_redundant_rows_is_compared_on_sparse_systems(part: float, ties: int) -> None:
    """What a nearly parallel contact lacks was carried by redundant rows, which left the strain right to 1e-8."""
    K, opposite = np.diag([396.0, 322.0, 24.0]), 1.0 if ties else -1.0
    rows = np.array([[-1.0, 0.0, 0.0], [-1.0, -(2.0**-27), 0.0], [opposite, 0.0, 0.0], [0.0, 0.0, 1.0]])
    u, right, held = np.array([0.25, -0.375, 0.5]), np.array([0.25, 0.0625, 0.125, 0.5]), np.array([-0.5])
    tie = {"tie": [[1.0, 0.0, 0.0]], "tie_value": [0.25]} if ties else {}
    load = K @ u + rows.T @ right + np.array([held[0], 0.0, 0.0]) * ties
    problem = cq.ContactProblem(K, load, rows, rows @ u, **tie)
    for change in np.array([part, -part, 0.0, 0.0]) * 0.0625, np.array([0.0625, 0.0, opposite * 0.0625, 0.0]):
        found = energy_bounds(problem, Answer(u, right + change, None, held[:ties]))
        assert found.redundant
        assert force_bound_fails(found, 1e-6, 0.0) is bool(change[1])  # other forces of redundant rows are as right


@pytest.mark.parametrize("asked", ["nothing", "the answer", "rest"])
def test_a_verdict_does_not_depend_on_what_was_asked_before(asked: str) -> None:
    """Two ties are 2^-23 apart; what refinement leaves there under one load says nothing of other loads."""
    problem = cq.ContactProblem(
        [
            [1430.5, -66.5, -956.0, -304.0, -104.0],
            [-66.5, 138.3203125, -1.1328125, -61.5, -9.1875],
            [-956.0, -1.1328125, 1833.1328125, -304.0, -572.0],
            [-304.0, -61.5, -304.0, 669.759765625, -0.259765625],
            [-104.0, -9.1875, -572.0, -0.259765625, 685.447265625],
        ],
        [101.5 - 0.625 * 2.0**-23, -12.5810546875, -986.9580078125, 601.349853515625, 298.189208984375],
        [[0, 0, 0, 1, 0], [0, 0, 0, 0, 1], [0, 1, 0, 0, 0], [0, -1, 0, 0, 0], [-1, 0, 0, 0, 0]],
        [0.625, 0.75, 0.375, -0.125, 0.625],
        tie=[[0, 0, 1.5, 1, 0.5], [1, 0.5, 1, -0.5, 1], [2.0**-23, 0, 1.5, 1, 0.5]],
        tie_value=[-0.125, -0.875, -0.125 * (1 + 2.0**-23)],
    )
    u, force, tie = [-0.125, 0.125, -0.5, 0.625, 0.0], [1.0, 0.0, 0.0, 0.625, 0.0], [0.375, 0.625, -0.625]
    left = problem.load - problem.stiffness @ np.array(u) - problem.normal.T @ force - problem.tie.T @ tie
    assert not left.any(), "the answer is the exact one"
    if asked == "the answer":
        assert cq.solve(problem).normal_force == pytest.approx(force, abs=1e-9)
    if asked == "rest":
        assert not cq.certify(problem, np.zeros(5), np.zeros(5), tie_force=np.zeros(3)).passed
    found = cq.certify(problem, u, force, tie_force=tie)
    assert found.passed
    assert found.proven


def test_a_verdict_does_not_depend_on_what_was_judged_or_solved_before() -> None:
    """A known contraction would end refinement a sweep earlier, and a row near the tie shows what that leaves."""
    K = np.array([[26.0, 0.0, 0.0], [0.0, 5.125, -2.109375], [0.0, -2.109375, 5.25]])
    rows = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.5 - 2.0**-26, 0.5, 1.0]])
    tie, u = np.array([[-0.5, -0.5, -1.0]]), np.array([0.375, 0.125, -0.375])
    right, tie_force = np.array([0.0, 0.0, 0.625, 0.0]), np.array([1.0])
    load = K @ u + rows.T @ right + tie.T @ tie_force
    problem = cq.ContactProblem(K, load, rows, rows @ u, tie=tie, tie_value=tie @ u)
    first = cq.certify(problem, u, (1 + 1e-10) * right, tie_force=tie_force)
    cq.solve(problem)
    for judged in [first, *(cq.certify(problem, u, (1 + 1e-10) * right, tie_force=tie_force) for _ in range(2))]:
        assert judged.proven
        assert judged.force_error == pytest.approx(1e-10, rel=0.1)
