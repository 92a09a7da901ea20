"""Forces and displacements that are not unique: the least ones and the ranges, derived by hand."""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np
import pytest

import contactqp as cq


def test_two_stops_of_one_node_share_its_force() -> None:
    # 3 - 2 * 1/2 = 2 = l_1 + l_2: least norm (1, 1), each from 0 to 2.
    stops = cq.ContactProblem([[2.0]], [3.0], [[1.0], [1.0]], [0.5, 0.5])
    answer = cq.exact(stops)
    assert not answer.unique_forces
    assert list(answer.normal_force) == [1, 1]
    assert answer.force_range.tolist() == [[0, 2], [0, 2]]
    assert answer.displacement[0] == F(1, 2)


def test_rows_of_other_lengths_share_by_their_lengths() -> None:
    # l_1 + 3 l_2 = 2: (1, 3) / 10 * 2 = (1/5, 3/5); l_1 up to 2, l_2 up to 2/3.
    stops = cq.ContactProblem([[2.0]], [3.0], [[1.0], [3.0]], [0.5, 1.5])
    answer = cq.exact(stops)
    assert list(answer.normal_force) == [F(1, 5), F(3, 5)]
    assert answer.force_range.tolist() == [[0, 2], [0, F(2, 3)]]


def test_the_least_forces_have_no_tension_where_the_least_of_all_would() -> None:
    # Rows (1, 0), (0, 1), (1, -2) must give (1, 4): l_1 + l_3 = 1, l_2 - 2 l_3 = 4.
    # Without signs the least is at l_3 = (1 - 8) / 6 < 0; with them l_3 = 0. l_3 ranges to 1, l_2 to 6.
    K, rows = np.eye(2), [[1.0, 0.0], [0.0, 1.0], [1.0, -2.0]]
    answer = cq.exact(cq.ContactProblem(K, [1.0, 4.0], rows, [0.0, 0.0, 0.0]))
    assert list(answer.normal_force) == [1, 4, 0]
    assert answer.force_range.tolist() == [[0, 1], [4, 6], [0, 1]]
    assert answer.contact_status == ("closed", "closed", "grazing")


def test_a_body_between_two_walls_may_be_squeezed_without_end() -> None:
    walls = cq.ContactProblem([[1.0]], [2.0], [[1.0], [-1.0]], [0.0, 0.0])
    answer = cq.exact(walls)
    assert list(answer.normal_force) == [2, 0]
    assert answer.force_range.tolist() == [[2, None], [0, None]]


def test_ties_that_say_the_same_share_their_force() -> None:
    twice = cq.ContactProblem([[2.0]], [3.0], [[1.0]], [5.0], tie=[[1.0], [1.0]], tie_value=[1.0, 1.0])
    answer = cq.exact(twice)
    assert list(answer.tie_force) == [F(1, 2), F(1, 2)]
    assert not answer.unique_forces
    assert answer.force_range.tolist() == [[0, 0]]
    assert "forces are not unique, though the normal force of each contact is" in str(answer)


def test_a_tie_and_a_contact_that_hold_the_same_node() -> None:
    # l + nu = 1, l >= 0: the least contact force is none.
    both = cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0], tie=[[1.0]], tie_value=[1.0])
    answer = cq.exact(both)
    assert (answer.normal_force[0], answer.tie_force[0]) == (0, 1)
    assert answer.force_range.tolist() == [[0, None]]


def test_blocks_that_share_nothing_range_by_themselves() -> None:
    rows = [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]]
    answer = cq.exact(cq.ContactProblem(np.eye(2), [2.0, 6.0], rows, [0.0] * 4))
    assert answer.force_range.tolist() == [[0, 2], [0, 2], [0, 6], [0, 6]]


