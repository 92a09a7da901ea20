"""Every equilibrium of a small problem with Coulomb friction: all combinations of open, stick, slip either way.

Each combination is a linear system in the scaled forces l and the coordinates a of rigid motions Z of the bodies,

    R x = R S^+ f - W l + R Z a,   W = R S^+ R',   Z'R'l = Z'f,
    open: l_N = l_T = 0    closed: N x = g    stick: T x = o    slip: l_T = s mu l_N    tie: A x = b,

and is an equilibrium where its signs hold: g - N x >= 0 where open, l_N >= 0 where closed, |l_T| <= mu l_N where it
sticks, s (T x - o) >= 0 where it slips. Above a critical coefficient of friction there may be none or several
(Klarbring 1990). Where a system leaves forces or motions free, a linear program looks for signs that hold.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.condensation import Condensation
from contactqp.errors import Unsupported
from contactqp.factorization import Array
from contactqp.friction.rows import FrictionalRows
from contactqp.friction.states import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, answer_in, holds
from contactqp.problem import ContactProblem, Vector
from contactqp.violations import Answer

# 4^8 systems take seconds.
MOST_CONTACTS = 8
# Systems solved at once.
BATCH = 4096
# Singular values of this part of the largest, rows being of unit length, are zero.
DEPENDENT = 1e-11
# Signs that fail by this part of the largest length or force, both in sqrt(energy), may be rounding; refinement tells.
DOUBTFUL = 1e-8
# Displacements that differ by this part of their size are one.
SAME = 1e-8


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One equilibrium, and the combination that it was found in."""

    status: Status  # (m,) of OPEN, STICK, SLIP_BACK, SLIP_ON
    answer: Answer


def all_equilibria(problem: ContactProblem, condensation: Condensation) -> tuple[Equilibrium, ...]:
    """Every equilibrium that differs from the others in its displacement; none is an empty tuple.

    Where contacts are redundant, many forces belong to one displacement: one of them is given.

    Raises
    ------
    Unsupported
        There are more than eight contacts.
    """
    if problem.contacts > MOST_CONTACTS:
        raise Unsupported(
            f"enumeration: {problem.contacts} contacts; at most {MOST_CONTACTS} have few combinations enough"
        )
    rows = FrictionalRows(problem, condensation)
    systems = _Systems(problem, condensation, rows)
    found: list[Equilibrium] = []
    for status, start in systems.plausible():
        answer = answer_in(problem, condensation, rows, status, start)
        if holds(problem, answer) and not any(_same(problem, answer, other.answer) for other in found):
            found.append(Equilibrium(status, answer))
    return tuple(found)


def _same(problem: ContactProblem, one: Answer, other: Answer) -> bool:
    """Whether two displacements are one, in the energy scale of the unknowns."""
    weight = np.sqrt(np.where(problem.diagonal > 0, problem.diagonal, np.max(problem.diagonal) or 1.0))
    difference = np.max(weight * abs(one.displacement - other.displacement))
    size = max(np.max(weight * abs(one.displacement)), np.max(weight * abs(other.displacement)))
    return bool(difference <= SAME * size)


