"""What the active set, the bounds and friction ask of a stiffness that is iterated on, in one process or over ranks.

They are written with the products, sums, projections and the preconditioner of a `ContactIteration` alone. A vector is
what one process has of it: all of it in `contactqp.linalg.iteration`, the part of a rank in `contactqp.distributed`;
sums, and what is decided by them, are of all processes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.krylov import ConjugateGradients, Projections
from contactqp.model.arrays import Vector

Flags = NDArray[np.bool_]
# Vectors that GMRES keeps until it starts anew.
RESTART = 60


class Limits(Protocol):
    """A contact problem as far as an iteration asks it: what changes from load to load."""

    @property
    def load(self) -> Vector: ...  # (n,)

    @property
    def gap(self) -> Vector: ...  # (m,)

    @property
    def tie_value(self) -> Vector: ...  # (k,)


class ConstrainedRows(Projections, Protocol):
    """The projections of some rows, held at limits."""

    def close(self, x: Vector) -> None:
        """Move x onto the limits, in place."""

    def forces(self, r: Vector) -> Vector:
        """The forces on the rows that carry r best."""


class ContactIteration(ABC):
    """A stiffness K and its rows E (contacts, then ties), shared by all problems that have both.

    Attributes
    ----------
    krylov_iterations : int
        Steps of conjugate gradients so far.
    least_eigenvalue : float
        The least Ritz value of M K that any run has found, on held rows or without.
    longest_run : int
        The steps of the longest of them.
    """

    factorised = False  # whether M is the inverse of K but for rounding

    def __init__(self) -> None:
        self.krylov_iterations = 0
        self.least_eigenvalue, self.longest_run = 1.0, 0

    def learn(self, run: ConjugateGradients) -> None:
        """Keep the least Ritz value of a run."""
        self.longest_run = max(self.longest_run, run.steps)
        self.least_eigenvalue = min(self.least_eigenvalue, run.least_eigenvalue())

    # Sums, of all processes.

    @abstractmethod
    def dot(self, a: Vector, b: Vector) -> float:
        """Return the inner product a'b of two vectors."""

    @abstractmethod
    def any(self, flags: Flags | bool) -> bool:
        """Whether any flag is set."""

    @abstractmethod
    def count(self, flags: Flags) -> int:
        """How many are set."""

    @abstractmethod
    def mark(self, flags: Flags) -> object:
        """Something to tell this set of flags from others by."""

    @abstractmethod
    def largest(self, values: Vector) -> Vector:
        """Return the largest over all processes, entry by entry."""

    # Products.

    @property
    @abstractmethod
    def diagonal(self) -> Vector:
        """D = diag K (n,) [force / length]."""

    @property
    @abstractmethod
    def own_compliance(self) -> Vector:
        """(m + k,) E_i D^-1 E_i' [length / force]."""

    @abstractmethod
    def product(self, x: Vector) -> Vector:
        """Return the forces K x of a displacement."""

    @abstractmethod
    def product_sizes(self, x: Vector) -> Vector:
        """Return the sizes |K||x| of what these forces add up."""

    @abstractmethod
    def lengths(self, x: Vector) -> Vector:
        """(m + k,) E x."""

    @abstractmethod
    def length_sizes(self, x: Vector) -> Vector:
        """(m + k,) |E||x|."""

    @abstractmethod
    def forces(self, force: Vector) -> Vector:
        """Return what forces on the rows do to the unknowns, E'l (n,)."""

    @abstractmethod
    def force_sizes(self, force: Vector) -> Vector:
        """(n,) |E|'|l|."""

    @abstractmethod
    def force_measure(self, force: Vector, x: Vector, load: Vector) -> Vector:
        """(m + k,) max_j |E_ij l_i| / F_j, F = |K||x| + |E|'|l| + |f|."""

    # Projections and conjugate gradients.

    @abstractmethod
    def held(self, rows: NDArray[np.intp], limit: Vector) -> ConstrainedRows:
        """The projections of some rows, held at limits."""

    @abstractmethod
    def close(self, held: ConstrainedRows, x: Vector, residual: Vector) -> None:
        """Move x onto the limits of held rows, and the residual with it, both in place."""

    @abstractmethod
    def run(self, x: Vector, residual: Vector, rows: NDArray[np.intp], held: ConstrainedRows) -> ConjugateGradients:
        """Conjugate gradients on the displacements that keep some rows; x and residual are changed in place."""

    @abstractmethod
    def run_without_rows(self, residual: Vector) -> ConjugateGradients:
        """Conjugate gradients on K e = r from e = 0; r is changed in place."""

    @abstractmethod
    def smooth(self, force: Vector) -> Vector:
        """M r, M for the bodies without rows."""

    # Contacts with friction, whose tangential rows follow contacts and ties, contact by contact.

    @property
    @abstractmethod
    def entries(self) -> sp.csr_matrix:
        """Return E (m + k + ..., t) over the unknowns that its rows touch."""

    @abstractmethod
    def of_rows(self, chosen: NDArray[np.intp]) -> ContactIteration:
        """Return the same stiffness with some of the rows alone, all contacts first."""

    @abstractmethod
    def lengths_of(self, entries: sp.csr_matrix, x: Vector) -> Vector:
        """Return the lengths of other rows (a, t) over the touched unknowns."""

    @abstractmethod
    def forces_of(self, entries: sp.csr_matrix, force: Vector) -> Vector:
        """Return what forces (a,) on other rows (a, t) do to the unknowns (n,)."""

    @abstractmethod
    def constrained(self, entries: sp.csr_matrix, limit: Vector) -> ConstrainedRows:
        """The projections of other rows (a, t), each a sum of rows of one contact, held at limits (a,)."""

    @abstractmethod
    def gmres(
        self, operator: Callable[[Vector], Vector], right: Vector, reduction: float, most: int
    ) -> tuple[Vector, int]:
        """Solve A x = right, A a function, until |right - A x| <= reduction |right| or for so many steps.

        Returns x and the number of steps.
        """

    def smoother(self, rows: NDArray[np.intp], sprung: sp.csr_matrix) -> Callable[[Vector], Vector]:
        """Return the function M r for bodies that rows hold and springs on `sprung` E join; here for bodies alone."""
        del rows, sprung
        return self.smooth

    # Bodies that nothing but contacts holds; an iteration that knows none need not overwrite these.

    def supports(self, closed: Flags, load: Vector) -> bool:
        """Whether closed contacts and all further rows hold every rigid motion that a load drives."""
        del closed, load
        return True

    def at_rest(self, held: ConstrainedRows, closed: Flags) -> ConstrainedRows:
        """The projections of held rows that also take out what neither closed contacts nor further rows hold."""
        del closed
        return held

    def rest(self, problem: Limits) -> tuple[Vector, Flags] | None:
        """Return where floating bodies come to rest and the contacts that hold them; None where none floats."""
        del problem
        return None

    def supported(self, problem: Limits, closed: Flags, x: Vector) -> Flags:
        """Closed contacts (m,), with more of them where a body that floats would not be held."""
        del problem, x
        return closed

    def around(self, contacts: Flags, layers: int) -> Flags:
        """(m,) these contacts and those within so many layers of unknowns around them; here the contacts alone."""
        del layers
        return contacts

    def balanced(self, residual: Vector, weight: Vector) -> Vector:
        """(m + k,) the least forces, each over its weight, that leave a residual no work on rigid motions."""
        del residual
        return np.zeros_like(weight)

    def deflated(self, force: Vector) -> Vector:
        """A force (n,) without what it does on rigid motions, which K has no answer to."""
        return force

    def norm(self, x: Vector) -> float:
        """Return the Euclidean norm |x| of a vector."""
        return float(np.sqrt(self.dot(x, x)))
