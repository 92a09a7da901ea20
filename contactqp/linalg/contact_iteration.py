"""Define the interface of iterative solution, in one process or on ranks, for the active set, the bounds and friction.

These use only the products, sums, projections and the preconditioner of a `ContactIteration`. A vector is the part on
one process, the whole in `contactqp.linalg.iteration` and the part of a rank in `contactqp.distributed`; sums and
decisions are over all processes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.floating import FloatingMotions
from contactqp.linalg.krylov import ConjugateGradients, ConstrainedRows
from contactqp.model.arrays import Array, Indices, Mask, Vector


class Limits(Protocol):
    """The part of a contact problem that changes from load to load, as an iteration reads it."""

    @property
    def load(self) -> Vector: ...  # (n,)

    @property
    def gap(self) -> Vector: ...  # (m,)

    @property
    def tie_value(self) -> Vector: ...  # (k,)


class ContactIteration(ABC):
    """A stiffness K and its rows E (contacts, then ties), shared by all problems that have both.

    Attributes
    ----------
    krylov_iterations : int, steps of conjugate gradients so far
    least_eigenvalue : float, the least Ritz value of M K in all runs, with or without constrained rows longest_run :
    int, the steps of the longest of them
    floating : the rigid motions of bodies held by contacts and ties only
    """

    floating: FloatingMotions
    factorised = False  # whether M is the inverse of K up to rounding

    def __init__(self) -> None:
        self.krylov_iterations = 0
        self.least_eigenvalue, self.longest_run = 1.0, 0

    def learn(self, run: ConjugateGradients) -> None:
        """Keep the least Ritz value and the length of a run."""
        self.longest_run = max(self.longest_run, run.steps)
        self.least_eigenvalue = min(self.least_eigenvalue, run.least_eigenvalue())

    # Sums, of all processes.

    @abstractmethod
    def dot(self, a: Vector, b: Vector) -> float:
        """Return the inner product a'b of two vectors."""

    @abstractmethod
    def dots(self, some: Array, b: Vector) -> Vector:
        """Return the inner products (q,) of the rows of some vectors (q, n) with another."""

    @abstractmethod
    def any(self, flags: Mask | bool) -> bool:
        """Return whether any flag is set, on any process."""

    @abstractmethod
    def count(self, flags: Mask) -> int:
        """Return the number of flags that are set."""

    @abstractmethod
    def mark(self, flags: Mask) -> object:
        """Return a hashable value that identifies this set of flags."""

    @abstractmethod
    def largest(self, values: Vector) -> Vector:
        """Return the largest over all processes, entry by entry."""

    # Products.

    @property
    @abstractmethod
    def diagonal(self) -> Vector:
        """Return the diagonal D of K (n,) [force / length]."""

    @property
    @abstractmethod
    def own_compliance(self) -> Vector:
        """Return the compliances E_i D^-1 E_i' of all rows (m + k,) [length / force]."""

    @abstractmethod
    def product(self, x: Vector) -> Vector:
        """Return the forces K x of a displacement."""

    @abstractmethod
    def product_sizes(self, x: Vector) -> Vector:
        """Return |K||x|, the sum of the sizes of the terms of K x."""

    @abstractmethod
    def lengths(self, x: Vector) -> Vector:
        """Return E x (m + k,)."""

    @abstractmethod
    def length_sizes(self, x: Vector) -> Vector:
        """Return |E||x| (m + k,)."""

    @abstractmethod
    def forces(self, force: Vector) -> Vector:
        """Return the forces of the rows on the unknowns, E'l (n,)."""

    @abstractmethod
    def force_sizes(self, force: Vector) -> Vector:
        """Return |E|'|l| (n,)."""

    @abstractmethod
    def force_measure(self, force: Vector, x: Vector, load: Vector) -> Vector:
        """Return max_j |E_ij l_i| / F_j of every row (m + k,), F = |K||x| + |E|'|l| + |f|."""

    # Projections and conjugate gradients.

    @abstractmethod
    def held(self, rows: Indices, limit: Vector) -> ConstrainedRows:
        """Return the projections for some rows, constrained to limits."""

    @abstractmethod
    def close(self, held: ConstrainedRows, x: Vector, residual: Vector) -> None:
        """Move x onto the limits of constrained rows and update the residual, both in place."""

    @abstractmethod
    def run(self, x: Vector, residual: Vector, rows: Indices, held: ConstrainedRows) -> ConjugateGradients:
        """Return conjugate gradients on the displacements that satisfy constrained rows.

        Parameters
        ----------
        x : (n,) array [length]
            The displacement so far, changed in place.
        residual : (n,) array [force]
            What it leaves out of balance, changed in place.
        rows : (q,) array of int
            The rows that are kept, counted over contacts, then ties.
        held : ConstrainedRows
            The projection onto what keeps them.
        """

    @abstractmethod
    def run_without_rows(self, residual: Vector) -> ConjugateGradients:
        """Return conjugate gradients on K e = r from e = 0; r is changed in place."""

    @abstractmethod
    def smooth(self, force: Vector) -> Vector:
        """Return M r, M being the preconditioner of the bodies without rows."""

    # Contacts with friction, whose tangential rows follow contacts and ties, contact by contact.

    @property
    @abstractmethod
    def entries(self) -> sp.csr_matrix:
        """Return E (m + k + ..., t) over the unknowns that its rows touch."""

    @abstractmethod
    def of_rows(self, chosen: Indices) -> ContactIteration:
        """Return the iteration with some of the rows only, all contacts first."""

    @abstractmethod
    def lengths_of(self, entries: sp.csr_matrix, x: Vector) -> Vector:
        """Return the lengths of other rows (a, t) over the touched unknowns."""

    @abstractmethod
    def forces_of(self, entries: sp.csr_matrix, force: Vector) -> Vector:
        """Return the forces on the unknowns (n,) of forces (a,) on other rows (a, t)."""

    @abstractmethod
    def constrained(self, entries: sp.csr_matrix, limit: Vector) -> ConstrainedRows:
        """Return the projections for other rows (a, t), each a sum of rows of one contact, constrained to limits
        (a,).
        """

    def refuse_late(self, what: str) -> None:
        """Raise NotConverged if the time limit has passed before `what`; never on ranks, whose clocks differ."""
        del what

    def smoother(self, rows: Indices, sprung: sp.csr_matrix) -> Callable[[Vector], Vector]:
        """Return the preconditioner M r with constrained rows and springs on `sprung` E; by default without both."""
        del rows, sprung
        return self.smooth

    # Bodies that nothing but contacts holds.

    def supports(self, closed: Mask, load: Vector) -> bool:
        """Return whether closed contacts and all further rows resist every rigid motion that a load drives."""
        return not self.floating.count or self.floating.holds(closed, load)

    def at_rest(self, held: ConstrainedRows, closed: Mask) -> ConstrainedRows:
        """Return the projections for constrained rows that also remove motions resisted by no closed contact or other
        row.
        """
        return self.floating.projections(held, closed)

    def rest(self, problem: Limits) -> tuple[Vector, Mask] | None:
        """Return the rest position of floating bodies and the contacts that hold them, None if none floats."""
        if not self.floating.count:
            return None
        return self.floating.resting(problem.load, np.concatenate([problem.gap, problem.tie_value]))

    def supported(self, problem: Limits, closed: Mask, x: Vector) -> Mask:
        """Return closed contacts (m,), with those added on which a body that they do not hold would come to rest."""
        if self.supports(closed, problem.load):
            return closed
        limit = np.concatenate([problem.gap, problem.tie_value])
        return closed | self.floating.resting(problem.load, limit - self.lengths(x))[1]

    def balanced(self, residual: Vector, weight: Vector) -> Vector:
        """Return the forces of least weighted norm (m + k,) after which a residual does no work on rigid motions."""
        return self.floating.balance(residual, weight)

    def elastic(self, x: Vector) -> Vector:
        """Return a displacement without its rigid part, in the metric of D."""
        if not self.floating.count:
            return x
        strained = x.copy()
        self.floating.admit(strained)
        return strained

    def deflated(self, force: Vector) -> Vector:
        """Return a force (n,) without the part that does work on rigid motions, which K cannot balance."""
        return self.floating.balanced(force) if self.floating.count else force

    def around(self, contacts: Mask, layers: int) -> Mask:
        """Return the contacts and those within `layers` of unknowns around them (m,), by default only the contacts."""
        del layers
        return contacts

    def norm(self, x: Vector) -> float:
        """Return the Euclidean norm |x| of a vector."""
        return float(np.sqrt(self.dot(x, x)))
