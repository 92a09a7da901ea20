"""A given answer, completed and certified; of two ways to complete it the one that passes."""

from __future__ import annotations

from contactqp.certificate.certificate import compute_certificate
from contactqp.linalg.condensation import Condensation
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Certificate
from contactqp.oracle.foreign.foreign_answer import GivenAnswer
from contactqp.oracle.foreign.recovery import Recovery, recoveries


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
        found = compute_certificate(problem, answer.displacement, *forces, tolerance, error_tolerance, factorization)
        if found.passed:
            return found, tried
        first = first or (found, tried)
    assert first is not None  # there is always a plain way
    return first
