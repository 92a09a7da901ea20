"""The penalty method of the course chapter (eqs 2.24-2.26).

With friction it is the exact problem of other bodies: between body and obstacle there is a slider on springs.

A contact with a normal spring beta and a tangential spring beta_T, and with rigid friction behind them, is Coulomb's
exact law for the far ends z_N, z_T of these springs,

    1/2 u'Ku - f'u + sum 1/2 beta (E_N u - z_N)^2 + sum 1/2 beta_T |E_T u - z_T|^2,        z_N <= g,
    |l_T| <= mu l_N,   l_T = mu l_N s/|s| where the slip s = z_T - slip_origin of the slider does not vanish,

so that l_N = beta (E_N u - z_N), l_T = beta_T (E_T u - z_T): any solver of the exact law solves the penalised one. Its
history is that of the sliders: the next step's slip origin is where they are.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.certificate.certificate import certificate_of
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.coulomb import Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate, FreeMotion, Solution
from contactqp.solving.methods.method import CLASSICAL_ENFORCEMENT, Method, Settings
from contactqp.solving.methods.status_loop import status_loop
from contactqp.solving.methods.stick_and_slip import (
    FrictionalStep,
    frictional_springs,
    refuse_tangential_penalty,
    spring_stiffnesses,
    status_rows,
)
from contactqp.solving.methods.textbook_algebra import binding_rows, contact_stiffness, solve_bordered, spread, springs
from contactqp.solving.methods.textbook_loop import Step, active_set_loop

NAME = "penalty"


def solve_penalty(problem: ContactProblem, settings: Settings) -> Candidate:
    """Enforce closed contacts by springs of stiffness beta that resist penetration:

        (K + E_N' beta E_N) u = f + E_N' beta g        lambda = beta (E_N u - g)

    (the course chapter, eqs 2.25 and 2.26). Ties are enforced by multiplier rows beside this system. The error is the
    penetration lambda / beta. The arithmetic is the textbook's: lambda is beta times a difference of lengths, so that
    from beta of about 1e12 the rounding of the gap shows, and at beta = 1e20 lambda is a multiple of beta times the
    last place of the gap (the 21.684 kN of the chapter's Table 2.1).

    Raises InvalidProblem: beta is not positive and finite; NotConverged: the closed contacts do not hold the bodies.

    Options
    -------
    penalty : float or (m,) array
        beta [force / length], positive.
    """
    refuse_tangential_penalty(NAME, settings)
    beta = contact_stiffness(NAME, "penalty", settings.options["penalty"], problem.contacts)
    return penalty_loop(NAME, problem, settings, beta)


def penalty_loop(
    name: str, problem: ContactProblem, settings: Settings, beta: Vector, *, refined: bool = False
) -> Candidate:
    """Run the active-set loop with the springs of eq. 2.25, for this method and those that build on it.

    Parameters
    ----------
    name : the method's name, for messages
    problem : ContactProblem
    settings : limits, and the answer to start from
    beta : (m,) array [force / length], stiffnesses of the springs
    refined : as in `solve_linear`
    """
    return active_set_loop(name, problem, settings, partial(_enforce, name, problem, beta, refined), stiffness=beta)


def _enforce(
    name: str, problem: ContactProblem, beta: Vector, refined: bool, closed: Mask, preference: Indices
) -> Step:
    rows, values, ties, _ = binding_rows(name, problem, np.zeros_like(closed), preference)
    matrix, load = springs(problem, closed, beta)
    displacement, tie_force = solve_bordered(name, matrix, load, rows, values, refined=refined)
    penetration = problem.normal @ displacement - problem.gap
    normal_force = np.where(closed, beta * penetration, 0.0)
    return Step(Answer(displacement, normal_force, None, spread(tie_force, ties, problem.ties)), bound=closed)


def solve_frictional(problem: ContactProblem, settings: Settings) -> Candidate:
    """Enforce contact by normal and tangential springs, with E_s = E_N + s mu E_T where a contact slips,

        stick  (K + E_N' beta E_N + E_T' beta_T E_T) u = f + E_N' beta g + E_T' beta_T o
        slip   (K + E_s' beta E_N) u = f + E_s' beta g
               lambda_N = beta (E_N u - g)        lambda_T = beta_T (E_T u - o) or s mu lambda_N

    (the course chapter, eqs 2.43 and 2.45, the latter's sign corrected). It sticks while |beta_T (E_T u - o)| is at
    most mu lambda_N, so that a contact that sticks has moved by lambda_T / beta_T. The tangential spring hangs on a
    slider with friction: `slip_origin` o is where the slider is when the step starts, and it ends at
    E_T u - lambda_T / beta_T (`contactqp.solving.methods.penalty.sliders`), from where a next step goes on.

    Raises InvalidProblem: beta or beta_T is not positive and finite; NotConverged: the contacts do not hold the bodies.

    Options
    -------
    penalty : float or (m,) array
        beta [force / length], positive.
    tangential_penalty : float or (m,) array, optional
        beta_T, in the same unit; beta by default.
    """
    beta = contact_stiffness(NAME, "penalty", settings.options["penalty"], problem.contacts)
    return frictional_penalty_loop(NAME, problem, settings, spring_stiffnesses(NAME, problem, settings, beta))


def frictional_penalty_loop(
    name: str, problem: ContactProblem, settings: Settings, beta: tuple[Vector, Vector], *, refined: bool = False
) -> Candidate:
    """Run the loop over statuses with normal and tangential springs, for this method and those that build on it.

    Parameters
    ----------
    name, problem, settings, refined
        As in `penalty_loop`.
    beta : two (m,) arrays [force / length], stiffnesses of the normal and of the tangential springs
    """
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
        kind=CLASSICAL_ENFORCEMENT,
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


SLIDERS = "contact springs"


def with_contact_springs(
    problem: ContactProblem, penalty: ArrayLike, tangential_penalty: ArrayLike | None = None
) -> ContactProblem:
    """Return the problem whose exact answer is the penalised answer to this one.

    Raises InvalidProblem: a stiffness is not positive and finite, or there are no tangential rows.

    Parameters
    ----------
    problem : with tangential rows, in the plane or in space
    penalty : float or (m,) array, beta [force / length], positive
    tangential_penalty : float or (m,) array, optional
        beta_T [force / length], positive; beta by default.

    Returns
    -------
    ContactProblem
        Its unknowns are (u, z_N, z_T), z_T contact by contact; its contacts, ties and slip origins those of `problem`.
    """
    if problem.tangent is None or problem.slip_origin is None:
        raise InvalidProblem(f"{SLIDERS}: expected a problem with tangential rows, got {shown(problem)}")
    n, m, width = problem.dimension, problem.contacts, problem.slip_origin.shape[1]
    normal, tangential = _stiffnesses(m, penalty, tangential_penalty)
    rows: Any = sp.vstack([problem.normal, problem.tangent], format="csr")
    springs = sp.diags(np.concatenate([normal, np.repeat(tangential, width)]))
    far = -springs @ rows
    stiffness = sp.bmat([[sp.csr_array(problem.stiffness) + rows.T @ springs @ rows, far.T], [far, springs]])
    # A contact whose tangential unknowns are all supported cannot slide, with or without a spring.
    slides = sp.diags((np.diff(sp.csr_array(problem.tangent).indptr) > 0).astype(float))
    ahead = sp.hstack([sp.csr_array((m, n)), sp.identity(m), sp.csr_array((m, m * width))])
    aside = sp.hstack([sp.csr_array((m * width, n + m)), slides])
    return ContactProblem(
        stiffness=stiffness if sp.issparse(problem.stiffness) else stiffness.toarray(),
        load=np.concatenate([problem.load, np.zeros(m + m * width)]),
        normal=ahead,
        gap=problem.gap,
        tangent=aside,
        friction=problem.friction,
        slip_origin=problem.slip_origin,
        tie=sp.hstack([problem.tie, sp.csr_array((problem.ties, m + m * width))]),
        tie_value=problem.tie_value,
        dof_names=_names(problem, width),
        contact_names=problem.contact_names,
        units=problem.units,
    )


def without_contact_springs(problem: ContactProblem, solution: Solution, name: str = "penalty") -> Solution:
    """Return the solution of `with_contact_springs(problem, ...)` as the penalised solution of `problem`.

    Its certificate is that of `problem` with rigid contacts, so it measures the error by the springs. Stick and slip
    are those of the sliders.
    """
    n = problem.dimension
    answer = replace(solution.answer, displacement=solution.answer.displacement[:n])
    return replace(
        solution,
        problem=problem,
        answer=answer,
        free_motions=tuple(FreeMotion(motion.direction[:n], str(motion)) for motion in solution.free_motions),
        certificate=certificate_of(problem, answer),
        method=f"{name} by {solution.method}",
        raw=None,
    )


def _stiffnesses(contacts: int, penalty: Any, tangential_penalty: Any) -> tuple[Vector, Vector]:
    normal = contact_stiffness(SLIDERS, "penalty", penalty, contacts)
    if tangential_penalty is None:
        return normal, normal
    return normal, contact_stiffness(SLIDERS, "tangential_penalty", tangential_penalty, contacts)


def _names(problem: ContactProblem, width: int) -> list[str] | None:
    if problem.dof_names is None:
        return None
    contacts = [problem.contact_name(i) for i in range(problem.contacts)]
    aside = [f"{name}: slider" + (f" {k + 1}" if width > 1 else "") for name in contacts for k in range(width)]
    return [*problem.dof_names, *(f"{name}: normal spring" for name in contacts), *aside]
