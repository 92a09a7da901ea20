"""The perturbed Lagrangian method of the course chapter (eqs 2.27-2.29), with its sign corrected."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy.sparse as sp

from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.coulomb import Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.method import Method, Settings
from contactqp.solving.methods.status_loop import status_loop
from contactqp.solving.methods.stick_and_slip import FrictionalStep, status_rows
from contactqp.solving.methods.textbook_algebra import binding_rows, contact_stiffness, solve_bordered
from contactqp.solving.methods.textbook_loop import Step, active_set_loop

NAME = "perturbed-lagrangian"


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
    kappa = contact_stiffness(NAME, "perturbation", settings.options["perturbation"], problem.contacts)
    return active_set_loop(NAME, problem, settings, partial(_enforce, problem, kappa), stiffness=0.0)


def _enforce(problem: ContactProblem, kappa: Vector, closed: Mask, preference: Indices) -> Step:
    # Perturbed contact rows may depend on each other; ties may not.
    rows, values, ties, _ = binding_rows(NAME, problem, np.zeros_like(closed), preference)
    contacts = np.flatnonzero(closed)
    rows = sp.csr_array(sp.vstack([rows, problem.normal[contacts]], format="csr"))
    values = np.concatenate([values, problem.gap[contacts]])
    corner = np.concatenate([np.zeros(ties.size), -1.0 / kappa[contacts]])
    displacement, force = solve_bordered(NAME, problem.stiffness, problem.load, rows, values, corner)
    return Step.on_rows(problem, displacement, force, ties, contacts)


def solve_frictional(problem: ContactProblem, settings: Settings) -> Candidate:
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
    kappa = contact_stiffness(NAME, "perturbation", settings.options["perturbation"], problem.contacts)
    return status_loop(NAME, problem, settings, partial(_enforce_friction, problem, kappa), compliance=1.0 / kappa)


def _enforce_friction(problem: ContactProblem, kappa: Vector, status: Status, preference: Indices) -> FrictionalStep:
    rows = status_rows(NAME, problem, status, preference, independent=False)
    corner = np.concatenate([np.zeros(rows.ties.size), -1.0 / rows.per_row(kappa, kappa)])
    K, f = problem.stiffness, problem.load
    displacement, force = solve_bordered(NAME, K, f, rows.held, rows.values, corner, pushed=rows.pushed)
    return rows.step(displacement, force[rows.of_contacts], force[: rows.ties.size])


METHODS = (
    Method(
        name=NAME,
        kind="classical enforcement",
        solve=solve_perturbed_lagrangian,
        solve_friction=solve_frictional,
        springs=("perturbation", "perturbation"),
        exact=False,
        options=("perturbation",),
        required=("perturbation",),
        knob="perturbation",
        note="multipliers with a compliance 1/kappa (course chapter, eq. 2.29, sign corrected); equals penalty",
    ),
)
