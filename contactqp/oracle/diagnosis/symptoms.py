"""What an answer violates, in words: no guess at a cause."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Certificate, Violations
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.oracle.foreign.judged_contacts import slips

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
        named = zip(("the displacement is", "the contact forces are"), bounds, strict=True)
        off = [f"{what} off by up to {_part(bound)}" for what, bound in named if bound > certificate.error_tolerance]
        yield Finding("inaccurate", f"{' and '.join(off)}, measured in the energy of the bodies")


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
        (
            "slip",
            found.slip_direction,
            lambda i: _friction_along(problem, answer, i),
            "slipping without friction of mu l_N against the slip",
        ),
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


def _friction_along(problem: ContactProblem, answer: Answer, i: int) -> str:
    """Friction beside mu l_N, and the angle that it has with the slip."""
    slip = slips(problem, answer.displacement)
    if slip is None or answer.friction_force is None:
        return ""
    force, way = answer.friction_force[i], slip[i]
    size = float(np.linalg.norm(force) * np.linalg.norm(way))
    said = _friction_of(problem, answer, i)
    if not 0 < size < np.inf:
        return said
    angle = float(np.degrees(np.arccos(np.clip(force @ way / size, -1, 1))))
    return f"{said}, {angle:.3g} degrees off" if angle >= 0.5 else said


def _part(bound: float) -> str:
    """A part of the right size in words."""
    if 1e-3 <= bound < 1:
        return f"{100 * bound:.2g} %"
    return f"{bound:.2g} {'of' if bound < 1 else 'times'} the right size"


def unit_of(unit: str) -> str:
    """The unit with a blank before it, if there is one."""
    return f" {unit}" if unit else ""
