"""Write the messages of a certificate: what failed, where and by how much, in the user's names and units."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.bounds import Bounds
from contactqp.certificate.uniqueness import UNKNOWN
from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.existence import doubtful_drive
from contactqp.linalg.extended import SparseRows, extend
from contactqp.linalg.measures import inner_forces
from contactqp.model.arrays import EPS, Array, Indices, Vector
from contactqp.model.names import describe_faint, listed
from contactqp.model.problem import ContactProblem, Units
from contactqp.model.solution import ANSWER_PARTS, FIGURES, FIGURES_ALONE, Answer, Certificate, Violations

# The most grazing contacts, and dependent ties, named in a note.
MOST_NAMED = 8
# Where |u|'|K||u| is more than this multiple of u'Ku, its last digits decide 1e-6 of the strain energy.
MUCH_MOVED = 1e-6 / EPS
# The reason why answers with unusable numbers have no bounds.
NOT_FINITE, ABSURD_ANSWER = "the answer is not finite", "the answer is beyond all that the problem's numbers can make"


class Named(Protocol):
    """The names and units of a problem, or of one rank's part of one, that messages use."""

    @property
    def units(self) -> Units: ...

    @property
    def dof_name(self) -> Callable[[int], str]: ...

    @property
    def contact_name(self) -> Callable[[int], str]: ...

    @property
    def tie_name(self) -> Callable[[int], str]: ...


def not_finite_parts(problem: ContactProblem, answer: Answer) -> Iterator[str]:
    """Yield a message for each part of an answer with an entry that is not finite."""
    for name in ANSWER_PARTS:
        values = getattr(answer, name)
        if values is not None and not np.all(np.isfinite(values)):
            yield of_part(problem, name, values, int(np.argwhere(~np.isfinite(values))[0][0]))


def of_part(problem: Named, name: str, values: Array, i: int) -> str:
    """Return the message that entry i of a part of an answer is not finite.

    Parameters
    ----------
    problem : ContactProblem or the like, with names
    name : the part: "displacement", "normal_force", "friction_force" or "tie_force"
    values : array, the part, a row an entry
    i : the index of the entry
    """
    called = {"displacement": problem.dof_name, "tie_force": problem.tie_name}.get(name, problem.contact_name)
    part = np.atleast_1d(values[i])
    return f"{name}: {part[~np.isfinite(part)][0]} at {called(i)}"


def of_absurd_part(problem: Named, name: str, values: Array, i: int) -> str:
    """Return the message that entry i of a part of an answer is absurdly large for the problem's numbers.

    Parameters
    ----------
    problem : ContactProblem or the like, with names and units
    name, values, i
        As in `of_part`.
    """
    called = {"displacement": problem.dof_name, "tie_force": problem.tie_name}.get(name, problem.contact_name)
    unit = problem.units.length if name == "displacement" else problem.units.force
    worst = np.atleast_1d(values[i])
    return f"{name}: {worst[np.argmax(abs(worst))]:.3g}{unit_of(unit)} at {called(i)}: what made this answer diverged"


def of_hidden_strain(problem: Named, displacement: Vector) -> str:
    """Return the message that a displacement is so large that its rounding hides the strain."""
    i = int(np.argmax(abs(displacement)))
    return (
        f"unproven: {displacement[i]:.3g}{unit_of(problem.units.length)} at {problem.dof_name(i)} is so large a "
        "motion that its rounding hides what loads and gaps strain"
    )


def failed_figures(
    problem: ContactProblem, answer: Answer, found: Violations, figures: dict[str, float], tolerance: float
) -> Iterator[str]:
    """Yield the messages of the figures that are above a tolerance.

    Parameters
    ----------
    problem : ContactProblem
    answer : Answer
    found : its figures, entry by entry
    figures : dict of str to float, the largest of each
    tolerance : float
    """
    for name in FIGURES:
        if figures[name] <= tolerance:
            continue
        if name == "balance":
            yield of_balance(figures[name], tolerance)
        else:
            i = int(np.argmax(getattr(found, name)))
            yield of_figure(problem, answer, found, name, i, tolerance)


def of_balance(figure: float, tolerance: float) -> str:
    """Return the message that the forces on a floating body do work on its rigid motions."""
    text = "the forces on a body do not balance over a rigid motion"
    return f"balance: {text} ({figure:.3g} of the forces that act on it, tolerance {tolerance:g})"


def of_figure(problem: Named, answer: Any, found: Violations, name: str, i: int, tolerance: float) -> str:
    """Return the message that unknown, contact or tie i violates a figure other than balance.

    Parameters
    ----------
    problem : ContactProblem or the like, with names and units
    answer : Answer
    found : its figures, entry by entry
    name : the figure, one of `FIGURES`
    i : the index of the unknown, contact or tie
    tolerance : the largest figure that passes
    """
    force, length = unit_of(problem.units.force), unit_of(problem.units.length)
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


