"""What certificates say of other answers with friction, where contacts hold bodies, and ties hold contacts."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.uniqueness import FORCES, POSSIBLE, SEVERAL


def test_both_answers_of_bodies_that_contacts_alone_hold_are_told_apart() -> None:
    """Without contacts the loads would move the bodies by 1e5; the answers, open and slipping, are 1e-3 apart."""
    problem = cq.ContactProblem(
        stiffness=[[2.0, 2.0], [2.0, 2.0]],
        load=[10251.495166015626, -71668.49692382812],
        normal=[[-1.0, 2.0], [2.0, -1.5]],
        gap=[9.25, -6.0],
        tangent=[[-2.0, -1.0], [1.5, 2.0]],
        friction=[0.6, 1.0],
        slip_origin=[[-7.0], [11.25]],
    )
    exact = cq.exact_equilibria(problem)
    assert {one.contact_status for one in exact} == {("open", "slip"), ("slip", "slip")}
    for answer in (cq.solve(problem), *cq.equilibria(problem)):
        assert answer.certificate.uniqueness == (SEVERAL,)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("stiffness", [[[1.0, 0.5], [0.5, 0.25]], [[1.0, 0.0], [0.0, 1.0]], [[2.0, 1.0], [1.0, 3.0]]])
def test_a_contact_that_a_tie_holds_shut_wedges_with_any_force(stiffness: list[list[float]], sign: float) -> None:
    """u0 = -u1 = v: (K00 - 2 K01 + K11) v = 8 - 2 l_N, and every l_N from 0 to 4 is balanced."""
    tied = cq.ContactProblem(
        stiffness,
        [4.0, -4.0],
        [[sign, sign]],
        [0.0],
        [[-1.0, 1.0]],
        friction=1.0,
        tie=[[1.0, 1.0]],
        tie_value=[0.0],
    )
    K = np.array(stiffness)
    for force in (0.0, 1.0, 4.0):
        v = (8 - 2 * force) / (K[0, 0] - 2 * K[0, 1] + K[1, 1])
        held = 4.0 - force - (K[0, 0] - K[0, 1]) * v - sign * force
        judged = cq.certify(tied, [v, -v], [force], [-force], tie_force=[held])
        assert judged.passed
        assert judged.uniqueness[-1] == SEVERAL
        assert judged.scope is None, "others are as near as one likes"
    assert not cq.critical_friction(tied).unique
    assert cq.solve(tied).certificate.uniqueness == (SEVERAL,)


def test_a_contact_that_ties_keep_open_is_no_other_answer() -> None:
    spring, none = np.array([[64.0, -64.0], [-64.0, 64.0]]), np.zeros((2, 2))
    problem = cq.ContactProblem(
        np.block([[spring, none], [none, np.diag([1.0, 64.0])]]),
        [-8.0, 8.0, 6.0, -8.0],
        [[-0.5, 0.0, 0.5, 0.0]],
        [0.125],
        [[0.0, -0.5, 0.0, 0.5]],
        friction=1.0,
        tie=[[1.0, 0.0, -1.0, 0.0]],
        tie_value=[0.0],
    )
    assert len(cq.exact_equilibria(problem)) == 1
    assert cq.solve(problem).certificate.uniqueness == ()


def test_what_rounding_alone_would_make_another_answer_is_not_said_to_exist() -> None:
    """Friction at its critical coefficient, exactly or to 1e-9: the one answer is nearly the end of a family."""
    grazing = cq.ContactProblem(
        [[1.0, 1.0], [1.0, 1025.0]],
        [13 / 64, 256.25 - 3 / 64],
        [[0.0, 1.0]],
        [0.25],
        [[-1.0, 0.0]],
        friction=1.0,
        slip_origin=[[3 / 64]],
    )
    spring, none = np.array([[6.0, -2.0], [-2.0, 8.0]]), np.zeros((2, 2))
    pads = cq.ContactProblem(
        np.block([[spring, none], [none, spring]]),
        [30.09375, -10.375, 0.060546875, -0.2421875000078125],
        [[-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]],
        [-4.0, 0.0],
        [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
        friction=[4.004, 3.999999996],
        slip_origin=[[0.0], [-0.90625]],
    )
    for problem in (grazing, pads):
        assert len(cq.exact_equilibria(problem)) == 1
        assert cq.solve(problem).certificate.uniqueness == (POSSIBLE,)


def test_forces_that_a_contact_without_force_could_take_are_others() -> None:
    """l_N (0, 1), l_T (0, -3) and l_N (7, 0), l_T (-1, 0) hold the same displacement."""
    problem = cq.ContactProblem(
        [[40.0, 48.0], [48.0, 64.0]],
        [-519.0, -649.0],
        [[0.0, 1.0], [-2.0, 1.0]],
        [-5.0, 9.0],
        [[-1.0, 0.0], [-1.0, -2.0]],
        friction=[0.5, 3.0],
        slip_origin=[[7.0], [18.0]],
    )
    for normal, friction in (([0.0, 1.0], [0.0, -3.0]), ([7.0, 0.0], [-1.0, 0.0])):
        judged = cq.certify(problem, [-7.0, -5.0], normal, friction)
        assert judged.passed
        assert judged.uniqueness == (FORCES,)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("apart", [1.0, -1.0])
def test_redundant_contacts_without_load_share_forces_where_they_press_against_each_other(apart: float) -> None:
    """Two contacts touch a mass that nothing presses: from both sides they may wedge it, from one side they may not."""
    mass = cq.ContactProblem(np.eye(2), [0.0, 0.0], [[1.0, 0.0], [-apart, 0.0]], [0.0, 0.0], [[0.0, 1.0]] * 2, 0.5)
    judged = cq.certify(mass, [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    assert judged.passed
    assert (FORCES in judged.uniqueness) == (apart > 0)


@pytest.mark.slow
def test_no_radius_is_claimed_where_ties_hold_a_contact_shut_that_may_press_with_any_force() -> None:
    """Contact 1 is held by the tie; another equilibrium, with l_N = 0.73 there, is 0.144 away in the energy norm."""
    K = np.array([[33.5, -34.0], [-34.0, 35.0]])
    tied = cq.ContactProblem(
        K,
        [-3.0, 5.0],
        [[-1.0, 0.0], [1.0, -2.0]],
        [0.0, 0.0],
        [[0.0, -1.0], [2.0, 1.0]],
        friction=[2.0, 0.5],
        slip_origin=[[-0.125], [0.125]],
        tie=[[-1.0, 2.0]],
        tie_value=[0.0],
    )
    u = np.array([0.05, 0.025])
    assert cq.certify(tied, u, [0.0, 0.73], [0.0, -0.365], tie_force=[3.825]).passed
    judged = cq.certify(tied, [0.0, 0.0], [0.25, 0.0], [0.5, 0.0], tie_force=[2.75])
    assert judged.passed
    assert judged.radius is None
    assert any("may press with any force" in reason for reason in judged.reasons)
    open_there = tied.replace(gap=[0.0, 1.0])
    assert cq.certify(open_there, cq.solve(open_there)).scope is not None


def test_an_answer_beside_those_that_redundant_contacts_share_is_another() -> None:
    """Two contacts stick and share 6e4 in many ways; open and sticking they carry 1.6e4, and lie 1e-5 elsewhere."""
    problem = cq.ContactProblem(
        [[20.25, 16.0, 8.0], [16.0, 22.0, 2.0], [8.0, 2.0, 9.0]],
        [106461.7861328125, -36909.751953125, -32772.875],
        [[2.0, 0.0, 2.0], [2.0, 0.0, -2.0]],
        [-0.21875, -0.21875],
        [[-1.0, -2.0, -2.0], [2.0, -1.0, 0.0]],
        friction=[1.0, 3.0],
        slip_origin=[[4.109375], [1.78125]],
    )
    exact = cq.exact_equilibria(problem)
    moved = {tuple(one.displacement) for one in exact}
    assert len(moved) == 2
    for one in exact:
        judged = cq.certify(
            problem, one.displacement.astype(float), one.normal_force.astype(float), one.friction_force.astype(float)
        )
        assert judged.passed
        assert SEVERAL in judged.uniqueness


def test_a_load_at_the_limit_of_friction_to_its_last_digit_leaves_the_question_open() -> None:
    """Bodies that friction alone holds would slide if 0.6 were 0.3 times 2; in doubles the load is below that."""
    problem = cq.ContactProblem(
        np.zeros((4, 4)),
        [-7.6, -9.4, 5.0, 8.0],
        [[0.0, -1.0, 0.0, 1.0], [-1.0, -1.0, 0.0, 0.0]],
        [0.171875, -2.875],
        [[1.0, 0.0, -1.0, 0.0], [1.0, -1.0, 0.0, 0.0]],
        friction=[1.0, 0.3],
        slip_origin=[[-1.0], [4.0]],
    )
    (exact,) = cq.exact_equilibria(problem)
    judged = cq.certify(
        problem, exact.displacement.astype(float), exact.normal_force.astype(float), exact.friction_force.astype(float)
    )
    assert judged.passed
    assert judged.uniqueness == (POSSIBLE,)


@pytest.mark.parametrize("soft", [2.0**-20, 2.0**-40, 2.0**-46])
def test_soft_springs_hide_no_other_answer(soft: float) -> None:
    """Either contact sticks while the other is open: forces differ, and displacements by less than what springs let."""
    normal = np.array([[-1.5, -0.5, 1.0, 1.5], [1.0, 0.0, 1.0, 0.0]])
    tangent = np.array([[-1.5, -0.5, -1.0, 0.5], [-1.0, 0.0, 1.0, 0.0]])
    problem = cq.ContactProblem(
        np.diag([soft, 2.0, soft, 2.0**30]), [-2.25, -1.5, 2.75, -(2.0**30)], normal, [0.25, -0.5],
        tangent=tangent, friction=10.0, slip_origin=[1.25, 1.0],
    )  # fmt: skip
    assert len({tuple(one.displacement) for one in cq.exact_equilibria(problem)}) == 2
    assert cq.solve(problem).certificate.uniqueness == (SEVERAL,)


def test_redundant_contacts_are_no_several_answers() -> None:
    """Two contacts at one place share a force as they like, at the border of stick and slip of one of them."""
    problem = cq.ContactProblem(
        np.diag([2.0, 2.0]), [0.5, 1.0], [[0.0, 1.0], [0.0, 1.0]], [0.0, 0.0], tangent=[[1.0, 0.0], [1.0, 0.0]],
        friction=[0.5, 0.75],
    )  # fmt: skip
    assert SEVERAL not in cq.solve(problem).certificate.uniqueness


@pytest.mark.parametrize("apart", [0, 18])
def test_friction_that_a_tie_may_carry_instead_is_no_other_answer(apart: int) -> None:
    """The contacts rub along an unknown that a tie holds: which of them carries how much changes no displacement.

    With further unknowns, which nothing loads, the problem is too large for rational numbers.
    """
    stiffness, n = np.eye(3 + apart), 3 + apart
    stiffness[:3, :3] = [[14.0, -2.0, 4.0], [-2.0, 3.0, -1.0], [4.0, -1.0, 8.0]]
    x, y = np.eye(n)[0], np.eye(n)[1]
    rows = dict(tangent=[y, y], friction=[0.5, 0.25], tie=[y], tie_value=[0.0])
    load = np.append([1.0, -3.0, 4.0], np.zeros(apart))
    problem = cq.ContactProblem(stiffness, load, [x, -x], [0.25, 0.0], **rows)
    assert len({tuple(one.displacement) for one in cq.exact_equilibria(problem)}) == 1
    assert cq.solve(problem).certificate.uniqueness == (FORCES,)
