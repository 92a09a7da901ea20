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
from contactqp.critical_friction import OPEN, STICK, combinations, system_matrices
from contactqp.factorization import Array
from contactqp.problem import ContactProblem, Vector

# 4^4 systems take a few milliseconds.
MOST_COUNTED = 4
# Singular values of this part of the largest are zero.
DEPENDENT = 1e-11
# Signs that fail by this part of the largest length or force, both in sqrt(energy), may be rounding.
DOUBTFUL = 1e-9
# Answers that differ by less than this part of their size are one.
SAME = 1e-6


def several_answers(problem: ContactProblem, condensation: Condensation) -> bool:
    """Whether more than one answer is found, or a family of them."""
    system = _Systems(problem, condensation)
    status = combinations(system.mu)
    matrices, right = system.assembled(status)
    left, values, rotation = np.linalg.svd(matrices)
    kept = values > DEPENDENT * values[:, :1]
    inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    y = np.einsum("bji,bj->bi", rotation, inverse * np.einsum("bji,bj->bi", left, right))
    missing = np.max(abs(np.einsum("bij,bj->bi", matrices, y) - right), axis=1, initial=0.0)
    found: list[Vector] = []
    for b in np.flatnonzero(missing <= DOUBTFUL * system.size):
        free = rotation[b][~kept[b]]
        room, change = system.signs(status[b])
        holds = bool(np.all(room + change @ y[b] >= -DOUBTFUL * system.size))
        if len(free) and not holds:
            y[b], holds = _within(room, change, y[b], free, system.size)
        if not holds:
            continue
        if len(free) and system.moves(free):
            return True
        moved = system.moved(y[b])
        if any(np.max(abs(moved - other), initial=0.0) > SAME * system.size for other in found):
            return True
        found.append(moved)
    return False


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

    def moves(self, free: Array) -> bool:
        """Whether a free direction moves any contact."""
        return bool(np.max(abs(self._felt @ free.T), initial=0.0) > np.sqrt(DEPENDENT))


def _within(room: Vector, change: Array, start: Vector, free: Array, size: float) -> tuple[Vector, bool]:
    """Of the solutions start + free'c, one whose signs hold best, and whether they do."""
    from scipy.optimize import linprog

    count = len(free)
    answer = linprog(
        np.append(np.zeros(count), -1.0),
        A_ub=np.column_stack([-change @ free.T, np.ones(len(room))]),
        b_ub=(room + change @ start) / size,
        bounds=[(None, None)] * count + [(None, 1.0)],
        method="highs",
    )
    if answer.x is None:
        return start, False
    y = np.asarray(start + size * free.T @ answer.x[:-1])
    return y, bool(np.all(room + change @ y >= -DOUBTFUL * size))
