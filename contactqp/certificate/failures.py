"""What a certificate refuses, in words: what failed, where, by how much, in the user's names and units."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.bounds import Bounds
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem, Units
from contactqp.model.solution import FIGURES, Answer, Violations

# Grazing contacts, and dependent ties, that a note names.
MOST_NAMED = 8
# Changes of the forces that are less than this part of them are as good as none.
WORTH_SAYING = 1e-9


class Named(Protocol):
    """A problem, or one rank's part of one, as messages know it."""

    @property
    def units(self) -> Units: ...

    @property
    def dof_name(self) -> Callable[[int], str]: ...

    @property
    def contact_name(self) -> Callable[[int], str]: ...

    @property
    def tie_name(self) -> Callable[[int], str]: ...


PARTS = ("displacement", "normal_force", "friction_force", "tie_force")


def not_finite_parts(problem: ContactProblem, answer: Answer) -> Iterator[str]:
    for name in PARTS:
        values = getattr(answer, name)
        if values is not None and not np.all(np.isfinite(values)):
            yield said_of_part(problem, name, values, int(np.argwhere(~np.isfinite(values))[0][0]))


def said_of_part(problem: Named, name: str, values: NDArray[np.float64], i: int) -> str:
    """What part i of an answer is that is not finite."""
    called = {"displacement": problem.dof_name, "tie_force": problem.tie_name}.get(name, problem.contact_name)
    part = np.atleast_1d(values[i])
    return f"{name}: {part[~np.isfinite(part)][0]} at {called(i)}"


def said_of_absurd_part(problem: Named, name: str, values: NDArray[np.float64], i: int) -> str:
    """What part i of an answer is that is beyond all that the numbers of the problem can make."""
    called = {"displacement": problem.dof_name, "tie_force": problem.tie_name}.get(name, problem.contact_name)
    unit = problem.units.length if name == "displacement" else problem.units.force
    worst = np.atleast_1d(values[i])
    return (
        f"{name}: {worst[np.argmax(abs(worst))]:.3g}{_with_unit(unit)} at {called(i)}: what made this answer diverged"
    )


def failed_figures(
    problem: ContactProblem, answer: Answer, found: Violations, figures: dict[str, float], tolerance: float
) -> Iterator[str]:
    for name in FIGURES:
        if figures[name] <= tolerance:
            continue
        if name == "balance":
            yield said_of_balance(figures[name], tolerance)
        else:
            i = int(np.argmax(getattr(found, name)))
            yield said_of_figure(problem, answer, found, name, i, tolerance)


def said_of_balance(figure: float, tolerance: float) -> str:
    text = "the forces on a body do not balance over a rigid motion"
    return f"balance: {text} ({figure:.3g} of the forces that act on it, tolerance {tolerance:g})"


def said_of_figure(problem: Named, answer: Any, found: Violations, name: str, i: int, tolerance: float) -> str:
    """How unknown, contact or tie i of an answer, or of a part of one, misses a figure other than balance."""
    force, length = _with_unit(problem.units.force), _with_unit(problem.units.length)
    of = {"penetration": "lengths", "tie": "lengths", "complementarity": "sizes", "slip_direction": "sizes"}
    if name == "equilibrium":
        text = f"{problem.dof_name(i)} is out of balance by {found.residual[i]:.6g}{force}"
    elif name == "penetration":
        text = f"{problem.contact_name(i)} is penetrated by {-found.gap[i]:.6g}{length}"
    elif name == "tension":
        text = f"{problem.contact_name(i)} is held with a force of {answer.normal_force[i]:.6g}{force}"
    elif name == "complementarity":
        text = (
            f"{problem.contact_name(i)} is open by {found.gap[i]:.6g}{length} "
            f"and pushes with {answer.normal_force[i]:.6g}{force}"
        )
    elif name == "cone":
        text = f"the friction of {problem.contact_name(i)} exceeds its bound"
    elif name == "slip_direction":
        text = f"{problem.contact_name(i)} slips and its friction does not oppose the slip at its bound"
    else:
        text = f"{problem.tie_name(i)} is not met"
    measured = f"{getattr(found, name)[i]:.3g} of the {of.get(name, 'forces')} that meet there"
    return f"{name}: {text} ({measured}, tolerance {tolerance:g})"


def failed_law(problem: ContactProblem, law: Vector | None, limit: float) -> Iterator[str]:
    if law is not None and not np.all(law <= limit):
        yield said_of_law(problem, law, int(np.argmax(law)), limit)


def said_of_law(problem: Named, law: Vector, i: int, limit: float) -> str:
    return (
        f"natural_map: {problem.contact_name(i)} misses the law of contact and friction by {law[i]:.3g} "
        f"of the sizes that meet there (tolerance {limit:g})"
    )


def failed_errors(known: Bounds, tolerance: float, nothing: float) -> Iterator[str]:
    """What is said of the bounds on the whole answer; errors up to `nothing` [square root of energy] are none."""
    if known.suspicious is not None:
        yield f"unproven: {known.suspicious}"
    # An error that is absolute, because the true size vanishes, is judged against the energy of the answer, and that
    # of a displacement without strain against what its rounding strains; what is nothing beside all sizes is none, in
    # the truth as in the error, unless the contact forces say how little that is.
    beside_forces = min(nothing, tolerance * known.force_scale) if known.force_scale > 0 else nothing
    strain, pushed = max(known.rigid_rounding, beside_forces), max(tolerance * known.energy_scale, nothing)
    # What touching contacts leave open is no strain of a body that only moves; it is in the bound and its uncertainty.
    forgiven_strain = known.free_distance + (0.0 if known.energy_scale > beside_forces else 2 * known.undecided)
    # Rigid motions take up true forces, those of the answer and their difference, each to rounding.
    rigidly = 4 * known.force_rounding
    pairs = (
        ("energy_error", "displacement", known.energy_scale, beside_forces, strain, forgiven_strain),
        ("force_error", "contact forces", known.force_scale, 0.0, pushed, rigidly),
    )
    for name, what, scale, none, absolute, forgiven in pairs:
        value = getattr(known, name)
        if value is None or (name == "energy_error" and known.by_energy):
            continue  # `failed_energy` judges the energy itself
        if scale > none:
            kind, limit, size = f"of {'its' if what == 'displacement' else 'their'} size", tolerance, scale
        else:
            value = value * (scale or 1.0)
            kind, limit, size = "in the square root of energy, where the truth is zero", absolute, 1.0
        # Forces so small that their error is beneath the rounding of the refinement have no relative error to ask for.
        if not value * size <= max(limit * size, known.rounding) + forgiven:
            yield f"{name}: the {what} may be off by {value:.3g} {kind} (tolerance {limit:.3g})"


