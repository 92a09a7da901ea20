"""`ContactIteration` over the ranks: PETSc's products and preconditioner, sums by reduction."""

from __future__ import annotations

from copy import copy
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.floating import Floating
from contactqp.distributed.preconditioner import Preconditioner
from contactqp.distributed.problem import DistributedProblem, stiffness_sizes
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows, chosen_rows
from contactqp.linalg.iteration import ConstrainedRows, ContactIteration, Flags, Limits
from contactqp.linalg.krylov import ConjugateGradients, IndependentRows, Projections
from contactqp.linalg.measures import ratio
from contactqp.model.arrays import Vector

# The projections of `contactqp.linalg.krylov`, of rows that stand on many ranks.
#
# Rows that share no unknown with others, nodes on rigid obstacles, are solved for one by one where they are. Where rows
# share unknowns on one rank alone, as the normal and the tangents of such a node may, their Gram matrix E D^-1 E' is
# factorised there. That of others is factorised on every rank, which needs what all held rows touch, a surface, on
# each.


class Gram(Protocol):
    """(E D^-1 E')^-1."""

    def solve(self, lengths: Vector) -> Vector:
        """The forces on the rows of this rank, (a,), that cause the lengths (a,)."""


class SeparateGram:
    """The Gram matrix of rows that share no unknowns: a diagonal."""

    def __init__(self, entries: sp.csr_matrix, compliance: Vector) -> None:
        own = entries.multiply(entries) @ compliance
        self._stiffness = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0)

    def solve(self, lengths: Vector) -> Vector:
        """Row by row."""
        return np.asarray(self._stiffness * lengths)


class SharedGram:
    """The Gram matrix of any rows, on every rank. Making it and solving is collective."""

    def __init__(self, ranks: Ranks, entries: sp.csr_matrix, touched: NDArray[np.intp], compliance: Vector) -> None:
        self._ranks = ranks
        rows = entries.tocoo()
        self._mine = slice(first := ranks.first(entries.shape[0]), first + entries.shape[0])
        count = ranks.sum(entries.shape[0])
        unknown, place = np.unique(ranks.gathered(touched[rows.col]), return_inverse=True)
        row, value = ranks.gathered(rows.row + first), ranks.gathered(rows.data)
        diagonal = np.zeros(len(unknown))
        diagonal[place.ravel()] = ranks.gathered(compliance[rows.col])
        whole = sp.coo_matrix((value, (row, place.ravel())), shape=(count, len(unknown)))
        self._gram = IndependentRows(sp.csr_matrix(whole), diagonal)

    def solve(self, lengths: Vector) -> Vector:
        """From the lengths of all ranks."""
        return self._gram.solve(self._ranks.gathered(lengths))[self._mine]


def gram_of(ranks: Ranks, entries: sp.csr_matrix, touched: NDArray[np.intp], compliance: Vector, meeting: str) -> Gram:
    """What solves for the forces on rows that meet as `meets` says. Collective."""
    if meeting == SEPARATE:
        return SeparateGram(entries, compliance)
    if meeting == HERE:
        return IndependentRows(entries, compliance)
    return SharedGram(ranks, entries, touched, compliance)


def meets(ranks: Ranks, rows: Rows) -> str:
    """Whether rows share unknowns, and with whom. Collective."""
    often = np.bincount(rows.entries.indices, minlength=len(rows.touched)).astype(float)
    if not ranks.any(rows.spread(often) > 1):
        return SEPARATE
    return ACROSS if ranks.any(rows.spread((often > 0).astype(float)) > 1) else HERE


# Rows share no unknown, or only with rows of their own rank, or with those of others too.
SEPARATE, HERE, ACROSS = "separate", "here", "across"


