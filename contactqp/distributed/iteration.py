"""Implement `ContactIteration` over the ranks.

Products and preconditioners are PETSc's, and sums are reductions. The projections of `contactqp.linalg.krylov` solve
with the Gram matrix E D^-1 E' of the constrained rows: rows that share no unknown with others, nodes on rigid
obstacles, are solved one by one on their rank. If rows share unknowns on one rank only, as the normal and tangents of
such a node may, the Gram matrix is factorised there. Otherwise it is factorised on every rank, which needs all unknowns
touched by constrained rows, a surface, on each.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.distributed.preconditioner import Preconditioner
from contactqp.distributed.problem import Bodies, DistributedProblem, floating_bodies
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows, chosen_rows
from contactqp.linalg.contact_iteration import ContactIteration, FloatingMotions
from contactqp.linalg.krylov import ConjugateGradients, ConstrainedRows, IndependentRows, Projections
from contactqp.linalg.measures import reciprocal, sizes_of
from contactqp.model.arrays import Array, Index, Indices, Mask, Vector


class SeparateGram:
    """The diagonal Gram matrix of rows that share no unknowns, from entries (a, t) and 1/K_jj (t,)."""

    def __init__(self, entries: sp.csr_matrix, compliance: Vector) -> None:
        own = entries.multiply(entries) @ compliance
        self._stiffness = reciprocal(own)

    def solve(self, lengths: Vector) -> Vector:
        """Return the forces (a,) on the rows that cause the lengths (a,)."""
        return np.asarray(self._stiffness * lengths)


class SharedGram:
    """The Gram matrix of any rows, factorised on every rank. The constructor and `solve` are collective.

    Parameters
    ----------
    ranks : Ranks, the processes
    touched : (c,) array of int, the numbers of the unknowns that this rank's rows touch, as counted over all ranks
    entries : (q, c) CSR, this rank's rows over these unknowns
    compliance : (c,) array, the weights of these unknowns in the Gram matrix
    """

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
    """Return the cheapest type of Gram matrix that is correct for these rows. Collective."""
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
    """Projections with rows constrained to limits; all methods are collective.

    Parameters
    ----------
    rows : Rows, the constrained rows, a of them on this rank
    limit : (a,) array, the lengths that they are constrained to [length]
    compliance : (t,) array, 1/K_jj of the unknowns that they touch
    gram : Gram, their Gram matrix
    """

    def __init__(self, rows: Rows, limit: Vector, compliance: Vector, gram: Gram) -> None:
        self._rows, self._limit, self._compliance, self._gram = rows, limit, compliance, gram

    def _moved(self, lengths: Vector) -> Vector:
        """Return the displacement D^-1 E'l with these lengths of rows."""
        return self._rows.assembled(self._compliance * (self._rows.entries.T @ self._gram.solve(lengths)))

    def close(self, x: Vector) -> None:
        """Move x so that E x = g, in place."""
        x += self._moved(self._limit - self._rows.lengths(x))

    def admit(self, z: Vector) -> None:
        """Project z onto the displacements with E z = 0, in place."""
        z -= self._moved(self._rows.lengths(z))

    def forces(self, r: Vector) -> Vector:
        """Return the forces l (a,) that balance r best, zero on dependent rows."""
        return self._gram.solve(self._rows.entries @ (self._compliance * self._rows.at_touched(r)))

    def balanced(self, r: Vector) -> Vector:
        """Return r - E'l, the part of r not balanced by forces on the rows."""
        return np.asarray(r - self._rows.forces(self.forces(r)))


