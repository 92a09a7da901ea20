"""What an answer violates, each rank its own part: the figures of `contactqp.violations`, in the same measures.

Residuals are formed in double precision, as `contactqp.violations.plain_residuals` forms them: a figure is known to a
few dozen roundings, 1e-14 or so, and what is smaller than that says nothing but that it is.
"""

from __future__ import annotations

import numpy as np

from contactqp.coulomb_residual import law_residual, normal_force, tangential_force
from contactqp.distributed.answer import DistributedAnswer
from contactqp.distributed.bodies import Bodies
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Vector
from contactqp.distributed.rows import Rows
from contactqp.distributed.stiffness_sizes import stiffness_sizes
from contactqp.factorization import Array
from contactqp.row_sizes import RowSizes, entries_of, sizes_of
from contactqp.violations import (
    Rubbing,
    Sizes,
    Violations,
    at_rest_infinite,
    figures,
    force_measure,
    lengths_of_pairs,
    vector_measure,
)


def violations(problem: DistributedProblem, answer: DistributedAnswer, bodies: Bodies, rounding: float) -> Violations:
    """Every figure of this rank's unknowns, contacts and ties; `rounding` as in `lengths_that_meet`. Collective."""
    u = answer.displacement
    F = stiffness_sizes(problem, abs(u)) + outer_forces(problem, answer)
    meeting = Meeting(problem, bodies, u, rounding)
    residual = outer_resultant(problem, answer) - problem.product(u)
    along = force_measure(problem.normal.entries, answer.normal_force, problem.normal.near(F))
    sizes = Sizes(
        meeting=F,
        push=along,
        lengths=meeting.lengths(problem.normal, problem.gap),
        tangential_lengths=_tangential_lengths(problem, meeting),
        tie_lengths=meeting.lengths(problem.tie, problem.tie_value),
    )
    left = residual, problem.gap - problem.normal.lengths(u), problem.tie_value - problem.tie.lengths(u)
    return figures(answer, left, sizes, _rubbing(problem, u, F))


def coulomb_residual(problem: DistributedProblem, answer: DistributedAnswer, found: Violations) -> Vector | None:
    """`contactqp.coulomb_residual` of this rank's contacts; None without friction on any rank. Collective."""
    if not problem.frictional or problem.tangent is None:
        return None
    rubbing = _rubbing(problem, answer.displacement, found.meeting)
    if rubbing is None:
        return None
    normal, tangent = (entries_of(rows.entries, problem.contacts) for rows in (problem.normal, problem.tangent))
    along = normal_force(normal, problem.normal.near(found.meeting))
    across = tangential_force(tangent, problem.tangent.near(found.meeting))
    return law_residual(answer, found, (rubbing.slip, rubbing.friction), (along, *across))


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
    """`contactqp.row_sizes` of this rank's rows over what they touch. Collective."""
    return sizes_of(rows.entries, rows.near(problem.diagonal))


class Meeting:
    """The lengths that meet at rows under a displacement. Making it is collective, and so is `lengths`."""

    def __init__(self, problem: DistributedProblem, bodies: Bodies, displacement: Vector, rounding: float) -> None:
        self._problem, self._displacement, self._rounding = problem, displacement, rounding
        size = np.zeros(len(bodies.number))
        np.maximum.at(size, bodies.of, np.sqrt(problem.diagonal) * abs(displacement))
        self._largest = bodies.told(bodies.largest(size))[bodies.of]  # (n_here,) of the unknown's body

    def lengths(self, rows: Rows, limit: Vector) -> Vector:
        """`contactqp.violations.lengths_that_meet` of this rank's rows."""
        sizes = row_sizes(self._problem, rows)
        length = sizes.size @ rows.near(abs(self._displacement)) + abs(limit)
        least = self._rounding * np.sqrt(sizes.compliance)
        return at_rest_infinite(rows.entries, length, least, rows.near(self._largest))


def _tangential_lengths(problem: DistributedProblem, meeting: Meeting) -> Vector:
    if problem.tangent is None or problem.slip_origin is None:
        return np.full(problem.contacts, np.inf)
    lengths = meeting.lengths(problem.tangent, problem.slip_origin.ravel())
    return lengths_of_pairs(lengths.reshape(problem.slip_origin.shape))


def _rubbing(problem: DistributedProblem, displacement: Vector, F: Vector) -> Rubbing | None:
    if problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        return None
    slip = problem.tangent.lengths(displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
    entries, meeting = entries_of(problem.tangent.entries, problem.contacts), problem.tangent.near(F)

    def measure(force: Array) -> Vector:
        return vector_measure(entries, force, meeting)

    return Rubbing(slip, problem.friction, measure)
