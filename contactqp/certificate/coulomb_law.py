"""Measure the violation of Coulomb's law at every contact, and force vectors by their effect on the unknowns.

`coulomb_residual` measures Signorini's and Coulomb's law as one equation. At contact i let r = (l_N, -l_T) be the force
on the body and u = (g - E_N u, E_T u - slip_origin). The law is

    n_i = r - P_K(r - rho_i (u + mu |u_T| e_N)) = 0        for any stiffness rho_i > 0

with the projection P_K onto the cone K = {|r_T| <= mu r_N}: the law states that De Saxce's velocity u + mu |u_T| e_N is
in K*, r is in K, and both are orthogonal (De Saxce and Feng 1998). With rho_i = phi_i / L_i, phi_i the larger of the
forces that meet along the contact's normal and its tangent and L_i the larger of the lengths that meet there, |n_i| /
phi_i has no dimension and survives a change of units, rescaling of any unknown and common scaling of the contact's
rows.

Divided by 1 + mu it is at most 1 + 2 sqrt(2) < 4 times the largest of penetration, tension, complementarity, cone and
slip_direction: changing r and u by these figures satisfies the law, and as P_K contracts, n changes by at most twice
the change of r plus that of u + mu |u_T| e_N.
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
from contactqp.model.solution import Answer, NegligibleSizes, Violations


@dataclass(frozen=True, eq=False)
class ContactEntries:
    """The entries of the w rows of every contact at their unknowns."""

    contact: Indices  # (z,)
    unknown: Indices  # (z,)
    values: Array  # (w, z)
    contacts: int
    last: list[Any] = field(default_factory=list)  # the last forces that met, and their `tangential_force`

    def over(self, meeting: Vector) -> Array:
        """Return E_ij / F_j (w, z); where no force meets, the largest value of the contact is used."""
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


# A tangential row is rounding of zero, as the cosine of a right angle, if its compliance is below this part of the
# normal row's and its entries are below the root of this part.
WEAK = 1e-16


def hardly_felt(compliances: tuple[Vector, Array], normal: Any, tangent: Any) -> Mask:
    """Return which contacts have a tangential row that is zero or rounding relative to the normal one (m,).

    A tangential row on other unknowns than the normal one is never rounding.

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


def with_negligible_slips(negligible: NegligibleSizes, hardly: Mask) -> NegligibleSizes:
    """Return `negligible` with the length of the normal row in the place of the slip's where `hardly_felt` (m,)."""
    if not hardly.any():
        return negligible
    slip = negligible.tangent.reshape(len(hardly), -1)
    along = np.maximum(slip, negligible.normal[:, None])
    return replace(negligible, tangent=np.where(hardly[:, None], along, slip).ravel())


def vector_measure(entries: ContactEntries, force: Array, meeting: Vector, negligible: Vector) -> Vector:
    """Return max_j |E_i'v|_j / F_j (m,) of a force vector v (m, w) at each contact, without forces up to `negligible`
    (n,).

    Parameters
    ----------
    entries : the entries of the rows of each contact
    force : (m, w) array [force]
    meeting : (n,) array [force], F_j, what meets at each unknown
    negligible : (n,) array [force], up to which a force counts as zero
    """
    if not force.any():
        return np.zeros(entries.contacts)
    acting = beyond(abs(entries.forces(force)), negligible[entries.unknown])
    return entries.largest(ratio(acting, meeting[entries.unknown])[None])


@dataclass(frozen=True, eq=False)
class ForcesMet:
    """The unknowns of contact rows, the forces that meet there, and those that count as zero [force]."""

    entries: ContactEntries
    meeting: Vector
    nothing: Vector

    def measure(self, force: Array) -> Vector:
        """Return max_j |E_i'v|_j / F_j (m,) of one force vector v for each contact, (m, w)."""
        return vector_measure(self.entries, force, self.meeting, self.nothing)


