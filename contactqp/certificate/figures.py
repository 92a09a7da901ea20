"""What an answer violates: the worst contact or unknown, without dimension, in any units and any scale of rows.

With F_j = (|K||u| + |E_N|'|l_N| + |E_T|'|l_T| + |A|'|nu| + |f|)_j the size of the forces that meet at unknown j (of a
load that is known to be a sum, |f| is the sum of the sizes) and
L_i = (|E_N||u| + |g|)_i the size of the lengths that meet at contact i (`lengths_that_meet` says what it is where
both vanish), a force of contact i is measured as max_j |E_ij l_i| / F_j and a gap as its size over L_i; 0/0 is 0. In F
and L, u is the displacement without its rigid part. What is nothing beside the intrinsic size of problem and answer
(`intrinsic_size`) violates nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactqp.certificate.balance import balance
from contactqp.linalg.condensation import condense
from contactqp.linalg.factorization import RigidMotions
from contactqp.linalg.intrinsic_size import (
    HELD_BY_DOUBLES,
    intrinsic_size,
    nothing,
    stiffness_sizes,
    without_rigid_part,
)
from contactqp.linalg.measures import (
    ROUNDING_OF_LENGTH,
    Residuals,
    beyond,
    force_measure,
    outer_forces,
    ratio,
    residuals,
    vector_measure,
)
from contactqp.linalg.row_sizes import contact_entries, row_sizes
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb_cone import directions, lengths
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import FIGURES, Answer, Nothing, Violations

# Figures of an answer whose signs hold: what the certificate asks for, less what rounding may add to it.
HOLDS = 1e-10

# The part of the intrinsic size that is nothing, less than the certificate's for the same reason.
NOTHING = 1e-13


def violations(
    problem: ContactProblem,
    answer: Answer,
    left: Residuals,
    rounding: float = ROUNDING_OF_LENGTH,
    rigid: RigidMotions | None = None,
) -> Violations:
    """Every figure of an answer with these residuals.

    Parameters
    ----------
    rounding : float
        The part of the intrinsic size that is nothing.
    rigid : RigidMotions, optional
        What K lets through; none where nothing floats.
    """
    elastic = answer.displacement if rigid is None else without_rigid_part(problem, answer.displacement, rigid)
    size = intrinsic_size(problem, answer, elastic)
    none = nothing(problem, answer, elastic, size, rounding)
    F = np.asarray(stiffness_sizes(problem) @ abs(elastic) + outer_forces(problem, answer))
    return figures(
        answer,
        (left.force.double(), left.gap.double(), left.tie.double()),
        Sizes(
            meeting=F,
            push=force_measure(problem.normal, answer.normal_force, F),
            felt=force_measure(problem.normal, answer.normal_force, F, none.force),
            lengths=_lengths(problem, problem.normal, problem.gap, elastic),
            tangential_lengths=_lengths_across(problem, elastic),
            tie_lengths=_lengths(problem, problem.tie, problem.tie_value, elastic),
            intrinsic_size=float(np.max(size, initial=0.0)),
            nothing=none,
        ),
        _rubbing(problem, answer, F, none.force),
    )


def _lengths(problem: ContactProblem, rows: Any, limit: Vector, displacement: Vector) -> Vector:
    """|E||u| + |g| (m,) of rows [length]."""
    return np.asarray(row_sizes(problem, rows).size @ abs(displacement) + abs(limit))


def _lengths_across(problem: ContactProblem, displacement: Vector) -> Vector:
    """The same (m,) of the tangential rows of each contact together."""
    if problem.tangent is None or problem.slip_origin is None:
        return np.zeros(problem.contacts)
    origin = problem.slip_origin
    return lengths(_lengths(problem, problem.tangent, origin.ravel(), displacement).reshape(origin.shape))


def _rubbing(problem: ContactProblem, answer: Answer, F: Vector, none: Vector) -> Rubbing | None:
    if problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        return None
    slip = (problem.tangent @ answer.displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
    entries, friction = contact_entries(problem, "tangent"), problem.friction
    rounding = rounded_slips(row_sizes(problem, problem.tangent).size, answer.displacement, problem.slip_origin)
    return Rubbing(slip, rounding, friction, lambda force: vector_measure(entries, force, F, none))


def rounded_slips(rows: Any, displacement: Vector, origin: Array) -> Vector:
    """(m,) what rounding a displacement to doubles makes of slips, of |E_T| ((d-1) m, n) and origins (m, d-1)."""
    size = rows @ abs(displacement) + abs(origin).ravel()
    return np.asarray(HELD_BY_DOUBLES * lengths(size.reshape(origin.shape)))


@dataclass(frozen=True, eq=False)
class Sizes:
    """What the residuals of an answer are measured against."""

    meeting: Vector  # (n,) F [force]
    push: Vector  # (m,) |l_N| as a force
    felt: Vector  # (m,) the same, 0 where it is nothing
    lengths: Vector  # (m,) L of the normal rows
    tangential_lengths: Vector  # (m,) that of the tangential rows
    tie_lengths: Vector  # (k,) that of the ties
    intrinsic_size: float  # S [square root of energy]
    nothing: Nothing


@dataclass(frozen=True, eq=False)
class Rubbing:
    """What Coulomb's law is judged by."""

    slip: Array  # (m, d-1) E_T u - slip_origin [length]
    rounding: Vector  # (m,) what rounding the displacement to doubles makes of it [length]
    friction: Vector  # (m,) the coefficients
    measure: Callable[[Array], Vector]  # max_j |E_T'v|_j / F_j (m,) of one tangential force v (m, d-1) a contact,
    # without what is nothing