class DistributedHeldRows:
    """Rows held at limits; everything here is collective.

    Parameters
    ----------
    rows : Rows
    entries : (a, t) CSR matrix
        Those of this rank that are held, over what `rows` touches.
    limit : (a,) array [length]
    compliance : (t,) array
        1/K_jj of what the rows touch.
    gram : Gram
        Of the held rows.
    """

    def __init__(self, rows: Rows, entries: sp.csr_matrix, limit: Vector, compliance: Vector, gram: Gram) -> None:
        self._rows, self._limit, self._compliance, self._gram = rows, limit, compliance, gram
        self._entries = entries

    def _moved(self, force: Vector) -> Vector:
        """D^-1 E'l."""
        return self._rows.spread(self._compliance * (self._entries.T @ force))

    def _lengths(self, x: Vector) -> Vector:
        return np.asarray(self._entries @ self._rows.near(x))

    def close(self, x: Vector) -> None:
        """Move x so that E x = g, in place."""
        x += self._moved(self._gram.solve(self._limit - self._lengths(x)))

    def admit(self, z: Vector) -> None:
        """Take out of z what moves the rows, in place."""
        z -= self._moved(self._gram.solve(self._lengths(z)))

    def forces(self, r: Vector) -> Vector:
        """(a,) l, zero on dependent rows."""
        return self._gram.solve(self._entries @ (self._compliance * self._rows.near(r)))

    def balanced(self, r: Vector) -> Vector:
        """What the forces on the rows leave of r."""
        return np.asarray(r - self._rows.spread(self._entries.T @ self.forces(r)))


