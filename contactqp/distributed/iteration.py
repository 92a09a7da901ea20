"""The `ContactIteration` over the ranks, and the rows and states of contacts with friction on it.

Products and preconditioners are PETSc's, sums are reductions. The projections of `contactqp.linalg.krylov` solve with
the Gram matrix E D^-1 E' of the constrained rows: rows that share no unknown with others, nodes on rigid obstacles, are
solved for one by one where they are. Where rows share unknowns on one rank alone, as the normal and the tangents of
such a node may, the Gram matrix is factorised there. That of others is factorised on every rank, which needs all that
constrained rows touch, a surface, on each.

The states of contacts with friction come from Alart and Curnier's trial forces. With stiffnesses rho of the contact's
own unknowns,

    p = l_N + rho_N (E_N u - g),    y = l_T + rho_T (E_T u - slip_origin),

a contact is closed where p > 0, sticks where |y| <= theta, and slides along t = y / |y| elsewhere; theta = mu p is
Coulomb's bound, another one Tresca's. In space the slip turns the friction: across t Newton's method has
l_T = C (E_T u - slip_origin) with C = rho_T theta / (|y| - theta).
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.distributed.floating import FloatingMotions
from contactqp.distributed.preconditioner import Preconditioner
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows, chosen_rows
from contactqp.linalg.iteration import ConstrainedRows, ContactIteration, Flags, Limits
from contactqp.linalg.krylov import ConjugateGradients, IndependentRows, Projections
from contactqp.linalg.measures import force_measure
from contactqp.model.arrays import Array, Index, Indices, Mask, Vector
from contactqp.model.coulomb import directions, lengths
from contactqp.model.solution import Answer


class SeparateGram:
    """The Gram matrix of rows that share no unknowns, which is diagonal; made from entries (a, t) and 1/K_jj (t,)."""

    def __init__(self, entries: sp.csr_matrix, compliance: Vector) -> None:
        own = entries.multiply(entries) @ compliance
        self._stiffness = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0)

    def solve(self, lengths: Vector) -> Vector:
        """Return the forces (a,) on the rows that cause the lengths (a,)."""
        return np.asarray(self._stiffness * lengths)


class SharedGram:
    """The Gram matrix of any rows, factorised on every rank. Making it and solving is collective."""

    def __init__(self, ranks: Ranks, touched: Index, entries: sp.csr_matrix, compliance: Vector) -> None:
        self._ranks = ranks
        rows = entries.tocoo()
        self._mine = slice(first := ranks.offset(entries.shape[0]), first + entries.shape[0])
        count = ranks.sum(entries.shape[0])
        unknown, place = np.unique(ranks.gathered(touched[rows.col]), return_inverse=True)
        row, value = ranks.gathered(rows.row + first), ranks.gathered(rows.data)
        diagonal = np.zeros(len(unknown))
        diagonal[place.ravel()] = ranks.gathered(compliance[rows.col])
        whole = sp.coo_matrix((value, (row, place.ravel())), shape=(count, len(unknown)))
        self._gram = IndependentRows(sp.csr_matrix(whole), diagonal)

    def solve(self, lengths: Vector) -> Vector:
        """Return the forces on this rank's rows, from the lengths of all ranks."""
        return self._gram.solve(self._ranks.gathered(lengths))[self._mine]


Gram = SeparateGram | IndependentRows | SharedGram


def gram_type(ranks: Ranks, rows: Rows) -> Callable[[sp.csr_matrix, Vector], Gram]:
    """Return the cheapest type of Gram matrix that fits how rows share unknowns. Collective."""
    times = _times_touched(rows)
    if not ranks.any(rows.assembled(times) > 1):
        return SeparateGram
    if not ranks.any(rows.assembled((times > 0).astype(float)) > 1):
        return IndependentRows
    return partial(SharedGram, ranks, rows.touched)


def _times_touched(rows: Rows) -> Vector:
    """Return how many rows of this rank touch each unknown (t,)."""
    return np.bincount(rows.entries.indices, minlength=len(rows.touched)).astype(float)


