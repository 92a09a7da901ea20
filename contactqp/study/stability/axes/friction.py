"""Coulomb's coefficient up to and past the critical one: one answer, then three."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.exact_answer import ExactAnswer
from contactqp.study.stability.posed import Posed, posed_with_answers

CRITICAL = Fraction(1, 2)  # K11 / |K12|


def pose(ratio: float) -> Posed:
    """Klarbring's node, K = [[1, -2], [-2, 5]], on a rough floor, with μ = ratio / 2 and the push P = (μ + 1/2) / 2.

    Sliding, u_x = (P - μ) / (1 - 2 μ) = 1/4 and λ_N = 1/2 whatever μ is. Beyond the critical 1/2 the node may also
    stick (λ_N = 1, λ_T = P < μ) or be lifted (u_z = 2 P - 1 > 0) under the same load.
    """
    friction = Fraction(ratio) / 2
    push = (friction + CRITICAL) / 2
    problem = ContactProblem(
        stiffness=[[1.0, -2.0], [-2.0, 5.0]],
        load=[float(push), -1.0],
        normal=[[0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0]],
        friction=float(friction),
    )
    slides = ExactAnswer((Fraction(1, 4), Fraction(0)), (Fraction(1, 2),), (friction / 2,))
    sticks = ExactAnswer((Fraction(0), Fraction(0)), (Fraction(1),), (push,))
    lifted = ExactAnswer((5 * push - 2, 2 * push - 1), (Fraction(0),), (Fraction(0),))
    answers = [slides, sticks, lifted] if friction > CRITICAL else [slides]
    return posed_with_answers(problem, answers, np.array([[0.0, -1.0]]), np.array([[float(friction), -1.0]]))


AXIS = Axis(
    name="friction",
    title="Friction past the critical coefficient",
    quantity="μ / critical μ [1]",
    values=(
        *(2.0**-10, 0.25, 0.5, 0.75),
        *(1.0 - 2.0**-e for e in (5, 10, 20, 30, 40, 50)),
        *(1.0 + 2.0**-e for e in (50, 40, 30, 20, 10, 5)),
        *(1.25, 1.5, 2.0, 4.0, 16.0, 2.0**10, 2.0**20),
    ),
    pose=pose,
    about=(
        "One node (Klarbring 1990) slides; above the critical coefficient the same load has three equilibria, each of "
        "which is right."
    ),
)
