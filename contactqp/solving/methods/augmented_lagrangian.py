"""The augmented Lagrangian method of the course chapter (eqs 2.30-2.32), as one system and as Uzawa's iteration."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, shown
from contactqp.linalg.measures import lengths_that_meet, ratio
from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.coulomb import Status
from contactqp.model.problem import ContactProblem, Matrix
from contactqp.model.solution import Candidate
from contactqp.solving.methods.method import CLASSICAL_ENFORCEMENT, Method, Settings
from contactqp.solving.methods.penalty import frictional_penalty_loop, penalty_loop
from contactqp.solving.methods.status_loop import status_loop
from contactqp.solving.methods.stick_and_slip import (
    FrictionalStep,
    coefficients,
    frictional_springs,
    origins,
    refuse_tangential_penalty,
    spring_stiffnesses,
    status_rows,
)
from contactqp.solving.methods.textbook_algebra import binding_rows, contact_stiffness, solve_bordered, spread, springs
from contactqp.solving.methods.textbook_loop import Budget, Step, active_set_loop

NAME = "augmented-lagrangian"

# With beta at this multiple of the contact stiffness, an Uzawa iteration gains about two decimal digits for uncoupled
# contacts; larger values gain more but lose as many digits of the gap to rounding.
UZAWA_STIFFENING = 100.0
# Uzawa's iteration ends after this many iterations without progress, unless `max_iter` is larger; with friction it may
# cycle, and at the level of rounding it stagnates.
STALLED = 100


def solve_augmented_lagrangian(problem: ContactProblem, settings: Settings) -> Candidate:
    """Enforce closed contacts by multipliers and penalty together.

    ``update="simultaneous"`` (the default) solves the chapter's eq. 2.32 for the closed contacts,

        [ K + E_N' beta E_N  E_N' ] {u     }   {f + E_N' beta g}
        [ E_N                0    ] {lambda} = {g              }

    which is exact for every beta >= 0, not only for beta -> 0 as the chapter says: E_N u = g cancels the beta terms.

    ``update="uzawa"`` keeps lambda fixed while u is found, and repeats

        lambda <- max(0, lambda + beta (E_N u - g))

    Each u is the answer of the penalty method with the gaps g - lambda / beta. The error shrinks by about
    S / (S + beta) an iteration with S the stiffness that a contact feels, (E_N K^-1 E_N')^-1.

    Raises InvalidProblem: beta is negative or not finite, or zero with Uzawa; `update` is neither of the two;
    NotConverged: the closed contacts do not hold the bodies.

    Options
    -------
    penalty : float or (m,) array, optional
        beta [force / length]; by default 1 / sum_j (E_ij^2 / K_jj), which estimates the stiffness that contact i
        feels from above, and exists for bodies that float as well; 100 times that with Uzawa.
    update : "simultaneous" or "uzawa"

    Returns
    -------
    Candidate
        `history` of Uzawa is the larger of the change of the forces relative to the largest force, and of the worst
        violation of g - E_N u >= 0, lambda (g - E_N u) = 0 relative to |E_N||u| + |g|, one number an iteration. It ends
        when both are at most `settings.tolerance`.
    """
    refuse_tangential_penalty(NAME, settings)
    update, beta = _chosen(problem, settings)
    if update == "uzawa":
        return _uzawa_frictionless(problem, settings, beta)
    return active_set_loop(NAME, problem, settings, partial(_enforce, problem, beta), stiffness=beta)


def _chosen(problem: ContactProblem, settings: Settings) -> tuple[str, Vector]:
    """Return the requested update, and beta (m,) as given or by default."""
    update = settings.options.get("update", "simultaneous")
    if not isinstance(update, str) or update not in ("simultaneous", "uzawa"):
        raise InvalidProblem(f"{NAME}: update: expected 'simultaneous' or 'uzawa', got {shown(update)}")
    given = settings.options.get("penalty")
    if given is None:
        return update, default_penalty(problem, problem.normal, UZAWA_STIFFENING if update == "uzawa" else 1.0)
    return update, contact_stiffness(NAME, "penalty", given, problem.contacts, zero=update == "simultaneous")


def default_penalty(problem: ContactProblem, rows: Matrix, stiffening: float) -> Vector:
    """Return beta_i = stiffening / sum_j (E_ij^2 / K_jj) of rows E (m, n), (m,) [force / length]; an empty row gets 1.

    An unknown without stiffness counts with the largest stiffness of the problem; if K is zero, beta is 1, as any value
    finds the answer in one iteration.
    """
    diagonal = problem.diagonal
    stiffest = float(diagonal.max(initial=0.0)) or 1.0
    softness = rows.power(2) @ (1.0 / np.where(diagonal > 0, diagonal, stiffest))
    return np.asarray(stiffening / np.where(softness > 0, softness, stiffening))


def _enforce(problem: ContactProblem, beta: Vector, closed: Mask, preference: Indices) -> Step:
    rows, values, ties, contacts = binding_rows(NAME, problem, closed, preference)
    bound = spread(np.ones(contacts.size), contacts, problem.contacts) > 0
    matrix, load = springs(problem, bound, beta)
    displacement, force = solve_bordered(NAME, matrix, load, rows, values, refined=True)
    return Step.on_rows(problem, displacement, force, ties, contacts)


def _uzawa_frictionless(problem: ContactProblem, settings: Settings, beta: Vector) -> Candidate:
    def answer(force: Vector, inner: Settings) -> Candidate:
        return penalty_loop(NAME, problem.replace(gap=problem.gap - force / beta), inner, beta, refined=True)

    def forces_of(step: Candidate) -> Vector:
        return np.maximum(step.answer.normal_force, 0.0)

    def violation(step: Candidate) -> float:
        return _violation(problem, step.answer.displacement, forces_of(step))

    warm = settings.warm_start
    force = np.zeros(problem.contacts) if warm is None else np.maximum(warm.answer.normal_force, 0.0)
    return _uzawa(settings, force, answer, forces_of, violation)


def _uzawa(
    settings: Settings,
    force: Vector,
    answer: Callable[[Vector, Settings], Candidate],
    forces_of: Callable[[Candidate], Vector],
    violation: Callable[[Candidate], float],
) -> Candidate:
    """Repeat the penalty method's `answer` with updated forces, beginning with `force`, until forces and contact laws
    converge.

    It ends unclaimed at the limit of iterations or time, or after long stagnation.
    """
    budget, history, changes = Budget(settings, 1000), list[float](), list[float]()
    status, inner = "", dataclasses.replace(settings, max_iter=None)
    while not status:
        step = answer(force, inner)
        updated = forces_of(step)
        changes.append(_relative_change(force, updated))
        history.append(max(changes[-1], violation(step)))
        force, inner = updated, dataclasses.replace(inner, warm_start=step)
        if not step.claimed:
            status = step.status
        elif history[-1] <= settings.tolerance:
            status = f"{NAME}: converged to {history[-1]:.1e}"
        elif spent := budget.spent(len(history)):
            status = f"{NAME}: {spent} at {history[-1]:.1e}"
        elif settings.max_iter is None and len(history) > STALLED + max(map(int, map(np.argmin, (history, changes)))):
            status = f"{NAME}: no nearer in {STALLED} iterations than {min(history):.1e}"
    claimed = history[-1] <= settings.tolerance and step.claimed
    last = dataclasses.replace(step.answer, normal_force=force[: len(step.answer.normal_force)])
    return dataclasses.replace(
        step,
        answer=last,
        iterations=len(history),
        claimed=claimed,
        status=status,
        history=tuple(history),
    )


def _relative_change(old: Vector, new: Vector) -> float:
    largest = float(np.max(np.abs(new), initial=0.0))
    change = float(np.max(np.abs(new - old), initial=0.0))
    return change / largest if largest > 0 else float(change > 0)


def _violation(problem: ContactProblem, displacement: Vector, force: Vector) -> float:
    """Return the worst penetration, or gap under force, relative to the lengths |E_N||u| + |g| that meet at the
    contact.
    """
    gap = problem.gap - problem.normal @ displacement
    wrong = np.where(force > 0, np.abs(gap), np.maximum(-gap, 0.0))
    return _worst(wrong, lengths_that_meet(problem, problem.normal, problem.gap, displacement))


def _worst(wrong: Vector, lengths: Vector) -> float:
    return float(np.max(ratio(wrong, lengths), initial=0.0))


def solve_frictional(problem: ContactProblem, settings: Settings) -> Candidate:
    """Enforce stick and slip by multipliers and penalty together, with E_s = E_N + s mu E_T where a contact slips.

    ``update="simultaneous"`` solves the systems of the Lagrange multiplier method with springs that its rows cancel,

        slip [ K + E_s' beta E_N  E_s' ] {u       }   {f + E_s' beta g}
             [ E_N                0    ] {lambda_N} = {g              }

    and for stick (the course chapter, eq. 2.51) E_N' beta E_N + E_T' beta_T E_T beside both rows: exact for every beta
    and beta_T >= 0.

    ``update="uzawa"`` repeats the penalty method with friction at the gaps g - lambda_N / beta and the slip origins
    o - lambda_T / beta_T: the forces that it returns are lambda_N + beta (E_N u - g), and
    lambda_T + beta_T (E_T u - o) returned to the bound mu lambda_N where they exceed it.

    Raises InvalidProblem: an option is wrong; NotConverged: the contacts do not hold the bodies.

    Options
    -------
    penalty, update
        As without friction; Uzawa's default beta_T is made of the tangential rows as beta is of the normal ones.
    tangential_penalty : float or (m,) array, optional
        beta_T [force / length]; beta where that is given.
    """
    update, normal = _chosen(problem, settings)
    beta = spring_stiffnesses(NAME, problem, settings, normal, zero=update == "simultaneous")
    if settings.options.get("penalty") is None and settings.options.get("tangential_penalty") is None:
        tangent = sp.csr_array(problem.tangent)
        beta = normal, default_penalty(problem, tangent, UZAWA_STIFFENING if update == "uzawa" else 1.0)
    if update == "uzawa":
        return _uzawa_frictional(problem, settings, beta)
    return status_loop(NAME, problem, settings, partial(_enforce_friction, problem, beta), stiffness=beta)


def _enforce_friction(
    problem: ContactProblem, beta: tuple[Vector, Vector], status: Status, preference: Indices
) -> FrictionalStep:
    rows = status_rows(NAME, problem, status, preference, independent=True)
    matrix, load = frictional_springs(rows, rows.per_row(*beta))
    displacement, force = solve_bordered(NAME, matrix, load, rows.held, rows.values, pushed=rows.pushed, refined=True)
    return rows.step(displacement, force[rows.of_contacts], force[: rows.ties.size])


def _uzawa_frictional(problem: ContactProblem, settings: Settings, beta: tuple[Vector, Vector]) -> Candidate:
    m, origin, tangent = problem.contacts, origins(problem), sp.csr_array(problem.tangent)

    def answer(force: Vector, inner: Settings) -> Candidate:
        shifted = problem.replace(
            gap=problem.gap - force[:m] / beta[0], slip_origin=(origin - force[m:] / beta[1])[:, None]
        )
        return frictional_penalty_loop(NAME, shifted, inner, beta, refined=True)

    def forces_of(step: Candidate) -> Vector:
        return np.concatenate([np.maximum(step.answer.normal_force, 0.0), _friction_of(step)])

    def violation(step: Candidate) -> float:
        u = step.answer.displacement
        slip = tangent @ u - origin
        against = np.maximum(-np.sign(_friction_of(step)) * slip, 0.0)
        named = np.asarray(step.contact_status)
        wrong = np.select([named == "stick", named == "slip"], [np.abs(slip), against], 0.0)
        wrong = np.where(coefficients(problem) > 0, wrong, 0.0)
        normal = _violation(problem, u, np.maximum(step.answer.normal_force, 0.0))
        return max(normal, _worst(wrong, lengths_that_meet(problem, tangent, origin, u)))

    warm, force = settings.warm_start, np.zeros(2 * m)
    if warm is not None:
        force[:m] = np.maximum(warm.answer.normal_force, 0.0)
    return _uzawa(settings, force, answer, forces_of, violation)


def _friction_of(step: Candidate) -> Vector:
    friction = step.answer.friction_force
    return np.zeros_like(step.answer.normal_force) if friction is None else friction[:, 0]


METHODS = (
    Method(
        name=NAME,
        kind=CLASSICAL_ENFORCEMENT,
        solve=solve_augmented_lagrangian,
        solve_friction=solve_frictional,
        options=("penalty", "tangential_penalty", "update"),
        knob="penalty",
        note="multipliers and penalty together (course chapter, eq. 2.32), exact for every penalty; or by Uzawa",
    ),
)
