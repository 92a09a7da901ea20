"""Solve the linear systems of combinations of open, stick and slip in the forces, with one factorisation for many.

With R = [N; T; A] the scaled rows of contacts, tangents and ties, l = (l_N, l_T, nu) their forces and a the coordinates
of rigid motions Z of the bodies,

    R x = R S^+ f - W l + R Z a,   W = R S^+ R',   Z'R'l = Z'f,

so that a combination is one row a contact force (N x = g where closed, l_N = 0 where open), one a friction force
(T x = o where it sticks, l_T = s mu l_N where it slips, l_T = 0 where open), and the rows of ties and balance. A
contact that changes its state changes two rows, which the factors of an earlier combination are corrected for (Sherman,
Morrison and Woodbury).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.friction_states import SINGULAR_STATES
from contactqp.model.arrays import Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# The part of the rows up to which an update is cheaper than a new factorisation.
CHANGED_ROWS = 0.15
# The largest residual of an update, relative to the largest number in the system.
LEFT = 1e-13
# Components of unit null vectors below this, as displacements of contacts or as forces, count as zero.
UNDETERMINED = 1e-8


@dataclass(frozen=True, eq=False)
class Lengths:
    """The right-hand sides of the system under one load and one history [square root of energy]."""

    free: Vector  # (2m + k,) R S^+ f
    target: Vector  # (2m + k,) g, o, b
    drive: Vector  # (q,) Z'f
    load: Vector  # (p,) f
    size: float  # the largest of them

    def felt(self, status: Status) -> float:
        """Return the largest of the data, without gaps and slip origins of open contacts, which may be large."""
        felt, m = np.ones(len(self.target), dtype=bool), len(status)
        felt[:m] = felt[m : 2 * m] = status != OPEN
        parts = (self.free, self.target[felt], self.drive)
        return max(float(np.max(abs(part), initial=0.0)) for part in parts) or self.size


@dataclass(frozen=True, eq=False)
class CombinationAnswer:
    """The scaled solution of the system of one combination, whose signs need not hold."""

    status: Status  # (m,)
    normal: Vector  # (m,) l_N
    friction: Vector  # (m,) l_T
    tie: Vector  # (k,) nu
    motion: Vector  # (q,) a
    gap: Vector  # (m,) g - N x
    slip: Vector  # (m,) T x - o
    residual: float  # the largest residual of the system, large where it has no solution

    def worst(self, coefficient: Vector) -> Vector:
        """Return by how much the signs of each contact fail (m,), negative where they hold."""
        stuck = np.abs(self.friction) - coefficient * self.normal
        tangential = np.where(self.status == STICK, stuck, np.where(coefficient > 0, -self.status * self.slip, -np.inf))
        return np.where(self.status == OPEN, -self.gap, np.maximum(-self.normal, tangential))


class ForceSystem:
    """The systems of one frictional problem of the plane; load, gap, slip origin and tie values may change.

    Attributes
    ----------
    rows : FrictionalRows
    coefficient : (m,) array, mu in scaled forces, 0 where a contact cannot slide at all
    slope : (2m + k, 2m + k + q) array, R x = R S^+ f + slope (l, a)
    """

    def __init__(self, problem: ContactProblem, condensation: Condensation) -> None:
        self.rows = rows = condensed_frictional_rows(problem, condensation)
        self.contacts, R = problem.contacts, rows.all_rows
        self.coefficient = np.where(rows.slides, rows.coefficient, 0.0)
        self._from_load = R @ rows.compliance
        self.slope = np.hstack([-self._from_load @ R.T, R @ rows.motions])
        motions = rows.motions.shape[1]
        self._balance = np.hstack([(R @ rows.motions).T, np.zeros((motions, motions))])
        self._factor: _Factor | None = None
        self.factorisations = 0
        # Force per unit of displacement at a single contact.
        compliance = -np.diagonal(self.slope)[: 2 * self.contacts]
        self.resistance = 1.0 / np.where(compliance > SINGULAR_STATES, compliance, 1.0)

    def lengths(self, problem: ContactProblem, reduced_load: Vector) -> Lengths:
        """Return the right-hand sides of a problem's condensed load, gaps, slip origins and tie values."""
        load = reduced_load * self.rows.scale
        target = np.concatenate(self.rows.lengths(problem))
        free, drive = self._from_load @ load, self.rows.motions.T @ load
        size = max(float(np.max(abs(part), initial=0.0)) for part in (free, target, drive))
        return Lengths(free, target, drive, load, size or 1.0)

    def plain(self, status: Status) -> Status:
        """Return the combination with SLIP_ON at all closed contacts without friction, for which both slips are
        equal.
        """
        return np.where((self.coefficient <= 0) & (status != OPEN), SLIP_ON, status).astype(np.int8)

    def solve(self, status: Status, lengths: Lengths) -> CombinationAnswer:
        """Return the answer of a combination, the minimum-norm least-squares solution where it is singular."""
        if self._factor is None or not self._factor.near(status):
            self._factorise(status)
        y, left = self._solved(status, lengths)
        if not left <= LEFT * max(lengths.size, float(np.max(abs(y), initial=0.0))):
            self._factorise(status)
            y, left = self._solved(status, lengths)
        return self._answer(status, lengths, y, left)

    def redundant(self, status: Status) -> bool:
        """Return whether the combination just solved does not determine all forces, as with dependent rows."""
        if self._factor is None or not self._factor.singular:
            return False
        _, values, rotation = np.linalg.svd(self.matrix(status))
        free = rotation[values <= SINGULAR_STATES * values[0], : len(self.slope)]
        return bool(np.any(abs(free) > UNDETERMINED))

    def undetermined(self, status: Status) -> bool:
        """Return whether a combination does not determine the displacements of its closed contacts and ties.

        Undetermined forces of redundant contacts, and rigid motions that displace none of these, do not count.
        """
        matrix = self.matrix(status)
        if not len(matrix):
            return False
        _, values, rotation = np.linalg.svd(matrix)
        free = rotation[values <= SINGULAR_STATES * values[0]].T
        ties = np.ones(len(self.slope) - 2 * self.contacts, dtype=bool)
        # A displacement of none of them does no work and deforms no body.
        moved = self.slope[np.concatenate([self._held(status != OPEN), ties])] @ free
        return bool(np.any(abs(moved) > UNDETERMINED))

    def same(self, one: CombinationAnswer, other: CombinationAnswer, loaded: Mask, tolerance: float) -> bool:
        """Return whether two answers differ only by a rigid motion that displaces no contact under load or force.

        Parameters
        ----------
        one, other : CombinationAnswer
            A contact pushes that does so in one of them.
        loaded : (m,) mask
            The contacts that may not move.
        tolerance : float
            Up to which lengths and forces count as zero, in scaled units.
        """
        moved = np.concatenate([other.gap - one.gap, one.slip - other.slip])
        rigid = self.slope[: len(moved), len(self.slope) :] @ (one.motion - other.motion)
        held = moved[self._held(loaded | (one.normal > tolerance) | (other.normal > tolerance))]
        return bool(np.all(abs(moved - rigid) <= tolerance) and np.all(abs(held) <= tolerance))

    def _held(self, contacts: Mask) -> Mask:
        """Return a mask (2m,) of the rows that these contacts constrain, without friction only the normal one."""
        return np.concatenate([contacts, contacts & (self.coefficient > 0)])

    def displacement(self, answer: CombinationAnswer, lengths: Lengths) -> Vector:
        """Return the scaled displacement x (p,)."""
        rows = self.rows
        forces = np.concatenate([answer.normal, answer.friction, answer.tie])
        pushed = lengths.load - rows.all_rows.T @ forces
        return np.asarray(rows.compliance @ pushed + rows.motions @ answer.motion)

    def unscaled(self, answer: CombinationAnswer, expanded: Vector) -> Answer:
        """Return the answer in the problem's own forces, with the displacement (n,) expanded from `displacement`."""
        rows = self.rows
        friction = (answer.friction / rows.tangent_length)[:, None]
        return Answer(expanded, answer.normal / rows.normal_length, friction, answer.tie / rows.tie_length)

    def row(self, i: int, status: Status) -> Vector:
        """Return row i of the matrix of a combination."""
        m, row = self.contacts, np.zeros(self.slope.shape[1])
        if i < m and status[i] == OPEN:
            row[i] = 1.0
        elif i < m or status[i - m] == STICK:
            row = self.slope[i]
        else:
            row[i], row[i - m] = 1.0, -status[i - m] * self.coefficient[i - m]
        return row

    def matrix(self, status: Status) -> Array:
        """Return the square matrix of a combination, of 2m + k + q rows."""
        m = self.contacts
        matrix = np.vstack([self.slope, self._balance])
        free, loose = np.flatnonzero(status == OPEN), np.flatnonzero(status != STICK)
        matrix[free], matrix[m + loose] = 0.0, 0.0
        matrix[free, free], matrix[m + loose, m + loose] = 1.0, 1.0
        matrix[m + loose, loose] = -status[loose] * self.coefficient[loose]
        return matrix

    def _factorise(self, status: Status) -> None:
        self.factorisations += 1
        self._factor = _Factor(self, status)

    def _solved(self, status: Status, lengths: Lengths) -> tuple[Vector, float]:
        """Return y and the largest residual, after one refinement where that is too large."""
        assert self._factor is not None
        right = self._right(status, lengths)
        y = self._factor.solve(status, right)
        left = right - self._times(status, y)
        largest = float(np.max(abs(left), initial=0.0))
        if largest > 0.1 * LEFT * max(lengths.size, float(np.max(abs(y), initial=0.0))):
            y = y + self._factor.solve(status, left)
            largest = float(np.max(abs(right - self._times(status, y)), initial=0.0))
        return y, largest

    def _right(self, status: Status, lengths: Lengths) -> Vector:
        m, wanted = self.contacts, lengths.target - lengths.free
        wanted[:m] = np.where(status == OPEN, 0.0, wanted[:m])
        wanted[m : 2 * m] = np.where(status == STICK, wanted[m : 2 * m], 0.0)
        return np.concatenate([wanted, lengths.drive])

    def _times(self, status: Status, y: Vector) -> Vector:
        m, product = self.contacts, self.slope @ y
        normal, friction = y[:m], y[m : 2 * m]
        product[:m] = np.where(status == OPEN, normal, product[:m])
        sliding = friction - np.where(status == STICK, 0, status) * self.coefficient * normal
        product[m : 2 * m] = np.where(status == STICK, product[m : 2 * m], sliding)
        return np.concatenate([product, self._balance @ y])

    def _answer(self, status: Status, lengths: Lengths, y: Vector, left: float) -> CombinationAnswer:
        m, moved = self.contacts, lengths.free + self.slope @ y
        off = moved - lengths.target
        closed, k = status != OPEN, len(moved) - 2 * m
        normal = np.where(closed, y[:m], 0.0)
        bound = self.coefficient * normal
        friction = np.where(status == STICK, y[m : 2 * m], status * bound)
        gap, slip = np.where(closed, 0.0, -off[:m]), np.where(status == STICK, 0.0, off[m : 2 * m])
        return CombinationAnswer(status, normal, friction, y[2 * m : 2 * m + k], y[2 * m + k :], gap, slip, left)