def test_a_pair_that_floats_rests_at_its_least_displacement() -> None:
    # Stretch 1 = u_1 - u_2 with nothing to hold the pair: (1/2, -1/2).
    pair = dict(stiffness=[[1.0, -1.0], [-1.0, 1.0]], normal=[[1.0, 0.0]])
    answer = cq.exact(cq.ContactProblem(load=[1.0, -1.0], gap=[5.0], **pair))
    assert list(answer.displacement) == [F(1, 2), F(-1, 2)]
    assert len(answer.free_motions) == 1
    assert answer.free_motions[0].direction.tolist() == [1.0, 1.0]
    # A wall at -5 that just touches it: the least displacement within the gap.
    answer = cq.exact(cq.ContactProblem(load=[1.0, -1.0], gap=[-5.0], **pair))
    assert list(answer.displacement) == [-5, -6]
    assert answer.contact_status == ("grazing",)
    # Pushed against it: nothing is free, and the wall takes the push.
    answer = cq.exact(cq.ContactProblem(load=[2.0, -1.0], gap=[-5.0], **pair))
    assert list(answer.displacement) == [-5, -6]
    assert list(answer.normal_force) == [1]
    assert answer.free_motions == ()


CONFLICTS: dict[str, dict[str, object]] = {
    "nothing holds the load": dict(stiffness=[[0.0]], load=[-1.0], normal=[[1.0]], gap=[1.0]),
    "two walls too close": dict(stiffness=[[1.0]], load=[0.0], normal=[[1.0], [-1.0]], gap=[1.0, -2.0]),
    "a tie behind a wall": dict(stiffness=[[1.0]], load=[0.0], normal=[[1.0]], gap=[1.0], tie=[[1.0]], tie_value=[2.0]),
    "two ties": dict(
        stiffness=[[1.0]], load=[0.0], normal=[[1.0]], gap=[9.0], tie=[[1.0], [1.0]], tie_value=[1.0, 2.0]
    ),
}


@pytest.mark.parametrize("what", CONFLICTS)
def test_no_equilibrium_is_proven(what: str) -> None:
    with pytest.raises(cq.NoEquilibrium, match="proven in rational numbers"):
        cq.exact(cq.ContactProblem(**CONFLICTS[what]))  # type: ignore[arg-type]


def test_what_just_touches_is_told_from_what_nearly_does() -> None:
    # 2 u = 1 and the wall at 1/2; the next doubles of the gap close or open it.
    for gap, word in ((0.5, "grazing"), (np.nextafter(0.5, 0), "closed"), (np.nextafter(0.5, 1), "open")):
        answer = cq.exact(cq.ContactProblem([[2.0]], [1.0], [[1.0]], [gap]))
        assert answer.contact_status == (word,)
        assert answer.normal_force[0] == max(F(0), 1 - 2 * F(float(gap)))


def test_friction_that_holds_a_wedged_block_is_shared() -> None:
    # Between two walls, weight 1 on friction 1/2: l_T = 1/2 each, and l_N at least 1 each, without end.
    block = cq.ContactProblem(
        np.zeros((2, 2)) + np.diag([1.0, 0.0]),
        [0.0, 1.0],
        [[1.0, 0.0], [-1.0, 0.0]],
        [0.0, 0.0],
        [[0.0, 1.0], [0.0, 1.0]],
        0.5,
    )
    answer = cq.exact(block)
    assert list(answer.normal_force) == [1, 1]
    assert answer.friction_force is not None
    assert list(answer.friction_force.ravel()) == [F(1, 2), F(1, 2)]
    assert answer.force_range.tolist() == [[1, None], [1, None]]
    assert not answer.unique_forces
    assert "forces not unique" in answer.uniqueness


def test_a_block_too_heavy_for_its_walls_that_are_apart() -> None:
    # Friction without normal force holds nothing: no combination of open, stick and slip is an equilibrium.
    block = cq.ContactProblem(np.diag([1.0, 0.0]), [0.0, 1.0], [[1.0, 0.0]], [1.0], [[0.0, 1.0]], 0.5)
    with pytest.raises(cq.NoEquilibrium, match=r"proven|no contact or tie holds"):
        cq.exact(block)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("taken", [1.0, 0.0, -2.0])
