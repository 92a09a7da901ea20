"""What an iteration on a contact problem is made of: products, sums, projections and a preconditioner.

The active set and the bounds are written with these alone. Vectors are what one process has of them: all of a vector in
`iteration`, the part of a rank in `distributed`; sums, and what is decided by them, are of all processes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactqp.linalg.conjugate_gradients import ConjugateGradients, Projections
from contactqp.model.arrays import Vector

Flags = NDArray[np.bool_]


class Limits(Protocol):
    """A contact problem as far as an iteration asks it: what changes from load to load."""

    @property
    def load(self) -> Vector: ...  # (n,)

    @property
    def gap(self) -> Vector: ...  # (m,)

    @property
    def tie_value(self) -> Vector: ...  # (k,)


class HeldRows(Projections, Protocol):
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
        """a'b."""

    @abstractmethod
    def any(self, flags: Flags | bool) -> bool:
        """Whether any flag is set."""

    @abstractmethod
    def count(self, flags: Flags) -> int:
        """How many are set."""

    @abstractmethod
    def mark(self, flags: Flags) -> object:
        """Something to tell this set of flags from others by."""

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
        """K x."""

    @abstractmethod
    def product_sizes(self, x: Vector) -> Vector:
        """|K||x|."""

    @abstractmethod
    def lengths(self, x: Vector) -> Vector:
        """(m + k,) E x."""

    @abstractmethod
    def length_sizes(self, x: Vector) -> Vector:
        """(m + k,) |E||x|."""

    @abstractmethod
    def forces(self, force: Vector) -> Vector:
        """(n,) E'l."""

    @abstractmethod
    def force_sizes(self, force: Vector) -> Vector:
        """(n,) |E|'|l|."""

    @abstractmethod
    def force_measure(self, force: Vector, x: Vector, load: Vector) -> Vector:
        """(m + k,) max_j |E_ij l_i| / F_j, F = |K||x| + |E|'|l| + |f|."""

    # Projections and conjugate gradients.

    @abstractmethod
    def held(self, rows: NDArray[np.intp], limit: Vector) -> HeldRows:
        """The projections of some rows, held at limits."""

    @abstractmethod
    def close(self, held: HeldRows, x: Vector, residual: Vector) -> None:
        """Move x onto the limits of held rows, and the residual with it, both in place."""

    @abstractmethod
    def run(self, x: Vector, residual: Vector, rows: NDArray[np.intp], held: HeldRows) -> ConjugateGradients:
        """Conjugate gradients on the displacements that keep some rows; x and residual are changed in place."""

    @abstractmethod
    def run_without_rows(self, residual: Vector) -> ConjugateGradients:
        """Conjugate gradients on K e = r from e = 0; r is changed in place."""

    @abstractmethod
    def smooth(self, force: Vector) -> Vector:
        """M r, M for the bodies without rows."""

    # Bodies that nothing but contacts holds; an iteration that knows none need not overwrite these.

    def rest(self, problem: Limits) -> tuple[Vector, Flags] | None:
        """Where bodies that float come to rest, and the contacts that hold them there; None where none floats."""
        del problem
        return None

    def supported(self, problem: Limits, closed: Flags, x: Vector) -> Flags:
        """Closed contacts (m,), with more of them where a body that floats would not be held."""
        del problem, x
        return closed

    def balanced(self, residual: Vector, weight: Vector) -> Vector:
        """(m + k,) the least forces, each over its weight, that leave a residual no work on rigid motions."""
        del residual
        return np.zeros_like(weight)

    def deflated(self, force: Vector) -> Vector:
        """A force (n,) without what it does on rigid motions, which K has no answer to."""
        return force

    def norm(self, x: Vector) -> float:
        """|x|."""
        return float(np.sqrt(self.dot(x, x)))
