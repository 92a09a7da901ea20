"""Compute the figures of `contactqp.certificate.figures` for a distributed answer, each rank its part.

Residuals are formed in double precision, as `contactqp.linalg.extended.plain_residuals` forms them: figures have an
error of a few dozen roundings, about 1e-14; of smaller ones only the bound is known.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.coulomb_law import (
    CoulombData,
    ForcesMet,
    bare_infinite,
    entries_of,
    friction_measure,
    hardly_felt,
    law_residual,
    normal_forces,
    rounded_slips,
    tangential_force,
    with_negligible_slips,
)
from contactqp.certificate.figures import Sizes, figures
from contactqp.distributed.problem import Bodies, DistributedProblem, without_rigid_part
from contactqp.distributed.rows import Rows
from contactqp.linalg.factorization import RIGID_FORCE
from contactqp.linalg.measures import (
    HELD_BY_DOUBLES,
    OF_ALL_LENGTHS,
    OF_NEAR_LENGTHS,
    ROUNDING_OF_LENGTH,
    ROUNDING_OF_LOADS,
    RowSizes,
    beside_yielding,
    imposed,
    in_energy,
    lengths,
    reciprocal,
    rows_and_limits,
    sizes_of,
)
from contactqp.model.arrays import Mask, Vector
from contactqp.model.solution import Answer, NegligibleSizes, Violations


def violations(problem: DistributedProblem, answer: Answer, bodies: Bodies, rounding: float) -> Violations:
    """Return all figures of this rank's unknowns, contacts and ties. Collective.

    Parameters
    ----------
    problem : the problem
    answer : the part of this rank
    bodies : the bodies of the problem
    rounding : float
        The part of the intrinsic size below which forces and lengths are nothing, as in
        `contactqp.certificate.figures.violations`.
    """
    u, normal, tie = answer.displacement, problem.normal, problem.tie
    elastic = without_rigid_part(problem, bodies, u)
    F = problem.product_sizes(abs(elastic)) + outer_forces(problem, answer)
    size = intrinsic_size(problem, answer, elastic)
    hardly = _hardly_felt(problem)
    negligible = with_negligible_slips(_nothing(problem, u, elastic, size, rounding), hardly)
    residuals = (
        outer_resultant(problem, answer) - problem.product(u),
        problem.gap - normal.lengths(u),
        problem.tie_value - tie.lengths(u),
    )
    near, of_entries = normal.at_touched(F), sizes_of(normal.entries)
    least = normal.at_touched(negligible.force if negligible.contact_force is None else negligible.contact_force)
    sizes = Sizes(
        meeting=F,
        push=of_entries.measure(answer.normal_force, near),
        lengths=normal.length_sizes(elastic) + abs(problem.gap),
        tangential_lengths=_tangential_lengths(problem, elastic),
        tie_lengths=tie.length_sizes(elastic) + abs(problem.tie_value),
        intrinsic_size=size,
    )
    felt = of_entries.measure(answer.normal_force, near, least)
    return figures(answer, residuals, sizes, negligible, felt, _friction_data(problem, u, F, negligible.force, hardly))


def intrinsic_size(problem: DistributedProblem, answer: Answer, elastic: Vector) -> float:
    """Return the intrinsic size S of all bodies together [square root of energy]. Collective.

    `elastic` (n_here,) is the displacement without its rigid part, as in `contactqp.linalg.measures.intrinsic_size`.
    """
    u, ranks = answer.displacement, problem.ranks
    D = reciprocal(np.sqrt(problem.diagonal))
    stiff = problem.diagonal > 0
    some_yield = ranks.any(not stiff.all())
    sizes = [float(np.max(D * abs(problem.load), initial=0.0))]
    for rows, limit in rows_and_limits(problem):
        moved, compliance = rows.length_sizes(u), row_sizes(problem, rows).compliance
        length = imposed(limit, rows.lengths(u), moved, rows.length_sizes(elastic), compliance)
        if some_yield:
            of_stiff, may = (rows.length_sizes(one) for one in (np.where(stiff, u, 0.0), np.where(stiff, 0.0, 1.0)))
            length = beside_yielding(length, of_stiff, may > 0, compliance)
        sizes.append(float(np.max(length, initial=0.0)))
    strain = ranks.dot(elastic, problem.product(elastic))
    return float(max(ranks.max(max(sizes)), np.sqrt(max(strain, 0.0))))


def _nothing(problem: DistributedProblem, u: Vector, elastic: Vector, size: float, part: float) -> NegligibleSizes:
    """Return the forces and lengths that are negligible compared to the intrinsic size, as
    `contactqp.linalg.measures.negligible_in` does. Collective.
    """
    force = np.maximum(part * size * np.sqrt(problem.diagonal), HELD_BY_DOUBLES * problem.product_sizes(abs(u)))
    if problem.ranks.any(elastic is not u):
        force = np.maximum(force, RIGID_FORCE * problem.product_sizes(abs(u - elastic)))
    strain = float(np.sqrt(max(problem.ranks.dot(elastic, problem.product(elastic)), 0.0)))
    least_size = ROUNDING_OF_LENGTH / part * strain if part > 0 else 0.0
    largest = problem.ranks.max(float(np.max(abs(problem.load), initial=0.0)))
    force[untouched(problem)] = ROUNDING_OF_LOADS * float(largest)

    def least(rows: Rows, longest: float) -> Vector:
        compliance = row_sizes(problem, rows).compliance
        rest = min(max(OF_ALL_LENGTHS * longest, least_size), OF_NEAR_LENGTHS * longest)
        negligible = part * min(size, rest) * np.sqrt(compliance)
        return np.asarray(np.maximum(negligible, HELD_BY_DOUBLES * rows.length_sizes(u)))

    longest, tangent = _longest_length(problem, u, along=False), np.zeros(0)
    if problem.tangent is not None:
        tangent = least(problem.tangent, _longest_length(problem, u, along=True))
    of_contacts = _least_contact_force(problem, u, strain, size, part, force)
    return NegligibleSizes(force, least(problem.normal, longest), tangent, least(problem.tie, longest), of_contacts)


def untouched(problem: DistributedProblem) -> Mask:
    """Return the unknowns (n_here,) touched neither by the stiffness nor by a row. Collective."""
    touched = problem.diagonal > 0
    if not problem.ranks.any(not touched.all()):
        return ~touched
    for rows in (problem.normal, problem.tangent, problem.tie):
        if rows is not None:
            touched = touched | (rows.force_sizes(np.ones(rows.count)) > 0)
    return ~touched


def _least_contact_force(
    problem: DistributedProblem, u: Vector, strain: float, size: float, part: float, negligible: Vector
) -> Vector | None:
    """Return the forces (n_here,) up to which contact forces count as zero, or None if these are `negligible`, those of
    residuals; as in `contactqp.linalg.measures`. `strain` is |u_e|_K. Collective.
    """
    pushed = problem.ranks.max(float(np.max(reciprocal(np.sqrt(problem.diagonal)) * abs(problem.load), initial=0.0)))
    if not 0 < OF_ALL_LENGTHS * pushed < size:
        return None
    loaded = np.where(
        problem.diagonal > 0, OF_ALL_LENGTHS * part * max(pushed, strain) * np.sqrt(problem.diagonal), np.inf
    )
    return np.asarray(np.minimum(negligible, np.maximum(loaded, HELD_BY_DOUBLES * problem.product_sizes(abs(u)))))


def _longest_length(problem: DistributedProblem, displacement: Vector, along: bool) -> float:
    """Return the largest of the lengths |g|, |b| and |E||u| of all bodies [square root of energy]. Collective.

    It is infinite without lengths; `along` is that of `contactqp.linalg.measures`.
    """
    stated = moved = 0.0
    for rows, limit in (one for one in rows_and_limits(problem) if along or one[0] is not problem.tangent):
        compliance = row_sizes(problem, rows).compliance
        finite = np.where(np.isfinite(limit), abs(limit), 0.0)
        stated = max(stated, float(in_energy(finite, compliance).max(initial=0.0)))
        moved = max(moved, float(in_energy(rows.length_sizes(displacement), compliance).max(initial=0.0)))
    stated, moved = problem.ranks.max(np.array([stated, moved]))
    return float(max(stated, moved)) if stated > 0 else np.inf


def coulomb_residual(problem: DistributedProblem, answer: Answer, found: Violations) -> Vector | None:
    """Return the residual (m_here,) of Signorini's and Coulomb's law as one equation. Collective.

    It is that of `contactqp.certificate.coulomb_law.coulomb_residual`, None if no contact of any rank has friction.
    """
    hardly = _hardly_felt(problem)
    data = _friction_data(problem, answer.displacement, found.meeting, found.nothing.force, hardly)
    if not problem.frictional or data is None or problem.tangent is None:
        return None
    normal, tangent = (entries_of(rows.entries, problem.contacts) for rows in (problem.normal, problem.tangent))
    meeting = problem.normal.at_touched(found.meeting)
    along, least = normal_forces(normal, meeting, problem.normal.at_touched(found.nothing.force))
    measures = (along, *tangential_force(tangent, problem.tangent.at_touched(found.meeting)))
    return law_residual(answer, found, (data.slip, data.friction), measures, least)


def outer_resultant(problem: DistributedProblem, answer: Answer) -> Vector:
    """Return f - E_N'l_N - E_T'l_T - A'nu (n_here,) [force]. Collective."""
    outer = problem.load.copy()
    for rows, force in _acting(problem, answer):
        outer -= rows.forces(force)
    return outer


