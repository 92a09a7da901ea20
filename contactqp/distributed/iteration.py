"""The `ContactIteration` over the ranks: products and a preconditioner of PETSc, sums by reduction."""

from __future__ import annotations

from copy import copy
from typing import Any, Protocol

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
from contactqp.model.arrays import Index, Indices, Vector

# The projections of `contactqp.linalg.krylov` solve with the Gram matrix E D^-1 E' of the constrained rows.
#
# Rows that share no unknown with others, nodes on rigid obstacles, are solved for one by one where they are. Where rows
# share unknowns on one rank alone, as the normal and the tangents of such a node may, the Gram matrix is factorised
# there. That of others is factorised on every rank, which needs all that constrained rows touch, a surface, on each.


class Gram(Protocol):
    """The inverse (E D^-1 E')^-1 of a Gram matrix."""

    def solve(self, lengths: Vector) -> Vector:
        """Return the forces (a,) on the rows of this rank that cause the lengths (a,)."""


class SeparateGram:
    """The Gram matrix of rows that share no unknowns, which is diagonal."""

    def __init__(self, entries: sp.csr_matrix, compliance: Vector) -> None:
        own = entries.multiply(entries) @ compliance
        self._stiffness = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0)

    def solve(self, lengths: Vector) -> Vector:
        """Return the forces, row by row."""
        return np.asarray(self._stiffness * lengths)


class SharedGram:
    """The Gram matrix of any rows, factorised on every rank. Making it and solving is collective."""

    def __init__(self, ranks: Ranks, entries: sp.csr_matrix, touched: Index, compliance: Vector) -> None:
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


# Whether rows share no unknown, share some with rows of their own rank alone, or with rows of other ranks too.
SEPARATE, HERE, ACROSS = "separate", "here", "across"


def sharing_of_rows(ranks: Ranks, rows: Rows) -> str:
    """Return SEPARATE, HERE or ACROSS: whether rows share unknowns, and with whom. Collective."""
    times = _times_touched(rows)
    if not ranks.any(rows.assembled(times) > 1):
        return SEPARATE
    return ACROSS if ranks.any(rows.assembled((times > 0).astype(float)) > 1) else HERE


def _times_touched(rows: Rows) -> Vector:
    """Return how many rows of this rank touch each unknown (t,)."""
    return np.bincount(rows.entries.indices, minlength=len(rows.touched)).astype(float)


class DistributedConstrainedRows:
    """Projections of rows that are constrained to limits; everything here is collective.

    Parameters
    ----------
    rows : Rows
        Rows with the touched unknowns.
    entries : (a, t) CSR matrix
        The constrained rows of this rank, over the unknowns that `rows` touches.
    limit : (a,) array
        The lengths that they are constrained to [length].
    compliance : (t,) array
        1/K_jj of the touched unknowns.
    gram : Gram
        The Gram matrix of the constrained rows.
    """

    def __init__(self, rows: Rows, entries: sp.csr_matrix, limit: Vector, compliance: Vector, gram: Gram) -> None:
        self._rows, self._limit, self._compliance, self._gram = rows, limit, compliance, gram
        self._entries = entries

    def _moved(self, force: Vector) -> Vector:
        """Return D^-1 E'l."""
        return self._rows.assembled(self._compliance * (self._entries.T @ force))

    def _lengths(self, x: Vector) -> Vector:
        return np.asarray(self._entries @ self._rows.at_touched(x))

    def close(self, x: Vector) -> None:
        """Move x so that E x = g, in place."""
        x += self._moved(self._gram.solve(self._limit - self._lengths(x)))

    def admit(self, z: Vector) -> None:
        """Remove from z what moves the rows, in place."""
        z -= self._moved(self._gram.solve(self._lengths(z)))

    def forces(self, r: Vector) -> Vector:
        """Return the forces l (a,) that carry r best, zero on dependent rows."""
        return self._gram.solve(self._entries @ (self._compliance * self._rows.at_touched(r)))

    def balanced(self, r: Vector) -> Vector:
        """Return r - E'l, the part of r that forces on the rows do not carry."""
        return np.asarray(r - self._rows.assembled(self._entries.T @ self.forces(r)))


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
        self._sharing = sharing_of_rows(problem.ranks, rows)
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
        """Return a'b."""
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
        """Return K x."""
        return self._problem.product(x)

    def product_sizes(self, x: Vector) -> Vector:
        """Return |K||x|."""
        return self._problem.product_sizes(abs(x))

    def lengths(self, x: Vector) -> Vector:
        """Return E x."""
        return self.rows.lengths(x)

    def length_sizes(self, x: Vector) -> Vector:
        """Return |E||x|."""
        return self.rows.length_sizes(x)

    def forces(self, force: Vector) -> Vector:
        """Return E'l."""
        return self.rows.forces(force)

    def force_sizes(self, force: Vector) -> Vector:
        """Return |E|'|l|."""
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
        gram: Gram
        if self._sharing == SEPARATE:
            gram = SeparateGram(entries, self._compliance)
        elif self._sharing == HERE:
            gram = IndependentRows(entries, self._compliance)
        else:
            gram = SharedGram(self._ranks, entries, self.rows.touched, self._compliance)
        return DistributedConstrainedRows(self.rows, entries, limit, self._compliance, gram)

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
        """Return conjugate gradients on the displacements that keep some rows."""
        precondition = self._precondition.with_rows(self.rows.entries[rows])
        return ConjugateGradients(self.product, precondition, x, residual, held, self.dot)

    def run_without_rows(self, residual: Vector) -> ConjugateGradients:
        """Return conjugate gradients on K e = r from e = 0; r is changed in place."""
        x = np.zeros_like(residual)
        return ConjugateGradients(self.product, self._precondition, x, residual, self.floating, self.dot)

    def smooth(self, force: Vector) -> Vector:
        """Return M r."""
        return self._precondition(force)


def stacked_rows(parts: list[Rows], like: Any) -> Rows:
    """Put rows one below the other on every rank. Collective."""
    touched, place = np.unique(np.concatenate([rows.touched for rows in parts]), return_inverse=True)
    cuts = np.cumsum([len(rows.touched) for rows in parts])[:-1]
    entries = [
        sp.csr_matrix((rows.entries.data, where[rows.entries.indices], rows.entries.indptr), (rows.count, len(touched)))
        for rows, where in zip(parts, np.split(place.ravel(), cuts), strict=True)
    ]
    return Rows(sp.vstack(entries, format="csr"), touched, like)
