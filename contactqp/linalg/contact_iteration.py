"""Define the interface of iterative solution, in one process or on ranks, for the active set, the bounds and friction.

These use only the products, sums, projections and the preconditioner of a `ContactIteration`. A vector is the part on
one process, the whole in `contactqp.linalg.iteration` and the part of a rank in `contactqp.distributed`; sums and
decisions are over all processes.

With Z the rigid motions of all floating bodies as columns, a body moved by Z a touches without deforming where

    max f'Z a    subject to    E_N Z a <= g,  A Z a = b,

a linear program with few unknowns. Its multipliers are contact forces that balance the load on every motion, its active
contacts hold the bodies, and if it is unbounded the load drives a motion that nothing resists.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NoEquilibrium, NotConverged
from contactqp.linalg.floating import UNRESISTED
from contactqp.linalg.krylov import ConjugateGradients, ConstrainedRows, Processes
from contactqp.linalg.measures import reciprocal
from contactqp.linalg.nonnegative import shift_within_gaps
from contactqp.model.arrays import Array, Indices, Mask, Vector

Lengths = Callable[[Vector], Vector]
# The work of a load on a motion is rounding below this part of the sum of its terms.
WORKLESS = 1e-10
# Multipliers of the linear program below this part of the largest count as zero.
NO_MULTIPLIER = 1e-9
# SciPy's status codes of linear programs.
_INFEASIBLE, _UNBOUNDED = 2, 3
_DRIVEN = "the load drives a rigid motion that no contact and no tie holds back"


class MotionProjections:
    """Projections that remove D-orthonormal motions z (n_here, r) with K z = 0. Both are collective."""

    def __init__(self, processes: Processes, diagonal: Vector, motions: Array) -> None:
        self._processes, self._diagonal, self.motions = processes, diagonal, motions

    def admit(self, z: Vector) -> None:
        """Remove the motions from a displacement, in the metric of D, in place."""
        if self.motions.shape[1]:
            z -= self.motions @ self._processes.sum(self.motions.T @ (self._diagonal * z))

    def balanced(self, r: Vector) -> Vector:
        """Return the force with the same work on deformations and no work on the motions."""
        if not self.motions.shape[1]:
            return r.copy()
        return np.asarray(r - self._diagonal * (self.motions @ self._processes.sum(self.motions.T @ r)))


class FloatingMotions(MotionProjections):
    """The rigid motions of the bodies of a problem and its rows, contacts first.

    All methods are collective but `with_rows`.

    Parameters
    ----------
    processes : Processes, those that share the problem
    diagonal : (n_here,) array, D, the diagonal of K, positive [force / length]
    motions : (n_here, r) array, Z, orthonormal in the metric of D; no columns where all bodies are supported
    contacts : int, the number m_here of contacts
    lengths : function, returns E z (a,) of all rows, contacts first
    compliance : (a,) array, E_i D^-1 E_i' of the rows [length / force]
    """

    def __init__(
        self,
        processes: Processes,
        diagonal: Vector,
        motions: Array,
        contacts: int,
        lengths: Lengths,
        compliance: Vector,
    ) -> None:
        super().__init__(processes, diagonal, motions)
        self.contacts = contacts
        self._set_rows(lengths, compliance)

    def with_rows(self, lengths: Lengths, compliance: Vector) -> FloatingMotions:
        """Return the motions with other rows, beginning with the same contacts, and their E_i D^-1 E_i'."""
        other = copy(self)
        other.__dict__.pop("moved", None)
        other._set_rows(lengths, compliance)
        return other

    def _set_rows(self, lengths: Lengths, compliance: Vector) -> None:
        self._lengths = lengths
        self._stiffness = reciprocal(compliance)

    @property
    def count(self) -> int:
        """Return the number r of motions."""
        return int(self.motions.shape[1])

    @cached_property
    def moved(self) -> Array:
        """Return E Z (a, r), with rounding errors set to zero, so that these rows do not resist the motion."""
        own = np.sqrt(reciprocal(self._stiffness))
        columns = [np.zeros((len(own), 0))]
        for z in self.motions.T:
            size = self._processes.max(float(np.max(np.sqrt(self._diagonal) * abs(z), initial=0.0)))
            lengths = self._lengths(z)
            columns.append(np.where(abs(lengths) > UNRESISTED * own * size, lengths, 0.0)[:, None])
        return np.hstack(columns)

    def resting(self, load: Vector, limit: Vector) -> tuple[Vector, Mask]:
        """Return the rigid displacement (n_here,) to which the load moves the bodies, and the contacts that stop them.

        Raises NoEquilibrium: the load drives a motion that nothing resists; NotConverged: the linear program found
        neither a position nor such a motion.
        """
        work = self._work(load)
        every = self._processes.gathered(self.moved), self._processes.gathered(limit)
        contact = self._processes.gathered(np.arange(len(limit)) < self.contacts)
        a, force = self._processes.broadcast(
            resting_place(work, *every, contact) if self._processes.rank == 0 else None
        )
        if isinstance(a, str):
            raise (NoEquilibrium if a == _DRIVEN else NotConverged)(a)
        first = self._processes.offset(len(limit))
        push = force * np.max(abs(every[0]), axis=1, initial=0.0)  # independent of the scale of a row
        pressed = push[first : first + self.contacts] > NO_MULTIPLIER * np.max(abs(push), initial=0.0)
        return self.motions @ a, pressed

    def loose(self, closed: Mask) -> Array:
        """Return orthonormal coefficients (r, q) of the motions that no closed contact and no tie resists."""
        holding = np.append(closed, np.ones(len(self._stiffness) - self.contacts, dtype=bool))
        values, turned = self._singular_values(np.where(holding, self._stiffness, 0.0))
        return turned[:, values <= UNRESISTED * np.max(values, initial=0.0)]

    def _singular_values(self, weight: Vector) -> tuple[Vector, Array]:
        """Return the singular values (r,) of sqrt(weight) E Z, and its right singular vectors as columns."""
        here = np.linalg.qr(np.sqrt(weight)[:, None] * self.moved, mode="r")
        every = self._processes.gathered(np.vstack([here, np.zeros((1, self.count))]))
        _, values, turned = np.linalg.svd(every)
        return np.append(values, np.zeros(self.count - len(values))), turned.T

    def holds(self, closed: Mask, load: Vector) -> bool:
        """Return whether closed contacts and ties resist every motion that the load drives."""
        loose, work = self.loose(closed), self._work(load)
        return not np.any(abs(loose.T @ work) > WORKLESS * (abs(loose).T @ abs(work)))

    def projections(self, rows: ConstrainedRows, closed: Mask) -> ConstrainedRows:
        """Return the projections of constrained rows that also remove motions that no closed contact or tie resists.

        Iterates are otherwise arbitrary along these motions.
        """
        loose = self.loose(closed) if self.count else np.zeros((0, 0))
        if not loose.shape[1]:
            return rows
        return _ProjectionsWithMotions(rows, MotionProjections(self._processes, self._diagonal, self.motions @ loose))

    def at_rest(self, displacement: Vector, normal_force: Vector, gap: Vector) -> tuple[Vector, Array]:
        """Return the displacement of least norm within the gaps, and orthonormal motions (n_here, q) that are free."""
        free = self.motions @ self.loose(normal_force > 0)
        gram = self._processes.sum(free.T @ free)
        values, vectors = np.linalg.eigh(gram)
        free = free @ (vectors / np.sqrt(values))
        if not free.shape[1]:
            return displacement, free
        rows = np.column_stack([self._lengths(z)[: self.contacts] for z in free.T])
        room = gap - self._lengths(displacement)[: self.contacts]
        size = self._processes.max(float(np.max(np.sqrt(self._diagonal)[:, None] * abs(free), initial=0.0)))
        own = 1 / np.sqrt(self._stiffness[: self.contacts])
        moved = np.linalg.norm(rows, axis=1) > UNRESISTED * own * size
        shift = -self._processes.sum(free.T @ displacement)
        every, room = self._processes.gathered(rows[moved]), self._processes.gathered(room[moved])
        if len(room):
            shift = shift_within_gaps(every, room, shift)
        return displacement + free @ shift, free

    def _work(self, load: Vector) -> Vector:
        """Return Z'f (r,), zero where it is rounding."""
        work, size = self._processes.sum(np.stack([self.motions.T @ load, abs(self.motions).T @ abs(load)]))
        return np.where(abs(work) > WORKLESS * size, work, 0.0)

    def balance(self, residual: Vector, weight: Vector) -> Vector:
        """Return the forces l (a,), least in the metric of 1/weight, with Z'(r - E'l) = 0 for a residual r."""
        if not self.count:
            return np.zeros(len(self._stiffness))
        values, turned = self._singular_values(weight)
        resisted = values > UNRESISTED * np.max(values)
        work = turned[:, resisted].T @ self._processes.sum(self.motions.T @ residual)
        return np.asarray(weight * (self.moved @ (turned[:, resisted] @ (work / values[resisted] ** 2))))


