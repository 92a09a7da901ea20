"""A bar whose elements shrink towards the contact."""

from __future__ import annotations

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis, powers_of_two
from contactqp.study.stability.bodies import chain, rows
from contactqp.study.stability.posed import Posed, posed_with_closed

ELEMENTS = 10


def pose(grading: float) -> Posed:
    """A bar of ten elements, the shortest 1/grading of the longest: springs from 1 to grading, each a power of two.

    It is pulled at its middle and at its end, which meets a wall. Neighbouring springs add up to doubles while their
    ratio is below 2^53.
    """
    exponent = grading.as_integer_ratio()[0].bit_length() - 1
    springs = [2.0 ** round(exponent * i / (ELEMENTS - 1)) for i in range(ELEMENTS)]
    load = [0.0] * ELEMENTS
    load[ELEMENTS // 2], load[-1] = 1.0, 2.0
    return posed_with_closed(ContactProblem(chain(springs), load, rows(ELEMENTS, {ELEMENTS - 1: 1.0}), [0.5]), [0])


AXIS = Axis(
    name="mesh-grading",
    title="Mesh grading",
    quantity="longest / shortest element [1]",
    values=powers_of_two(0, 3, 7, 10, 13, 17, 20, 27, 33, 40, 47, 53, 60, 80, 100),
    pose=pose,
    about="A bar whose elements shrink towards the wall that it meets: stiffnesses 1 to the grading in one chain.",
)
