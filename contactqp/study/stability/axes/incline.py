"""A block that nothing but friction holds on an incline: below tan α there is no equilibrium."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.exact_answer import ExactAnswer
from contactqp.study.stability.posed import Posed, posed_with_answers

SLOPE = Fraction(3, 4)  # tan α
NORMAL, TANGENT = [[3.0, -4.0]], [[4.0, 3.0]]  # along (-3, 4) / 5 and along the plane, five times as long


def pose(ratio: float) -> Posed:
    """A rigid block of weight 25 without any spring on an incline of slope 3/4, μ = ratio × 3/4.

    It is held by λ_N = 4 and λ_T = -3 (forces of rows of length 5: 20 and 15 N) wherever μ >= 3/4.
    """
    friction = Fraction(ratio) * SLOPE
    problem = ContactProblem(np.zeros((2, 2)), [0.0, -25.0], NORMAL, [0.0], tangent=TANGENT, friction=float(friction))
    held = ExactAnswer((Fraction(0), Fraction(0)), (Fraction(4),), (Fraction(-3),))
    rows = np.array([*NORMAL, *TANGENT])
    return posed_with_answers(problem, [held] if friction >= SLOPE else [], rows, rows)


AXIS = Axis(
    name="incline",
    title="Friction that must hold a body",
    quantity="μ / slope [1]",
    values=(
        *(2.0**-10, 0.5, 0.75),
        *(1.0 - 2.0**-e for e in (5, 10, 20, 30, 40, 50)),
        *(1.0, *(1.0 + 2.0**-e for e in (50, 40, 30, 20, 10, 5))),
        *(1.25, 2.0, 16.0, 2.0**10, 2.0**20),
    ),
    pose=pose,
    about="A block without springs on an incline: below its slope no equilibrium exists, and to say so is right.",
)