class DistributedConstrainedRows:
    """Projections of rows that are constrained to limits; everything here is collective.

    Parameters
    ----------
    rows : Rows
        The constrained rows, a of them on this rank.
    limit : (a,) array
        The lengths that they are constrained to [length].
    compliance : (t,) array
        1/K_jj of the unknowns that they touch.
    gram : Gram
        Their Gram matrix.
    """

    def __init__(self, rows: Rows, limit: Vector, compliance: Vector, gram: Gram) -> None:
        self._rows, self._limit, self._compliance, self._gram = rows, limit, compliance, gram

    def _moved(self, lengths: Vector) -> Vector:
        """Return the displacement D^-1 E'l that causes these lengths."""
        return self._rows.assembled(self._compliance * (self._rows.entries.T @ self._gram.solve(lengths)))

    def close(self, x: Vector) -> None:
        """Move x so that E x = g, in place."""
        x += self._moved(self._limit - self._rows.lengths(x))

    def admit(self, z: Vector) -> None:
        """Remove from z what moves the rows, in place."""
        z -= self._moved(self._rows.lengths(z))

    def forces(self, r: Vector) -> Vector:
        """Return the forces l (a,) that carry r best, zero on dependent rows."""
        return self._gram.solve(self._rows.entries @ (self._compliance * self._rows.at_touched(r)))

    def balanced(self, r: Vector) -> Vector:
        """Return r - E'l, the part of r that forces on the rows do not carry."""
        return np.asarray(r - self._rows.forces(self.forces(r)))


