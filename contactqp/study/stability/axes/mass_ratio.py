"""A heavy mass on a stack of light ones: the contact problem of a time step of impact."""

from __future__ import annotations

import numpy as np

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis, powers_of_two
from contactqp.study.stability.bodies import rows
from contactqp.study.stability.posed import Posed, posed_with_closed

COUNT = 8


def pose(ratio: float) -> Posed:
    """Seven masses of 1 under one of r fall at a speed of 1 onto a floor that sinks at 1/4: M v + E'p = M v_free.

    All fall at 1/4 afterwards, and the impulse between two of them is 3/4 of the mass above.
    """
    mass = np.ones(COUNT)
    mass[-1] = ratio
    joints = [{0: -1.0}, *({i: 1.0, i + 1: -1.0} for i in range(COUNT - 1))]
    gap = np.zeros(COUNT)
    gap[0] = 0.25
    return posed_with_closed(ContactProblem(np.diag(mass), -mass, rows(COUNT, *joints), gap), list(range(COUNT)))


AXIS = Axis(
    name="mass-ratio",
    title="Mass ratio",
    quantity="heavy mass / light mass [1]",
    values=powers_of_two(-53, -40, -30, -20, -10, -5, 0, 2, 4, 7, 10, 13, 17, 20, 27, 33, 40, 47, 53, 60),
    pose=pose,
    about=(
        "A step of Moreau's and Jean's scheme for eight bodies that fall on each other is the contact problem "
        "M v + E'p = M v_free, E v <= g: K is the mass matrix, displacements are velocities, forces are impulses."
    ),
)