def of_law(problem: Named, law: Vector, i: int, limit: float) -> str:
    """Return the message that a contact violates the law of contact and friction.

    Parameters
    ----------
    problem : ContactProblem or the like, with names
    law : (m,) array, by how much each contact misses it, relative to the sizes that meet there
    i : the index of the contact
    limit : the largest that passes
    """
    return (
        f"natural_map: {problem.contact_name(i)} misses the law of contact and friction by {law[i]:.3g} "
        f"of the sizes that meet there (tolerance {limit:g})"
    )


def of_force_bound(problem: Named, answer: Any, bounds: Bounds, i: int, tolerance: float) -> str:
    """Return the message that the bound on the error of a contact force is too large.

    Parameters
    ----------
    problem : ContactProblem or the like, with names and units
    answer : Answer
    bounds : with bounds of each force
    i : the index of the contact
    tolerance : the largest relative bound that passes
    """
    if bounds.force_bound is None or bounds.relative_force_bound is None:
        raise ValueError("there is no bound to speak of")
    unit = unit_of(problem.units.force)
    beside = "the largest contact force" if bounds.largest_force > 0 else "all contact forces"
    return (
        f"force_bound: the force of {problem.contact_name(i)}, {answer.normal_force[i]:.6g}"
        f"{unit}, may be off by {bounds.force_bound[i]:.3g}{unit} "
        f"({bounds.relative_force_bound[i]:.3g} of {beside} in energy, tolerance {tolerance:g})"
    )


def unit_of(unit: str) -> str:
    """Return the unit, if there is one, after a blank."""
    return f" {unit}" if unit else ""


# Rows are redundant if they are a sum of others up to this part of its terms, the rounding of the weights.
SUMMED = 16 * EPS
# A note for answers without friction; with friction see `contactqp.certificate.uniqueness`.
NEARLY_DEPENDENT = "ties that nearly depend on each other prescribe more than doubles tell; state them apart"
FORCES_NOT_UNIQUE = (
    "forces are not unique: closed contacts or ties depend on each other, and other answers share their forces "
    "differently (contactqp.exact gives the range of each)"
)
FORCES_UNDECIDED = (
    "forces may be not unique: closed contacts and ties depend on each other, and whether another answer shares their "
    "forces differently was not decided (contactqp.exact gives the range of each)"
)


def of_shared_forces(several: bool | None, grazing: bool) -> tuple[str, ...]:
    """Return the note on forces that may be shared differently; it is empty if they are unique, None if undecided.

    Parameters
    ----------
    several : whether other forces belong to the same displacement
    grazing : whether contacts that graze press in some of them
    """
    if several is None:
        return (FORCES_UNDECIDED,)
    others = ": those that graze here may press in another" if grazing else ""
    return (FORCES_NOT_UNIQUE + others,) if several else ()


def of_hidden_gap(problem: ContactProblem, contact: int, floor: float) -> str:
    """Return the note that lengths up to a floor count as zero, including the gap of a contact."""
    return (
        f"the gap of {problem.contact_name(contact)}, {abs(problem.gap[contact]):.3g}, is not told from zero: lengths "
        f"up to {floor:.3g} count as nothing beside loads and other gaps: the stiffness there is very small; contacts "
        "may be exchanged within them; springs that are stiffer, or none at all, tell them apart"
    )


# Unit rows nearer to dependence than this leave few digits of their forces; the most entries that are examined, and the
# weight beside the largest from which on a row is named.
NEAR, MOST_EXAMINED, NAMED = 1e-9, 1_000_000, 1e-2


def none_is_certified(problem: ContactProblem, found: Any) -> str:
    """Return that no answer is certified, what in the problem may be the reason, and what to change.

    `found` is the solution that was refused, if there is one.
    """
    answer = getattr(found, "answer", None)
    near = "" if answer is None else of_nearly_dependent_rows(problem, answer)
    return f"no answer is certified{doubtful_drive(problem)}{near}"


def of_nearly_dependent_rows(problem: ContactProblem, answer: Answer) -> str:
    """Return which ties and closed contacts nearly depend on each other, and what to do; nothing where none do."""
    closed = np.flatnonzero(answer.normal_force > 0)
    rows = sp.csr_matrix(sp.vstack([problem.tie, problem.normal[closed]]) @ sp.diags(unknown_scale(problem)))
    touched = np.unique(rows.indices)
    if not 1 < rows.shape[0] <= len(touched) or rows.shape[0] * len(touched) > MOST_EXAMINED:
        return ""
    unit = rows[:, touched].toarray()
    unit = unit / np.linalg.norm(unit, axis=1)[:, None]
    weights, values, _ = np.linalg.svd(unit, full_matrices=False)
    if not np.all(np.isfinite(values)) or values[-1] > NEAR:
        return ""
    names = [problem.tie_name(i) for i in range(problem.ties)] + [problem.contact_name(int(i)) for i in closed]
    weight = abs(weights[:, -1])
    named = listed([names[i] for i in np.flatnonzero(weight > NAMED * weight.max())])
    return (
        f"; the rows of {named} depend on each other but for {values[-1]:.2g} of their lengths, which leaves their "
        "forces no digits: leave one of them out, or state them further apart"
    )


