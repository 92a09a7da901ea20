"""`ContactIteration` over the ranks: PETSc's products and preconditioner, sums by reduction."""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.floating import Floating
from contactqp.distributed.held_rows import DistributedHeldRows, gram_of, meets
from contactqp.distributed.preconditioner import Preconditioner
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.rows import Rows
from contactqp.distributed.stiffness_sizes import stiffness_sizes
from contactqp.distributed.stored_rows import chosen_rows
from contactqp.linalg.iteration import ConstrainedRows, ContactIteration, Flags, Limits
from contactqp.linalg.krylov import ConjugateGradients, Projections
from contactqp.linalg.measures import ratio
from contactqp.model.arrays import Vector


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
        """Where bodies that float come to rest, and the contacts that hold them there; None where none floats."""
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
