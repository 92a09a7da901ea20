"""How many answers a small frictional problem of the plane has at its load: all combinations of open, stick and slip.

Each combination is a linear system in the contact forces l and joints j (`contactqp.linalg.contact_compliance`), and an
answer where its signs hold. Answers are told apart by how the contacts move: normal rows, and tangential ones where
there is friction. Signs and motions are measured contact by contact, against the lengths that meet there: a contact
that is far, or has slipped far, hides no answer at another. Where a system leaves something free that moves contacts, a
linear program decides whether signs can hold; if they can, there is a family of answers. `contactqp.equilibria` refines
each of them; here they are counted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.critical_coefficients import DEPENDENT, OPEN, STICK, combinations, regular, system_matrices
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.contact_compliance import contact_compliance
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem

# 4^5 systems take some ten milliseconds.
MOST_COUNTED = 5
# Each system that leaves something free takes some linear programs.
MOST_LOOSE = 30
# Signs that fail by this part of the lengths that meet at their contact, or of its force, may be rounding.
DOUBTFUL = 1e-9
# Of the largest force, what rounding may leave of another.
ROUNDING = 1e-13
# Of the largest displacement that the loads make without contacts, what rounding may leave of another.
NOTHING = 1e-12
# Answers whose forces move every contact alike, to this part of what the forces make of it, are one.
SAME = 1e-6


def several_answers(problem: ContactProblem, condensation: Condensation) -> bool | None:
    """Whether more than one answer is found, or a family of them; None where too many systems leave something free."""
    system = _Systems(problem, condensation)
    status = combinations(system.mu)
    matrices, right = system.assembled(status)
    singular = ~regular(matrices)
    y = np.zeros_like(right)
    y[~singular] = np.linalg.solve(matrices[~singular], right[~singular][:, :, None])[:, :, 0]
    found = [y[b] for b in np.flatnonzero(~singular & system.holds(status, y))]
    loose = []
    for b in np.flatnonzero(singular):
        y[b], free = _least(matrices[b], right[b])
        sizes = abs(right[b]) + abs(matrices[b]) @ abs(y[b])
        rounding = system.nothing + ROUNDING * np.max(abs(y[b]), initial=0.0)
        if np.any(abs(matrices[b] @ y[b] - right[b]) > DOUBTFUL * sizes + rounding):
            continue
        if len(free):
            signs = _Signs(system, status[b], y[b], free)
            if signs.may_hold:
                loose.append(signs)
        elif system.holds(status[b : b + 1], y[b : b + 1])[0]:
            found.append(y[b])
    if len(loose) > MOST_LOOSE:
        return None
    for signs in loose:
        found += signs.extremes()
    return any(system.differ(one, found[0]) for one in found[1:])


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
        self._given = (abs(limits).ravel() + abs(free)).reshape(-1, 2)
        self.nothing = NOTHING * max(float(np.max(abs(part), initial=0.0)) for part in (free, self._held))
        self._compliance = np.diagonal(self._W).reshape(-1, 2)
        self._slope = -np.hstack([self._W, self._V])
        self._rubs = np.repeat(self.mu > 0, 2)
        self._rubs[::2] = True
        self._felt = self._slope[self._rubs]

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
        m = len(self.mu)
        force = y[:, : 2 * m].reshape(len(y), m, 2)
        room = self._room - (y @ self._slope.T).reshape(force.shape)
        gap, slip = room[:, :, 0], -room[:, :, 1]
        length, pushed = self._allowed(y)
        opened, stuck = status == OPEN, status == STICK
        right = np.where(opened, gap >= -length[:, :, 0], force[:, :, 0] >= -pushed[:, :, 0])
        bound = self.mu * (force[:, :, 0] + pushed[:, :, 0]) + pushed[:, :, 1]
        right &= np.where(stuck, abs(force[:, :, 1]) <= bound, True)
        right &= np.where(opened | stuck | (self.mu == 0), True, status * slip >= -length[:, :, 1])
        return np.asarray(np.all(right, axis=1))

    def _allowed(self, y: Array) -> tuple[Array, Array]:
        """(c, m, 2) by how much lengths and forces of solutions (c, q) may fail their signs by rounding."""
        meeting = self._given + self.nothing / DOUBTFUL + (abs(y) @ abs(self._slope).T).reshape(len(y), -1, 2)
        largest = np.max(abs(y), axis=1, initial=0.0)[:, None, None]
        compliance = np.broadcast_to(self._compliance, meeting.shape)
        felt = compliance > DEPENDENT * np.max(compliance, initial=0.0)
        asked = np.divide(meeting, compliance, out=np.broadcast_to(largest, meeting.shape).copy(), where=felt)
        return DOUBTFUL * meeting, DOUBTFUL * asked + ROUNDING * largest

    def sizes(self, status: NDArray[np.int8], y: Vector) -> Vector:
        """Of every row of `signs`, what it may fail by in a solution (q,)."""
        length, pushed = (part[0] for part in self._allowed(y[None]))
        opened, closed, stuck = (np.flatnonzero(mask) for mask in (status == OPEN, status != OPEN, status == STICK))
        sliding = np.flatnonzero((abs(status) == 1) & (self.mu > 0))
        rubbed = self.mu[stuck] * pushed[stuck, 0] + pushed[stuck, 1]
        return np.concatenate([length[opened, 0], pushed[closed, 0], rubbed, rubbed, length[sliding, 1]])

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

    def differ(self, one: Vector, other: Vector) -> bool:
        """Whether forces and joints of two answers move any contact differently."""
        sizes = abs(self._felt) @ np.maximum(abs(one), abs(other))
        doubtful = 10 * (DOUBTFUL * self._given.ravel()[self._rubs] + self.nothing)
        return bool(np.any(abs(self._felt @ (one - other)) > SAME * sizes + doubtful))

    def moving(self, free: Array) -> Array:
        """What free directions (k, q) make of the contacts: rows (r, k) that they move at all."""
        change = self._felt @ free.T
        return np.asarray(change[np.any(abs(change) > np.sqrt(DEPENDENT), axis=1)])


class _Signs:
    """The signs of one combination along the solutions start + free'c of a system that leaves something free."""

    def __init__(self, system: _Systems, status: NDArray[np.int8], start: Vector, free: Array) -> None:
        self._start, self._free, self._moving = start, free, system.moving(free)
        room, change = system.signs(status)
        self._left, self._slope, self._allowed = room + change @ start, change @ free.T, system.sizes(status, start)
        self._idle = np.all(abs(self._slope) <= np.sqrt(DEPENDENT), axis=1)

    @property
    def may_hold(self) -> bool:
        """Whether all signs that no c changes hold."""
        return bool(np.all(self._left[self._idle] >= -self._allowed[self._idle]))

    def extremes(self) -> list[Vector]:
        """Those solutions whose signs hold that move the contacts furthest apart; none where no signs hold."""
        from scipy.optimize import linprog

        size = self._allowed / DOUBTFUL
        known = size[~self._idle & (size > 0)]
        step = float(np.median(known)) if len(known) else 1.0
        size = np.where(size > 0, size, step)
        moving = self._moving
        wanted = np.vstack([moving, -moving]) if len(moving) else np.zeros((1, len(self._free)))
        found = []
        for row in wanted:
            answer = linprog(
                -row,
                A_ub=-self._slope * (step / size)[:, None],
                b_ub=self._left / size + DOUBTFUL,
                bounds=[(-1e3, 1e3)] * len(self._free),  # beyond a thousand times its size a family is a family
                method="highs",
            )
            if answer.x is None:
                return []
            found.append(self._start + step * self._free.T @ answer.x)
        return found