def outer_forces(problem: DistributedProblem, answer: Answer) -> Vector:
    """Return |f| + |E_N|'|l_N| + |E_T|'|l_T| + |A|'|nu| (n_here,) [force]. Collective."""
    outer = abs(problem.load)
    for rows, force in _acting(problem, answer):
        outer += rows.force_sizes(force)
    return outer


def _acting(problem: DistributedProblem, answer: Answer) -> list[tuple[Rows, Vector]]:
    """Return the rows with nonzero forces, and these forces."""
    acting = [(problem.normal, answer.normal_force), (problem.tie, answer.tie_force)]
    if problem.tangent is not None and answer.friction_force is not None:
        acting.append((problem.tangent, answer.friction_force.ravel()))
    return acting


def row_sizes(problem: DistributedProblem, rows: Rows) -> RowSizes:
    """Return the sizes of this rank's rows at their touched unknowns. Collective."""
    return sizes_of(rows.entries, rows.at_touched(problem.diagonal))


def _tangential_lengths(problem: DistributedProblem, displacement: Vector) -> Vector:
    """Return the size (m_here,) of |E_T||u| + |slip_origin| of each contact. Collective."""
    if problem.tangent is None or problem.slip_origin is None:
        return np.zeros(problem.contacts)
    origin = problem.slip_origin
    return lengths(problem.tangent.length_sizes(displacement).reshape(origin.shape) + abs(origin))


