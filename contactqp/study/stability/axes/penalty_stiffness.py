"""Penalty β, perturbation κ and the augmented Lagrangian's β on the two-bar truss of the course chapter."""

from __future__ import annotations

from fractions import Fraction

from contactqp.model.problem import ContactProblem
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.exact_answer import ExactAnswer
from contactqp.study.stability.posed import Posed, posed_with_closed

STIFFNESS = ((59803.0, 6883.1), (6883.1, 77443.0))  # kN/m, as printed
LOAD = (60.0, -100.0)  # kN
GAP = 1e-3  # m
# Between 1e9 and 1e16, where the error turns, every half decade.
VALUES = tuple(sorted([10.0**k for k in range(25)] + [float(f"1e{k}") * 3.0 for k in range(9, 16)]))


def truss() -> ContactProblem:
    """Two bars over a smooth floor (Example 2.10): kN and m."""
    return ContactProblem(
        stiffness=STIFFNESS, load=LOAD, normal=[[0.0, -1.0]], gap=[GAP], units={"length": "m", "force": "kN"}
    )


def closed_form() -> ExactAnswer:
    """u_x = (f_x + K12 g) / K11, u_z = -g, λ = K12 u_x - K22 g - f_z, of the doubles as they stand."""
    (k11, k12), (_, k22) = ((Fraction(x) for x in row) for row in STIFFNESS)
    g, (fx, fz) = Fraction(GAP), (Fraction(x) for x in LOAD)
    ux = (fx + k12 * g) / k11
    return ExactAnswer((ux, -g), (k12 * ux - k22 * g - fz,))


def pose(_: float) -> Posed:
    """The same problem for every β."""
    return posed_with_closed(truss(), [0])


AXIS = Axis(
    name="penalty",
    title="Penalty β and perturbation κ",
    quantity="β, κ [kN/m]",
    values=VALUES,
    pose=pose,
    about=(
        "The two-bar truss of Example 2.10 of the course chapter, whose Table 2.1 ends with 21.684 kN at β = 1e20. "
        "Only methods that have such a knob are swept."
    ),
    knobs={"penalty": "penalty", "perturbed-lagrangian": "perturbation", "augmented-lagrangian": "penalty"},
)
