"""What an answer violates, in words: no guess at a cause."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from contactqp.certificate import Certificate
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.problem import ContactProblem, Vector
from contactqp.violations import Answer, Violations

# Contacts named one by one.
NAMED = 3


def symptoms(problem: ContactProblem, answer: Answer, certificate: Certificate) -> Iterator[Finding]:
    """A finding for each figure and bound that fails."""
    found = certificate.violations
    if found is None:
        for failure in certificate.failures:
            yield Finding("not-finite", f"the answer is not finite: {failure}")
        return
    limit = certificate.tolerance
    force, length = unit_of(problem.units.force), unit_of(problem.units.length)
    yield from _of_contacts(problem, answer, found, limit)
    if certificate.tie > limit:
        worst = int(np.argmax(found.tie))
        missed = abs(problem.tie[[worst]] @ answer.displacement - problem.tie_value[worst])[0]
        yield Finding("tie", f"tie {worst} is missed by {missed:.3g}{length}")
    if certificate.equilibrium > limit:
        worst = int(np.argmax(found.equilibrium))
        count = int(np.sum(found.equilibrium > limit))
        text = f"{problem.dof_name(worst)} is out of balance by {found.residual[worst]:.4g}{force}"
        others = f", and {count - 1} other unknowns are too" if count > 1 else ""
        yield Finding("equilibrium", text + others)
    if certificate.balance > limit:
        part = f"{certificate.balance:.2g} of the forces that act on it"
        yield Finding("balance", f"the forces on a body do not balance as a whole (by {part})")
    bounds = (certificate.energy_error or 0.0, certificate.force_error or 0.0)
    if max(bounds) > certificate.error_tolerance and certificate.failures:
        text = f"the displacement is off by up to {bounds[0]:.2g} and the contact forces by up to {bounds[1]:.2g}"
        yield Finding("inaccurate", f"{text}, relative and in the energy of the bodies")


def _of_contacts(problem: ContactProblem, answer: Answer, found: Violations, limit: float) -> Iterator[Finding]:
    force, length = unit_of(problem.units.force), unit_of(problem.units.length)
    sizes: tuple[tuple[str, Vector, Callable[[int], str], str], ...] = (
        ("tension", found.tension, lambda i: f"{answer.normal_force[i]:.4g}{force}", "held in tension"),
        ("penetration", found.penetration, lambda i: f"{-found.gap[i]:.3g}{length}", "penetrated"),
        (
            "complementarity",
            found.complementarity,
            lambda i: f"{answer.normal_force[i]:.4g}{force} across a gap of {found.gap[i]:.3g}{length}",
            "pushing without touching",
        ),
        ("cone", found.cone, lambda i: _friction_of(problem, answer, i), "rubbing beyond mu l_N"),
        ("slip", found.slip_direction, lambda i: _friction_of(problem, answer, i), "slipping without full friction"),
    )
    for kind, measure, said, what in sizes:
        beyond = np.flatnonzero(measure > limit)
        if not beyond.size:
            continue
        worst = beyond[np.argsort(-measure[beyond], kind="stable")]
        if len(worst) == 1:
            i = int(worst[0])
            yield Finding(kind, f"{problem.contact_name(i)} is {what} ({said(i)})")
            continue
        named = ", ".join(f"{problem.contact_name(int(i))} ({said(int(i))})" for i in worst[:NAMED])
        more = f" and {len(worst) - NAMED} more contacts" if len(worst) > NAMED else ""
        yield Finding(kind, f"{named}{more} are {what}")


def _friction_of(problem: ContactProblem, answer: Answer, i: int) -> str:
    if answer.friction_force is None or problem.friction is None:
        return ""
    bound = problem.friction[i] * max(answer.normal_force[i], 0.0)
    size = float(np.linalg.norm(answer.friction_force[i]))
    return f"{size:.4g} against {bound:.4g}{unit_of(problem.units.force)}"


def unit_of(unit: str) -> str:
    """The unit with a blank before it, if there is one."""
    return f" {unit}" if unit else ""
