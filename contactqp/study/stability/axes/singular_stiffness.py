"""A body on a support that softens until the body floats."""

from __future__ import annotations

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis, powers_of_two
from contactqp.study.stability.bodies import chain, rows
from contactqp.study.stability.posed import Posed, posed_with_closed


def pose(support: float) -> Posed:
    """Five nodes, unit springs, a ground spring ε, a wall: u is of size 1 and the wall carries all but ε of the load.

    From ε = 2^-53 on, 1 + ε is 1: K is singular, the body floats, and the wall holds it.
    """
    problem = ContactProblem(chain([support, 1.0, 1.0, 1.0, 1.0]), [0.0, 0.0, 1.0, 0.0, 2.0], rows(5, {4: 1.0}), [4.0])
    return posed_with_closed(problem, [0])


AXIS = Axis(
    name="singular-stiffness",
    title="Stiffness nearly singular",
    quantity="support / spring of the body [1]",
    values=powers_of_two(-60, -54, -53, -52, -50, -47, -43, -40, -37, -33, -30, -27, -23, -20, -13, -7, -3, -1),
    pose=pose,
    about="A body on a soft support is pressed on a wall; at last rounding loses the support, and the body floats.",
)
