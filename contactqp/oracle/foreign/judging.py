"""A given answer, completed and certified; of two ways to complete it the one that passes."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from contactqp.certificate.certificate import compute_certificate
from contactqp.certificate.number_range import near_one
from contactqp.certificate.uniqueness import POSSIBLE, SEVERAL
from contactqp.errors import ContactQPError
from contactqp.linalg.condensation import Condensation
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate, Certificate, Solution
from contactqp.oracle.foreign.foreign_answer import GivenAnswer
from contactqp.oracle.foreign.recovery import Recovery, recoveries
from contactqp.solving.equilibria import equilibria
from contactqp.solving.solve import begin, of_problem, solve


def judge(
    problem: ContactProblem,
    given: GivenAnswer,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    factorization: Condensation | None = None,
) -> tuple[Certificate, Recovery]:
    """The certificate of the first completion that passes, or else of the first.

    Raises
    ------
    InvalidProblem, Unsupported
        As `contactqp.certificate.certificate.compute_certificate` and `recoveries`.
    """
    first: tuple[Certificate, Recovery] | None = None
    for tried in recoveries(problem, given):
        answer = tried.answer
        forces = (answer.normal_force, answer.friction_force, answer.tie_force)
        found = compute_certificate(
            problem, answer.displacement, *forces, tolerance, error_tolerance, factorization, prove_friction=True
        )
        if found.passed:
            return found, tried
        first = first or (found, tried)
    assert first is not None  # there is always a plain way
    return first


# The right answer to set beside a wrong one; of several equilibria the one nearest to what was given.

# Contacts of which all combinations of open, stick and slip are tried.
FEW = 6


def right_answer(problem: ContactProblem, answer: Answer) -> Solution:
    """A certified solution.

    Raises
    ------
    ContactQPError
        There is none, or none was found.
    """
    found = solve(problem)
    others = found.certificate.uniqueness
    plane = problem.tangent is not None and problem.tangent.shape[0] == problem.contacts
    if not (SEVERAL in others or POSSIBLE in others) or not answer.finite():
        return found
    known = [found]
    with suppress(ContactQPError):
        known += equilibria(problem) if plane and problem.contacts <= FEW else [_from(problem, answer)]
    weight = np.sqrt(np.maximum(problem.diagonal, 0.0))
    return min(known, key=lambda one: float(np.linalg.norm(weight * (one.displacement - answer.displacement))))


def _from(problem: ContactProblem, answer: Answer) -> Solution:
    """What Newton's method finds from the answer."""
    if (near := near_one(problem)) is not None:
        return of_problem(near, _from(near.problem, near.answer(answer)))
    start = Candidate(answer.displacement, answer.normal_force, answer.tie_force, friction_force=answer.friction_force)
    return begin(problem, start=start).finish()
