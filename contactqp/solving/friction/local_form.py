"""Scale a local problem for its algorithms, and define their common iterate and Aitken's relaxation.

Contacts have a compliance of one and velocities a size of one. With D = diag(s_i I), s the problem's `contact_scale`,
b its `typical_velocity`, and T such that D V T has unit columns,

    W := D W D,    q := D q / b,    V := D V T,    r := D^-1 r / b,    u := D u / b,

which keeps every cone as it is. Where bodies move as if rigid, forces are scaled by a separate size c, r := r / c, W :=
c W, R := R / c and s := s / c, so that they are not rounding errors beside lengths of size one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.coulomb_law import natural_map
from contactqp.errors import InvalidProblem, NotConverged
from contactqp.linalg.runtime import lapack, refuse_more_than_memory
from contactqp.model.arrays import Array, Indices, Mask, Vector, seconds_left, stated_limit
from contactqp.model.local_problem import LocalProblem
from contactqp.model.solution import Answer

# Operators beyond this size, with a part of nonzero entries below this, are stored and factorised sparse.
DENSE_SIZE = 150
SPARSE_DENSITY = 0.05
# The dense matrices of an algorithm at a time.
COPIES = 4
# A regularisation of the equations of motions that no contact resists, which do not influence any force.
JOINT_REGULARISATION = 1e-12


class LocalForm:
    """The scaled problem u = W r + q + V l, V'r + R l + s = 0.

    Attributes
    ----------
    W : (d m, d m) array or CSR matrix
    q, mu : (d m,), (m,) arrays
    V, R, s : (d m, p), (p, p), (p,) arrays
    """

    def __init__(self, problem: LocalProblem, force_size: float = 1.0) -> None:
        self.problem, self.d, self.m = problem, problem.dimension, problem.contacts
        self.mu = problem.friction
        self._contact_scale = np.repeat(problem.contact_scale, self.d)
        self._joint_scale = problem.joint_scale
        self._velocity_size, self._force_size = problem.typical_velocity, force_size
        W = problem.scaled_delassus if force_size == 1.0 else problem.scaled_delassus * force_size
        self.sparse = W.shape[0] > DENSE_SIZE and W.nnz < SPARSE_DENSITY * W.shape[0] ** 2
        if not self.sparse and W.shape[0] > DENSE_SIZE:
            refuse_more_than_memory(f"dense operators of {self.m} contacts", COPIES * float(W.shape[0]) ** 2)
        self.W: Any = W if self.sparse else W.toarray()
        self.q = self._contact_scale * problem.offset / self._velocity_size
        self.V = problem.bilateral.toarray() * np.outer(self._contact_scale, self._joint_scale)
        self.R = problem.bilateral_delassus.toarray() * np.outer(self._joint_scale, self._joint_scale) / force_size
        self.s = problem.bilateral_offset * self._joint_scale / self._velocity_size / force_size
        self._refuse_beyond_doubles()

    def _refuse_beyond_doubles(self) -> None:
        entries = self.W.data if self.sparse else self.W
        joints = {"bilateral": self.V, "bilateral_delassus": self.R, "bilateral_offset": self.s}
        for name, values in {"delassus": entries, "offset": self.q, **joints}.items():
            if not np.isfinite(values).all():
                raise InvalidProblem(
                    f"{name}: an entry is not a double in units in which every contact's own compliance is one and "
                    "what drives it is one; state the problem in units in which its numbers are nearer to each other"
                )

    @cached_property
    def blocks(self) -> ContactBlocks:
        """Return the blocks of a sparse W."""
        return ContactBlocks.of(self.W, self.d)

    @property
    def joints(self) -> int:
        """Return the number of joints p."""
        return len(self.s)

    @cached_property
    def joint_signs(self) -> Vector:
        """Return the signs (p,) by which R may be regularised: 1 for joints with a compliance, -1 for conditions on
        forces.
        """
        return np.where(np.any(self.R != 0, axis=1), 1.0, -1.0)

    @cached_property
    def asymmetric(self) -> bool:
        """Return whether W is unsymmetric by more than rounding."""
        return self.problem.scaled_asymmetry > 1e-14

    @cached_property
    def symmetric_part(self) -> Any:
        """Return (W + W')/2, the part of W that enters a minimisation."""
        return (self.W + self.W.T) / 2 if self.asymmetric else self.W

    def velocity(self, r: Array, joint: Vector) -> Array:
        """Return the velocities u (m, d) of forces of contacts (m, d) and joints (p,)."""
        return np.asarray((self.W @ r.ravel() + self.q + self.V @ joint).reshape(self.m, self.d))

    def error(self, r: Array, joint: Vector) -> float:
        """Return the largest entry of the natural map's residual and of the residual of the joints."""
        residual = abs(natural_map(r, self.velocity(r, joint), self.mu)).max(initial=0.0)
        return float(max(residual, abs(self.joint_residual(r, joint)).max(initial=0.0) if self.joints else 0.0))

    def joint_residual(self, r: Array, joint: Vector) -> Vector:
        """Return the residual V'r + R l + s (p,) of the joints."""
        return np.asarray(self.V.T @ r.ravel() + self.R @ joint + self.s)

    def joint_force(self, r: Array) -> Vector:
        """Return the joint forces for given contact forces: R l = -s - V'r, with small u where R is singular."""
        if not self.joints:
            return np.zeros(0)
        stacked = np.vstack([self.R, 1e-8 * self.V])
        right = np.concatenate([-self.s - self.V.T @ r.ravel(), -1e-8 * (self.W @ r.ravel() + self.q)])
        return np.asarray(np.linalg.lstsq(stacked, right, rcond=None)[0])

    def scaled(self, force: Array) -> Array:
        """Return r (m, d) from the contact forces of the problem."""
        size = self._contact_scale * self._velocity_size * self._force_size
        return np.asarray((np.asarray(force).ravel() / size).reshape(self.m, self.d))

    def unscaled(self, r: Array, joint: Vector) -> tuple[Array, Vector]:
        """Return the contact forces (m, d) and joint forces (p,) of the problem."""
        size = self._contact_scale * self._velocity_size * self._force_size
        force = (r.ravel() * size).reshape(self.m, self.d)
        return force, joint * self._joint_scale * self._velocity_size


class ContactBlocks:
    """A sparse W by its d x d blocks of contacts that feel each other, column by column; a contact's own is there.

    Attributes
    ----------
    rows, columns : (b,) arrays of int, contacts
    values : (b, d, d) array
    """

    def __init__(self, rows: Indices, columns: Indices, values: Array) -> None:
        self.rows, self.columns, self.values = rows, columns, values

    @classmethod
    def of(cls, W: Any, d: int) -> ContactBlocks:
        """Return the blocks of a matrix (d m, d m)."""
        stored, m = sp.bsr_array(W, blocksize=(d, d)), W.shape[0] // d
        rows, columns, own = np.arange(m).repeat(np.diff(stored.indptr)), stored.indices, np.zeros(m, dtype=bool)
        own[rows[rows == columns]] = True
        lacks = np.flatnonzero(~own)  # contacts without any compliance of their own
        rows, columns = np.concatenate([rows, lacks]), np.concatenate([columns, lacks])
        values = np.concatenate([stored.data, np.zeros((len(lacks), d, d))])
        order = np.lexsort((rows, columns))
        return cls(rows[order], columns[order], values[order])

    def stiffened(self, weight: float) -> ContactBlocks:
        """Return the blocks of W + weight I."""
        values = self.values.copy()
        values[self.rows == self.columns] += weight * np.eye(values.shape[1])
        return ContactBlocks(self.rows, self.columns, values)

    def jacobian(self, own: Array, B: Array, closed: Mask) -> Any:
        """Return A + B W of the closed contacts among all (m,), as an array where it is small, else by columns.

        Parameters
        ----------
        own, B : (q, d, d) arrays, A and B of the closed contacts
        closed : (m,) array of bool
        """
        d, q = self.values.shape[1], len(B)
        rows, columns, values = self.rows, self.columns, self.values
        if q < len(closed):
            kept = closed[rows] & closed[columns]
            number = np.cumsum(closed) - 1
            rows, columns, values = number[rows[kept]], number[columns[kept]], values[kept]
        values = np.matmul(B[rows], values)
        values[rows == columns] += own
        if q * d <= DENSE_SIZE:
            matrix = np.zeros((q, d, q, d))
            matrix[rows, :, columns, :] = values
            return matrix.reshape(q * d, q * d)
        count = np.bincount(columns, minlength=q)
        start = np.cumsum(count) - count
        # Entry (a, b) of a block: behind those of the columns before, then behind the blocks above it.
        first = d * (d * start[columns] + np.arange(len(rows)) - start[columns])
        entry = np.arange(d)
        place = first[:, None, None] + entry[:, None] + (d * count[columns])[:, None, None] * entry
        data, indices = np.empty(values.size), np.empty(values.size, dtype=np.int32)
        data[place], indices[place] = values, (d * rows)[:, None, None] + entry[:, None]
        ends = np.concatenate([[0], np.cumsum(np.repeat(d * count, d))]).astype(np.int32)
        return sp.csc_matrix((data, indices, ends), shape=(q * d, q * d))


class BlockSystem:
    """The factors of [[A, C], [V', R + e I]], with tiny e where R is zero.

    Raises LinAlgError: it is singular.

    Parameters
    ----------
    form : LocalForm, with the R of its joints
    A : (d q, d q) array, or sparse by columns
    V, coupling : (q, d, p) or (d q, p) arrays, V and C
    """

    def __init__(self, form: LocalForm, A: Any, V: Array, coupling: Array) -> None:
        self._size, self._sparse = A.shape[0], sp.issparse(A)
        V, coupling = V.reshape(self._size, form.joints), coupling.reshape(self._size, form.joints)
        R = form.R + JOINT_REGULARISATION * np.diag(form.joint_signs) if form.joints else form.R
        if self._sparse:
            from scipy.sparse.linalg import splu

            blocks = sp.bmat([[A, sp.csr_array(coupling)], [sp.csr_array(V.T), R]]) if form.joints else A
            try:
                self._factor: Any = splu(sp.csc_matrix(blocks))
            except RuntimeError as error:
                raise np.linalg.LinAlgError(str(error)) from error
        else:
            blocks = np.block([[A, coupling], [V.T, R]]) if form.joints else A
            # LAPACK does not accept matrices without rows.
            factor, pivots, info = lapack().dgetrf(blocks) if len(blocks) else (blocks, np.zeros(0, dtype=np.int32), 0)
            if info > 0:
                raise np.linalg.LinAlgError(f"pivot {info} is zero")
            self._factor = (factor, pivots)

    def solve(self, top: Vector, bottom: Vector) -> tuple[Vector, Vector]:
        """Return x (d m,) and l (p,)."""
        right = np.concatenate([top, bottom])
        if not len(right):
            solution = right
        elif self._sparse:
            solution = self._factor.solve(right)
        else:
            solution = lapack().dgetrs(*self._factor, right)[0]
        return solution[: self._size], solution[self._size :]


@dataclass(frozen=True, eq=False)
class Iterate:
    """The forces that an algorithm has reached, scaled as their `LocalForm`."""

    force: Array  # (m, d)
    joint_force: Vector  # (p,)
    error: float  # of the natural map, `LocalForm.error`
    iterations: int = 0
    history: tuple[float, ...] = ()

    @property
    def size(self) -> float:
        """Return the largest force, at least one, the size of velocities."""
        return max(1.0, float(np.max(abs(self.force), initial=0.0)))

    @classmethod
    def at(cls, form: LocalForm, force: Array, joint: Vector, iterations: int = 0) -> Iterate:
        """Return an iterate with its error.

        Parameters
        ----------
        form : LocalForm
        force : (m, d) array
            Scaled as the form.
        joint : (p,) array
            Forces of joints, scaled likewise.
        iterations : int
            How many led there.
        """
        return cls(force, joint, form.error(force, joint), iterations)

    @classmethod
    def nothing(cls, form: LocalForm) -> Iterate:
        """Return the iterate without contact forces, with the joint forces that belong to it."""
        none = np.zeros((form.m, form.d))
        at_rest = cls.at(form, none, np.zeros(form.joints))
        if not form.joints:
            return at_rest
        return min(at_rest, cls.at(form, none, form.joint_force(none)), key=lambda one: one.error)


class Deadline:
    """A limit in seconds, if any, counted from when it is made, and never later than the end of the call."""

    def __init__(self, limit: float | None) -> None:
        left = seconds_left()
        limit = left if limit is None or (left is not None and left < limit) else limit
        self._end = np.inf if limit is None else time.perf_counter() + limit
        self._limit = limit

    @property
    def remaining(self) -> float | None:
        """Return the seconds left, None without a limit."""
        return None if self._limit is None else max(self._end - time.perf_counter(), 0.0)

    @property
    def passed(self) -> bool:
        return time.perf_counter() > self._end

    def refuse_if_passed(self, who: str) -> None:
        if self.passed:
            raise NotConverged(f"{who}: stopped at the time limit of {stated_limit(self._limit)}")


# A combination is tried again from an iterate whose error has fallen to this part.
NEARER = 0.5
# The range of the factor, from a full step to one that is small enough for mu = 20 mu_c.
RELAXATION = (0.05, 1.0)


def aitken(
    relaxation: float, before: Vector | None, missing: Vector, dot: Callable[[Vector, Vector], float] = np.dot
) -> float:
    """Return the next relaxation factor of a fixed-point iteration b -> F(b) (Irons and Tuck 1969).

    Parameters
    ----------
    relaxation : the factor of this step
    before : array or None, F(b) - b of the step before; None at the first step, which keeps the factor
    missing : array, F(b) - b of this step
    dot : function of two arrays, their inner product
    """
    if before is None:
        return relaxation
    change = missing - before
    size = float(dot(change, change))
    wanted = relaxation if size == 0 else -relaxation * float(dot(before, change)) / size
    return float(np.clip(wanted, *RELAXATION))


@dataclass(frozen=True, eq=False)
class FoundOnBodies:
    """The answer of an algorithm that works on the bodies themselves, without their local form."""

    answer: Answer
    name: str  # of the algorithm, and of the convex method where it takes steps of one
    history: tuple[float, ...] = ()  # the algorithm's measure of progress, one number an iteration
    iterations: int | None = None  # iterations, if not the length of the history less one
