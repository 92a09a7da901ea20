"""Rigid bodies that may roll: normal forces whose levers about the middle are the rounding of a direction."""

from typing import Any

import numpy as np
import pytest

import contactqp as cq

RADIUS, WEIGHT = 0.2, 500.0


def lever(direction: Any, arm: Any) -> np.ndarray:
    """The row of a direction at a point of a plane rigid body: two displacements of its middle and its turn."""
    return np.array([*direction, arm[0] * direction[1] - arm[1] * direction[0]])


def three_logs(between: float, on_ground: float, tilt: float = 0.0, away: float = 0.0) -> cq.ContactProblem:
    """Two logs side by side on the ground and a third on top of both."""
    turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    middle = [turn @ (RADIUS * np.array(at)) + away for at in ((-1, 0), (1, 0), (0, 3**0.5))]
    up, normal, tangent = turn @ [0.0, 1.0], np.zeros((4, 9)), np.zeros((4, 9))
    for i, (body, other) in enumerate(((0, None), (1, None), (2, 0), (2, 1))):
        below = middle[body] - RADIUS * up if other is None else (middle[body] + middle[other]) / 2
        out = (middle[body] - below) / np.linalg.norm(middle[body] - below)
        along = np.array([-out[1], out[0]])
        for part, sign in ((body, 1), (other, -1)):
            if part is not None:
                own = slice(3 * part, 3 * part + 3)
                normal[i, own] = -sign * lever(out, below - middle[part])
                tangent[i, own] = sign * lever(along, below - middle[part])
    load = np.concatenate([[*(-WEIGHT * up), 0.0]] * 3)
    friction = [on_ground, on_ground, between, between]
    return cq.ContactProblem(np.zeros((9, 9)), load, normal, np.zeros(4), tangent=tangent, friction=friction)


@pytest.mark.slow
@pytest.mark.parametrize(("tilt", "away"), [(1.0, 1e4), (0.0, 0.0), (0.3, 10.0)])
def test_three_logs_need_the_friction_of_statics(tilt: float, away: float) -> None:
    """Of each lower log three forces meet at its foot: tan 15 degrees between logs, a third of it on the ground."""
    least = 2 - 3**0.5
    found = cq.solve(three_logs(1.001 * least, 1.001 * least / 3, tilt, away))
    assert found.certificate.passed
    np.testing.assert_allclose(found.normal_force, [1.5 * WEIGHT, 1.5 * WEIGHT, WEIGHT / 2, WEIGHT / 2], rtol=1e-9)
    np.testing.assert_allclose(abs(found.friction_force.ravel()), least * WEIGHT / 2, rtol=1e-8)
    for between, on_ground in ((0.999, 1.1), (1.1, 0.9999)):  # just too little is no load that was meant to balance
        with pytest.raises(cq.NoEquilibrium, match="lower the load to what friction holds, or check the sign"):
            cq.solve(three_logs(between * least, on_ground * least / 3, tilt, away))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("rounding", [7e-19, 0.0, -1e-17])
def test_a_disc_on_springs_does_not_turn_by_1e17_to_open_its_contact(rounding: float) -> None:
    """It is pushed by 5 N, rolls 5 mm on a spring of 1 N/mm and presses on the ground with its weight."""
    disc = cq.ContactProblem(
        stiffness=np.diag([1000.0, 1000.0, 0.0]),
        load=[5.0, -100.0, 0.0],
        normal=[[0.0, -1.0, rounding]],
        gap=[0.0],
        tangent=[[1.0, 0.0, RADIUS]],
        friction=0.3,
    )
    found = cq.solve(disc)
    assert found.certificate.passed
    assert found.contact_status == "stick"
    np.testing.assert_allclose(found.displacement, [5e-3, 0.0, -25e-3], rtol=1e-12, atol=1e-15)
    assert cq.certify(disc, [5e-3, 0.0, -25e-3], [100.0], [[0.0]]).passed


def test_levers_of_rotations_with_stiffness_stay_as_they_are() -> None:
    rows = dict(normal=[[0.0, -1.0, 1e-18]], gap=[0.0], tangent=[[1.0, 1e-18, RADIUS]], friction=0.3)
    held = cq.ContactProblem(np.diag([1.0, 1.0, 1.0]), [0.0, -1.0, 0.0], **rows)
    assert (held.normal[0, 2], held.tangent[0, 1]) == (1e-18, 1e-18)
    free = cq.ContactProblem(np.diag([1.0, 1.0, 0.0]), [0.0, -1.0, 0.0], **rows)
    assert (free.normal[0, 2], free.tangent[0, 1], free.tangent[0, 2]) == (0.0, 1e-18, RADIUS)


def test_a_smooth_disc_is_told_that_its_lever_may_be_rounding() -> None:
    """Without friction nothing tells the unit of the turn: the numbers count as they are, and the cure is stated."""
    smooth = dict(normal=[[0.0, -1.0, 7e-19]], gap=[0.0], dof_names=["x", "y", "turn"])
    stated = "at turn all rows have less than 2e-15 of their largest entry: state 0 where that is rounding"
    with pytest.raises(cq.NoEquilibrium, match=f"turn by -1 .{stated}"):
        cq.solve(cq.ContactProblem(np.zeros((3, 3)), [0.0, -1.0, 0.0], **smooth))
    turned = cq.solve(cq.ContactProblem(np.diag([1.0, 1.0, 0.0]), [0.0, -1.0, 0.0], **smooth))
    assert any(stated in note for note in turned.certificate.notes)
    level = smooth | {"normal": [[0.0, -1.0, 0.0]]}
    resting = cq.solve(cq.ContactProblem(np.diag([1.0, 1.0, 0.0]), [0.0, -1.0, 0.0], **level))
    assert resting.normal_force == pytest.approx([1.0])
    assert not any(stated in note for note in resting.certificate.notes)