def of_dependent_ties(problem: ContactProblem, dependent: Sequence[tuple[int, Indices]]) -> tuple[str, ...]:
    """Return a message for each dependent tie: `dependent` has its number and those of the ties it depends on."""
    sentences = []
    for i, others in dependent[:MOST_NAMED]:
        names = [problem.tie_name(int(j)) for j in others[:MOST_NAMED]]
        more = f" and {len(others) - len(names)} more" if len(others) > len(names) else ""
        sentences.append(
            f"{problem.tie_name(i)} depends on {', '.join(names)}{more}: it is set aside where these are met, and how "
            "they share their force is not unique"
        )
    if len(dependent) > MOST_NAMED:
        sentences.append(f"{len(dependent) - MOST_NAMED} more ties depend on others")
    return tuple(sentences)


def of_missed_ties(
    problem: ContactProblem, answer: Answer, dependent: Sequence[tuple[int, Indices]], tolerance: float
) -> Iterator[str]:
    """Yield the message that a dependent tie, which the bounds leave out, is violated beyond rounding.

    Parameters
    ----------
    problem, answer : the problem, and the answer that is judged
    dependent : as in `of_dependent_ties`
    tolerance : the part of the lengths that meet at a tie which it may miss
    """
    rows = problem.tie
    missed = abs((SparseRows(rows) @ extend(answer.displacement) - extend(problem.tie_value)).double())
    meeting = abs(rows) @ abs(answer.displacement) + abs(problem.tie_value)
    far = [(i, others) for i, others in dependent if missed[i] > tolerance * meeting[i]]
    for i in [i for i, others in far if not _summed(rows, i, others)][:MOST_NAMED]:
        yield (
            f"{problem.tie_name(i)} depends on other ties, and is missed by {missed[i] / meeting[i]:.2g} of "
            f"the lengths that meet there: {NEARLY_DEPENDENT}"
        )


def _summed(rows: Any, tie: int, others: Indices) -> bool:
    """Return whether a tie (row of (k, n) rows) is a sum of others, value included, up to rounding of the weights.

    Then its figure judges it like theirs, as the difference of values does not depend on the answer.
    """
    columns = np.unique(rows[[tie, *others]].indices)
    row, basis = rows[[tie]][:, columns].toarray()[0], rows[others][:, columns].toarray()
    if not np.all(np.isfinite(basis)) or not np.any(basis):
        return False
    # In units in which the largest entry of each unknown, and then that of each row, is one.
    unit = np.maximum(abs(row), abs(basis).max(axis=0))
    row, basis = row / np.where(unit > 0, unit, 1.0), basis / np.where(unit > 0, unit, 1.0)
    largest = abs(basis).max(axis=1)
    summands = (basis / np.where(largest > 0, largest, 1.0)[:, None]).T
    weights = np.linalg.lstsq(summands, row, rcond=None)[0]
    weights += np.linalg.lstsq(summands, row - summands @ weights, rcond=None)[0]
    size = abs(row) + abs(summands) @ abs(weights)
    return bool(np.all(abs(row - summands @ weights) <= SUMMED * size))


def of_printing(problem: ContactProblem) -> str:
    """Return the message on the part of the stiffness that was taken for the rounding of printed digits."""
    return (
        f"the stiffness was changed by {problem.rigid_change:.2g} of its diagonal at most, the rounding of printed "
        "digits, so that rigid motions cost no energy"
    )


def of_grazing(names: Sequence[str]) -> tuple[str, ...]:
    """Return the note that names the contacts whose gap and force both vanish."""
    return (f"grazing (gap and force both vanish): {', '.join(names)}",) if names else ()


def of_friction_on_supports(problem: Named, contacts: Indices) -> tuple[str, ...]:
    """Return the note on contacts (k,) whose friction is not determined, as it acts on supports."""
    if not len(contacts):
        return ()
    names = ", ".join(problem.contact_name(int(i)) for i in contacts[:MOST_NAMED])
    more = f" and {len(contacts) - MOST_NAMED} more" if len(contacts) > MOST_NAMED else ""
    return (
        f"friction on supports: along a tangent whose unknowns are all supported any force within the cone would do "
        f"({names}{more}); `force_bound` leaves it out",
    )


