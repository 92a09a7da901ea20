"""Coulomb's law at every contact: what its force vectors do at the unknowns, and how far an answer is from the law.

`coulomb_residual` measures Signorini's and Coulomb's law as one equation. At contact i let r = (l_N, -l_T) be the force
on the body and u = (g - E_N u, E_T u - slip_origin). The law is

    n_i = r - P_K(r - rho_i (u + mu |u_T| e_N)) = 0        for any stiffness rho_i > 0

with the projection P_K onto the cone K = {|r_T| <= mu r_N}: with De Saxce's velocity u + mu |u_T| e_N the law is that
K* contains it, K contains r, and the two are orthogonal (De Saxce and Feng 1998). With rho_i = phi_i / L_i, phi_i the
larger of the forces that meet along the contact's normal and its tangent and L_i the larger of the lengths that meet
there, |n_i| / phi_i has no dimension and survives a change of units, rescaling of any unknown and common scaling of the
contact's rows.

Divided by 1 + mu it is at most 1 + 2 sqrt(2) < 4 times the largest of penetration, tension, complementarity, cone and
slip_direction: put the answer onto the law by moving r and u by what these figures say; P_K contracts, so n changes by
twice the move of r and once that of u + mu |u_T| e_N.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from contactqp.linalg.measures import (
    HELD_BY_DOUBLES,
    beyond,
    directions,
    lengths,
    ratio,
    reciprocal,
    row_sizes,
)
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Nothing, Violations


@dataclass(frozen=True, eq=False)
class ContactEntries:
    """The entries of the w rows of every contact, at every unknown that one of them touches."""

    contact: Indices  # (z,)
    unknown: Indices  # (z,)
    values: Array  # (w, z)
    contacts: int
    last: list[Any] = field(default_factory=list)  # forces that met, and `tangential_force` of them

    def over(self, meeting: Vector) -> Array:
        """Return E_ij / F_j (w, z); where no force meets, an entry counts as much as the contact's largest."""
        F = meeting[self.unknown]
        scaled = np.divide(self.values, F, out=np.zeros(self.values.shape), where=F > 0)
        if not (F > 0).all():
            largest = self.largest(scaled)
            idle = np.where(largest > 0, largest, 1.0)[self.contact] * np.sign(self.values)
            scaled = np.where(F > 0, scaled, idle)
        return scaled

    def meets(self, meeting: Vector) -> Mask:
        """Return whether any force meets at an unknown of each contact (m,)."""
        return self.sums((meeting[self.unknown] > 0).astype(float)) > 0

    def largest(self, values: Array) -> Vector:
        """Return the largest absolute value of (w, z) at each contact (m,)."""
        found = np.zeros(self.contacts)
        np.maximum.at(found, self.contact, abs(values).max(axis=0))
        return found

    def sums(self, values: Array) -> Vector:
        """Return the sum of values (z,) at each contact (m,)."""
        return np.asarray(np.bincount(self.contact, weights=values, minlength=self.contacts), dtype=float)

    def forces(self, force: Array) -> Array:
        """Return E_i'v (z,) of one vector v for each contact, (m, w)."""
        return np.asarray((self.values * force.T[:, self.contact]).sum(axis=0))


def contact_entries(problem: ContactProblem, name: str) -> ContactEntries:
    """Return the entries of the rows `normal` or `tangent`, computed once."""
    rows, made = getattr(problem, name), problem._computed.contact_entries
    if id(rows) not in made:
        made[id(rows)] = entries_of(rows, problem.contacts)
    entries: ContactEntries = made[id(rows)]
    return entries


