"""What an answer violates, each rank its own part: the figures of `contactqp.certificate.figures`, in the same
measures.

Residuals are formed in double precision, as `contactqp.linalg.extended.plain_residuals` forms them: a figure is
known to a few dozen roundings, 1e-14 or so, and what is smaller than that says nothing but that it is.
"""

from __future__ import annotations

import numpy as np

from contactqp.certificate.figures import (
    Rubbing,
    Sizes,
    figures,
    law_residual,
    least_force,
    normal_force,
    rounded_slips,
    tangential_force,
)
from contactqp.distributed.floating import without_rigid_part
from contactqp.distributed.problem import Bodies, DistributedAnswer, DistributedProblem, stiffness_sizes
from contactqp.distributed.rows import Rows
from contactqp.linalg.factorization import RIGID_FORCE
from contactqp.linalg.measures import (
    HELD_BY_DOUBLES,
    RowSizes,
    entries_of,
    force_measure,
    imposed,
    sizes_of,
    vector_measure,
)
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb import lengths
from contactqp.model.solution import Nothing, Violations


def violations(problem: DistributedProblem, answer: DistributedAnswer, bodies: Bodies, rounding: float) -> Violations:
    """Every figure of this rank's unknowns, contacts and ties; `rounding` as in
    `contactqp.certificate.figures.violations`.

    Collective."""
    u = answer.displacement
    elastic = without_rigid_part(problem, bodies, u)
    F = stiffness_sizes(problem, abs(elastic)) + outer_forces(problem, answer)
    size = intrinsic_size(problem, answer, elastic)
    none = _nothing(problem, u, elastic, size, rounding)
    residual = outer_resultant(problem, answer) - problem.product(u)
    near = problem.normal.near(F)
    sizes = Sizes(
        meeting=F,
        push=force_measure(problem.normal.entries, answer.normal_force, near),
        felt=force_measure(problem.normal.entries, answer.normal_force, near, problem.normal.near(none.force)),
        lengths=_lengths(problem.normal, problem.gap, elastic),
        tangential_lengths=_lengths_across(problem, elastic),
        tie_lengths=_lengths(problem.tie, problem.tie_value, elastic),
        intrinsic_size=size,
        nothing=none,
    )
    left = residual, problem.gap - problem.normal.lengths(u), problem.tie_value - problem.tie.lengths(u)
    return figures(answer, left, sizes, _rubbing(problem, u, F, none.force))


def intrinsic_size(problem: DistributedProblem, answer: DistributedAnswer, elastic: Vector) -> float:
    """`contactqp.linalg.measures` of all bodies together, `elastic` (n_here,) as there. Collective."""
    u, ranks = answer.displacement, problem.ranks
    force = problem.load - outer_resultant(problem, answer)
    D = np.divide(1.0, np.sqrt(problem.diagonal), out=np.zeros_like(u), where=problem.diagonal > 0)
    load = float(np.max(D * abs(problem.load), initial=0.0))
    sizes = [load, float(np.max(D * abs(force), initial=0.0))]
    for rows, limit in _rows(problem):
        of_row, size = row_sizes(problem, rows), abs(rows.entries)
        moved = rows.lengths(u), size @ rows.near(abs(u)), size @ rows.near(abs(elastic))
        sizes.append(float(np.max(imposed(limit, *moved, of_row.compliance), initial=0.0)))
    strain = ranks.dot(elastic, problem.product(elastic))
    return float(max(ranks.max(max(sizes)), np.sqrt(max(strain, 0.0))))


def _rows(problem: DistributedProblem) -> list[tuple[Rows, Vector]]:
    rows = [(problem.normal, problem.gap), (problem.tie, problem.tie_value)]
    if problem.tangent is not None and problem.slip_origin is not None:
        rows.append((problem.tangent, problem.slip_origin.ravel()))
    return rows


