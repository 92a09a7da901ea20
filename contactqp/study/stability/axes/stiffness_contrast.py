"""Soft and stiff springs in turn."""

from __future__ import annotations

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis, powers_of_two
from contactqp.study.stability.bodies import chain, rows
from contactqp.study.stability.posed import Posed, posed_with_closed


def pose(contrast: float) -> Posed:
    """Springs 1, c, 1, c in a row; stops at the far ends of the stiff ones. Forces stay of size 1 whatever c is.

    What a stiff spring carries is c times a difference of displacements of size 1/c: their rounding shows c times.
    The last value is 2^53 - 1: beyond it 1 + c is no double, and K with its rounded entries is no stiffness any more.
    """
    return posed_with_closed(
        ContactProblem(
            stiffness=chain([1.0, contrast, 1.0, contrast]),
            load=[0.0, 4.0, 0.0, 8.0],
            normal=rows(4, {1: 1.0}, {3: 1.0}),
            gap=[1.0, 2.0],
        ),
        [0, 1],
    )


AXIS = Axis(
    name="stiffness-contrast",
    title="Stiffness contrast",
    quantity="stiff spring / soft spring [1]",
    values=(*powers_of_two(0, 3, 7, 10, 13, 17, 20, 23, 27, 30, 33, 37, 40, 43, 47, 50, 52), 2.0**53 - 1),
    pose=pose,
    about="A chain of soft and stiff springs in turn with two stops, up to what one entry of K can hold.",
)
