"""Assertions for the tests of a contact code; failures are explained in words, with the right values."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.linalg.measures import directions, lengths
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Mask, Vector, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import refuse_not_positive
from contactqp.model.solution import BY_DISPLACEMENT, Answer, HoldsAnswer
from contactqp.model.summary import aligned
from contactqp.oracle.foreign.judging import GivenAnswer, right_answer
from contactqp.oracle.gallery.problem import GalleryProblem
from contactqp.oracle.judged_answer import JudgedAnswer, certify, read_given

# The answer for comparison: exact if it is known, else a certified solution.


@dataclass(frozen=True, eq=False)
class Reference(HoldsAnswer):
    """A right answer, and whether it is unique."""

    problem: ContactProblem
    name: str
    answer: Answer
    open: Mask  # (m,)
    slip: Array  # (m, d-1) zero where it sticks, (m, 0) without friction
    one_displacement: bool
    one_force: bool

    @property
    def length(self) -> float:
        """Return the reference length of displacements [length], 0 if all lengths vanish."""
        problem = self.problem
        origin = np.zeros(0) if problem.slip_origin is None else problem.slip_origin.ravel()
        moved = largest_of(self.displacement)
        return moved if moved > 0 else max(largest_of(problem.gap), largest_of(origin), largest_of(problem.tie_value))

    @property
    def force(self) -> float:
        """Return the reference force: the largest nodal force of a contact or tie, else the load."""
        parts = [weights(self.problem.normal) * abs(self.normal_force), weights(self.problem.tie) * abs(self.tie_force)]
        if self.friction_force is not None:
            parts.append(weights(self.problem.tangent) * abs(self.friction_force).ravel())
        return largest_of(np.concatenate(parts)) or largest_of(self.problem.load)

    @property
    def resultant(self) -> Vector:
        """Return the nodal forces E_N'l_N + E_T'l_T + A'nu (n,) [force]."""
        problem = self.problem
        total = problem.normal.T @ self.normal_force + problem.tie.T @ self.tie_force
        if problem.tangent is not None and self.friction_force is not None:
            total = total + problem.tangent.T @ self.friction_force.ravel()
        return np.asarray(total)


def weights(rows: Any) -> Vector:
    """Return max_j |E_ij| of every row (m,), the largest nodal force for a multiplier of one."""
    return np.asarray(abs(rows).max(axis=1).toarray()).ravel() if rows.shape[0] else np.zeros(0)


def plain_problem(problem: ContactProblem | GalleryProblem) -> ContactProblem:
    """Return the contact problem itself."""
    return problem.problem if isinstance(problem, GalleryProblem) else problem


def name_of(problem: ContactProblem | GalleryProblem) -> str:
    return problem.name if isinstance(problem, GalleryProblem) else repr(problem)


def known_reference(known: GalleryProblem) -> Reference:
    """Return the exact answer of a gallery problem."""
    problem, exact = known.problem, known.exact
    return Reference(
        problem,
        known.name,
        Answer(known.displacement, known.normal_force, known.friction_force, known.tie_force),
        np.array([gap > 0 for gap in exact.gap], dtype=bool),
        np.array([[float(x) for x in row] for row in exact.slip]).reshape(problem.contacts, -1 if exact.slip else 0),
        known.unique_displacement,
        known.unique_forces,
    )


def solved_reference(problem: ContactProblem, answer: Answer) -> Reference:
    """Return a certified solution, of several the one nearest to an answer.

    Raises ContactQPError: none exists, or none was found.
    """
    found = right_answer(problem, answer)
    sliding = found.contact_status == "slip"
    slip = np.zeros((problem.contacts, 0)) if found.slip is None else np.where(sliding[:, None], found.slip, 0.0)
    only = not found.certificate.uniqueness
    return Reference(
        problem,
        repr(problem),
        found.answer,
        found.contact_status == "open",
        slip,
        only and not found.free_motions and found.certificate.determined == BY_DISPLACEMENT,
        only if problem.frictional else found.certificate.force_bound is not None,
    )


def largest_of(values: Vector) -> float:
    """Return the largest absolute value, 0 for no values."""
    return float(np.max(abs(values), initial=0.0))


# Deviations of given numbers from the right ones, by components or by nodal forces.


@dataclass(frozen=True)
class Deviation:
    """One wrong number; `size` is its error relative to the largest right one of its kind."""

    what: str
    where: str
    value: float
    right: float
    size: float


def displacement_deviations(reference: Reference, displacement: Vector, rtol: float) -> list[Deviation]:
    """Return unknowns with errors above rtol times the largest displacement, none if that is zero."""
    if not reference.one_displacement or not reference.length > 0:
        return []
    problem = reference.problem
    return _beyond("displacement", problem.dof_name, displacement, reference.displacement, 1 / reference.length, rtol)