class DistributedIteration(ContactIteration):
    """A stiffness and its rows on all ranks. Everything is collective.

    Parameters
    ----------
    problem : DistributedProblem
        Any with this K, E_N and A.
    solver : str
        What `Preconditioner` takes.
    tangents : bool
        Whether the tangential rows stand after contacts and ties.
    """

    def __init__(self, problem: DistributedProblem, solver: str, *, tangents: bool = False) -> None:
        super().__init__()
        self.solver, self.factorised = solver, solver == "mumps"
        self._ranks, self._problem = problem.ranks, problem
        parts = [problem.normal, problem.tie]
        if tangents and problem.tangent is not None:
            parts.append(problem.tangent)
        rows = stacked(parts, problem.stiffness)
        self._compliance = rows.near(1 / problem.metric)
        self._meeting = meets(problem.ranks, rows)
        often = np.bincount(rows.entries.indices, minlength=len(rows.touched)).astype(float)
        self._touched = np.flatnonzero(rows.spread(often) > 0)  # of this rank's unknowns, by rows of any
        self._near_sizes = Rows.over_touched(abs(chosen_rows(problem.stiffness, self._touched)), problem.stiffness)
        self._stand_on(rows)
        self.floating = Floating(problem, rows, self.own_compliance)
        self._precondition = Preconditioner(problem, rows, self.floating.motions, solver)

    def _stand_on(self, rows: Rows) -> None:
        self.rows = rows
        self._row_sizes = abs(rows.entries)
        self._own_compliance = np.asarray(rows.entries.multiply(rows.entries) @ self._compliance)

    def standing(self, entries: sp.csr_matrix) -> DistributedIteration:
        """The same stiffness and preconditioner with some of the rows alone, all contacts first; not collective."""
        other = copy(self)
        other._stand_on(self.rows.standing(entries))
        other.floating = self.floating.standing(other.rows, other.own_compliance)
        return other

    def dot(self, a: Vector, b: Vector) -> float:
        """a'b."""
        return self._ranks.dot(a, b)

    def any(self, flags: Flags | bool) -> bool:
        """Whether any flag is set on any rank."""
        return self._ranks.any(flags)

    def count(self, flags: Flags) -> int:
        """How many are set on all ranks."""
        return int(self._ranks.sum(int(np.sum(flags))))

    def mark(self, flags: Flags) -> object:
        """The same on all ranks for the same flags on all ranks."""
        return int(self._ranks.sum(hash((self._ranks.rank, flags.tobytes()))))

    @property
    def diagonal(self) -> Vector:
        """D = diag K (n_here,) [force / length]."""
        return self._problem.metric

    @property
    def own_compliance(self) -> Vector:
        """(m_here + k_here,) E_i D^-1 E_i' [length / force]."""
        return self._own_compliance

    def product(self, x: Vector) -> Vector:
        """K x."""
        return self._problem.product(x)

    def product_sizes(self, x: Vector) -> Vector:
        """|K||x|."""
        return stiffness_sizes(self._problem, abs(x))

    def lengths(self, x: Vector) -> Vector:
        """E x."""
        return self.rows.lengths(x)

    def length_sizes(self, x: Vector) -> Vector:
        """|E||x|."""
        return np.asarray(self._row_sizes @ abs(self.rows.near(x)))

    def forces(self, force: Vector) -> Vector:
        """E'l."""
        return self.rows.forces(force)

    def force_sizes(self, force: Vector) -> Vector:
        """|E|'|l|."""
        return self.rows.spread(self._row_sizes.T @ abs(force))

    def force_measure(self, force: Vector, x: Vector, load: Vector) -> Vector:
        """max_j |E_ij l_i| / F_j, F = |K||x| + |E|'|l| + |f|."""
        meeting = self.force_sizes(force) + abs(load)
        meeting[self._touched] += self._near_sizes.lengths(abs(x))
        F = self.rows.near(meeting)
        row = np.repeat(np.arange(self.rows.count), np.diff(self.rows.entries.indptr))
        measure = np.zeros(self.rows.count)
        sizes = self._row_sizes.data * abs(force)[row]
        np.maximum.at(measure, row, ratio(sizes, F[self.rows.entries.indices]))
        return measure

    def held(self, rows: NDArray[np.intp], limit: Vector) -> ConstrainedRows:
        """The projections of some rows, held at limits."""
        held = self.holding(self.rows.entries[rows], limit)
        closed = np.isin(np.arange(self._problem.contacts), rows)
        return self.floating.kept_from(held, closed)

    def holding(self, entries: sp.csr_matrix, limit: Vector) -> DistributedHeldRows:
        """The projections of rows over what `rows` touches, sums of rows of one contact each, held at limits."""
        gram = gram_of(self._ranks, entries, self.rows.touched, self._compliance, self._meeting)
        return DistributedHeldRows(self.rows, entries, limit, self._compliance, gram)

    def close(self, held: ConstrainedRows, x: Vector, residual: Vector) -> None:
        """Move x onto the limits of held rows, and the residual with it, both in place."""
        away = x.copy()
        held.close(x)
        residual -= self.product(x - away)

    def rest(self, problem: Limits) -> tuple[Vector, Flags] | None:
        """Return where floating bodies come to rest and the contacts that hold them; None where none floats."""
        if not self.floating.count:
            return None
        return self.floating.resting(problem.load, np.concatenate([problem.gap, problem.tie_value]))

    def supported(self, problem: Limits, closed: Flags, x: Vector) -> Flags:
        """Closed contacts, and where they leave a body loose those that it would come to rest on."""
        if not self.floating.count or self.floating.holds(closed, problem.load):
            return closed
        limit = np.concatenate([problem.gap, problem.tie_value])
        return closed | self.floating.resting(problem.load, limit - self.lengths(x))[1]

    def deflated(self, force: Vector) -> Vector:
        """A force without what it does on rigid motions."""
        return self.floating.balanced(force)

    def balanced(self, residual: Vector, weight: Vector) -> Vector:
        """The least forces, each over its weight, that leave a residual no work on rigid motions."""
        return self.floating.balance(residual, weight)

    def run(self, x: Vector, residual: Vector, rows: NDArray[np.intp], held: Projections) -> ConjugateGradients:
        """Conjugate gradients on the displacements that keep some rows."""
        precondition = self._precondition.holding(self.rows.entries[rows])
        return ConjugateGradients(self.product, precondition, x, residual, held, self.dot)

    def run_without_rows(self, residual: Vector) -> ConjugateGradients:
        """Conjugate gradients on K e = r from e = 0; r is changed in place."""
        x = np.zeros_like(residual)
        return ConjugateGradients(self.product, self._precondition, x, residual, self.floating, self.dot)

    def smooth(self, force: Vector) -> Vector:
        """M r."""
        return self._precondition(force)


def stacked(parts: list[Rows], like: Any) -> Rows:
    """Rows one below the other on every rank."""
    touched, place = np.unique(np.concatenate([rows.touched for rows in parts]), return_inverse=True)
    cuts = np.cumsum([len(rows.touched) for rows in parts])[:-1]
    entries = [
        sp.csr_matrix((rows.entries.data, where[rows.entries.indices], rows.entries.indptr), (rows.count, len(touched)))
        for rows, where in zip(parts, np.split(place.ravel(), cuts), strict=True)
    ]
    return Rows(sp.vstack(entries, format="csr"), touched, like)
