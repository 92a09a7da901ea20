"""Assertions for the tests of a contact code; what fails is said in words, beside the right values."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.errors import InvalidProblem, Unsupported, refuse_other
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import refuse_not_positive
from contactqp.oracle.deviations import Deviation, deviations_table, displacement_deviations, force_deviations
from contactqp.oracle.foreign.foreign_answer import GivenAnswer, read_given
from contactqp.oracle.gallery.problem import GalleryProblem
from contactqp.oracle.judged_answer import JudgedAnswer, certify
from contactqp.oracle.reference import Reference, known_reference, name_of, plain_problem, solved_reference

# Longest line of a diagnosis.
WIDTH = 110


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
        The arguments are no answer to this problem: shapes, a missing friction force, an unknown sign.

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
    """Assert that contact forces alone are right: those of the exact answer, or of a certified solution.

    Where forces are not unique (redundant contacts), right are all that act on the bodies together as the right ones
    do, E_N'l_N + E_T'l_T + A'nu within rtol times its largest entry, and that to the same size pull nowhere, push at no
    contact that is open and obey Coulomb's law. Where friction allows several answers, or may, the forces are judged
    by the displacements that they make. Friction and tie forces that are not given are not compared.

    Parameters
    ----------
    rtol : float
        Each force is within rtol times the largest contact or tie force (of the load, where all of those vanish); a
        multiplier counts by the largest force that it puts on an unknown, max_j |E_ij| |l_i|.

    Raises
    ------
    AssertionError
        With a table of the worst contacts.
    InvalidProblem
        The arguments are no forces of this problem.
    ContactQPError
        The problem is not in the gallery and no right answer was found to compare with.

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
    """What `assert_contact_solution` says of an answer, given as to it; None where it is right."""
    refuse_other("assert_contact_solution", problem, ContactProblem, GalleryProblem)
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


def multiplier_fault(problem: ContactProblem | GalleryProblem, rtol: float, **parts: Any) -> str | None:
    """What `assert_multipliers` says of forces, given as to it; None where they are right."""
    refuse_other("assert_multipliers", problem, ContactProblem, GalleryProblem)
    refuse_not_positive("rtol", rtol)
    plain = plain_problem(problem)
    if parts["normal_force"] is None:
        raise InvalidProblem("assert_multipliers: expected normal_force, one a contact, got None")
    # No displacement is looked at; with zeros for it friction may be missing.
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
    """Forces judged by themselves: a cause must not rest on displacements that nobody gave."""
    try:
        return certify(problem, None, *forces, rtol, rtol)
    except Unsupported:  # too large for displacements to be found from forces
        return certify(problem, reference.displacement, *forces, rtol, rtol)


def _judged_by_displacements(problem: ContactProblem | GalleryProblem, given: GivenAnswer, rtol: float) -> str | None:
    """Forces of a problem with several answers are right if the displacements that they make are."""
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
    """The diagnosis of an answer that the certificate refuses."""
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
    """The table of numbers that are not the right ones, and a diagnosis where there is one."""
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