class DistributedIteration(ContactIteration):
    """A stiffness and its rows on all ranks. All methods are collective but `with_rows`.

    Parameters
    ----------
    problem : DistributedProblem, any problem with this K, E_N and A
    solver : str, the preconditioner, as `Preconditioner` takes it
    tangents : bool, whether the tangential rows follow contacts and ties
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
        self.floating = floating_motions(problem, rows, self.own_compliance)
        self._precondition = Preconditioner(problem, rows, self.floating.motions, solver)

    def _set_rows(self, rows: Rows) -> None:
        self.rows = rows
        self._own_compliance = np.asarray(rows.entries.multiply(rows.entries) @ self._compliance)

    @property
    def entries(self) -> sp.csr_matrix:
        """Return E over the unknowns that the rows of this rank touch."""
        return self.rows.entries

    def of_rows(self, chosen: Indices) -> DistributedIteration:
        """Return the same stiffness and preconditioner with only some of the rows, contacts first."""
        other = copy(self)
        other._set_rows(self.rows.with_entries(self.rows.entries[chosen]))
        other.floating = self.floating.with_rows(other.rows.lengths, other.own_compliance)
        return other

    def lengths_of(self, entries: sp.csr_matrix, x: Vector) -> Vector:
        """Return the lengths of other rows over the touched unknowns."""
        return self.rows.with_entries(entries).lengths(x)

    def forces_of(self, entries: sp.csr_matrix, force: Vector) -> Vector:
        """Return the nodal forces of forces on other rows over the touched unknowns."""
        return self.rows.with_entries(entries).forces(force)

    def largest(self, values: Vector) -> Vector:
        """Return the largest over all ranks, entry by entry."""
        return np.asarray(self._ranks.max(values))

    def dot(self, a: Vector, b: Vector) -> float:
        """Return the inner product a'b of all ranks together."""
        return self._ranks.dot(a, b)

    def dots(self, some: Array, b: Vector) -> Vector:
        """Return the inner products (q,) of vectors (q, n) with another, of all ranks together."""
        return np.asarray(self._ranks.sum(some @ b))

    def any(self, flags: Mask | bool) -> bool:
        """Return whether any flag is set on any rank."""
        return self._ranks.any(flags)

    def count(self, flags: Mask) -> int:
        """Return how many flags are set on all ranks."""
        return int(self._ranks.sum(int(np.sum(flags))))

    def mark(self, flags: Mask) -> object:
        """Return a hash of the flags of all ranks, the same on all ranks."""
        return int(self._ranks.sum(hash((self._ranks.rank, flags.tobytes()))))

    @property
    def diagonal(self) -> Vector:
        """Return D = diag K (n_here,) [force / length]."""
        return self._problem.metric

    @property
    def own_compliance(self) -> Vector:
        """Return E_i D^-1 E_i' (m_here + k_here,) [length / force]."""
        return self._own_compliance

    def product(self, x: Vector) -> Vector:
        return self._problem.product(x)

    def product_sizes(self, x: Vector) -> Vector:
        """Return the sizes |K||x| of the terms of K x."""
        return self._problem.product_sizes(abs(x))

    def lengths(self, x: Vector) -> Vector:
        """Return the lengths E x of the rows."""
        return self.rows.lengths(x)

    def length_sizes(self, x: Vector) -> Vector:
        """Return the sizes |E||x| of the terms of E x."""
        return self.rows.length_sizes(x)

    def forces(self, force: Vector) -> Vector:
        """Return the nodal forces E'l of contact and tie forces."""
        return self.rows.forces(force)

    def force_sizes(self, force: Vector) -> Vector:
        """Return the sizes |E|'|l| of the terms of E'l."""
        return self.rows.force_sizes(force)

    def force_measure(self, force: Vector, x: Vector, load: Vector) -> Vector:
        """Return max_j |E_ij l_i| / F_j of each row, with F = |K||x| + |E|'|l| + |f|."""
        meeting = self.force_sizes(force) + abs(load)
        meeting[self._touched] += self._sizes_at_touched.lengths(abs(x))
        return sizes_of(self.rows.entries).measure(force, self.rows.at_touched(meeting))

    def held(self, rows: Indices, limit: Vector) -> ConstrainedRows:
        """Return the projections with some rows constrained to limits."""
        closed = np.isin(np.arange(self._problem.contacts), rows)
        return self.at_rest(self.constrained(self.rows.entries[rows], limit), closed)

    def constrained(self, entries: sp.csr_matrix, limit: Vector) -> DistributedConstrainedRows:
        """Return the projections with rows over the touched unknowns, each a sum of rows of one contact."""
        gram = self._gram(entries, self._compliance)
        return DistributedConstrainedRows(self.rows.with_entries(entries), limit, self._compliance, gram)

    def close(self, held: ConstrainedRows, x: Vector, residual: Vector) -> None:
        """Move x onto the limits of constrained rows and update the residual, both in place."""
        away = x.copy()
        held.close(x)
        residual -= self.product(x - away)

    def run(self, x: Vector, residual: Vector, rows: Indices, held: Projections) -> ConjugateGradients:
        """Return conjugate gradients on the displacements that do not move some rows.

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
        x = np.zeros_like(residual)
        return ConjugateGradients(self.product, self._precondition, x, residual, self.floating, self.dot)

    def smooth(self, force: Vector) -> Vector:
        """Return the preconditioned residual M r."""
        return self._precondition(force)


def stacked_rows(parts: list[Rows], like: Any) -> Rows:
    """Stack rows on every rank. Collective."""
    columns = like.getSize()[1]
    entries = [
        sp.csr_matrix(
            (rows.entries.data, rows.touched[rows.entries.indices], rows.entries.indptr), (rows.count, columns)
        )
        for rows in parts
    ]
    return Rows.from_csr(sp.vstack(entries, format="csr"), like)


def floating_motions(problem: DistributedProblem, rows: Rows, compliance: Vector) -> FloatingMotions:
    """Return the rigid motions of all bodies, with rows whose E_i D^-1 E_i' is the compliance. Collective."""
    own = _motions(problem)
    return FloatingMotions(problem.ranks, problem.metric, own, problem.contacts, rows.lengths, compliance)


def _motions(problem: DistributedProblem) -> Array:
    """Return the rigid motions (n_here, r) of all bodies, D-orthonormal, body by body. Collective."""
    ranks, bodies = problem.ranks, Bodies(problem.ranks, problem.body)
    found = floating_bodies(problem, bodies)
    columns = [
        np.where(problem.body == body, motion, 0.0)
        for body in np.unique(ranks.gathered(bodies.numbers[found.floats]))
        for motion in found.motions.T
    ]
    acting = [z for z in columns if ranks.any(z != 0)]
    return np.column_stack(acting) if acting else np.zeros((len(problem.load), 0))
