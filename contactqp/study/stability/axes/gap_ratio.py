"""A small gap between bodies that travel far, and a wide one."""

from __future__ import annotations

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis, powers_of_two
from contactqp.study.stability.bodies import blocks, chain, rows
from contactqp.study.stability.posed import Posed, posed_with_closed


def pose(gap: float) -> Posed:
    """Two chains of unit springs; their ends travel by 1 + g and by 1 and meet with a force of 1/2.

    u = (1/2, 1 + g, 1, 1/2) gives f = (-g, 1 + g, 0, 0). From g = 2^-53 on 1 + g is no double, and the problem is the
    one of the rounded load.
    """
    right = chain([1.0, 1.0])[::-1, ::-1]  # held at its far end
    load = [-gap, 1.0 + gap, 0.0, 0.0]
    return posed_with_closed(
        ContactProblem(blocks(chain([1.0, 1.0]), right), load, rows(4, {1: 1.0, 2: -1.0}), [gap]), [0]
    )


AXIS = Axis(
    name="gap-ratio",
    title="Gap / travel",
    quantity="gap / displacement of the other body [1]",
    values=powers_of_two(-70, -60, -54, -52, -50, -47, -43, -40, -33, -27, -20, -13, -7, -3, 0, 7, 13, 20, 30, 40),
    pose=pose,
    about="Two bodies that travel by 1: what closes the gap between them is a difference of lengths of size 1.",
)