def entries_of(rows: Any, contacts: int) -> ContactEntries:
    """Return the entries of CSR rows, as many rows for each of the contacts."""
    width = rows.shape[0] // contacts if contacts else 1
    if width == 1 and rows.has_canonical_format:
        row = np.repeat(np.arange(contacts), rows.indptr[1:] - rows.indptr[:-1])
        return ContactEntries(row, rows.indices.astype(np.intp), rows.data[None], contacts)
    row = np.repeat(np.arange(rows.shape[0]), rows.indptr[1:] - rows.indptr[:-1])
    places, at = np.unique(row // width * rows.shape[1] + rows.indices, return_inverse=True)
    values = np.zeros((width, len(places)))
    values[row % width, at] = rows.data
    return ContactEntries(places // rows.shape[1], places % rows.shape[1], values, contacts)


# A tangential row that has this part of the normal row's compliance and at no unknown more than the root of this of its
# entry is the rounding of zero, as of the cosine of a right angle.
WEAK = 1e-16


def hardly_felt(compliances: tuple[Vector, Array], normal: Any, tangent: Any) -> Mask:
    """Return which contacts have a tangential row that is rounding beside the normal one, or zero (m,).

    A body that is soft along the normal of its contact makes no rounding of a row across, which acts on other unknowns.

    Parameters
    ----------
    compliances : (m,) and (m, d-1) arrays, sum E_ij^2 / K_jj of normal and tangential rows [length / force]; rows on
        unknowns without stiffness, of infinite compliance, are not judged
    normal, tangent : (m, n) and (m (d-1), n) CSR arrays
    """
    along, across = compliances
    weak = (across < WEAK * along[:, None]) & np.isfinite(across)
    if weak.any():
        rows = np.flatnonzero(weak)
        beside = abs(tangent[rows]) - np.sqrt(WEAK) * abs(normal[rows // weak.shape[1]])
        weak.flat[rows] = beside.max(axis=1).toarray().ravel() <= 0
    return np.asarray(weak.any(axis=1))


def slips_that_are_nothing(none: Nothing, hardly: Mask) -> Nothing:
    """Return `none` with the length of the normal row in place of the slip's where a contact is `hardly` felt (m,)."""
    if not hardly.any():
        return none
    slip = none.tangent.reshape(len(hardly), -1)
    along = np.maximum(slip, none.normal[:, None])
    return replace(none, tangent=np.where(hardly[:, None], along, slip).ravel())


def vector_measure(entries: ContactEntries, force: Array, meeting: Vector, none: Vector) -> Vector:
    """Return max_j |E_i'v|_j / F_j (m,) of a force vector v (m, w) at each contact; up to `none` (n,) it is zero.

    Parameters
    ----------
    entries : the entries of the rows of each contact
    force : (m, w) array [force]
    meeting : (n,) array [force], F_j, what meets at each unknown
    none : (n,) array [force], up to which a force counts as zero
    """
    if not force.any():
        return np.zeros(entries.contacts)
    acting = beyond(abs(entries.forces(force)), none[entries.unknown])
    return entries.largest(ratio(acting, meeting[entries.unknown])[None])


@dataclass(frozen=True, eq=False)
class ForcesMet:
    """The unknowns that rows of contacts act on, the forces that meet there, and those that are nothing [force]."""

    entries: ContactEntries
    meeting: Vector
    nothing: Vector

    def measure(self, force: Array) -> Vector:
        """Return max_j |E_i'v|_j / F_j (m,) of one force vector v for each contact, (m, w)."""
        return vector_measure(self.entries, force, self.meeting, self.nothing)


def friction_measure(across: ForcesMet, along: ForcesMet, hardly: Mask) -> Callable[[Array], Vector]:
    """Return the function that measures tangential forces (m, d-1) by the forces that meet at their unknowns, (m,).

    Where a contact's tangential rows leave a direction that no unknown feels, as those of a node that is held across,
    forces are measured as if they pushed along its normal, so that friction beyond its bound is seen there too; so are
    those of contacts that have a row which is `hardly` felt (m,).
    """
    felt = tangential_force(across.entries, across.meeting)[1] & ~hardly

    def measure(force: Array) -> Vector:
        own = across.measure(force)
        return own if felt.all() else np.where(felt, own, np.maximum(own, along.measure(lengths(force)[:, None])))

    return measure


def rounded_slips(moved: Vector, origin: Array) -> Vector:
    """Return the rounding of slips (m,) of a displacement in doubles, from |E_T||u| and origins (m, d-1) [length]."""
    return np.asarray(HELD_BY_DOUBLES * lengths(moved.reshape(origin.shape) + abs(origin)))


@dataclass(frozen=True, eq=False)
class CoulombData:
    """The slips, coefficients and measures by which Coulomb's law is judged."""

    slip: Array  # (m, d-1) E_T u - slip_origin [length]
    rounding: Vector  # (m,) what rounding the displacement to doubles makes of it [length]
    friction: Vector  # (m,) the coefficients
    measure: Callable[[Array], Vector]  # `friction_measure`


@dataclass(frozen=True, eq=False)
class Slips:
    """The slips of an answer, whatever counts as none."""

    slip: Array  # (m, d-1) E_T u - slip_origin [length]
    rounding: Vector  # (m,) what rounding the displacement to doubles makes of it [length]
    hardly: Mask  # (m,) the contacts that are `hardly_felt`


def slips_of(problem: ContactProblem, displacement: Vector) -> Slips | None:
    """Return the slips of a displacement (n,), None without tangential rows."""
    if problem.tangent is None or problem.slip_origin is None:
        return None
    slip = (problem.tangent @ displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
    hardly = hardly_felt(compliances(problem), problem.normal, problem.tangent)
    return Slips(slip, HELD_BY_DOUBLES * lengths_across(problem, displacement), hardly)


def coulomb_data(problem: ContactProblem, found: Slips, F: Vector, none: Vector) -> CoulombData | None:
    """Return the data that judge Coulomb's law, None without friction.

    Parameters
    ----------
    problem : ContactProblem
    found : the slips of the answer
    F, none : (n,) arrays, the forces that meet at each unknown, and those that count as none [force]
    """
    if problem.friction is None:
        return None
    across = ForcesMet(contact_entries(problem, "tangent"), F, none)
    measure = friction_measure(across, ForcesMet(contact_entries(problem, "normal"), F, none), found.hardly)
    return CoulombData(found.slip, found.rounding, problem.friction, measure)


def lengths_across(problem: ContactProblem, displacement: Vector) -> Vector:
    """Return |E_T||u| + |slip_origin| of the tangential rows of each contact together (m,) [length]."""
    if problem.tangent is None or problem.slip_origin is None:
        return np.zeros(problem.contacts)
    origin, moved = problem.slip_origin, row_sizes(problem, problem.tangent).lengths(abs(displacement))
    return lengths(moved.reshape(origin.shape) + abs(origin))


def compliances(problem: ContactProblem) -> tuple[Vector, Array]:
    """Return the compliances of the normal rows (m,) and of the tangential ones (m, d-1) [length / force].

    They are sum E_ij^2 / K_jj, and infinite where a tangential row acts on an unknown without stiffness.
    """
    normal = row_sizes(problem, problem.normal).compliance
    if problem.tangent is None or problem.slip_origin is None:
        return normal, np.zeros((problem.contacts, 0))
    tangent = row_sizes(problem, problem.tangent).compliance
    return normal, bare_infinite(problem.tangent, tangent, problem.diagonal).reshape(problem.slip_origin.shape)


def bare_infinite(rows: Any, compliance: Vector, diagonal: Vector) -> Vector:
    """Return the compliances of rows [length / force], infinite where they act on an unknown without stiffness."""
    if diagonal.all():
        return compliance
    bare = abs(rows) @ (diagonal == 0).astype(float) > 0
    return np.asarray(np.where(bare, np.inf, compliance))


def friction_figures(
    answer: Any, coulomb: CoulombData, meeting: Vector, none: Nothing
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return `cone`, `slip_direction`, the measure of the slip, and the force that a small slip's rounding may turn.

    Parameters
    ----------
    answer : Answer, with friction forces (m, d-1)
    coulomb : slips, their rounding, and the coefficients of friction
    meeting : (m,) array [length], the lengths that meet along the tangential rows of each contact
    none : lengths and forces that count as zero
    """
    force = answer.friction_force
    slip = slips(coulomb.slip, none)
    moved = lengths(slip)
    bound = coulomb.friction * np.maximum(answer.normal_force, 0.0)
    excess = np.maximum(lengths(force) - bound, 0.0)[:, None] * directions(force)
    part = np.divide(coulomb.rounding, moved, out=np.zeros(len(bound)), where=moved > 0)
    turned = bound * np.minimum(part, 1.0) if slip.shape[1] > 1 else np.zeros(len(bound))
    off = force - bound[:, None] * directions(slip)
    wrong = np.maximum(lengths(off) - turned, 0.0)[:, None] * directions(off)
    slip_measure = ratio(moved, meeting)
    return coulomb.measure(excess), np.minimum(slip_measure, coulomb.measure(wrong)), slip_measure, turned


def slips(slip: Array, none: Nothing) -> Array:
    """Return slips (m, d-1), zero at contacts where they count as none."""
    least = lengths(none.tangent.reshape(slip.shape))
    return np.asarray(np.where(((lengths(slip) <= least) & np.isfinite(least))[:, None], 0.0, slip))


# The other figures imply this one up to this factor.
IMPLIED = 4.0
# Tangential rows, each scaled by the forces that meet, whose angle has a smaller squared sine than this are parallel.
PARALLEL = 1e-14


def coulomb_residual(problem: ContactProblem, answer: Answer, found: Violations) -> Vector | None:
    """Return the residual |n_i| / (phi_i (1 + mu_i)) of Coulomb's law (m,), or None without friction.

    A contact whose tangential rows leave a direction that no unknown feels is measured along its normal alone: any
    friction within the bound would do in that direction.
    """
    if not problem.frictional or problem.tangent is None or problem.slip_origin is None or problem.friction is None:
        return None
    slip = (problem.tangent @ answer.displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
    across, felt = tangential_force(contact_entries(problem, "tangent"), found.meeting)
    along, least = normal_forces(contact_entries(problem, "normal"), found.meeting, found.nothing.force)
    return law_residual(answer, found, (slip, problem.friction), (along, across, felt), least)


def law_residual(
    answer: Any,
    found: Violations,
    sliding: tuple[Array, Vector],
    unit: tuple[Vector, Vector, Mask],
    nothing: Vector,
) -> Vector:
    """Return `coulomb_residual` (m,) of an `Answer`, or of one rank's part of one.

    Parameters
    ----------
    answer : Answer
    found : the figures of the answer
    sliding : (m, d-1) and (m,) arrays, the slips [length] and the coefficients of friction
    unit : three (m,) arrays, the first of `normal_forces` and what `tangential_force` returns
    nothing : (m,) array, the second of `normal_forces`: contact forces up to which there is none
    """
    (slip, friction), (along, across, felt), least = sliding, unit, nothing
    slip = np.where(felt[:, None], slips(slip, found.nothing), 0.0)
    gap = np.where(found.gap_measure > 0, found.gap, 0.0)
    L = np.maximum(found.lengths, np.where(felt, found.tangential_lengths, 0.0))
    # Bodies that move rigidly meet at no length but the gap and the slip themselves, beside which forces would drown.
    L = np.maximum(L, np.maximum(abs(gap), lengths(slip)))
    given = answer.friction_force
    given = np.zeros_like(slip) if given is None else np.where(felt[:, None], given, 0.0)
    per_force = reciprocal(np.maximum(along, np.where(felt, across, 0.0)))  # 1 / phi
    force = np.column_stack([answer.normal_force, -given]) * per_force[:, None]
    velocity = np.column_stack([gap, slip]) * reciprocal(L)[:, None]
    mu = np.where(felt, friction, 0.0)
    missed = np.linalg.norm(natural_map(force, velocity, mu), axis=1) - 2.0 * found.turned * per_force
    missed = np.maximum(missed, 0.0) / (1.0 + mu)
    return beyond(missed, least * per_force)


def normal_forces(entries: ContactEntries, meeting: Vector, none: Vector) -> tuple[Vector, Vector]:
    """Return the l_N whose measure is one and the largest that is nothing, (m,) each.

    The first has max_j |E_ij l_N| / F_j = 1 and is zero where no force meets; the second is at most `none` (n,) at
    every unknown of its contact.
    """
    nothing = entries.largest(ratio(abs(entries.values), none[entries.unknown]))
    unit, meets = entries.largest(entries.over(meeting)), entries.meets(meeting)
    return np.where(meets, reciprocal(unit), 0.0), reciprocal(nothing)


def tangential_force(entries: ContactEntries, meeting: Vector) -> tuple[Vector, Mask]:
    """Return an upper bound of the |l_T| whose measure is one (m,), and whether the unknowns feel all its directions.

    It follows from max_j |E_T'l_T|_j / F_j >= sqrt(l_T' G l_T / c), G = E_T diag(F)^-2 E_T', of the c unknowns of a
    contact, and is zero where no force meets.
    """
    last = entries.last[0] if entries.last else None
    if last is None or last[0] is not meeting:
        last = meeting, _tangential_force(entries, meeting)
        entries.last[:] = [last]  # as one, whoever else asks meanwhile
    found: tuple[Vector, Mask] = last[1]
    return found


def _tangential_force(entries: ContactEntries, meeting: Vector) -> tuple[Vector, Mask]:
    scaled, count = entries.over(meeting), entries.sums(np.ones(len(entries.contact)))
    unit = reciprocal(entries.largest(scaled))  # so that squares are doubles
    scaled = scaled * unit[entries.contact]
    own = [entries.sums(row * row) for row in scaled]
    meets = entries.meets(meeting)
    if len(own) == 1:
        return np.where(meets, unit * np.sqrt(count) * reciprocal(np.sqrt(own[0])), 0.0), own[0] > 0
    shared, product = entries.sums(scaled[0] * scaled[1]), own[0] * own[1]
    sine = 1.0 - np.divide(shared**2, product, out=np.ones_like(product), where=product > 0)
    felt = sine > PARALLEL
    largest = (own[0] + own[1]) / 2 + np.hypot((own[0] - own[1]) / 2, shared)
    smallest = np.divide(product * sine, largest, out=np.zeros_like(product), where=felt)
    return np.where(meets, unit * np.sqrt(count) * reciprocal(np.sqrt(smallest)), 0.0), felt


def onto_cone(vectors: Array, friction: Vector) -> Array:
    """Return the nearest points (m, d) of the cones K with coefficients `friction` (m,)."""
    normal, tangent = vectors[:, 0], vectors[:, 1:]
    size = lengths(tangent)
    factor = (friction * size + normal) / (1.0 + friction**2)
    beyond = np.column_stack([factor, (friction * factor)[:, None] * directions(tangent)])
    projected = np.where((size <= friction * normal)[:, None], vectors, beyond)
    return np.where((friction * size <= -normal)[:, None], 0.0, projected)


def onto_discs(vectors: Array, radius: Vector) -> Array:
    """Return the nearest points (m, d-1) of discs around zero with these radii (m,)."""
    size = lengths(vectors)
    return np.where((size <= radius)[:, None], vectors, radius[:, None] * directions(vectors))


def de_saxce(velocity: Array, friction: Vector) -> Array:
    """Return the velocities u + mu |u_T| e_N (m, d), with which Coulomb's law is a normality rule."""
    shifted = velocity.copy()
    shifted[:, 0] += friction * lengths(velocity[:, 1:])
    return shifted


# A friction force within this part of mu r_N, either way, is mu r_N: doubles come no nearer.
ON_CONE = 4 * EPS


def natural_map(force: Array, velocity: Array, friction: Vector) -> Array:
    """Return n = r - P_K(r - v), v = u + mu |u_T| e_N (m, d), which is zero exactly where the law holds.

    It is computed from velocities and the distance of r from the cone, never as a difference of forces or of mu |u_T|,
    beside which velocities would be lost where redundant contacts press on each other or mu is large. In K n is v, in
    its polar cone r. Outside, with the direction t of r_T - u_T and e = |r_T| - mu r_N + |r_T - u_T| - |r_T| - |u_T|,

        n_N = (u_N - mu e) / (1 + mu^2),    n_T = u_T + |u_T| t + (e + mu u_N) t / (1 + mu^2).
    """
    slip, slid, step = velocity[:, 1:], lengths(velocity[:, 1:]), velocity.copy()
    step[:, 0] += friction * slid
    moved = force - step
    given, size, t = lengths(force[:, 1:]), lengths(moved[:, 1:]), directions(moved[:, 1:])
    bound = friction * force[:, 0]
    excess = np.where(abs(given - bound) <= ON_CONE * (given + abs(bound)), 0.0, given - bound)
    # |r_T - u_T| - |r_T| = -u_T'(2 r_T - u_T) / (|r_T - u_T| + |r_T|)
    whole = (size + given)[:, None]
    both = np.divide(moved[:, 1:] + force[:, 1:], whole, out=np.zeros_like(slip), where=whole > 0)
    excess = excess - np.sum(both * slip, axis=1) - slid
    root = np.hypot(1.0, friction)
    across, along = 1.0 / root, friction / root
    # Without friction the cone is a half line, and -0 is no side of it.
    inside = (across * excess + along * velocity[:, 0] + root * slid <= 0) & (moved[:, 0] >= 0)
    normal = across * (across * velocity[:, 0] - along * excess)
    tangential = slip + slid[:, None] * t + (across * (across * excess + along * velocity[:, 0]))[:, None] * t
    missed = np.where((friction * size <= -moved[:, 0])[:, None], force, np.column_stack([normal, tangential]))
    return np.where(inside[:, None], step, missed)


def distance_from_law(force: Array, velocity: Array, friction: Vector) -> Vector:
    """Return |n| of each contact, or |u_T| + |n| without slip where that is less (m,).

    With its velocities changed by u_T a contact sticks: a large mu makes much of a slip that is rounding.
    """
    sticking = np.column_stack([velocity[:, :1], np.zeros_like(velocity[:, 1:])])
    missed, missed_sticking = (lengths(natural_map(force, each, friction)) for each in (velocity, sticking))
    return np.minimum(missed, missed_sticking + lengths(velocity[:, 1:]))
