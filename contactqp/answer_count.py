"""How many answers a small frictional problem of the plane has at its load: all combinations of open, stick and slip.

Each combination is a linear system in the contact forces l and joints j (`contactqp.contact_compliance`), and an
answer where its signs hold. Answers are told apart by how the contacts move: normal rows, and tangential ones where
there is friction. Where a system leaves something free that moves contacts, a linear program decides whether signs can
hold; if they can, there is a family of answers. `contactqp.equilibria` refines each of them; here they are counted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.condensation import Condensation
from contactqp.contact_compliance import contact_compliance
from contactqp.critical_coefficients import DEPENDENT, OPEN, STICK, combinations, regular, system_matrices
from contactqp.factorization import Array
from contactqp.problem import ContactProblem, Vector

# 4^5 systems take some ten milliseconds.
MOST_COUNTED = 5
# Each system that leaves something free takes some linear programs.
MOST_LOOSE = 30
# Signs that fail by this part of the largest length or force, both in sqrt(energy), may be rounding.
DOUBTFUL = 1e-9
# Answers that differ by less than this part of their size are one.
SAME = 1e-6


def several_answers(problem: ContactProblem, condensation: Condensation) -> bool | None:
    """Whether more than one answer is found, or a family of them; None where too many systems leave something free."""
    system = _Systems(problem, condensation)
    status = combinations(system.mu)
    matrices, right = system.assembled(status)
    singular = ~regular(matrices)
    y = np.zeros_like(right)
    y[~singular] = np.linalg.solve(matrices[~singular], right[~singular][:, :, None])[:, :, 0]
    found = [system.moved(y[b]) for b in np.flatnonzero(~singular & system.holds(status, y))]
    loose = []
    for b in np.flatnonzero(singular):
        y[b], free = _least(matrices[b], right[b])
        if np.max(abs(matrices[b] @ y[b] - right[b]), initial=0.0) > DOUBTFUL * system.size:
            continue
        if len(free):
            loose.append((b, y[b], free))
        elif system.holds(status[b : b + 1], y[b : b + 1])[0]:
            found.append(system.moved(y[b]))
    if len(loose) > MOST_LOOSE:
        return None
    for b, start, free in loose:
        found += _extremes(*system.signs(status[b]), start, free, system)
    return any(np.max(abs(one - found[0]), initial=0.0) > SAME * system.size for one in found[1:])


def _least(matrix: Array, right: Vector) -> tuple[Vector, Array]:
    """The least solution that fits best, and the directions (k, q) that change nothing."""
    left, values, rotation = np.linalg.svd(matrix)
    kept = values > DEPENDENT * values[0]
    return rotation[kept].T @ ((left.T @ right)[kept] / values[kept]), rotation[~kept]


class _Systems:
    """The linear systems of all combinations in y = (l, j)."""

    def __init__(self, problem: ContactProblem, condensation: Condensation) -> None:
        compliance = contact_compliance(problem, condensation)
        if problem.friction is None or problem.slip_origin is None:
            raise ValueError("answers are counted with friction only")
        self.mu = problem.friction
        self._W, self._V, self._J = compliance.W, compliance.V, compliance.J
        free, self._held = compliance.free(problem, condensation)
        limits = np.stack([problem.gap, problem.slip_origin[:, 0]], axis=1) / compliance.scale[:, None]
        self._room = (limits.ravel() - free).reshape(-1, 2)  # of gap and slip without forces
        self.size = float(max(np.max(abs(part), initial=0.0) for part in (free, limits, self._held))) or 1.0
        self._slope = -np.hstack([self._W, self._V])
        rubs = np.repeat(self.mu > 0, 2)
        rubs[::2] = True
        self._felt = self._slope[rubs]

    def assembled(self, status: NDArray[np.int8]) -> tuple[Array, Array]:
        """(c, q, q) and (c, q)."""
        m, joints = len(self.mu), len(self._J)
        matrices = np.zeros((len(status), 2 * m + joints, 2 * m + joints))
        right = np.zeros(matrices.shape[:2])
        matrices[:, : 2 * m, : 2 * m] = system_matrices(self._W, self.mu, status)
        closed = np.stack([status != OPEN, status == STICK], axis=2).reshape(len(status), 2 * m)
        matrices[:, : 2 * m, 2 * m :] = np.where(closed[:, :, None], self._V, 0.0)
        right[:, : 2 * m] = np.where(closed, -self._room.ravel(), 0.0)
        matrices[:, 2 * m :, : 2 * m], matrices[:, 2 * m :, 2 * m :] = self._V.T, self._J
        right[:, 2 * m :] = self._held
        return matrices, right

    def holds(self, status: NDArray[np.int8], y: Array) -> NDArray[np.bool_]:
        """Which solutions (c, q) have the signs of their combination (c, m)."""
        m, allowed = len(self.mu), DOUBTFUL * self.size
        force = y[:, : 2 * m].reshape(len(y), m, 2)
        room = self._room - (y @ self._slope.T).reshape(force.shape)
        gap, slip = room[:, :, 0], -room[:, :, 1]
        opened, stuck = status == OPEN, status == STICK
        right = np.where(opened, gap >= -allowed, force[:, :, 0] >= -allowed)
        right &= np.where(stuck, abs(force[:, :, 1]) <= self.mu * force[:, :, 0] + allowed, True)
        right &= np.where(opened | stuck | (self.mu == 0), True, status * slip >= -allowed)
        return np.asarray(np.all(right, axis=1))

    def signs(self, status: NDArray[np.int8]) -> tuple[Vector, Array]:
        """Room and its slope in y: the signs hold where room + slope y >= 0."""
        m, unit = len(self.mu), np.eye(self._slope.shape[1])
        opened, closed, stuck = (np.flatnonzero(mask) for mask in (status == OPEN, status != OPEN, status == STICK))
        sliding = np.flatnonzero((abs(status) == 1) & (self.mu > 0))
        sign, bound = status[sliding].astype(float), self.mu[stuck, None] * unit[2 * stuck]
        none = np.zeros(len(closed) + 2 * len(stuck))
        room = np.concatenate([self._room[opened, 0], none, -sign * self._room[sliding, 1]])
        friction, slip = unit[2 * stuck + 1], sign[:, None] * self._slope[2 * sliding + 1]
        rows = [-self._slope[2 * opened], unit[2 * closed], bound - friction, bound + friction, slip]
        return room, np.vstack(rows) if m else np.zeros((0, len(unit)))

    def moved(self, y: Vector) -> Vector:
        """How the contacts move by forces and joints."""
        return np.asarray(self._felt @ y)

    def moving(self, free: Array) -> Array:
        """What free directions (k, q) make of the contacts: rows (r, k) that they move at all."""
        change = self._felt @ free.T
        return np.asarray(change[np.any(abs(change) > np.sqrt(DEPENDENT), axis=1)])


def _extremes(room: Vector, change: Array, start: Vector, free: Array, system: _Systems) -> list[Vector]:
    """How the contacts move in those solutions start + free'c whose signs hold that lie furthest apart."""
    from scipy.optimize import linprog

    size, allowed = system.size, DOUBTFUL * system.size
    left, slope = room + change @ start, change @ free.T
    idle = np.all(abs(slope) <= np.sqrt(DEPENDENT), axis=1)
    if np.any(left[idle] < -allowed):
        return []
    moving = system.moving(free)
    wanted = np.vstack([moving, -moving]) if len(moving) else np.zeros((1, len(free)))
    found = []
    for row in wanted:
        # Beyond a thousand times the size of the data a family is a family.
        bounds = [(-1e3, 1e3)] * len(free)
        answer = linprog(-row, A_ub=-slope, b_ub=left / size + DOUBTFUL, bounds=bounds, method="highs")
        if answer.x is None:
            return []
        found.append(system.moved(start + size * free.T @ answer.x))
    return found
