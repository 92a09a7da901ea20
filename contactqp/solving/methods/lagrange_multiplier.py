"""The Lagrange multiplier and the perturbed Lagrangian method of the course chapter (eqs 2.21-2.23, 2.27-2.29).

The second gives the multipliers of the first a compliance 1 / kappa; its sign in the chapter is corrected.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy.sparse as sp

from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.coulomb import Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.method import CLASSICAL_ENFORCEMENT, Method, Settings
from contactqp.solving.methods.status_loop import status_loop
from contactqp.solving.methods.stick_and_slip import FrictionalStep, status_rows
from contactqp.solving.methods.textbook_algebra import binding_rows, contact_stiffness, solve_bordered
from contactqp.solving.methods.textbook_loop import Step, active_set_loop

NAME, PERTURBED = "lagrange-multiplier", "perturbed-lagrangian"


def solve_lagrange_multiplier(problem: ContactProblem, settings: Settings) -> Candidate:
    """Enforce closed contacts and ties as equations whose forces are unknowns:

        [ K  C' ] {u     }   {f  }
        [ C  0  ] {lambda} = {q  }        C = [A; E_N], q = [b; g] over ties and closed contacts

    (the course chapter, eq. 2.23). The matrix is indefinite and, contrary to what the chapter says of its zero
    diagonal, regular as long as the rows of C are independent and K is positive definite on the motions that C leaves
    free. Dependent rows are left out. The multiplier is the contact force, positive in compression.

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


def solve_perturbed_lagrangian(problem: ContactProblem, settings: Settings) -> Candidate:
    """Perturb the multiplier's energy by lambda^2 / (2 kappa), which regularises the multiplier system:

        [ K    E_N'     ] {u     }   {f}
        [ E_N  -1/kappa ] {lambda} = {g}

    (the course chapter, eq. 2.29, which prints +1/kappa: that is a contact spring of negative stiffness, and singular
    at kappa = K). Eliminating lambda gives the penalty method with beta = kappa; in floating point this form does not
    multiply a difference of lengths by kappa, and stays right at kappa = 1e20. Ties have a zero on the diagonal.

    Raises InvalidProblem: kappa is not positive and finite; NotConverged: the closed contacts do not hold the bodies.

    Options
    -------
    perturbation : float or (m,) array
        kappa [force / length], positive.
    """
    kappa = contact_stiffness(PERTURBED, "perturbation", settings.options["perturbation"], problem.contacts)
    return active_set_loop(PERTURBED, problem, settings, partial(_enforce_perturbed, problem, kappa), stiffness=0.0)


def _enforce_perturbed(problem: ContactProblem, kappa: Vector, closed: Mask, preference: Indices) -> Step:
    # Perturbed contact rows may depend on each other; ties may not.
    rows, values, ties, _ = binding_rows(PERTURBED, problem, np.zeros_like(closed), preference)
    contacts = np.flatnonzero(closed)
    rows = sp.csr_array(sp.vstack([rows, problem.normal[contacts]], format="csr"))
    values = np.concatenate([values, problem.gap[contacts]])
    corner = np.concatenate([np.zeros(ties.size), -1.0 / kappa[contacts]])
    displacement, force = solve_bordered(PERTURBED, problem.stiffness, problem.load, rows, values, corner)
    return Step.on_rows(problem, displacement, force, ties, contacts)


def solve_perturbed_frictional(problem: ContactProblem, settings: Settings) -> Candidate:
    """Enforce stick (course chapter, eq. 2.48, sign corrected) and slip, with E_s = E_N + s mu E_T:

        [ K    E_N'      E_T'     ] {u       }   {f}        [ K    E_s'     ] {u       }   {f}
        [ E_N  -1/kappa           ] {lambda_N} = {g}        [ E_N  -1/kappa ] {lambda_N} = {g}
        [ E_T            -1/kappa ] {lambda_T}   {o}        lambda_T = s mu lambda_N

    It is the penalty method with friction for beta = beta_T = kappa, in exact arithmetic; `slip_origin` means the same.

    Raises InvalidProblem: kappa is not positive and finite; NotConverged: the contacts do not hold the bodies.

    Options
    -------
    perturbation : float or (m,) array
        kappa [force / length], positive.
    """
    kappa = contact_stiffness(PERTURBED, "perturbation", settings.options["perturbation"], problem.contacts)
    return status_loop(
        PERTURBED, problem, settings, partial(_enforce_perturbed_friction, problem, kappa), compliance=1.0 / kappa
    )


def _enforce_perturbed_friction(
    problem: ContactProblem, kappa: Vector, status: Status, preference: Indices
) -> FrictionalStep:
    rows = status_rows(PERTURBED, problem, status, preference, independent=False)
    corner = np.concatenate([np.zeros(rows.ties.size), -1.0 / rows.per_row(kappa, kappa)])
    K, f = problem.stiffness, problem.load
    displacement, force = solve_bordered(PERTURBED, K, f, rows.held, rows.values, corner, pushed=rows.pushed)
    return rows.step(displacement, force[rows.of_contacts], force[: rows.ties.size])


METHODS = (
    Method(
        name=NAME,
        kind=CLASSICAL_ENFORCEMENT,
        solve=solve_lagrange_multiplier,
        solve_friction=solve_frictional,
        note="the contact forces are unknowns (course chapter, eq. 2.23)",
    ),
    Method(
        name=PERTURBED,
        kind=CLASSICAL_ENFORCEMENT,
        solve=solve_perturbed_lagrangian,
        solve_friction=solve_perturbed_frictional,
        springs=("perturbation", "perturbation"),
        exact=False,
        options=("perturbation",),
        required=("perturbation",),
        knob="perturbation",
        note="multipliers with a compliance 1/kappa (course chapter, eq. 2.29, sign corrected); equals penalty",
    ),
)
