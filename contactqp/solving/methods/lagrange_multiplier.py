"""The Lagrange multiplier method of the course chapter (eqs 2.21-2.23)."""

from __future__ import annotations

from functools import partial

from contactqp.model.arrays import Indices, Mask
from contactqp.model.coulomb import Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.method import Method, Settings
from contactqp.solving.methods.status_loop import status_loop
from contactqp.solving.methods.stick_and_slip import FrictionalStep, status_rows
from contactqp.solving.methods.textbook_algebra import binding_rows, solve_bordered
from contactqp.solving.methods.textbook_loop import Step, active_set_loop

NAME = "lagrange-multiplier"


def solve_lagrange_multiplier(problem: ContactProblem, settings: Settings) -> Candidate:
    """Enforce closed contacts and ties as equations whose forces are unknowns:

        [ K  C' ] {u     }   {f  }
        [ C  0  ] {lambda} = {q  }        C = [A; E_N], q = [b; g] over ties and closed contacts

    (the course chapter, eq. 2.23). The matrix is indefinite and, contrary to what the chapter says of its zero
    diagonal, regular as long as the rows of C are independent and K is positive definite on the motions that C leaves
    free. Rows that depend on others are left out. The multiplier is the contact force, positive in compression.

    Raises NotConverged: the closed contacts do not hold the bodies, or ties contradict each other.
    """
    return active_set_loop(NAME, problem, settings, partial(_enforce, problem))


def _enforce(problem: ContactProblem, closed: Mask, preference: Indices) -> Step:
    rows, values, ties, contacts = binding_rows(NAME, problem, closed, preference)
    displacement, force = solve_bordered(NAME, problem.stiffness, problem.load, rows, values, refined=True)
    return Step.on_rows(problem, displacement, force, ties, contacts)


def solve_frictional(problem: ContactProblem, settings: Settings) -> Candidate:
    """Enforce stick and slip as equations beside those of ties (course chapter, eqs 2.37 and 2.41, signs corrected):

        [ K  P' ] {u     }   {f}
        [ H  0  ] {lambda} = {q}        H = [A; E_N; E_T where it sticks], P the same with E_s = E_N + s mu E_T where
                                        it slips, q = [b; g; o]

    The matrix is unsymmetric where a contact slips.

    Raises NotConverged: the contacts do not hold the bodies, or ties contradict each other.
    """
    return status_loop(NAME, problem, settings, partial(_enforce_friction, problem))


def _enforce_friction(problem: ContactProblem, status: Status, preference: Indices) -> FrictionalStep:
    rows = status_rows(NAME, problem, status, preference, independent=True)
    K, f = problem.stiffness, problem.load
    displacement, force = solve_bordered(NAME, K, f, rows.held, rows.values, pushed=rows.pushed, refined=True)
    return rows.step(displacement, force[rows.of_contacts], force[: rows.ties.size])


METHODS = (
    Method(
        name=NAME,
        kind="classical enforcement",
        solve=solve_lagrange_multiplier,
        solve_friction=solve_frictional,
        note="the contact forces are unknowns (course chapter, eq. 2.23)",
    ),
)