def _friction_data(
    problem: DistributedProblem, displacement: Vector, F: Vector, negligible: Vector, hardly: Mask
) -> CoulombData | None:
    """Return the slips of this rank's contacts and their measures, None without tangential rows. Collective.

    Parameters are those of `contactqp.certificate.coulomb_law.coulomb_data`.
    """
    if problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        return None
    tangent, origin = problem.tangent, problem.slip_origin
    near = tangent.at_touched(displacement)
    slip = np.asarray(tangent.entries @ near).reshape(origin.shape) - origin
    across, along = (
        ForcesMet(entries_of(rows.entries, problem.contacts), rows.at_touched(F), rows.at_touched(negligible))
        for rows in (tangent, problem.normal)
    )
    rounding = rounded_slips(tangent.sizes @ abs(near), origin)
    return CoulombData(slip, rounding, problem.friction, friction_measure(across, along, hardly))


def _hardly_felt(problem: DistributedProblem) -> Mask:
    """Return `contactqp.certificate.coulomb_law.hardly_felt` of this rank's contacts (m_here,). Collective."""
    normal, rows = problem.normal, problem.tangent
    along = row_sizes(problem, normal).compliance
    if rows is None or problem.slip_origin is None:
        return np.zeros(problem.contacts, dtype=bool)
    across = bare_infinite(rows.entries, row_sizes(problem, rows).compliance, rows.at_touched(problem.diagonal))
    # Only unknowns touched by normal and tangential rows count.
    both = np.isin(normal.touched, rows.touched)
    place = np.searchsorted(rows.touched, normal.touched[both], sorter=(order := np.argsort(rows.touched)))
    pick = sp.csr_array((np.ones(len(place)), (np.flatnonzero(both), order[place])), (len(both), len(rows.touched)))
    compliances = along, across.reshape(problem.slip_origin.shape)
    return hardly_felt(compliances, sp.csr_array(normal.entries) @ pick, sp.csr_array(rows.entries))