def figures(answer: Any, left: tuple[Vector, Vector, Vector], sizes: Sizes, rubbing: Rubbing | None) -> Violations:
    """Every figure of an `Answer`, or of one rank's part of one, that leaves these forces, gaps and lengths of ties."""
    residual, gap, open_tie = left
    none, push, felt = sizes.nothing, sizes.push, sizes.felt
    gap_measure = ratio(beyond(abs(gap), none.normal), sizes.lengths)
    cone, direction, slip_measure, turned = _friction(answer, rubbing, sizes)
    return Violations(
        equilibrium=ratio(beyond(abs(residual), none.force), sizes.meeting),
        residual=residual,
        penetration=np.where(gap < 0, gap_measure, 0.0),
        tension=np.where(answer.normal_force < 0, felt, 0.0),
        complementarity=np.where((gap > 0) & (answer.normal_force > 0), np.minimum(gap_measure, felt), 0.0),
        cone=cone,
        slip_direction=direction,
        tie=ratio(beyond(abs(open_tie), none.tie), sizes.tie_lengths),
        slip_measure=slip_measure,
        turned=turned,
        lengths=sizes.lengths,
        tangential_lengths=sizes.tangential_lengths,
        gap=gap,
        gap_measure=gap_measure,
        force_measure=push,
        meeting=sizes.meeting,
        intrinsic_size=sizes.intrinsic_size,
        nothing=none,
    )


def _friction(answer: Any, rubbing: Rubbing | None, sizes: Sizes) -> tuple[Vector, Vector, Vector, Vector]:
    """Coulomb's law, contact by contact: how far outside the cone, how far from opposing the slip, the slip, and the
    force that rounding of a small slip's direction turns."""
    if rubbing is None or answer.friction_force is None:
        none = np.zeros(len(answer.normal_force))
        return none, none, none, none
    force = answer.friction_force
    slip = slips(rubbing.slip, sizes.nothing)
    size = lengths(force)
    bound = rubbing.friction * np.maximum(answer.normal_force, 0.0)
    excess = np.maximum(size - bound, 0.0)[:, None] * directions(force)
    moved = lengths(slip)
    part = np.divide(rubbing.rounding, moved, out=np.zeros_like(bound), where=moved > 0)
    turned = bound * np.minimum(part, 1.0) if slip.shape[1] > 1 else np.zeros_like(bound)
    off = force - bound[:, None] * directions(slip)
    wrong = np.maximum(lengths(off) - turned, 0.0)[:, None] * directions(off)
    slip_measure = ratio(moved, sizes.tangential_lengths)
    return rubbing.measure(excess), np.minimum(slip_measure, rubbing.measure(wrong)), slip_measure, turned


def slips(slip: Array, none: Nothing) -> Array:
    """Slips (m, d-1), zero at contacts where they are nothing."""
    slipped = beyond(lengths(slip), lengths(none.tangent.reshape(slip.shape)))
    return np.asarray(np.where((slipped == 0)[:, None], 0.0, slip))


def holds(problem: ContactProblem, answer: Answer, tolerance: float = HOLDS) -> bool:
    """Whether an answer satisfies equilibrium, contact and Coulomb's law, each figure by the certificate's measure:
    the rigid part of the displacement left out, and what is nothing beside the intrinsic size excused."""
    if not answer.finite():
        return False
    rigid = condense(problem).rigid
    found = violations(problem, answer, residuals(problem, answer), NOTHING, rigid)
    if any(float(np.max(getattr(found, name), initial=0.0)) > tolerance for name in FIGURES if name != "balance"):
        return False
    return balance(problem, answer, rigid) <= tolerance
