"""The penalty method of the course chapter (eqs 2.24-2.26)."""

from __future__ import annotations

from functools import partial

import numpy as np

from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.coulomb import Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.criss_cross import Step
from contactqp.solving.methods.method import Method, Settings
from contactqp.solving.methods.status_loop import status_loop
from contactqp.solving.methods.stick_and_slip import (
    FrictionalStep,
    frictional_springs,
    refuse_tangential_penalty,
    spring_stiffnesses,
    status_rows,
)
from contactqp.solving.methods.textbook_algebra import binding_rows, contact_stiffness, solve_bordered, spread, springs
from contactqp.solving.methods.textbook_loop import active_set_loop

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
    refuse_tangential_penalty(NAME, settings)
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


def solve_frictional(problem: ContactProblem, settings: Settings) -> Candidate:
    """Springs at the contacts, normal and tangential: with E_s = E_N + s mu E_T where a contact slips,

        stick  (K + E_N' beta E_N + E_T' beta_T E_T) u = f + E_N' beta g + E_T' beta_T o
        slip   (K + E_s' beta E_N) u = f + E_s' beta g
               lambda_N = beta (E_N u - g)        lambda_T = beta_T (E_T u - o) or s mu lambda_N

    (the course chapter, eqs 2.43 and 2.45, the latter's sign corrected). It sticks while |beta_T (E_T u - o)| is at
    most mu lambda_N, so that a contact that sticks has moved by lambda_T / beta_T. The tangential spring hangs on a
    slider that rubs: `slip_origin` o is where the slider is when the step starts, and it ends at
    E_T u - lambda_T / beta_T (`contactqp.solving.friction.contact_springs.sliders`), from where a next step goes on.

    Options
    -------
    penalty : float or (m,) array
        beta [force / length], positive.
    tangential_penalty : float or (m,) array, optional
        beta_T, in the same unit; beta by default.

    Raises
    ------
    InvalidProblem
        beta or beta_T is not positive and finite.
    NotConverged
        The contacts do not hold the bodies.
    """
    beta = contact_stiffness(NAME, "penalty", settings.options["penalty"], problem.contacts)
    return frictional_penalty_loop(NAME, problem, settings, spring_stiffnesses(NAME, problem, settings, beta))


def frictional_penalty_loop(
    name: str, problem: ContactProblem, settings: Settings, beta: tuple[Vector, Vector], *, refined: bool = False
) -> Candidate:
    """The loop over statuses around these springs, normal and tangential, for methods that build on it."""
    enforce = partial(_enforce_friction, name, problem, beta, refined)
    return status_loop(name, problem, settings, enforce, compliance=1.0 / beta[1], stiffness=beta)


def _enforce_friction(
    name: str,
    problem: ContactProblem,
    beta: tuple[Vector, Vector],
    refined: bool,
    status: Status,
    preference: Indices,
) -> FrictionalStep:
    rows = status_rows(name, problem, status, preference, independent=False)
    springs_of_rows, contacts, ties = rows.per_row(*beta), rows.of_contacts, slice(rows.ties.size)
    matrix, load = frictional_springs(rows, springs_of_rows)
    tie = (rows.held[ties], rows.values[ties])
    displacement, tie_force = solve_bordered(name, matrix, load, *tie, refined=refined)
    force = springs_of_rows * (rows.held[contacts] @ displacement - rows.values[contacts])
    return rows.step(displacement, force, tie_force)


METHODS = (
    Method(
        name=NAME,
        kind="classical enforcement",
        solve=solve_penalty,
        solve_friction=solve_frictional,
        springs=("penalty", "tangential_penalty"),
        exact=False,
        options=("penalty", "tangential_penalty"),
        required=("penalty",),
        knob="penalty",
        note="closed contacts are springs of the given stiffness (course chapter, eq. 2.25); ties by multipliers",
    ),
)