class DistributedIteration(ContactIteration):
    """A stiffness and its rows on all ranks. All methods are collective but `with_rows`.

    Parameters
    ----------
    problem : DistributedProblem
        Any problem with this K, E_N and A.
    solver : str
        The preconditioner, as `Preconditioner` takes it.
    tangents : bool
        Whether the tangential rows follow contacts and ties.
    """

    def __init__(self, problem: DistributedProblem, solver: str, *, tangents: bool = False) -> None:
        super().__init__()
        self.solver, self.factorised = solver, solver == "mumps"
        self._ranks, self._problem = problem.ranks, problem
        parts = [problem.normal, problem.tie]
        if tangents and problem.tangent is not None:
            parts.append(problem.tangent)
        rows = stacked_rows(parts, problem.stiffness)
        self._compliance = rows.at_touched(1 / problem.metric)
        self._gram = gram_type(problem.ranks, rows)
        self._touched = np.flatnonzero(rows.assembled(_times_touched(rows)) > 0)  # unknowns here, by rows of any rank
        self._sizes_at_touched = Rows.from_csr(abs(chosen_rows(problem.stiffness, self._touched)), problem.stiffness)
        self._set_rows(rows)
        self.floating = FloatingMotions(problem, rows, self.own_compliance)
        self._precondition = Preconditioner(problem, rows, self.floating.motions, solver)

    def _set_rows(self, rows: Rows) -> None:
        self.rows = rows
        self._own_compliance = np.asarray(rows.entries.multiply(rows.entries) @ self._compliance)

    def with_rows(self, entries: sp.csr_matrix) -> DistributedIteration:
        """Return the same stiffness and preconditioner with some of the rows alone, all contacts first."""
        other = copy(self)
        other._set_rows(self.rows.with_entries(entries))
        other.floating = self.floating.with_rows(other.rows, other.own_compliance)
        return other

    def dot(self, a: Vector, b: Vector) -> float:
        """Return the inner product a'b of all ranks together."""
        return self._ranks.dot(a, b)

    def any(self, flags: Flags | bool) -> bool:
        """Return whether any flag is set on any rank."""
        return self._ranks.any(flags)

    def count(self, flags: Flags) -> int:
        """Return how many flags are set on all ranks."""
        return int(self._ranks.sum(int(np.sum(flags))))

    def mark(self, flags: Flags) -> object:
        """Return a number that is the same on all ranks, and the same for the same flags on all ranks."""
        return int(self._ranks.sum(hash((self._ranks.rank, flags.tobytes()))))

    @property
    def diagonal(self) -> Vector:
        """D = diag K (n_here,) [force / length]."""
        return self._problem.metric

    @property
    def own_compliance(self) -> Vector:
        """E_i D^-1 E_i' (m_here + k_here,) [length / force]."""
        return self._own_compliance

    def product(self, x: Vector) -> Vector:
        """Return the forces K x of a displacement."""
        return self._problem.product(x)

    def product_sizes(self, x: Vector) -> Vector:
        """Return the sizes |K||x| of what K x adds up."""
        return self._problem.product_sizes(abs(x))

    def lengths(self, x: Vector) -> Vector:
        """Return the lengths E x of the rows."""
        return self.rows.lengths(x)

    def length_sizes(self, x: Vector) -> Vector:
        """Return the sizes |E||x| of what E x adds up."""
        return self.rows.length_sizes(x)

    def forces(self, force: Vector) -> Vector:
        """Return what contact and tie forces do to the unknowns, E'l."""
        return self.rows.forces(force)

    def force_sizes(self, force: Vector) -> Vector:
        """Return the sizes |E|'|l| of what E'l adds up."""
        return self.rows.force_sizes(force)

    def force_measure(self, force: Vector, x: Vector, load: Vector) -> Vector:
        """Return max_j |E_ij l_i| / F_j of each row, with F = |K||x| + |E|'|l| + |f|."""
        meeting = self.force_sizes(force) + abs(load)
        meeting[self._touched] += self._sizes_at_touched.lengths(abs(x))
        return force_measure(self.rows.entries, force, self.rows.at_touched(meeting))

    def held(self, rows: Indices, limit: Vector) -> ConstrainedRows:
        """Return the projections of some rows, constrained to limits."""
        closed = np.isin(np.arange(self._problem.contacts), rows)
        return self.floating.projections(self.constrained(self.rows.entries[rows], limit), closed)

    def constrained(self, entries: sp.csr_matrix, limit: Vector) -> DistributedConstrainedRows:
        """Return the projections of rows over the touched unknowns, sums of rows of one contact each."""
        gram = self._gram(entries, self._compliance)
        return DistributedConstrainedRows(self.rows.with_entries(entries), limit, self._compliance, gram)

    def close(self, held: ConstrainedRows, x: Vector, residual: Vector) -> None:
        """Move x onto the limits of constrained rows, and the residual with it, both in place."""
        away = x.copy()
        held.close(x)
        residual -= self.product(x - away)

    def rest(self, problem: Limits) -> tuple[Vector, Flags] | None:
        """Return where floating bodies come to rest and the contacts that hold them; None where none floats."""
        if not self.floating.count:
            return None
        return self.floating.resting(problem.load, np.concatenate([problem.gap, problem.tie_value]))

    def supported(self, problem: Limits, closed: Flags, x: Vector) -> Flags:
        """Return closed contacts, and where they leave a body loose those that it would come to rest on."""
        if not self.floating.count or self.floating.holds(closed, problem.load):
            return closed
        limit = np.concatenate([problem.gap, problem.tie_value])
        return closed | self.floating.resting(problem.load, limit - self.lengths(x))[1]

    def deflated(self, force: Vector) -> Vector:
        """Return a force without what it does on rigid motions."""
        return self.floating.balanced(force)

    def balanced(self, residual: Vector, weight: Vector) -> Vector:
        """Return the least forces, each over its weight, that leave a residual no work on rigid motions."""
        return self.floating.balance(residual, weight)

    def run(self, x: Vector, residual: Vector, rows: Indices, held: Projections) -> ConjugateGradients:
        """Return conjugate gradients on the displacements that keep some rows.

        Parameters
        ----------
        x : (n_here,) array
            The start, on the limits of the rows; changed in place.
        residual : (n_here,) array
            f - K x there; changed in place.
        rows : (a,) array of int
            The numbers of the rows.
        held : Projections
            Their projections.
        """
        precondition = self._precondition.with_rows(self.rows.entries[rows])
        return ConjugateGradients(self.product, precondition, x, residual, held, self.dot)

    def run_without_rows(self, residual: Vector) -> ConjugateGradients:
        """Return conjugate gradients on K e = r from e = 0; r is changed in place."""
        x = np.zeros_like(residual)
        return ConjugateGradients(self.product, self._precondition, x, residual, self.floating, self.dot)

    def smooth(self, force: Vector) -> Vector:
        """Return the displacement M r that the preconditioner makes of a residual."""
        return self._precondition(force)