class _ProjectionsWithMotions:
    """Projections of constrained rows, and of motions that do not move these rows."""

    def __init__(self, rows: ConstrainedRows, motions: MotionProjections) -> None:
        self._rows, self._motions = rows, motions
        self.close, self.forces = rows.close, rows.forces

    def admit(self, z: Vector) -> None:
        self._rows.admit(z)
        self._motions.admit(z)

    def balanced(self, r: Vector) -> Vector:
        return self._motions.balanced(self._rows.balanced(r))


def resting_place(work: Vector, moved: Array, limit: Vector, contact: Mask) -> tuple[Vector | str, Vector]:
    """Solve the linear program of rigid motions under a load.

    Where no rigid motion removes an overlap of bodies, overlapping contacts count as touching.

    Parameters
    ----------
    work : (r,) array, the work Z'f of the load on each motion
    moved : (a, r) array, E Z of contacts and ties
    limit : (a,) array, g and b [length]
    contact : (a,) array of bool, which rows are contacts; the others are ties

    Returns
    -------
    coefficients : (r,) array or str
        The resting place, or why there is none.
    force : (a,) array
        The contact forces that balance the load there; 0 on ties.
    """
    size = np.max(abs(moved), axis=1, initial=0.0)
    acting = size > 0
    for reach in (limit, np.where(contact, np.maximum(limit, 0.0), 0.0)):
        found = _program(work, moved[acting] / size[acting, None], reach[acting] / size[acting], contact[acting])
        if found.status != _INFEASIBLE:
            break
    if found.status == _UNBOUNDED:
        return _DRIVEN, limit
    if found.x is None:
        return f"the resting place of the bodies that float was not found: {found.message}", limit
    force = np.zeros(len(limit))
    force[np.flatnonzero(acting & contact)] = -found.ineqlin.marginals / size[acting & contact]
    return np.asarray(found.x), force


def _program(work: Vector, rows: Array, limit: Vector, contact: Mask) -> Any:
    from scipy.optimize import linprog

    length = np.max(abs(limit), initial=0.0) or 1.0
    push = np.max(abs(work), initial=0.0) or 1.0
    found = linprog(
        -work / push,
        A_ub=rows[contact],
        b_ub=limit[contact] / length,
        A_eq=rows[~contact] if not np.all(contact) else None,
        b_eq=limit[~contact] / length if not np.all(contact) else None,
        bounds=[(None, None)] * len(work),
        method="highs",
    )
    if found.x is not None:
        found.x, found.ineqlin.marginals = length * found.x, push * found.ineqlin.marginals
    return found


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