def _nothing(problem: DistributedProblem, u: Vector, elastic: Vector, size: float, part: float) -> Nothing:
    """`contactqp.linalg.measures.nothing` of this rank's unknowns and rows. Collective."""
    force = np.maximum(part * size * np.sqrt(problem.diagonal), HELD_BY_DOUBLES * stiffness_sizes(problem, abs(u)))
    if problem.ranks.any(elastic is not u):
        force = np.maximum(force, RIGID_FORCE * stiffness_sizes(problem, abs(u - elastic)))

    def least(rows: Rows) -> Vector:
        of_row, whole = row_sizes(problem, rows), abs(rows.entries) @ rows.near(abs(u))
        return np.asarray(np.maximum(part * size * np.sqrt(of_row.compliance), HELD_BY_DOUBLES * whole))

    tangent = np.zeros(0) if problem.tangent is None else least(problem.tangent)
    return Nothing(force, least(problem.normal), tangent, least(problem.tie))


def coulomb_residual(problem: DistributedProblem, answer: DistributedAnswer, found: Violations) -> Vector | None:
    """`contactqp.certificate.figures` of this rank's contacts; None without friction on any rank.
    Collective.
    """
    if not problem.frictional or problem.tangent is None:
        return None
    rubbing = _rubbing(problem, answer.displacement, found.meeting, found.nothing.force)
    if rubbing is None:
        return None
    normal, tangent = (entries_of(rows.entries, problem.contacts) for rows in (problem.normal, problem.tangent))
    along = normal_force(normal, problem.normal.near(found.meeting))
    across = tangential_force(tangent, problem.tangent.near(found.meeting))
    least = least_force(normal, problem.normal.near(found.nothing.force))
    return law_residual(answer, found, (rubbing.slip, rubbing.friction), (along, *across), least)


def outer_resultant(problem: DistributedProblem, answer: DistributedAnswer) -> Vector:
    """f - E_N'l_N - E_T'l_T - A'nu (n_here,) [force]. Collective."""
    outer = problem.load - problem.normal.forces(answer.normal_force) - problem.tie.forces(answer.tie_force)
    if problem.tangent is not None and answer.friction_force is not None:
        outer -= problem.tangent.forces(answer.friction_force.ravel())
    return np.asarray(outer)


def outer_forces(problem: DistributedProblem, answer: DistributedAnswer) -> Vector:
    """|f| + |E_N|'|l_N| + |E_T|'|l_T| + |A|'|nu| (n_here,) [force]. Collective."""
    outer = abs(problem.load) + _sizes_of_forces(problem.normal, answer.normal_force)
    outer = outer + _sizes_of_forces(problem.tie, answer.tie_force)
    if problem.tangent is not None and answer.friction_force is not None:
        outer = outer + _sizes_of_forces(problem.tangent, answer.friction_force.ravel())
    return np.asarray(outer)


def _sizes_of_forces(rows: Rows, force: Vector) -> Vector:
    return rows.spread(abs(rows.entries).T @ abs(force))


def row_sizes(problem: DistributedProblem, rows: Rows) -> RowSizes:
    """`contactqp.linalg.measures` of this rank's rows over what they touch. Collective."""
    return sizes_of(rows.entries, rows.near(problem.diagonal))


def _lengths(rows: Rows, limit: Vector, displacement: Vector) -> Vector:
    """|E||u| + |g| of this rank's rows. Collective."""
    return np.asarray(abs(rows.entries) @ rows.near(abs(displacement)) + abs(limit))


def _lengths_across(problem: DistributedProblem, displacement: Vector) -> Vector:
    """The same of the tangential rows of each contact together. Collective."""
    if problem.tangent is None or problem.slip_origin is None:
        return np.zeros(problem.contacts)
    origin = problem.slip_origin
    return lengths(_lengths(problem.tangent, origin.ravel(), displacement).reshape(origin.shape))


def _rubbing(problem: DistributedProblem, displacement: Vector, F: Vector, none: Vector) -> Rubbing | None:
    if problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        return None
    slip = problem.tangent.lengths(displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
    entries = entries_of(problem.tangent.entries, problem.contacts)
    meeting, least = problem.tangent.near(F), problem.tangent.near(none)

    def measure(force: Array) -> Vector:
        return vector_measure(entries, force, meeting, least)

    rows = abs(problem.tangent.entries)
    rounding = rounded_slips(rows, problem.tangent.near(displacement), problem.slip_origin)
    return Rubbing(slip, rounding, problem.friction, measure)
