"""The Lagrange multiplier method of the course chapter (eqs 2.21-2.23)."""

from __future__ import annotations

from functools import partial

import numpy as np

from contactqp.methods.criss_cross import Step
from contactqp.methods.method import Method, Settings
from contactqp.methods.textbook_algebra import Indices, Mask, binding_rows, solve_bordered, spread
from contactqp.methods.textbook_loop import active_set_loop
from contactqp.problem import ContactProblem
from contactqp.solution import Candidate

NAME = "lagrange-multiplier"


def solve_lagrange_multiplier(problem: ContactProblem, settings: Settings) -> Candidate:
    """Closed contacts and ties as equations, their forces as unknowns:

        [ K  C' ] {u     }   {f  }
        [ C  0  ] {lambda} = {q  }        C = [A; E_N], q = [b; g] over ties and closed contacts

    (the course chapter, eq. 2.23). The matrix is indefinite and, contrary to what the chapter says of its zero
    diagonal, regular as long as the rows of C are independent and K is positive definite on the motions that C leaves
    free. Rows that depend on others are left out. The multiplier is the contact force, positive in compression.

    Raises
    ------
    NotConverged
        The closed contacts do not hold the bodies, or ties contradict each other.
    """
    return active_set_loop(NAME, problem, settings, partial(_enforce, problem))


def _enforce(problem: ContactProblem, closed: Mask, preference: Indices) -> Step:
    rows, values, ties, contacts = binding_rows(NAME, problem, closed, preference)
    displacement, force = solve_bordered(NAME, problem.stiffness, problem.load, rows, values, refined=True)
    return Step(
        displacement,
        normal_force=spread(force[ties.size :], contacts, problem.contacts),
        tie_force=spread(force[: ties.size], ties, problem.ties),
        bound=spread(np.ones(contacts.size), contacts, problem.contacts) > 0,
    )


METHODS = (
    Method(
        name=NAME,
        kind="classical enforcement",
        solve=solve_lagrange_multiplier,
        note="the contact forces are unknowns (course chapter, eq. 2.23)",
    ),
)