class _Factor:
    """The LU factors of one combination, used with updates for combinations near it."""

    def __init__(self, system: ForceSystem, status: Status) -> None:
        from scipy.linalg.lapack import dgecon, dgetrf

        self._system, self._status = system, status.copy()
        matrix = system.matrix(status)
        self._lu, self._pivots, info = dgetrf(matrix)
        condition = dgecon(self._lu, np.linalg.norm(matrix, 1))[0] if info == 0 and len(matrix) else float(info == 0)
        self._inverse = np.linalg.pinv(matrix, rcond=SINGULAR_STATES) if condition < SINGULAR_STATES else None
        self._columns: dict[int, Vector] = {}

    @property
    def singular(self) -> bool:
        """Return whether a pseudo-inverse takes the place of the factors."""
        return self._inverse is not None

    def near(self, status: Status) -> bool:
        """Return whether few enough rows have changed."""
        if self._inverse is not None:
            return not len(self._changed(status))
        return len(self._changed(status)) <= CHANGED_ROWS * len(self._lu)

    def solve(self, status: Status, right: Vector) -> Vector:
        """Return the solution y of another combination by an update of the factors."""
        y = self._back(right)
        changed = self._changed(status)
        if not len(changed):
            return y
        columns = np.array([self._column(int(i)) for i in changed]).T
        change = np.array([self._system.row(i, status) - self._system.row(i, self._status) for i in changed.tolist()])
        small = np.eye(len(changed)) + change @ columns
        try:
            return np.asarray(y - columns @ np.linalg.solve(small, change @ y))
        except np.linalg.LinAlgError:
            return np.full_like(y, np.nan)

    def _changed(self, status: Status) -> Indices:
        closes = (status == OPEN) != (self._status == OPEN)
        return np.concatenate([np.flatnonzero(closes), np.flatnonzero(status != self._status) + len(status)])

    def _column(self, i: int) -> Vector:
        if i not in self._columns:
            unit = np.zeros(len(self._lu))
            unit[i] = 1.0
            self._columns[i] = self._back(unit)
        return self._columns[i]

    def _back(self, right: Vector) -> Vector:
        from scipy.linalg.lapack import dgetrs

        if self._inverse is not None or not len(right):
            return right if self._inverse is None else np.asarray(self._inverse @ right)
        return np.asarray(dgetrs(self._lu, self._pivots, right)[0])
