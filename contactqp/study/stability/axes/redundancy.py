"""Two contacts whose normals differ by a small angle."""

from __future__ import annotations

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis, powers_of_two
from contactqp.study.stability.posed import Posed, posed_with_closed


def pose(angle: float) -> Posed:
    """A node held by springs, pressed into the corner of (0, -1) and (θ, -1): u = (0, -1), λ = (3, 5) while θ > 2^-50.

    f = K u + E'λ = (1 + 5 θ, -13): what tells the two forces apart is the angle, 5 θ beside 1. From θ = 2^-51 on it
    is no double; then, as when the angle is lost, the problem is that of the rounded load.
    """
    problem = ContactProblem(
        [[4.0, -1.0], [-1.0, 5.0]], [1.0 + 5.0 * angle, -13.0], [[0.0, -1.0], [angle, -1.0]], [1.0, 1.0]
    )
    return posed_with_closed(problem, [0, 1])


AXIS = Axis(
    name="redundancy",
    title="Nearly redundant contacts",
    quantity="angle between the normals of two contacts [rad]",
    values=powers_of_two(-50, -47, -43, -40, -37, -33, -30, -27, -23, -20, -17, -13, -10, -7, -3, 0),
    pose=pose,
    about="A node in a corner that is nearly flat: both contacts carry force, and only the angle tells them apart.",
)