def stacked_rows(parts: list[Rows], like: Any) -> Rows:
    """Put rows one below the other on every rank. Collective."""
    columns = like.getSize()[1]
    entries = [
        sp.csr_matrix(
            (rows.entries.data, rows.touched[rows.entries.indices], rows.entries.indptr), (rows.count, columns)
        )
        for rows in parts
    ]
    return Rows.from_csr(sp.vstack(entries, format="csr"), like)


# C is at most so many times rho_T: friction that turns harder as good as sticks across t.
STIFFEST = 1e2


@dataclass(frozen=True, eq=False)
class FrictionalAnswer(Answer):
    """Displacement and forces on one rank of a problem with tangential rows."""

    friction_force: Array  # (m_here, d-1)


@dataclass(frozen=True, eq=False)
class Combination:
    """The states of the contacts of one rank."""

    closed: Mask  # (m_here,)
    stick: Mask  # (m_here,) some of the closed ones
    direction: Array  # (m_here, d-1) t where a contact slides, else zero
    turning: Vector  # (m_here,) C [force / length], zero in the plane and where nothing slides

    @property
    def flags(self) -> Mask:
        """Flags (2, m_here) that tell one combination from another; in the plane (3, m_here), with the direction."""
        parts = [self.closed, self.stick]
        if self.direction.shape[1] == 1:
            parts.append(self.direction[:, 0] > 0)
        return np.stack(parts)


def combination_of(
    trial: tuple[Vector, Array], bound: Vector, stiffness: Vector, before: Combination | None = None
) -> Combination:
    """Return the states that trial forces give.

    A contact that slid `before` and turns against itself sticks at first: it slid the wrong way, which says little of
    how far it would slide the other way.

    Parameters
    ----------
    trial : (m,) and (m, d-1) arrays
        p and y [force].
    bound : (m,) array
        theta [force].
    stiffness : (m,) array
        rho_T [force / length].
    before : Combination, optional
        The states before.
    """
    normal, y = trial
    closed, size = normal > 0, lengths(y)
    stick = closed & (size <= bound) & (bound > 0)
    if before is not None:
        stick |= closed & (bound > 0) & (np.sum(before.direction * y, axis=1) < 0)
    slides = closed & ~stick & (bound > 0)
    turning = np.zeros(len(normal))
    if y.shape[1] > 1:
        room = np.where(slides, size - bound, 1.0)
        share = np.divide(bound, np.maximum(room, bound / STIFFEST), out=np.zeros_like(bound), where=slides)
        turning = stiffness * share
    return Combination(closed, stick, np.where(slides[:, None], directions(y), 0.0), turning)