def force_deviations(
    reference: Reference,
    normal_force: Vector,
    friction_force: Array | None,
    tie_force: Vector | None,
    rtol: float,
) -> list[Deviation]:
    """Return forces with errors above rtol times the largest one.

    A multiplier is measured by its largest nodal force max_j |E_ij| |l_i|, which is independent of the scale of the
    row. If forces are not unique, their resultants are compared instead (`resultant_deviations`).

    Parameters
    ----------
    reference : the right answer
    normal_force, friction_force, tie_force : (m,), (m, d-1) and (k,) arrays
        The forces to be compared, the last two None where they were not given.
    rtol : the largest relative deviation that is right
    """
    if not reference.one_force:
        return resultant_deviations(reference, normal_force, friction_force, tie_force, rtol)
    problem, scale = reference.problem, reference.force
    name = problem.contact_name
    rows = [("normal force", name, normal_force, reference.normal_force, problem.normal)]
    if friction_force is not None and reference.friction_force is not None:
        width = friction_force.shape[1]
        given, right = friction_force.ravel(), reference.friction_force.ravel()
        rows.append(("friction force", lambda i: name(i // width), given, right, problem.tangent))
    if tie_force is not None:
        rows.append(("tie force", problem.tie_name, tie_force, reference.tie_force, problem.tie))
    return [
        one
        for what, called, given, right, matrix in rows
        for one in _beyond(what, called, given, right, _relative(weights(matrix), scale), rtol)
    ]


def resultant_deviations(
    reference: Reference,
    normal_force: Vector,
    friction_force: Array | None,
    tie_force: Vector | None,
    rtol: float,
) -> list[Deviation]:
    """Return the errors of forces that need not be unique.

    All forces are right that have the same nodal forces E_N'l_N + E_T'l_T + A'nu, no tension, no force at open
    contacts, and obey Coulomb's law. Tie forces that were not given are arbitrary.

    Parameters
    ----------
    reference : a right answer
    normal_force, friction_force, tie_force : (m,), (m, d-1) and (k,) arrays
        The forces to be judged, the last two None where they were not given.
    rtol : the largest relative deviation that is right
    """
    problem = reference.problem
    right = reference.resultant
    scale = float(np.max(abs(right), initial=0.0)) or reference.force
    name, size = problem.contact_name, _relative(weights(problem.normal), scale)
    nothing = np.zeros(problem.contacts)
    found = _beyond("tension", name, np.minimum(normal_force, 0), nothing, size, rtol)
    found += _beyond("force at an open contact", name, np.where(reference.open, normal_force, 0), nothing, size, rtol)
    change = problem.normal.T @ (normal_force - reference.normal_force)
    if friction_force is not None and problem.tangent is not None and problem.friction is not None:
        change = change + problem.tangent.T @ (friction_force - np.asarray(reference.friction_force)).ravel()
        bound = problem.friction * np.maximum(normal_force, 0)
        found += _beyond("friction force", name, np.maximum(lengths(friction_force), bound), bound, size, rtol)
        slides = np.any(reference.slip != 0, axis=1)
        along = np.sum(friction_force * directions(reference.slip), axis=1)
        found += _beyond("friction along the slip", name, np.where(slides, along, bound), bound, size, rtol)
    if tie_force is not None:
        change = change + problem.tie.T @ (tie_force - reference.tie_force)
    elif problem.ties:
        A = problem.tie.toarray()
        change = change - A.T @ np.linalg.lstsq(A.T, change, rcond=None)[0]
    together = _relative(np.ones(problem.dimension), scale)
    return found + _beyond("resultant", problem.dof_name, right + change, right, together, rtol)


# The number of deviations listed in a message.
MOST_LISTED = 10


def deviations_table(found: list[Deviation], force: str = "", length: str = "") -> str:
    """Return the largest deviations as text in descending order."""
    units = {"displacement": length}
    lines = [["where", "what", "given", "right", "relative"]]
    for one in sorted(found, key=lambda one: -one.size if one.size == one.size else -np.inf)[:MOST_LISTED]:
        unit = units.get(one.what, force)
        numbers = [f"{value:.12g}{' ' + unit if unit else ''}" for value in (one.value, one.right)]
        lines.append([one.where, one.what, *numbers, f"{one.size:.2g}"])
    text = aligned(lines)
    return "\n".join(text + ([f"and {len(found) - MOST_LISTED} more"] if len(found) > MOST_LISTED else []))


def _relative(size: Vector, scale: float) -> Vector:
    return size / scale if scale > 0 else np.where(size > 0, np.inf, 0.0)


def _beyond(what: str, called: Callable[[int], str], given: Any, right: Any, size: Any, rtol: float) -> list[Deviation]:
    """Return the entries whose difference times `size` is larger than rtol or not a number."""
    given, right = np.asarray(given, dtype=float), np.asarray(right, dtype=float)
    apart = abs(given - right)
    relative = np.where(apart > 0, apart, 0.0) * np.broadcast_to(size, apart.shape) if apart.size else apart
    relative = np.where(np.isfinite(given), np.where(apart == 0, 0.0, relative), np.inf)
    return [
        Deviation(what, called(int(i)), float(given[i]), float(right[i]), float(relative[i]))
        for i in np.flatnonzero(relative > rtol)
    ]


# The longest line of a diagnosis.
WIDTH = 110


@checked
def assert_contact_solution(
    problem: ContactProblem | GalleryProblem,
    displacement: ArrayLike | None = None,
    normal_force: ArrayLike | None = None,
    friction_force: ArrayLike | None = None,
    tie_force: ArrayLike | None = None,
    *,
    rtol: float = 1e-9,
    compression: str = "positive",
    pressure_area: ArrayLike | None = None,
    dof_map: Any = None,
    contact_map: Any = None,
) -> None:
    """Assert that an answer is right: certified and, for a problem of the gallery, equal to the exact one.

    Parameters
    ----------
    problem : ContactProblem or GalleryProblem
    displacement, normal_force, friction_force, tie_force, compression, pressure_area, dof_map, contact_map
        As for `contactqp.certify`: what is not given is recovered from the rest; signs and orders are never guessed.
    rtol : float
        The largest error, in three ways. Every figure of the certificate (what is violated, relative to the forces and
        lengths that meet there) is at most rtol: its `tolerance`. Every bound on the error of the energy norms that can
        be had is at most rtol: its `error_tolerance`. And where the exact answer is known, each displacement is within
        rtol times the largest one of it, each force within rtol times the largest contact or tie force (a multiplier
        counts by the largest force that it puts on an unknown). Only what is unique is compared with the exact answer;
        another right answer passes. Numbers beneath about 1e-13 ask for more than doubles hold.

    Raises
    ------
    AssertionError
        The answer is wrong; the message says what, where, and what would be right.
    InvalidProblem
        The arguments are not an answer to this problem: shapes, a missing friction force, an unknown sign.

    Examples
    --------
    >>> from contactqp.testing import problem
    >>> assert_contact_solution(problem("bar-and-wall"), [1.0], [142.5])
    >>> assert_contact_solution(problem("bar-and-wall"), [1.0], [-142.5], compression="negative")
    """
    __tracebackhide__ = True
    message = solution_fault(
        problem,
        rtol,
        displacement=displacement,
        normal_force=normal_force,
        friction_force=friction_force,
        tie_force=tie_force,
        compression=compression,
        pressure_area=pressure_area,
        dof_map=dof_map,
        contact_map=contact_map,
    )
    if message is not None:
        raise AssertionError(message)


@checked
def assert_multipliers(
    problem: ContactProblem | GalleryProblem,
    normal_force: ArrayLike,
    friction_force: ArrayLike | None = None,
    tie_force: ArrayLike | None = None,
    *,
    rtol: float = 1e-9,
    compression: str = "positive",
    pressure_area: ArrayLike | None = None,
    contact_map: Any = None,
) -> None:
    """Assert that contact forces are those of the exact answer, or of a certified solution.

    If forces are not unique (redundant contacts), all are right that have the same nodal forces E_N'l_N + E_T'l_T +
    A'nu, within rtol times the largest entry, and to the same accuracy no tension, no force at open contacts, and obey
    Coulomb's law. If friction may allow several answers, the forces are judged by their displacements. Friction and tie
    forces that are not given are not compared.

    Parameters
    ----------
    problem : ContactProblem or GalleryProblem
    normal_force, friction_force, tie_force, compression, pressure_area, contact_map
        As in `contactqp.certify`.
    rtol : float
        Each force is within rtol times the largest contact or tie force (of the load, where all of those vanish); a
        multiplier counts by the largest force that it puts on an unknown, max_j |E_ij| |l_i|.

    Raises
    ------
    AssertionError
        The forces are wrong; the message holds a table of the worst contacts.
    InvalidProblem
        The arguments are not forces of this problem.
    ContactQPError
        The problem is not in the gallery, and no right answer was found for comparison.

    Examples
    --------
    >>> from contactqp.testing import problem
    >>> assert_multipliers(problem("redundant-stops"), [7.0, 3.0])
    """
    __tracebackhide__ = True
    message = multiplier_fault(
        problem,
        rtol,
        normal_force=normal_force,
        friction_force=friction_force,
        tie_force=tie_force,
        compression=compression,
        pressure_area=pressure_area,
        contact_map=contact_map,
    )
    if message is not None:
        raise AssertionError(message)


def solution_fault(problem: ContactProblem | GalleryProblem, rtol: float, **given: Any) -> str | None:
    """Return the message of `assert_contact_solution` for the same arguments, None if the answer is right."""
    refuse_not_positive("rtol", rtol)
    judged = certify(plain_problem(problem), **given, tolerance=rtol, error_tolerance=rtol)
    if not judged.passed:
        return _refused(problem, judged, rtol)
    if not isinstance(problem, GalleryProblem):
        return None
    reference, answer = known_reference(problem), judged.answer
    found = displacement_deviations(reference, answer.displacement, rtol)
    if reference.one_force:
        found += force_deviations(reference, answer.normal_force, answer.friction_force, answer.tie_force, rtol)
    return _off(problem, found, rtol, "what it violates is small, but this is not the exact answer") if found else None


@own_floating_point
def multiplier_fault(problem: ContactProblem | GalleryProblem, rtol: float, **parts: Any) -> str | None:
    """Return the message of `assert_multipliers` for the same arguments, None if the forces are right."""
    refuse_not_positive("rtol", rtol)
    plain = plain_problem(problem)
    if parts["normal_force"] is None:
        raise InvalidProblem("assert_multipliers: expected normal_force, one a contact, got None")
    # Displacements are not judged; with zeros for them, friction may be missing.
    given = read_given(plain, np.zeros(plain.dimension), **parts)
    reference = _reference(problem, given)
    if plain.frictional and not reference.one_displacement:
        return _judged_by_displacements(problem, given, rtol)
    if plain.frictional and not reference.one_force and given.friction_force is None:
        raise InvalidProblem(
            "friction_force: the forces of this problem are not unique, and normal forces cannot be judged without "
            "friction; expected one force a contact, got None"
        )
    assert given.normal_force is not None
    found = force_deviations(reference, given.normal_force, given.friction_force, given.tie_force, rtol)
    if not found:
        return None
    friction = reference.friction_force if given.friction_force is None else given.friction_force
    tie = reference.tie_force if given.tie_force is None else given.tie_force
    judged = _of_forces(plain, reference, (given.normal_force, friction, tie), rtol)
    beside = "the exact ones" if isinstance(problem, GalleryProblem) else "those of a certified solution"
    return _off(problem, found, rtol, f"the forces are not {beside}", judged)


def _reference(problem: ContactProblem | GalleryProblem, given: GivenAnswer) -> Reference:
    if isinstance(problem, GalleryProblem):
        return known_reference(problem)
    return solved_reference(problem, given.filled(problem))


def _of_forces(
    problem: ContactProblem, reference: Reference, forces: tuple[Any, Any, Any], rtol: float
) -> JudgedAnswer:
    """Judge forces only, as displacements that were not given must not affect the causes."""
    try:
        return certify(problem, None, *forces, rtol, rtol)
    except Unsupported:  # too large for computing displacements from forces
        return certify(problem, reference.displacement, *forces, rtol, rtol)


def _judged_by_displacements(problem: ContactProblem | GalleryProblem, given: GivenAnswer, rtol: float) -> str | None:
    """Judge forces of a problem with several answers by the displacements that they cause."""
    if given.friction_force is None:
        raise Unsupported(
            "assert_multipliers: friction may allow several answers here, normal forces alone do not tell which; give "
            "friction_force too, or displacements to assert_contact_solution"
        )
    judged = certify(
        plain_problem(problem), None, given.normal_force, given.friction_force, given.tie_force, rtol, rtol
    )
    return None if judged.passed else _refused(problem, judged, rtol)


def _refused(problem: ContactProblem | GalleryProblem, judged: JudgedAnswer, rtol: float) -> str:
    """Return the diagnosis of an answer refused by the certificate."""
    lines = [f"{name_of(problem)}: the answer is wrong (rtol {rtol:g})", _in_words(judged)]
    if judged.contacts:
        lines.append(judged.table(10))
    return "\n".join(lines)


def _off(
    problem: ContactProblem | GalleryProblem,
    found: list[Deviation],
    rtol: float,
    why: str,
    judged: JudgedAnswer | None = None,
) -> str:
    """Return the table of wrong numbers, and a diagnosis if there is one."""
    units = plain_problem(problem).units
    lines = [f"{name_of(problem)}: {why} (rtol {rtol:g})"]
    if judged is not None and not judged.passed:
        lines.append(_in_words(judged))
    return "\n".join([*lines, deviations_table(found, units.force, units.length)])


def _in_words(judged: JudgedAnswer) -> str:
    text = judged.diagnosis
    if "error_tolerance=" in text:
        text += " (rtol is both tolerances)"
    return "\n".join(textwrap.wrap(text, WIDTH, break_on_hyphens=False))