def failed_energy(known: Bounds, tolerance: float, nothing: float) -> Iterator[str]:
    """What is said of the energy, where that is all that a problem determines; `nothing` [energy] is none."""
    if known.energy_bounds is None or not known.by_energy:
        return
    lower, upper = known.energy_bounds
    if not upper - lower <= max(tolerance * known.energy_size, nothing, known.energy_rounding):
        part = (upper - lower) / known.energy_size if known.energy_size > 0 else float("inf")
        yield f"energy: it may be {part:.3g} of its larger term above the least (tolerance {tolerance:g})"


def fails_force_bound(known: Bounds, tolerance: float, nothing: float) -> bool:
    """Whether the bound of a contact force, of those that are here, is beyond the tolerance.

    On bodies that float, errors up to `nothing` [square root of energy] are none: loads may be far larger than what
    presses them together.
    """
    relative = known.relative_force_bound
    beneath = known.rounding / known.force_scale if known.force_scale > 0 else 0.0
    if known.largest_force > 0:
        beneath = max(known.rounding, nothing) / known.largest_force
    return relative is not None and known.force_bound is not None and not np.all(relative <= max(tolerance, beneath))


def said_of_force_bound(problem: Named, answer: Any, known: Bounds, i: int, tolerance: float) -> str:
    if known.force_bound is None or known.relative_force_bound is None:
        raise ValueError("there is no bound to speak of")
    unit = _with_unit(problem.units.force)
    return (
        f"force_bound: the force of {problem.contact_name(i)}, {answer.normal_force[i]:.6g}"
        f"{unit}, may be off by {known.force_bound[i]:.3g}{unit} "
        f"({known.relative_force_bound[i]:.3g} of all contact forces in energy, tolerance {tolerance:g})"
    )


def _with_unit(unit: str) -> str:
    return f" {unit}" if unit else ""


# Of an answer without friction; with it `contactqp.certificate.uniqueness` says so.
FORCES_NOT_UNIQUE = (
    "forces are not unique: closed contacts or ties depend on each other, and other answers share their forces "
    "differently (contactqp.exact gives the range of each)"
)


def notes(problem: ContactProblem, grazing: NDArray[np.bool_], known: Bounds) -> tuple[str, ...]:
    said = list(said_of_grazing([problem.contact_name(int(i)) for i in np.flatnonzero(grazing)[:MOST_NAMED]]))
    if known.redundant and not problem.frictional:
        said.append(FORCES_NOT_UNIQUE + (": those that graze here may press in another" if np.any(grazing) else ""))
    if problem.asymmetry > 0:
        said.append(f"the stiffness was asymmetric by {problem.asymmetry:.2g} of its diagonal and was symmetrised")
    if known.cleared > WORTH_SAYING:
        said.append(
            f"the stiffness is taken to be zero along the rigid motions of the bodies: being rounded, it would make "
            f"{known.cleared:.2g} of the forces there"
        )
    if known.free_distance > WORTH_SAYING * known.energy_scale > 0:
        said.append(
            f"{known.free_distance / known.energy_scale:.2g} of energy_error is what the rounding of the stiffness "
            "makes of motions that nothing resists: the answer lies elsewhere along them, which is as right"
        )
    if problem.rigid_change > 0:
        said.append(said_of_printing(problem))
    return (*said, *said_of_estimates(known))


def said_of_dependent_ties(
    problem: ContactProblem, dependent: Sequence[tuple[int, NDArray[np.intp]]]
) -> tuple[str, ...]:
    """Which ties depend on which: `dependent` are their numbers, and those of the others."""
    said = []
    for i, others in dependent[:MOST_NAMED]:
        names = [problem.tie_name(int(j)) for j in others[:MOST_NAMED]]
        more = f" and {len(others) - len(names)} more" if len(others) > len(names) else ""
        said.append(
            f"{problem.tie_name(i)} depends on {', '.join(names)}{more}: it is set aside where these are met, and how "
            "they share their force is not unique"
        )
    if len(dependent) > MOST_NAMED:
        said.append(f"{len(dependent) - MOST_NAMED} more ties depend on others")
    return tuple(said)


def said_of_printing(problem: ContactProblem) -> str:
    """How much of the stiffness was taken for the rounding of printed digits."""
    return (
        f"the stiffness was changed by {problem.rigid_change:.2g} of its diagonal at most, the rounding of printed "
        "digits, so that rigid motions cost no energy"
    )


def said_of_grazing(names: Sequence[str]) -> tuple[str, ...]:
    return (f"grazing (gap and force both vanish): {', '.join(names)}",) if names else ()


def said_of_estimates(known: Bounds) -> tuple[str, ...]:
    said = "nothing was factorised: energy_error and force_error are estimates from Ritz values, no proof"
    return (said,) if known.estimated else ()
