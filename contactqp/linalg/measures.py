"""What meets at an unknown or a contact: the residuals of an answer, and the forces and lengths that measure them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.linalg.extended import Extended, extend
from contactqp.linalg.extended_rows import ExtendedRows, extended_rows
from contactqp.linalg.factorization import RigidMotions
from contactqp.linalg.intrinsic_size import bodies, stiffness_sizes
from contactqp.linalg.row_sizes import ContactEntries, row_sizes
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb_cone import lengths
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import Answer

# A row whose lengths are this part of the largest displacement around it, in the energy scale, is at rest.
ROUNDING_OF_LENGTH = 1e-14


@dataclass(frozen=True, eq=False)
class Residuals:
    """What an answer leaves, in extended precision."""

    force: Extended  # (n,) f - K u - E_N'l_N - E_T'l_T - A'nu
    gap: Extended  # (m,) g - E_N u
    tie: Extended  # (k,) b - A u


def residuals_of(
    rows: ExtendedRows, problem: ContactProblem, u: Extended, force: Extended, tie: Extended, friction: Any = None
) -> Residuals:
    """The residuals of a displacement (n,), contact forces (m,), tie forces (k,) and friction (m, d-1), if any."""
    outer = extend(problem.load) - rows.contact_force(force, tie)
    if friction is not None:
        outer = outer - rows.friction_force(friction)
    gap, open_tie = extend(problem.gap) - rows.normal @ u, extend(problem.tie_value) - rows.tie @ u
    return Residuals(outer - rows.stiffness @ u, gap, open_tie)


def lay_out(problem: ContactProblem) -> None:
    """Make what residuals and figures need of the stiffness, for every answer that follows."""
    extended_rows(problem), stiffness_sizes(problem), bodies(problem)


def residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """The residuals of an answer."""
    parts = (extend(answer.displacement), extend(answer.normal_force), extend(answer.tie_force))
    return residuals_of(extended_rows(problem), problem, *parts, answer.friction_force)


def plain_residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """The residuals of an answer in double precision, each entry to a few dozen roundings of the sizes that meet."""
    u = answer.displacement
    outer = problem.normal.T @ answer.normal_force + problem.tie.T @ answer.tie_force
    if problem.tangent is not None and answer.friction_force is not None:
        outer = outer + problem.tangent.T @ answer.friction_force.ravel()
    force = problem.load - problem.stiffness_rows @ u - outer
    return Residuals(
        extend(force), extend(problem.gap - problem.normal @ u), extend(problem.tie_value - problem.tie @ u)
    )


def forces_that_meet(problem: ContactProblem, answer: Answer) -> Vector:
    """F (n,) [force]: the sum of the sizes of all forces at each unknown."""
    return np.asarray(stiffness_sizes(problem) @ abs(answer.displacement) + outer_forces(problem, answer))


def outer_forces(problem: ContactProblem, answer: Answer) -> Vector:
    """F without |K||u|: what acts on the bodies from outside."""
    outer = problem.load_size + row_sizes(problem, problem.normal).transposed @ abs(answer.normal_force)
    outer = outer + row_sizes(problem, problem.tie).transposed @ abs(answer.tie_force)
    if problem.tangent is not None and answer.friction_force is not None:
        outer = outer + row_sizes(problem, problem.tangent).transposed @ abs(answer.friction_force).ravel()
    return np.asarray(outer)


def imbalance(problem: ContactProblem, answer: Answer, rigid: RigidMotions) -> float:
    """The part by which the outer forces miss balance on the worst rigid motion of a basis, of those along it."""
    rows, motions = extended_rows(problem), rigid.motions
    if not motions.shape[1]:
        return 0.0
    outer = extend(problem.load) - rows.contact_force(extend(answer.normal_force), extend(answer.tie_force))
    missed = motions.T @ (outer - rows.friction_force(answer.friction_force)).double()
    return float(np.max(ratio(abs(missed), abs(motions).T @ outer_forces(problem, answer))))


def lengths_that_meet(
    problem: ContactProblem, rows: Any, limit: Vector, displacement: Vector, rounding: float = ROUNDING_OF_LENGTH
) -> Vector:
    """L_i = (|E||u| + |g|)_i, infinite where that is zero [length].

    It is zero where it is no more than `rounding` |E_i D| max_j |u_j / D_j| of the displacements of the bodies that the
    row touches, D = 1/sqrt(K_jj): a support at zero (u_j = 0 as a row) holds its unknown at rounding, which
    measured against itself would be a gross violation. Measured against infinity it is none: 0/0 is 0.
    """
    sizes = row_sizes(problem, rows)
    length = sizes.size @ abs(displacement) + abs(limit)
    least = rounding * np.sqrt(sizes.compliance)
    size = np.sqrt(problem.diagonal) * abs(displacement)
    if np.any(length <= least * np.max(size, initial=0.0)):
        length = at_rest_infinite(rows, length, least, _largest_of_bodies(problem, size))
    return np.asarray(length)


def tangential_lengths(problem: ContactProblem, displacement: Vector, rounding: float = ROUNDING_OF_LENGTH) -> Vector:
    """|L| (m,) of the tangential rows of each contact [length]; a row at rest adds none where another one moves."""
    if problem.tangent is None or problem.slip_origin is None:
        return np.full(problem.contacts, np.inf)
    meeting = lengths_that_meet(problem, problem.tangent, problem.slip_origin.ravel(), displacement, rounding)
    return lengths_of_pairs(meeting.reshape(problem.slip_origin.shape))


def lengths_of_pairs(meeting: Array) -> Vector:
    """|L| (m,) of the lengths (m, d-1) that meet along the tangential rows of each contact, infinite at rest."""
    finite = np.where(np.isfinite(meeting), meeting, 0.0)
    return np.where(np.any(finite > 0, axis=1), lengths(finite), np.inf)


def at_rest_infinite(rows: Any, length: Vector, least: Vector, largest: Vector) -> Vector:
    """Lengths (m,), infinite where they are at most `least` (m,) of the `largest` (n,) unknown that a row touches."""
    touched = np.zeros(rows.shape[0])
    np.maximum.at(touched, _row_of_entries(rows), largest[rows.indices])
    return np.where(length <= least * touched, np.inf, length)


def _largest_of_bodies(problem: ContactProblem, size: Vector) -> Vector:
    """(n,) the largest size (n,) of an unknown on the body that each belongs to."""
    body = bodies(problem)
    largest = np.zeros(int(body.max()) + 1)
    np.maximum.at(largest, body, size)
    return np.asarray(largest[body])


def own_compliance(problem: ContactProblem, rows: Any) -> Vector:
    """|E_i D|^2, D = 1/sqrt(K_jj): what row i finds at its own unknowns, the rest held [length / force]."""
    return row_sizes(problem, rows).compliance


def ratio(size: Vector, scale: Vector) -> Vector:
    """size / scale with 0/0 = 0."""
    return np.divide(size, scale, out=np.where(size > 0, np.inf, 0.0), where=scale > 0)


def beyond(size: Vector, none: Vector) -> Vector:
    """Sizes, 0 where they are nothing; NaN is something, and nothing hides behind what overflows."""
    return np.asarray(np.where((size <= none) & np.isfinite(none), 0.0, size))


def force_measure(rows: Any, force: Vector, meeting: Vector, none: Vector | None = None) -> Vector:
    """max_j |E_ij l_i| / F_j for every row i; what is no more than `none` (n,) does not count."""
    row = _row_of_entries(rows)
    acting = abs(rows.data) * abs(force)[row]
    if none is not None:
        acting = beyond(acting, none[rows.indices])
    measure = np.zeros(rows.shape[0])
    np.maximum.at(measure, row, ratio(acting, meeting[rows.indices]))
    return measure


def vector_measure(entries: ContactEntries, force: Array, meeting: Vector, none: Vector) -> Vector:
    """max_j |E_i'v|_j / F_j of one force vector v (m, w) a contact; what is no more than `none` (n,) does not count."""
    acting = beyond(abs(entries.forces(force)), none[entries.unknown])
    return entries.largest(ratio(acting, meeting[entries.unknown])[None])


def _row_of_entries(rows: Any) -> NDArray[np.intp]:
    """Of every entry of rows in CSR."""
    return np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
