"""Whether the exact answer of a problem is the only one, by exact ranks: "no" here means "not proven"."""

from __future__ import annotations

from contactqp.oracle.gallery.algebra import (
    ZERO,
    Rows,
    columns_are_independent,
    dominance,
    largest_row_sum,
    rank,
    transposed,
)
from contactqp.oracle.gallery.problem import ExactAnswer, ExactProblem
from contactqp.solving.friction.exact_algebra import Polyhedron, solutions


def only_displacement(data: ExactProblem, answer: ExactAnswer) -> bool:
    """Whether the displacement is proven to be the only one.

    Without friction the answers form a convex set on which K u, the ties and the gaps of contacts that carry force
    are the same: one point where K, A and these rows of E_N have no common null vector. With friction see
    `below_critical_friction`.
    """
    if any(data.friction) and not below_critical_friction(data):
        return False
    if dominance(data.stiffness) > 0:
        return True
    carrying = tuple(row for row, force in zip(data.normal, answer.normal_force, strict=True) if force > 0)
    return columns_are_independent((*data.stiffness, *data.tie, *carrying), data.unknowns)


def below_critical_friction(data: ExactProblem) -> bool:
    """Whether friction is small enough for one answer: mu < least / largest eigenvalue of K, bounded by Gershgorin.

    Let the rows of all contacts, each contact's divided by its length, be orthonormal, x be what they see of the
    difference of two answers, and H = (E K^-1 E')^-1. Signorini's and Coulomb's law give x'Hx <= mu |(Hx)_N| |x_T|
    <= mu |H| |x|^2, while x'Hx >= |x|^2 times the least eigenvalue of H; those of H lie between those of K.
    """
    if not _orthogonal_frames(data) or data.tie:
        return False
    least = dominance(data.stiffness)
    return least > 0 and max(data.friction) < least / largest_row_sum(data.stiffness)


def _orthogonal_frames(data: ExactProblem) -> bool:
    """Whether all rows are orthogonal, those of one contact of one length."""
    width = data.directions
    rows = [row for i, normal in enumerate(data.normal) for row in (normal, *data.tangent[i * width : (i + 1) * width])]
    lengths = [sum((x * x for x in row.values()), ZERO) for row in rows]
    if any(lengths[i] != lengths[i - i % (width + 1)] for i in range(len(rows))):
        return False
    meeting = [[i for i, _ in enumerate(rows) if j in rows[i]] for j in range(data.unknowns)]
    pairs = {(a, b) for rows_here in meeting for a in rows_here for b in rows_here if a < b}
    return all(sum((x * rows[b].get(j, ZERO) for j, x in rows[a].items()), ZERO) == 0 for a, b in pairs)


def only_forces(data: ExactProblem, answer: ExactAnswer, displacement_is_unique: bool) -> bool:
    """Whether the forces are proven to be the only ones.

    The forces of a displacement are unique where the rows of closed contacts, their directions of slip where they have
    friction, and the ties are independent. Where only contacts that carry nothing make them dependent, without
    friction, they may still be: no other forces are compressive (a linear program in rational numbers).
    """
    width = data.directions
    if any(data.friction) and not displacement_is_unique:
        return False
    closed = [i for i, gap in enumerate(answer.gap) if gap == 0]
    slipping = tuple(data.tangent[i * width + k] for i in closed for k in range(width) if data.friction[i] > 0)
    rows = (*(data.normal[i] for i in closed), *slipping, *data.tie)
    if rank(rows) == len(rows):
        return True
    carrying = [i for i in closed if answer.normal_force[i] > 0]
    strong = (*(data.normal[i] for i in carrying), *data.tie)
    if slipping or rank(strong) < len(strong):
        return False
    weak = tuple(data.normal[i] for i in closed if answer.normal_force[i] == 0)
    return not _other_compressions((*weak, *strong), len(weak), data.unknowns)


def _other_compressions(rows: Rows, weak: int, n: int) -> bool:
    """Whether some combination of the rows is zero with nothing negative for the first ones, `weak` in number."""
    found = solutions([[row.get(j, ZERO) for j in range(len(rows))] + [ZERO] for row in transposed(rows, n)], len(rows))
    free = found.free if found is not None else []
    slopes = [[direction[i] for direction in free] for i in range(weak)]
    growth = [sum(column, ZERO) for column in zip(*slopes, strict=True)]
    return Polyhedron([ZERO] * weak, slopes, len(free)).range(growth)[1] is None