def of_rigid_motions(bounds: Bounds) -> str:
    """Return the note that K was set to zero along rigid motions, and whether that is proven."""
    taken = "the stiffness is taken to be zero along the rigid motions of the bodies: being rounded, it would make"
    unsure = "; whether it is rounding that resists them is not known: stated in near_null_space, they are exact"
    return f"{taken} {bounds.cleared:.2g} of the forces there{unsure if bounds.estimated else ''}"


def of_rounded_stiffness(problem: ContactProblem, answer: Answer, bounds: Bounds) -> Iterator[str]:
    """Yield a note where the last digits of the entries of K may decide more than 1e-6 of the strain energy.

    Changes of all entries by their last digits change u'Ku by at most eps |u|'|K||u|. Rigid motions have other notes.
    """
    if not bounds.energy_scale > 0 or bounds.rigid_rounding > 0:
        return
    u = answer.displacement
    moved = float((abs(u) / bounds.energy_scale) @ (inner_forces(problem, u) / bounds.energy_scale))
    if moved > MUCH_MOVED:
        yield (
            f"the last digits of the entries of the stiffness may change the strain energy by {EPS * moved:.2g} "
            "of itself: the bounds are those of the matrix as it is, not of what it was assembled from"
        )


def of_faint_levers(problem: ContactProblem, answer: Answer) -> tuple[str, ...]:
    """Return a note where the answer moves unknowns that rows see by entries like the rounding of zero only."""
    faint = describe_faint(problem, np.flatnonzero(answer.displacement))
    return (f"the answer moves unknowns that neither stiffness nor rows seem to resist{faint}",) if faint else ()


def of_estimates(bounds: Bounds) -> Iterator[str]:
    """Yield the notes that errors are estimated and not proven, or proven up to free motions."""
    if bounds.estimated and not bounds.cleared:
        yield "nothing was factorised: energy_error and force_error are estimates from Ritz values, no proof"
    if bounds.free:
        yield "friction: equilibria nearby may differ by rigid motions that nothing resists, not in strain or forces"


def energy_failures(bounds: Bounds, tolerance: float, nothing: float) -> Iterator[str]:
    """Yield a message if the energy bounds fail, where a problem determines only that; `nothing` [energy] is none."""
    if bounds.energy_bounds is None or not bounds.by_energy:
        return
    lower, upper = bounds.energy_bounds
    none = nothing if bounds.energy_size <= nothing else 0.0  # forces on soft unknowns may make it large
    if not upper - lower <= max(tolerance * bounds.energy_size, none, bounds.energy_rounding):
        part = (upper - lower) / bounds.energy_size if bounds.energy_size > 0 else float("inf")
        yield f"energy: it may be {part:.3g} of its larger term above the least (tolerance {tolerance:g})"


def of_distances(problem: Named, worst: int, relative: dict[str, float], tolerance: float) -> tuple[str, ...]:
    """Return the message on too large distances of a frictional answer from that of its own states.

    Parameters
    ----------
    problem : ContactProblem or the like, with names
    worst : the contact whose force is farthest away
    relative : dict of str to float, the distances of "displacement", "contact forces" and "contact", over their scales
    tolerance : the largest that passes
    """
    own = "the answer of its own combination of open, stick and slip"
    named = {
        "displacement": f"the displacement is {{:.3g}} of its size away from {own}",
        "contact forces": f"the contact forces are {{:.3g}} of their size away from {own}",
        "contact": f"the force of {problem.contact_name(worst)} is {{:.3g}} of all away from {own}",
    }
    limit = f" (tolerance {tolerance:.3g})"
    return tuple(
        f"state: {named[name].format(part)}{limit}" for name, part in relative.items() if not part <= tolerance
    )


def not_finite(
    frictional: bool, failures: list[str], tolerance: float, error_tolerance: float, reason: str = NOT_FINITE
) -> Certificate:
    """Return the failing certificate of an answer with parts that are not finite, or absurdly large.

    Parameters
    ----------
    frictional : whether the problem has friction
    failures : list of str, messages of what is not finite
    tolerance, error_tolerance : as in `compute_certificate`
    reason : why there are no bounds
    """
    figures: dict[str, Any] = dict.fromkeys(FIGURES, float("inf"))
    return Certificate(
        **figures,
        natural_map=float("inf") if frictional else None,
        energy_error=None,
        force_error=None,
        force_bound=None,
        reasons=tuple(f"{name}: {reason}" for name in ("energy_error", "force_error", "force_bound")),
        grazing=(),
        failures=tuple(failures),
        notes=(),
        uniqueness=(UNKNOWN,) if frictional else (),
        contraction=None,
        tolerance=tolerance,
        error_tolerance=error_tolerance,
        passed=False,
        proven=False,
        basis=FIGURES_ALONE,
    )
