"""The associated relaxation as an algorithm of `solve`: right as what it is, and never called Coulomb's answer."""

from __future__ import annotations

from dataclasses import replace

from contactqp.certificate.certificate import compute_certificate
from contactqp.errors import NotConverged, Unsupported
from contactqp.linalg.condensation import condense
from contactqp.linalg.existence import refuse_conflict, refuse_driven_motion
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import Answer
from contactqp.solving.condensed_attempt import CondensedAttempt
from contactqp.solving.friction.associated import recovered, relaxed_in_space, relaxed_in_the_plane
from contactqp.solving.methods import Method, Settings


def solve_associated(problem: ContactProblem, method: Method, settings: Settings) -> tuple[Answer, str]:
    """The relaxation's answer and what to call it: in the plane by `method`, in space by Clarabel.

    Raises
    ------
    NoEquilibrium
        Constraints conflict, or a load drives what nothing holds.
    NotConverged, BackendFailed, BackendMissing
        The convex solver gave up, or what it found is not the relaxation's answer.
    Unsupported
        A method that is approximate by design.
    """
    if not method.exact:
        raise Unsupported(f"{method.name}: the associated relaxation takes an exact method")
    if problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
        try:
            answer = relaxed_in_space(problem, condense(problem))
        except NotConverged:
            refuse_conflict(problem, condense(problem))
            refuse_driven_motion(problem, condense(problem))
            raise
        return answer, "associated with clarabel (not Coulomb)"
    relaxed = relaxed_in_the_plane(problem)
    # A start has one force a contact, and the program two.
    found = CondensedAttempt(relaxed, method, replace(settings, warm_start=None), "auto").final(polished=True)
    parts = (found.displacement, found.normal_force, found.tie_force)
    certificate = compute_certificate(relaxed, found.displacement, found.normal_force, tie_force=found.tie_force)
    if not certificate.passed:
        raise NotConverged(f"associated with {method.name}: {'; '.join(certificate.failures)}")
    return recovered(problem, *parts), f"associated with {method.name} (not Coulomb)"
