"""What a certificate refuses, in words: what failed, where, by how much, in the user's names and units."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from contactqp.bounds import Bounds
from contactqp.problem import ContactProblem, Vector
from contactqp.violations import FIGURES, Answer, Violations


def not_finite_parts(problem: ContactProblem, answer: Answer) -> Iterator[str]:
    called = {
        "displacement": problem.dof_name,
        "normal_force": problem.contact_name,
        "friction_force": problem.contact_name,
    }
    for name in ("displacement", "normal_force", "friction_force", "tie_force"):
        values = getattr(answer, name)
        if values is not None and not np.all(np.isfinite(values)):
            at = np.argwhere(~np.isfinite(values))[0]
            where = called[name](int(at[0])) if name in called else f"tie {at[0]}"
            yield f"{name}: {values[tuple(at)]} at {where}"


def failed_figures(
    problem: ContactProblem, answer: Answer, found: Violations, figures: dict[str, float], tolerance: float
) -> Iterator[str]:
    def where(name: str) -> int:
        return int(np.argmax(getattr(found, name)))

    def said(name: str, text: str, of: str) -> str:
        return f"{name}: {text} ({figures[name]:.3g} of the {of}, tolerance {tolerance:g})"

    force, length = _with_unit(problem.units.force), _with_unit(problem.units.length)
    failed = [name for name in FIGURES if not figures[name] <= tolerance]
    for name in failed:
        if name == "balance":
            yield said(name, "the forces on a body do not balance over a rigid motion", "forces that act on it")
            continue
        i = where(name)
        if name == "equilibrium":
            missing = found.residual[i]
            yield said(
                name, f"{problem.dof_name(i)} is out of balance by {missing:.6g}{force}", "forces that meet there"
            )
        elif name == "penetration":
            text = f"{problem.contact_name(i)} is penetrated by {-found.gap[i]:.6g}{length}"
            yield said(name, text, "lengths that meet there")
        elif name == "tension":
            text = f"{problem.contact_name(i)} is held with a force of {answer.normal_force[i]:.6g}{force}"
            yield said(name, text, "forces that meet there")
        elif name == "complementarity":
            text = (
                f"{problem.contact_name(i)} is open by {found.gap[i]:.6g}{length} "
                f"and pushes with {answer.normal_force[i]:.6g}{force}"
            )
            yield said(name, text, "sizes that meet there")
        elif name == "cone":
            yield said(name, f"the friction of {problem.contact_name(i)} exceeds its bound", "forces that meet there")
        elif name == "slip_direction":
            text = f"{problem.contact_name(i)} slips and its friction does not oppose the slip at its bound"
            yield said(name, text, "sizes that meet there")
        else:
            yield said(name, f"tie {i} is not met", "lengths that meet there")


def failed_law(problem: ContactProblem, law: Vector | None, limit: float) -> Iterator[str]:
    if law is not None and not np.all(law <= limit):
        i = int(np.argmax(law))
        yield (
            f"natural_map: {problem.contact_name(i)} misses the law of contact and friction by {law[i]:.3g} "
            f"of the sizes that meet there (tolerance {limit:g})"
        )


def failed_bounds(problem: ContactProblem, answer: Answer, known: Bounds, tolerance: float) -> Iterator[str]:
    if known.suspicious is not None:
        yield f"unproven: {known.suspicious}"
    # An error that is absolute, because the true size vanishes, is judged against the energy of the answer, and that
    # of a displacement without strain against the rounding of the displacement.
    pairs = (
        ("energy_error", "displacement", known.energy_scale, known.rigid_rounding, known.free_distance),
        ("force_error", "contact forces", known.force_scale, tolerance * known.energy_scale, known.force_rounding),
    )
    for name, what, scale, absolute, forgiven in pairs:
        value = getattr(known, name)
        if value is None:
            continue
        limit, size = (tolerance, scale) if scale > 0 else (absolute, 1.0)
        # Forces so small that their error is beneath the rounding of the refinement have no relative error to ask for.
        if not value * size <= max(limit * size, known.rounding) + forgiven:
            kind = "of their size" if scale > 0 else "in the square root of energy, where the truth is zero"
            yield f"{name}: the {what} may be off by {value:.3g} {kind} (tolerance {limit:.3g})"
    relative = known.relative_force_bound
    beneath = known.rounding / known.force_scale if known.force_scale > 0 else 0.0
    if relative is not None and known.force_bound is not None and not np.all(relative <= max(tolerance, beneath)):
        i = int(np.argmax(relative))
        unit = _with_unit(problem.units.force)
        yield (
            f"force_bound: the force of {problem.contact_name(i)}, {answer.normal_force[i]:.6g}"
            f"{unit}, may be off by {known.force_bound[i]:.3g}{unit} "
            f"({relative[i]:.3g} of the contact forces, tolerance {tolerance:g})"
        )


def _with_unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def notes(problem: ContactProblem, grazing: NDArray[np.bool_], known: Bounds) -> tuple[str, ...]:
    said = []
    if np.any(grazing):
        names = ", ".join(problem.contact_name(int(i)) for i in np.flatnonzero(grazing)[:8])
        said.append(f"grazing (gap and force both vanish): {names}")
    if problem.asymmetry > 0:
        said.append(f"the stiffness was asymmetric by {problem.asymmetry:.2g} of its diagonal and was symmetrised")
    if known.estimated:
        said.append("nothing was factorised: energy_error and force_error are estimates from Ritz values, no proof")
    return tuple(said)