class _Systems:
    """The linear systems of all combinations in y = (l_N, l_T, nu, a)."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, rows: FrictionalRows) -> None:
        self._problem, self._way, self._rows = problem, condensation, rows
        load, self._inner = condensation.reduce_load(problem.load)
        self._load = load * rows.scale
        self.m, R = problem.contacts, rows.all_rows
        self._gap, self._origin, value = rows.lengths(problem)
        self._free = rows.compliance @ self._load
        # R x = base + slope y.
        self._base = R @ self._free
        self._slope = np.hstack([-R @ rows.compliance @ R.T, R @ rows.motions])
        self._target = np.concatenate([self._gap, self._origin, value])
        balance = np.hstack([(R @ rows.motions).T, np.zeros((rows.motions.shape[1],) * 2)])
        tied = slice(2 * self.m, None)
        self._fixed = np.vstack([self._slope[tied], balance])
        self._fixed_right = np.concatenate([(self._target - self._base)[tied], rows.motions.T @ self._load])
        parts = (self._base, self._target, rows.motions.T @ self._load)
        self._size = float(max(np.max(abs(part), initial=0.0) for part in parts)) or 1.0

    def plausible(self) -> Iterator[tuple[Status, Answer]]:
        """Combinations whose signs hold, or miss by what may be rounding."""
        # Without friction at a contact, slipping one way says all there is to say of a closed one.
        choices = [(OPEN, STICK, SLIP_BACK, SLIP_ON) if mu > 0 else (OPEN, SLIP_ON) for mu in self._rows.coefficient]
        combinations = itertools.product(*choices)
        while batch := list(itertools.islice(combinations, BATCH)):
            yield from self._of_batch(np.array(batch, dtype=np.int8).reshape(len(batch), self.m))

    def _of_batch(self, status: Status) -> Iterator[tuple[Status, Answer]]:
        matrix, right = self._assembled(status)
        left, values, rotation = np.linalg.svd(matrix)
        kept = values > DEPENDENT * values[:, :1]
        inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
        y = np.einsum("bji,bj->bi", rotation, inverse * np.einsum("bji,bj->bi", left, right))
        missing = np.max(abs(np.einsum("bij,bj->bi", matrix, y) - right), axis=1)
        for b in np.flatnonzero(missing <= DOUBTFUL * self._size):
            room, change = self._signs(status[b])
            solution = y[b]
            if np.any(room + change @ solution < -DOUBTFUL * self._size) and not np.all(kept[b]):
                solution = self._within(room, change, solution, rotation[b][~kept[b]])
            if np.all(room + change @ solution >= -DOUBTFUL * self._size):
                yield status[b], self._answer(solution)

    def _assembled(self, status: Status) -> tuple[Array, Array]:
        """(b, q, q) and (b, q): one row a contact force, one a friction force, then ties and balance."""
        count, m, q = len(status), self.m, self._slope.shape[1]
        unit = np.eye(q)
        closed, stuck = status != OPEN, status == STICK
        sliding = np.where(stuck, 0, status) * self._rows.coefficient
        matrix, right = np.empty((count, q, q)), np.zeros((count, q))
        matrix[:, :m] = np.where(closed[:, :, None], self._slope[:m], unit[:m])
        matrix[:, m : 2 * m] = np.where(
            stuck[:, :, None], self._slope[m : 2 * m], unit[m : 2 * m] - sliding[:, :, None] * unit[:m]
        )
        matrix[:, 2 * m :], right[:, 2 * m :] = self._fixed, self._fixed_right
        lengths = self._target - self._base
        right[:, :m] = np.where(closed, lengths[:m], 0.0)
        right[:, m : 2 * m] = np.where(stuck, lengths[m : 2 * m], 0.0)
        return matrix, right

    def _signs(self, status: Status) -> tuple[Vector, Array]:
        """Room and its slope in y: the signs hold where room + slope y >= 0."""
        m, unit = self.m, np.eye(self._slope.shape[1])
        gap_room, slip = self._target[:m] - self._base[:m], self._base[m : 2 * m] - self._target[m : 2 * m]
        opened, closed, stuck = (np.flatnonzero(mask) for mask in (status == OPEN, status != OPEN, status == STICK))
        sliding = np.flatnonzero((abs(status) == 1) & (self._rows.coefficient > 0))
        bound = self._rows.coefficient[stuck, None] * unit[stuck]
        sign = status[sliding].astype(float)
        room = [gap_room[opened], np.zeros(len(closed)), np.zeros(2 * len(stuck)), sign * slip[sliding]]
        slope = [-self._slope[opened], unit[closed], bound - unit[m + stuck], bound + unit[m + stuck]]
        return np.concatenate(room), np.vstack([*slope, sign[:, None] * self._slope[m + sliding]])

    def _within(self, room: Vector, change: Array, start: Vector, free: Array) -> Vector:
        """Of the solutions start + free'c, one whose signs hold best, no room counting beyond the size of the data."""
        from scipy.optimize import linprog

        count = len(free)
        answer = linprog(
            np.append(np.zeros(count), -1.0),
            A_ub=np.column_stack([-change @ free.T, np.ones(len(room))]),
            b_ub=(room + change @ start) / self._size,
            bounds=[(None, None)] * count + [(None, 1.0)],
            method="highs",
        )
        return start if answer.x is None else np.asarray(start + self._size * free.T @ answer.x[:-1])

    def _answer(self, y: Vector) -> Answer:
        rows, m = self._rows, self.m
        forces, motion = y[: len(self._base)], y[len(self._base) :]
        x = self._free - rows.compliance @ rows.all_rows.T @ forces + rows.motions @ motion
        lengths: tuple[NDArray[np.float64], ...] = (rows.normal_length, rows.tangent_length, rows.tie_length)
        normal, friction, tie = (
            force / length for force, length in zip(np.split(forces, [m, 2 * m]), lengths, strict=True)
        )
        return Answer(self._way.expand(x * rows.scale, self._inner), normal, friction[:, None], tie)