def friction_measure(across: ForcesMet, along: ForcesMet, hardly: Mask) -> Callable[[Array], Vector]:
    """Return the function that measures tangential forces (m, d-1) relative to forces that meet at their unknowns,
    (m,).

    If a contact's tangential rows are zero in a direction, as at a node supported there, forces are measured as if
    along the normal, so that friction beyond its bound is also found; likewise for contacts of `hardly_felt` (m,).
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
    """The slips of an answer, before any are set to zero."""

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


def coulomb_data(problem: ContactProblem, found: Slips, F: Vector, negligible: Vector) -> CoulombData | None:
    """Return the data by which Coulomb's law is judged, None without friction.

    Parameters
    ----------
    problem : ContactProblem
    found : the slips of the answer
    F, negligible : (n,) arrays, the forces that meet at each unknown, and those that count as negligible [force]
    """
    if problem.friction is None:
        return None
    across = ForcesMet(contact_entries(problem, "tangent"), F, negligible)
    measure = friction_measure(across, ForcesMet(contact_entries(problem, "normal"), F, negligible), found.hardly)
    return CoulombData(found.slip, found.rounding, problem.friction, measure)


def lengths_across(problem: ContactProblem, displacement: Vector) -> Vector:
    """Return |E_T||u| + |slip_origin| of the tangential rows of each contact together (m,) [length]."""
    if problem.tangent is None or problem.slip_origin is None:
        return np.zeros(problem.contacts)
    origin, moved = problem.slip_origin, row_sizes(problem, problem.tangent).lengths(abs(displacement))
    return lengths(moved.reshape(origin.shape) + abs(origin))


def compliances(problem: ContactProblem) -> tuple[Vector, Array]:
    """Return the compliances of the normal rows (m,) and of the tangential ones (m, d-1) [length / force].

    They are sum E_ij^2 / K_jj, infinite if a tangential row has an unknown without stiffness.
    """
    normal = row_sizes(problem, problem.normal).compliance
    if problem.tangent is None or problem.slip_origin is None:
        return normal, np.zeros((problem.contacts, 0))
    tangent = row_sizes(problem, problem.tangent).compliance
    return normal, bare_infinite(problem.tangent, tangent, problem.diagonal).reshape(problem.slip_origin.shape)


def bare_infinite(rows: Any, compliance: Vector, diagonal: Vector) -> Vector:
    """Return the compliances of rows [length / force], infinite if they have an unknown without stiffness."""
    if diagonal.all():
        return compliance
    bare = abs(rows) @ (diagonal == 0).astype(float) > 0
    return np.asarray(np.where(bare, np.inf, compliance))


def friction_figures(
    answer: Any, coulomb: CoulombData, meeting_lengths: Vector, negligible: NegligibleSizes
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return `cone`, `slip_direction`, the measure of the slip, and the change of force by rounding of a small slip.

    Parameters
    ----------
    answer : Answer, with friction forces (m, d-1)
    coulomb : slips, their rounding, and the coefficients of friction
    meeting_lengths : (m,) array [length], the lengths that meet along the tangential rows of each contact
    negligible : lengths and forces that count as zero
    """
    force = answer.friction_force
    slip = slips_beyond(coulomb.slip, negligible)
    moved = lengths(slip)
    bound = coulomb.friction * np.maximum(answer.normal_force, 0.0)
    excess = np.maximum(lengths(force) - bound, 0.0)[:, None] * directions(force)
    part = np.divide(coulomb.rounding, moved, out=np.zeros(len(bound)), where=moved > 0)
    turned = bound * np.minimum(part, 1.0) if slip.shape[1] > 1 else np.zeros(len(bound))
    off = force - bound[:, None] * directions(slip)
    wrong = np.maximum(lengths(off) - turned, 0.0)[:, None] * directions(off)
    slip_measure = ratio(moved, meeting_lengths)
    return coulomb.measure(excess), np.minimum(slip_measure, coulomb.measure(wrong)), slip_measure, turned


def slips_beyond(slip: Array, negligible: NegligibleSizes) -> Array:
    """Return slips (m, d-1), with negligible ones set to zero."""
    least = lengths(negligible.tangent.reshape(slip.shape))
    return np.asarray(np.where(((lengths(slip) <= least) & np.isfinite(least))[:, None], 0.0, slip))


# The other figures imply this one up to this factor.
IMPLIED = 4.0
# Tangential rows, scaled by the forces that meet, are parallel if the squared sine of their angle is below this.
PARALLEL = 1e-14


