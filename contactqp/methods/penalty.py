"""The penalty method of the course chapter (eqs 2.24-2.26)."""

from __future__ import annotations

from functools import partial

import numpy as np

from contactqp.methods.criss_cross import Step
from contactqp.methods.method import Method, Settings
from contactqp.methods.textbook_algebra import (
    Indices,
    Mask,
    binding_rows,
    contact_stiffness,
    solve_bordered,
    spread,
    springs,
)
from contactqp.methods.textbook_loop import active_set_loop
from contactqp.problem import ContactProblem, Vector
from contactqp.solution import Candidate

NAME = "penalty"


def solve_penalty(problem: ContactProblem, settings: Settings) -> Candidate:
    """Closed contacts as springs of stiffness beta that resist penetration:

        (K + E_N' beta E_N) u = f + E_N' beta g        lambda = beta (E_N u - g)

    (the course chapter, eqs 2.25 and 2.26). Ties are no springs: they are enforced by multiplier rows beside this
    system. The answer is off by the penetration lambda / beta. The arithmetic is the textbook's: lambda is beta times a
    difference of lengths, so that from beta of about 1e12 the rounding of the gap shows, and at beta = 1e20 lambda is a
    multiple of beta times the last place of the gap (the 21.684 kN of the chapter's Table 2.1).

    Options
    -------
    penalty : float or (m,) array
        beta [force / length], positive.

    Raises
    ------
    InvalidProblem
        beta is not positive and finite.
    NotConverged
        The closed contacts do not hold the bodies.
    """
    beta = contact_stiffness(NAME, "penalty", settings.options["penalty"], problem.contacts)
    return penalty_loop(NAME, problem, settings, beta)


def penalty_loop(
    name: str, problem: ContactProblem, settings: Settings, beta: Vector, *, refined: bool = False
) -> Candidate:
    """The active-set loop around eq. 2.25, for methods that build on it."""
    return active_set_loop(name, problem, settings, partial(_enforce, name, problem, beta, refined), stiffness=beta)


def _enforce(
    name: str, problem: ContactProblem, beta: Vector, refined: bool, closed: Mask, preference: Indices
) -> Step:
    rows, values, ties, _ = binding_rows(name, problem, np.zeros_like(closed), preference)
    matrix, load = springs(problem, closed, beta)
    displacement, tie_force = solve_bordered(name, matrix, load, rows, values, refined=refined)
    penetration = problem.normal @ displacement - problem.gap
    return Step(
        displacement,
        normal_force=np.where(closed, beta * penetration, 0.0),
        tie_force=spread(tie_force, ties, problem.ties),
        bound=closed,
    )


METHODS = (
    Method(
        name=NAME,
        kind="classical enforcement",
        solve=solve_penalty,
        exact=False,
        options=("penalty",),
        required=("penalty",),
        knob="penalty",
        note="closed contacts are springs of the given stiffness (course chapter, eq. 2.25); ties by multipliers",
    ),
)
