"""A contact that is nearly open, and one that is nearly closed."""

from __future__ import annotations

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.bodies import chain, rows
from contactqp.study.stability.posed import Posed, posed_with_closed

SPRINGS, GAP = (3.0, 5.0, 7.0), 1.0
FIRST_GAP, FIRST_LOAD = 0.25, 4.0


def pose(distance: float) -> Posed:
    """A chain whose first node is pressed on a stop; its end reaches for a wall with the load P = P_c (1 + δ).

    Springs 5 and 7 from the first node at 1/4 to the wall at 1: P_c = (3/4) / (1/5 + 1/7) = 35/16. The force at the
    wall is P_c δ for δ > 0, and for δ < 0 the gap is -(3/4) δ, both to the rounding of the load.
    """
    touching = (GAP - FIRST_GAP) * SPRINGS[1] * SPRINGS[2] / (SPRINGS[1] + SPRINGS[2])
    problem = ContactProblem(
        chain(SPRINGS),
        [FIRST_LOAD, 0.0, touching * (1.0 + distance)],
        rows(3, {0: 1.0}, {2: 1.0}),
        [FIRST_GAP, GAP],
    )
    return posed_with_closed(problem, [0, 1] if touching * (1.0 + distance) > touching else [0])


AXIS = Axis(
    name="grazing",
    title="Grazing distance",
    quantity="load / touching load - 1 [1]",
    values=(
        *(-(2.0**-e) for e in (1, 4, 7, 10, 14, 17, 20, 24, 27, 30, 34, 40, 44, 47, 50)),
        0.0,
        *(2.0**-e for e in (50, 47, 44, 40, 34, 30, 27, 24, 20, 17, 14, 10, 7, 4, 1)),
    ),
    pose=pose,
    about="One contact is pressed, the other one is open, touches, or is closed with next to no force.",
)
