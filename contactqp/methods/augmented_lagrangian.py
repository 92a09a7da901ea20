"""The augmented Lagrangian method of the course chapter (eqs 2.30-2.32), as one system and as Uzawa's iteration."""

from __future__ import annotations

import dataclasses
import time
from functools import partial

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.methods.criss_cross import Step
from contactqp.methods.method import Method, Settings
from contactqp.methods.penalty import penalty_loop
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

NAME = "augmented-lagrangian"

# With beta at this many times the contact stiffness, an Uzawa iteration gains about two decimal digits where contacts
# do not feel each other; larger values gain more and lose as many digits of the gap to rounding.
UZAWA_STIFFENING = 100.0


def solve_augmented_lagrangian(problem: ContactProblem, settings: Settings) -> Candidate:
    """Multipliers and penalty together.

    ``update="simultaneous"`` (the default) solves the chapter's eq. 2.32 for the closed contacts,

        [ K + E_N' beta E_N  E_N' ] {u     }   {f + E_N' beta g}
        [ E_N                0    ] {lambda} = {g              }

    which is exact for every beta >= 0, not only for beta -> 0 as the chapter says: E_N u = g cancels the beta terms.

    ``update="uzawa"`` keeps lambda fixed while u is found, and repeats

        lambda <- max(0, lambda + beta (E_N u - g))

    Each u is the answer of the penalty method with the gaps g - lambda / beta. The error shrinks by about
    S / (S + beta) an iteration with S the stiffness that a contact feels, (E_N K^-1 E_N')^-1.

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

    Raises
    ------
    InvalidProblem
        beta is negative or not finite, or zero with Uzawa; `update` is neither of the two.
    NotConverged
        The closed contacts do not hold the bodies.
    """
    update = settings.options.get("update", "simultaneous")
    if update not in ("simultaneous", "uzawa"):
        raise InvalidProblem(f"{NAME}: update: expected 'simultaneous' or 'uzawa', got {update!r}")
    given = settings.options.get("penalty")
    if given is None:
        beta = default_penalty(problem, UZAWA_STIFFENING if update == "uzawa" else 1.0)
    else:
        beta = contact_stiffness(NAME, "penalty", given, problem.contacts, zero=update == "simultaneous")
    if update == "uzawa":
        return _uzawa(problem, settings, beta)
    return active_set_loop(NAME, problem, settings, partial(_enforce, problem, beta))


def default_penalty(problem: ContactProblem, stiffening: float) -> Vector:
    """beta_i = stiffening / sum_j (E_ij^2 / K_jj), (m,) [force / length].

    An unknown without stiffness of its own counts with the largest stiffness of the problem; if nothing has any, every
    beta finds the answer in one iteration and 1 is taken.
    """
    diagonal = problem.diagonal
    stiffest = float(diagonal.max()) or 1.0
    softness = problem.normal.power(2) @ (1.0 / np.where(diagonal > 0, diagonal, stiffest))
    return np.asarray(stiffening / softness)


def _enforce(problem: ContactProblem, beta: Vector, closed: Mask, preference: Indices) -> Step:
    rows, values, ties, contacts = binding_rows(NAME, problem, closed, preference)
    bound = spread(np.ones(contacts.size), contacts, problem.contacts) > 0
    matrix, load = springs(problem, bound, beta)
    displacement, force = solve_bordered(NAME, matrix, load, rows, values, refined=True)
    return Step(
        displacement,
        normal_force=spread(force[ties.size :], contacts, problem.contacts),
        tie_force=spread(force[: ties.size], ties, problem.ties),
        bound=bound,
    )


def _uzawa(problem: ContactProblem, settings: Settings, beta: Vector) -> Candidate:
    started, history = time.perf_counter(), list[float]()
    limit = settings.max_iter or 1000
    warm = settings.warm_start
    force = np.zeros(problem.contacts) if warm is None else np.maximum(warm.normal_force, 0.0)
    status, inner = "", dataclasses.replace(settings, max_iter=None)
    while not status:
        step = penalty_loop(NAME, problem.replace(gap=problem.gap - force / beta), inner, beta, refined=True)
        updated = np.maximum(step.normal_force, 0.0)
        history.append(max(_relative_change(force, updated), _violation(problem, step.displacement, updated)))
        force, inner = updated, dataclasses.replace(inner, warm_start=step)
        if not step.claimed:
            status = step.status
        elif history[-1] <= settings.tolerance:
            status = f"{NAME}: converged to {history[-1]:.1e}"
        elif len(history) >= limit:
            status = f"{NAME}: stopped after {limit} iterations at {history[-1]:.1e}"
        elif settings.time_limit is not None and time.perf_counter() - started > settings.time_limit:
            status = f"{NAME}: stopped after {settings.time_limit:g} s at {history[-1]:.1e}"
    claimed = history[-1] <= settings.tolerance and step.claimed
    return Candidate(step.displacement, force, step.tie_force, len(history), claimed, status, tuple(history))


def _relative_change(old: Vector, new: Vector) -> float:
    largest = float(np.max(np.abs(new), initial=0.0))
    change = float(np.max(np.abs(new - old), initial=0.0))
    return change / largest if largest > 0 else float(change > 0)


def _violation(problem: ContactProblem, displacement: Vector, force: Vector) -> float:
    """Worst penetration, or gap under force, relative to |E_N||u| + |g|."""
    gap = problem.gap - problem.normal @ displacement
    wrong = np.where(force > 0, np.abs(gap), np.maximum(-gap, 0.0))
    lengths = abs(problem.normal) @ np.abs(displacement) + np.abs(problem.gap)
    return float(np.max(wrong / np.where(lengths > 0, lengths, 1.0), initial=0.0))


METHODS = (
    Method(
        name=NAME,
        kind="classical enforcement",
        solve=solve_augmented_lagrangian,
        options=("penalty", "update"),
        knob="penalty",
        note="multipliers and penalty together (course chapter, eq. 2.32), exact for every penalty; or by Uzawa",
    ),
)