class FrictionRows:
    """The rows E = [E_N; A; E_T] of one rank with limits [g; b; slip_origin].

    Attributes
    ----------
    iteration : DistributedIteration
        The iteration on these rows.
    m, width, plain : int
        The numbers of contacts, of tangential rows of each, and of contacts and ties.
    friction : (m_here,) array
        mu, which is zero also where no unknown feels the tangential rows.
    limit : (m_here + k_here + (d-1) m_here,) array
        The limits [length].
    """

    def __init__(self, problem: DistributedProblem, iteration: DistributedIteration) -> None:
        self.problem, self.iteration = problem, iteration
        m, k = problem.contacts, problem.ties
        origin: Any = problem.slip_origin
        self.m, self.width, self.plain = m, int(origin.shape[1]), m + k
        self.limit = np.concatenate([problem.gap, problem.tie_value, origin.ravel()])
        compliance = iteration.own_compliance
        across = compliance[self.plain :].reshape(m, self.width)
        self._felt = across > 0
        self._normal_stiffness, self.stiffness = _inverse(compliance[:m]), _inverse(np.max(across, axis=1, initial=0.0))
        friction = np.zeros(m) if problem.friction is None else problem.friction
        self.friction = np.where(self.stiffness > 0, friction, 0.0)

    def tangents(self, contacts: Mask) -> Indices:
        """Return the numbers of the tangential rows of some contacts that an unknown feels."""
        return self.plain + np.flatnonzero((contacts[:, None] & self._felt).ravel())

    def bound(self, normal_force: Vector) -> Vector:
        """Return Coulomb's bound mu l_N (m,), zero in tension."""
        return np.asarray(self.friction * np.maximum(normal_force, 0.0))

    def trial(self, answer: FrictionalAnswer) -> tuple[Vector, Array]:
        """Return p (m,) and y (m, d-1). Collective."""
        beyond = self.iteration.lengths(answer.displacement) - self.limit
        slip = np.where(self._felt, beyond[self.plain :].reshape(self.m, self.width), 0.0)
        y = answer.friction_force + self.stiffness[:, None] * slip
        return answer.normal_force + self._normal_stiffness * beyond[: self.m], y

    def coulomb(self, answer: FrictionalAnswer, before: Combination | None) -> Combination:
        """Return the states that Newton's method on Coulomb's law goes on with. Collective."""
        trial = self.trial(answer)
        return combination_of(trial, self.bound(trial[0]), self.stiffness, before)

    def within_law(self, answer: FrictionalAnswer, states: Combination) -> FrictionalAnswer:
        """Return forces that Coulomb's law allows: no tension, and friction of the bound where a contact slides."""
        full = self.bound(answer.normal_force)[:, None] * directions(answer.friction_force)
        slides = np.any(states.direction != 0, axis=1)
        friction = np.where(slides[:, None], full, answer.friction_force)
        return FrictionalAnswer(answer.displacement, np.maximum(answer.normal_force, 0.0), friction, answer.tie_force)

    def constrained(self, states: Combination) -> Indices:
        """Return the rows that a combination constrains: closed contacts, ties, tangents where it sticks."""
        rows = [np.flatnonzero(states.closed), np.arange(self.m, self.plain), self.tangents(states.stick)]
        return np.concatenate(rows)

    def sliding(self, states: Combination) -> sp.csr_matrix:
        """Return mu t'E_T (m, t), along which the normal force of a sliding contact acts too."""
        values = self.friction[:, None] * states.direction
        by_contact = (values.ravel(), np.arange(values.size), self.width * np.arange(self.m + 1))
        return sp.csr_matrix(sp.csr_matrix(by_contact, (self.m, values.size)) @ self.tangential)

    def turning(self, states: Combination) -> tuple[sp.csr_matrix, Vector]:
        """Return sqrt(C) (I - t t')E_T ((d-1) m, t), and sqrt(C) (I - t t') slip_origin ((d-1) m,)."""
        t, root = states.direction, np.sqrt(states.turning)
        blocks = root[:, None, None] * (np.eye(self.width) - t[:, :, None] * t[:, None, :])
        size = self.m * self.width
        column = np.repeat(np.arange(size).reshape(self.m, 1, self.width), self.width, axis=1)
        across = sp.csr_matrix((blocks.ravel(), column.ravel(), self.width * np.arange(size + 1)), (size, size))
        return sp.csr_matrix(across @ self.tangential), np.asarray(across @ self.limit[self.plain :])

    def turned_friction(self, u: Vector, states: Combination) -> Array:
        """Return C (I - t t')(E_T u - slip_origin) (m, d-1), the friction across t in space. Collective."""
        t, slip = states.direction, (self.iteration.lengths(u) - self.limit)[self.plain :].reshape(self.m, self.width)
        across = slip - np.sum(t * slip, axis=1)[:, None] * t
        return np.asarray(states.turning[:, None] * np.where(self._felt, across, 0.0))

    def sticking(self, stick: Mask) -> tuple[DistributedIteration, Vector]:
        """Return the iteration on contacts, ties and the tangents of sticking contacts as further ties; its limits."""
        chosen = np.concatenate([np.arange(self.plain), self.tangents(stick)])
        return self.iteration.with_rows(self.iteration.rows.entries[chosen]), self.limit[chosen]

    @property
    def tangential(self) -> sp.csr_matrix:
        """E_T over the unknowns that the rows touch."""
        return self.iteration.rows.entries[self.plain :]


def _inverse(size: Vector) -> Vector:
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