def test_every_share_of_a_force_between_contacts_and_a_tie_is_right(taken: float) -> None:
    """Two stops and the tie u1 + u2 = 0 hold a node at 0: l_1 + nu = 3, l_2 + nu = 1, so any nu up to 1 is right."""
    node = cq.ContactProblem(
        [[2.0, 1.0], [1.0, 3.0]], [3.0, 1.0], np.eye(2), [0.0, 0.0], tie=[[1.0, 1.0]], tie_value=[0.0]
    )
    right = np.array([3.0 - taken, 1.0 - taken])
    judged = cq.certify(node, [0.0, 0.0], right, None, [taken])
    assert judged.proven
    assert judged.passed
    assert judged.force_error < 1e-12
    pulling = cq.certify(node, [0.0, 0.0], [1.5, -0.5], None, [1.5])
    assert not pulling.passed
    assert pulling.force_error > 0.1
    for wrong in (*(right + 1e-5 * np.eye(2)), right[::-1]):
        assert not cq.certify(node, [0.0, 0.0], wrong, None, [taken]).passed
    printed = right * [1 + 1e-6, 1 - 1e-6]
    assert cq.certify(node, [0.0, 0.0], printed, None, [taken], 1e-5, 1e-4).passed


@pytest.mark.slow
def test_exact_forces_of_programs_with_dependent_rows_and_ties_are_right() -> None:
    """Whole numbers: f is made of u, l and nu, which are therefore an answer; no other is known beforehand."""
    rng = np.random.default_rng(5)
    for _ in range(40):
        n, m = int(rng.integers(2, 6)), int(rng.integers(3, 9))
        B, rows, tie = rng.integers(-3, 4, (n, n)), rng.integers(-2, 3, (m, n)), rng.integers(-2, 3, (1, n))
        rows[:, 0] += ~rows.any(axis=1)
        tie[:, 0] += ~tie.any(axis=1)
        K, u, touches = B @ B.T + np.eye(n), rng.integers(-3, 4, n).astype(float), rng.random(m) < 0.8
        force, held = np.where(touches, rng.integers(0, 4, m), 0).astype(float), np.array([2.0])
        load = K @ u + rows.T @ force + tie.T @ held
        gap = rows @ u + np.where(touches, 0, rng.integers(1, 4, m))
        problem = cq.ContactProblem(K, load, rows, gap, tie=tie, tie_value=tie @ u)
        assert cq.certify(problem, u, force, None, held).passed
        if force.any():
            assert not cq.certify(problem, u, -force, None, held).passed
            assert not cq.certify(problem, u, np.where(force == force.max(), 1.001, 1.0) * force, None, held).passed


def test_contacts_that_stick_where_a_free_motion_ends_may_share_forces() -> None:
    # Nothing is stiff. A tie holds u_1 - u_3 = -4 along the row of the contact, so l + nu = 0. The least displacement
    # (-2, 0, 2, 0) has no slip, and the contact may squeeze there without end; with slip it could not.
    row = [[1.0, 0.0, -1.0, 0.0]]
    squeezed = cq.ContactProblem(
        np.zeros((4, 4)),
        np.zeros(4),
        row,
        [-4.0],
        tangent=[[0.0, -1.0, 1.0, 0.0]],
        friction=0.5,
        slip_origin=[2.0],
        tie=row,
        tie_value=[-4.0],
    )
    answer = cq.exact(squeezed)
    assert list(answer.displacement) == [-2, 0, 2, 0]
    assert answer.slip[0, 0] == 0
    assert not answer.unique_forces
    assert answer.force_range.tolist() == [[0, None]]


@pytest.mark.slow
def test_a_proposal_that_overlaps_wherever_it_drifts_is_left_for_the_other_combinations() -> None:
    # Nothing is stiff, and a free motion parts no contact that overlaps in the first proposal. The load is
    # (1, 0, 1) - (1, -1, 0) / 2: the second contact slips back and carries it alone.
    problem = cq.ContactProblem(
        np.zeros((3, 3)),
        [0.5, 0.5, 1.0],
        [[0.0, 2.0, 1.0], [1.0, 0.0, 1.0], [1.0, -1.0, 1.0]],
        [-1.0, -4.0, -4.0],
        tangent=[[0.0, 0.0, 1.0], [1.0, -1.0, 0.0], [2.0, 2.0, 1.0]],
        friction=[0.0, 0.5, 1.0],
        slip_origin=[-3.0, -1.0, -5.0],
    )
    answer = cq.exact(problem)
    assert list(answer.normal_force) == [0, 1, 0]
    assert list(answer.friction_force.ravel()) == [0, F(-1, 2), 0]
    assert list(answer.gap) == [1, 0, 0]