def coulomb_residual(problem: ContactProblem, answer: Answer, found: Violations) -> Vector | None:
    """Return the residual |n_i| / (phi_i (1 + mu_i)) of Coulomb's law (m,), or None without friction.

    A contact whose tangential rows are zero in a direction is measured along its normal only, as any friction within
    the bound is right in that direction.
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
    slip = np.where(felt[:, None], slips_beyond(slip, found.nothing), 0.0)
    gap = np.where(found.gap_measure > 0, found.gap, 0.0)
    L = np.maximum(found.lengths, np.where(felt, found.tangential_lengths, 0.0))
    # For rigidly moving bodies only gap and slip themselves are lengths, relative to which forces would vanish.
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


def normal_forces(entries: ContactEntries, meeting: Vector, negligible: Vector) -> tuple[Vector, Vector]:
    """Return the l_N whose measure is one and the largest that counts as zero, (m,) each.

    The first has max_j |E_ij l_N| / F_j = 1 and is zero where no force meets; the second has no force beyond
    `negligible` (n,) at any unknown of its contact.
    """
    nothing = entries.largest(ratio(abs(entries.values), negligible[entries.unknown]))
    unit, meets = entries.largest(entries.over(meeting)), entries.meets(meeting)
    return np.where(meets, reciprocal(unit), 0.0), reciprocal(nothing)


def tangential_force(entries: ContactEntries, meeting: Vector) -> tuple[Vector, Mask]:
    """Return an upper bound of the |l_T| whose measure is one (m,), and whether no direction of it is without effect.

    It follows from max_j |E_T'l_T|_j / F_j >= sqrt(l_T' G l_T / c), G = E_T diag(F)^-2 E_T', of the c unknowns of a
    contact, and is zero where no force meets.
    """
    last = entries.last[0] if entries.last else None
    if last is None or last[0] is not meeting:
        last = meeting, _tangential_force(entries, meeting)
        entries.last[:] = [last]  # read once, as other threads may replace it
    found: tuple[Vector, Mask] = last[1]
    return found


def _tangential_force(entries: ContactEntries, meeting: Vector) -> tuple[Vector, Mask]:
    scaled, count = entries.over(meeting), entries.sums(np.ones(len(entries.contact)))
    unit = reciprocal(entries.largest(scaled))  # to avoid overflow of squares
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


# A friction force within this relative distance of mu r_N is at its bound.
ON_CONE = 4 * EPS


def natural_map(force: Array, velocity: Array, friction: Vector) -> Array:
    """Return n = r - P_K(r - v), v = u + mu |u_T| e_N (m, d), which is zero exactly where the law holds.

    It is computed from velocities and the distance of r from the cone, not as a difference of forces or of mu |u_T|, in
    which velocities would be lost for large self-equilibrated forces or large mu. In K n is v, in its polar cone r.
    Outside, with the direction t of r_T - u_T and e = |r_T| - mu r_N + |r_T - u_T| - |r_T| - |u_T|,

        n_N = (u_N - mu e) / (1 + mu^2),    n_T = u_T + |u_T| t + (e + mu u_N) t / (1 + mu^2).
    """
    given_along, slip, step = force[:, 1:], velocity[:, 1:], velocity.copy()
    slid, given = lengths(slip), lengths(given_along)
    step[:, 0] += friction * slid
    moved = force - step
    trial = moved[:, 1:]
    size = lengths(trial)
    t = trial / np.where(size > 0, size, 1.0)[:, None]
    bound = friction * force[:, 0]
    excess = given - bound
    excess = np.where(abs(excess) <= ON_CONE * (given + abs(bound)), 0.0, excess)
    # |r_T - u_T| - |r_T| = -u_T'(2 r_T - u_T) / (|r_T - u_T| + |r_T|)
    whole = size + given
    both = (trial + given_along) / np.where(whole > 0, whole, 1.0)[:, None]
    excess = excess - (both * slip).sum(axis=1) - slid
    root = np.hypot(1.0, friction)
    across, along = 1.0 / root, friction / root
    inner, beside = across * velocity[:, 0], across * excess + along * velocity[:, 0]
    # Without friction the cone is a half line.
    inside = (beside + root * slid <= 0) & (moved[:, 0] >= 0)
    missed = np.empty(force.shape)
    missed[:, 0] = across * (inner - along * excess)
    missed[:, 1:] = slip + slid[:, None] * t + (across * beside)[:, None] * t
    missed = np.where((friction * size <= -moved[:, 0])[:, None], force, missed)
    return np.where(inside[:, None], step, missed)


def distance_from_law(force: Array, velocity: Array, friction: Vector) -> Vector:
    """Return |n| of each contact, or |u_T| + |n| without slip if that is smaller (m,).

    The latter treats a contact as sticking with its velocity changed by u_T, as a large mu amplifies a slip of rounding
    size.
    """
    sticking = np.zeros(velocity.shape)
    sticking[:, 0] = velocity[:, 0]
    missed, missed_sticking = (lengths(natural_map(force, each, friction)) for each in (velocity, sticking))
    return np.minimum(missed, missed_sticking + lengths(velocity[:, 1:]))


def sticks_on_supports(problem: ContactProblem, answer: Answer) -> Indices:
    """Return the contacts that stick along a tangential row of zeros, whose friction force supports carry."""
    if answer.friction_force is None or problem.tangent is None or problem.friction is None:
        return np.zeros(0, dtype=int)
    supported = (np.diff(problem.tangent.indptr).reshape(problem.contacts, -1) == 0).any(axis=1)
    if supported.any():
        limit = problem.friction * np.maximum(answer.normal_force, 0.0)
        supported &= lengths(answer.friction_force) < limit
    return np.flatnonzero(supported)
