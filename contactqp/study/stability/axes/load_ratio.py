"""Loads that are tiny and huge beside stiffness times gap."""

from __future__ import annotations

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis, powers_of_two
from contactqp.study.stability.bodies import blocks, chain, rows
from contactqp.study.stability.posed import Posed, posed_with_closed

GAP = 0.25
# The loaded chain is two unit springs in series: it travels by twice the load.
TOUCHING = GAP / 2


def pose(load: float) -> Posed:
    """Two chains of two unit springs, 1/4 apart, one of them pulled onto the other."""
    right = chain([1.0, 1.0])[::-1, ::-1]
    problem = ContactProblem(blocks(chain([1.0, 1.0]), right), [0.0, load, 0.0, 0.0], rows(4, {1: 1.0, 2: -1.0}), [GAP])
    return posed_with_closed(problem, [0] if load > TOUCHING else [])


AXIS = Axis(
    name="load-ratio",
    title="Load / stiffness",
    quantity="load / (spring times unit length) [1]; the gap closes above 1/8",
    values=powers_of_two(-540, -100, -50, -30, -20, -10, -5, -4, 0, 5, 10, 20, 30, 50, 100, 300, 500, 540),
    pose=pose,
    about="The same two bodies under loads from nothing to far beyond what numbers can square.",
)
