"""Decide whether a frictional problem in the plane has other answers at its load, by all combinations of states.

Each combination of open, stick and slip is a linear system in the contact forces l and joints j
(`contactqp.linalg.delassus`), and gives an answer if its signs hold. Answers are distinguished by the displacements of
contacts, normal and with friction tangential. Signs and displacements are measured contact by contact relative to
rounding, so that a distant contact, or one with a large slip, hides no answer at another. If a system leaves
displacements of contacts undetermined, a linear program decides whether signs can hold; if so, there is a family of
answers. If there may be several answers, and bodies are small and the systems in question few, these are solved again
in rational numbers, since at a limit of friction families depend on the last digit of a load. `contactqp.equilibria`
refines each of them; here they are counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.certificate.critical_friction import SINGULAR_SYSTEM, combinations, regular, system_matrices
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import contact_compliance
from contactqp.linalg.exact_algebra import ONE, ZERO, Region, Row, dot, solutions
from contactqp.model.arrays import Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, STICK
from contactqp.model.problem import ContactProblem

# 4^5 systems take some ten milliseconds.
MOST_COUNTED = 5
# The most underdetermined systems, each of which needs some linear programs.
MOST_LOOSE = 30
# The size of systems that are solved in rational numbers, each in up to forty milliseconds.
MOST_EXACT = 24
# The most systems times the cube of their size, in about a second.
EXACT_OPERATIONS = 5e5
# Signs that fail by less than this part of the lengths or the force of their contact may be rounding.
DOUBTFUL = 1e-9
# Signs along families that fail by more than this part are not due to rounding of data.
SURE = 1e-13
# The rounding of forces relative to the largest one.
FORCE_ROUNDING = 1e-13
# The rounding of displacements relative to the largest one without contacts.
DISPLACEMENT_ROUNDING = 1e-12
# Answers are equal if the displacements of all contacts agree to this part of the sizes of their terms.
SAME_ANSWER = 1e-6
# The ends of a family, found by linear programs, are different answers if contacts differ by this part.
PROGRAMMED = 1e-5
# Changes of the forces of redundant contacts balance to this part of them at every unknown.
BALANCED = 1e-9
# The relative error of entries of the systems, and a safety factor on the resulting error of solutions.
LOST, SAFE = 1e-15, 30.0


def several_answers(problem: ContactProblem, condensation: Condensation) -> bool | None:
    """Return whether more than one answer, or a family, exists; it is computed once for a problem.

    None if too many systems are underdetermined, if signs overflow, or if others exist only within rounding.
    """
    of = (problem.load, problem.gap, problem.tie_value, problem.friction, problem.slip_origin)
    cached = problem._computed.several_answers
    if cached is None or any(mine is not other for mine, other in zip(of, cached[0], strict=True)):
        several, status, by_forces = _several_answers(problem, condensation, DOUBTFUL)
        if several and _is_small(problem, len(status)):
            several = _exactly_several(problem, status) or (False if by_forces else None)
        elif several:
            several = _several_answers(problem, condensation, SURE)[0] or None
        cached = problem._computed.several_answers = of, several
    found: bool | None = cached[1]
    return found


def _several_answers(
    problem: ContactProblem, condensation: Condensation, doubtful: float
) -> tuple[bool | None, NDArray[np.int8], bool]:
    """Return whether there may be several answers, or with `doubtful` of at most `SURE`, whether there are; the
    combinations (c, m) that may have them; and whether only forces differ, which ties may carry. With ties, forces are
    compared only where rational numbers can decide.

    Parameters
    ----------
    problem, condensation : with friction in the plane
    doubtful : by which the signs along families may fail, of what meets there
    """
    system = _Systems(problem, condensation, doubtful)
    status = combinations(system.mu)
    matrices, right = system.assembled(status)
    singular = ~regular(matrices)
    y, free = np.zeros_like(right), dict[int, Array]()
    y[~singular] = np.linalg.solve(matrices[~singular], right[~singular][:, :, None])[:, :, 0]
    for b in np.flatnonzero(singular).tolist():
        y[b], free[b] = _least(matrices[b], right[b])
    alone = np.array([b not in free or not len(free[b]) for b in range(len(status))])
    off = system.rounding(matrices, right, status, y, alone)
    held = alone & system.holds(status, y, *off)
    clear = held & system.holds(status, y, -off[0], -off[1])
    side = np.linalg.slogdet(matrices)[0]
    found = [_Found(y[b], off[0][b], bool(clear[b]), float(side[b]), off[1][b]) for b in np.flatnonzero(held)]
    loose = dict[int, _Signs]()
    for b in np.flatnonzero(~alone).tolist():
        sizes = abs(right[b]) + abs(matrices[b]) @ abs(y[b])
        rounding = system.nothing + FORCE_ROUNDING * abs(y[b]).max(initial=0.0)
        if np.any(abs(matrices[b] @ y[b] - right[b]) > doubtful * sizes + rounding):
            continue
        signs = _Signs(system, status[b], y[b], free[b])
        if signs.may_hold:
            loose[b] = signs
    if len(loose) > MOST_LOOSE:
        return None, status, False
    for signs in loose.values():
        if (extremes := signs.extremes()) is None:
            return None, status, False
        found += [_Found(one, None, False, 0.0) for one in extremes]
    asked = status[[*np.flatnonzero(held), *loose]]
    if doubtful <= SURE:
        return _surely_several(system, found), asked, False
    if len(found) < 2:
        return False, asked, False
    apart = any(far is not False for far in system.apart(found[0], found[1:]))
    if not apart and problem.ties and not _is_small(problem, len(asked)):
        return False, asked, False
    return apart or any(system.pushed_apart(problem, found[0], found[1:])), asked, not apart


def _least(matrix: Array, right: Vector) -> tuple[Vector, Array]:
    """Return the least-squares solution of least norm, and the directions (k, q) of the null space."""
    left, values, rotation = np.linalg.svd(matrix)
    kept = values > SINGULAR_SYSTEM * values[0]
    return rotation[kept].T @ ((left.T @ right)[kept] / values[kept]), rotation[~kept]


def _is_small(problem: ContactProblem, systems: int) -> bool:
    size = problem.dimension + 2 * problem.contacts + problem.ties
    return size <= MOST_EXACT and systems * size**3 <= EXACT_OPERATIONS


def _exactly_several(problem: ContactProblem, status: NDArray[np.int8]) -> bool:
    """Return whether some combinations (c, m) have several answers, in rational numbers.

    This matters if friction is at its limit or critical, where the last digit of a load decides.
    """
    found = list[Row]()
    for one in status:
        moved = _exact_motions(problem, one)
        if moved is None or any(other != moved[0] for other in found if moved):
            return True
        found += moved
    return False


def _exact_motions(problem: ContactProblem, status: NDArray[np.int8]) -> list[Row] | None:
    """Return the displacements of contacts by the answer of a combination (m,), empty without answer, None for a
    family.
    """
    if problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        raise ValueError("answers are counted with friction only")
    n, closed, stuck = problem.dimension, np.flatnonzero(status != OPEN), np.flatnonzero(status == STICK)
    size = n + len(closed) + len(stuck) + problem.ties
    K, E, T, A = (
        [[Fraction(x) for x in row] for row in one.toarray().tolist()]
        for one in (problem.stiffness_rows, problem.normal, problem.tangent, problem.tie)
    )
    mu = [Fraction(x) for x in problem.friction.tolist()]
    slides = [int(s) * (s != STICK) for s in status]
    sticking, held = [T[i] for i in stuck], [E[i] for i in closed]
    along = [[x + slides[i] * mu[i] * y for x, y in zip(E[i], T[i], strict=True)] for i in closed]
    held, pushed = [*held, *sticking, *A], [*along, *sticking, *A]
    limits = np.concatenate([problem.gap[closed], problem.slip_origin[stuck, 0], problem.tie_value]).tolist()
    rows = [[*K[j], *(row[j] for row in pushed), Fraction(f)] for j, f in enumerate(problem.load.tolist())]
    rows += [[*row, *[ZERO] * len(held), Fraction(limit)] for row, limit in zip(held, limits, strict=True)]
    found = solutions(rows, size)
    if found is None:
        return []
    none, signs = [ZERO] * (size - n), list[tuple[Row, float]]()
    for i, state in enumerate(status):
        force, rubbed = [ZERO] * size, [ZERO] * size
        if state == OPEN:
            signs.append(([*(-x for x in E[i]), *none], -float(problem.gap[i])))
            continue
        force[n + int(np.searchsorted(closed, i))] = ONE
        signs.append((force, 0.0))
        if state == STICK:
            rubbed[n + len(closed) + int(np.searchsorted(stuck, i))] = ONE
            signs += [([mu[i] * x + sign * y for x, y in zip(force, rubbed, strict=True)], 0.0) for sign in (1, -1)]
        elif mu[i]:
            origin = float(problem.slip_origin[i, 0])
            signs.append(([*(slides[i] * x for x in T[i]), *none], slides[i] * origin))
    images = [(found.image(row), Fraction(least)) for row, least in signs if np.isfinite(least)]
    region = Region([(value - least, slope) for (value, slope), least in images], len(found.free))
    if region.empty:
        return []
    moved = [found.image([*row, *none]) for row in [*E, *(T[i] for i in range(len(T)) if mu[i])]]
    point = region.point()
    one = [value + dot(slope, point) for value, slope in moved]
    return [one] if region.ends([slope for _, slope in moved]) == [] else None


@dataclass(frozen=True, eq=False)
class _Found:
    """An answer of a combination, or one of the extreme members of a family."""

    y: Vector
    off: Array | None  # (m, 2) rounding of the contacts' displacements; None for families
    clear: bool  # whether its signs hold beyond rounding
    side: float  # the sign of the determinant of its combination
    off_force: Array | None = None  # (m, 2) rounding of the forces; None for families


def _surely_several(system: _Systems, found: list[_Found]) -> bool:
    """Return whether two different answers exist in spite of rounding.

    An answer with signs of rounding size is at the border of several combinations. If their determinants have one sign,
    the law maps a neighbourhood of it onto a neighbourhood of its load, so the answer persists; otherwise the load may
    be at the limit of those with such answers.
    """
    apart = [system.apart(one, found) for one in found]
    stays = [
        one.clear or all(other.side * one.side > 0 for other, far in zip(found, row, strict=True) if far is not True)
        for one, row in zip(found, apart, strict=True)
    ]
    return any(stays[i] and stays[j] and apart[i][j] for i in range(len(found)) for j in range(i))


class _Systems:
    """The linear systems of all combinations in y = (l, j), with a tolerance of signs relative to what meets."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, doubtful: float) -> None:
        self.doubtful = doubtful
        compliance = contact_compliance(problem, condensation)
        if problem.friction is None or problem.slip_origin is None:
            raise ValueError("answers are counted with friction only")
        self.mu = problem.friction
        self._scale = compliance.scale
        self._W, self._V, self._J = compliance.W, compliance.V, compliance.J
        free, self._held = compliance.free(problem, condensation)
        limits = np.stack([problem.gap, problem.slip_origin[:, 0]], axis=1) / compliance.scale[:, None]
        self._room = (limits.ravel() - free).reshape(-1, 2)  # of gap and slip without forces
        self._given = (abs(limits).ravel() + abs(free)).reshape(-1, 2)
        self.nothing = DISPLACEMENT_ROUNDING * max(float(abs(part).max(initial=0.0)) for part in (free, self._held))
        self._lost = LOST + compliance.rounding
        self._compliance = np.diagonal(self._W).reshape(-1, 2)
        self._slope = -np.hstack([self._W, self._V])
        self._acting_rows = np.repeat(self.mu > 0, 2)
        self._acting_rows[::2] = True
        self._felt = self._slope[self._acting_rows]

    def assembled(self, status: NDArray[np.int8]) -> tuple[Array, Array]:
        """Return the matrices (c, q, q) and right-hand sides (c, q) of combinations (c, m)."""
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

    def rounding(
        self, matrices: Array, right: Array, status: NDArray[np.int8], y: Array, alone: Mask
    ) -> tuple[Array, Array]:
        """Return bounds of rounding of contact displacements and forces of solutions (c, q), (c, m, 2) each.

        Errors of the entries are propagated by the inverse, component by component (R. D. Skeel, 1979).

        Parameters
        ----------
        matrices, right, status, y : systems, right-hand sides, combinations and solutions
        alone : (c,) which systems have one solution; others are left out
        """
        m = len(self.mu)
        closed = np.stack([status != OPEN, status == STICK], axis=2).reshape(len(status), 2 * m)
        lost = self._lost * (np.einsum("cij,cj->ci", abs(matrices), abs(y)) + abs(right))
        lost[:, : 2 * m] += closed * (self._lost * self._given.ravel() + self.nothing)
        lost[:, 2 * m :] += self.nothing
        force = np.zeros_like(y)
        force[alone] = np.einsum("cij,cj->ci", abs(np.linalg.pinv(matrices[alone], rcond=0.0)), lost[alone])
        moved = (SAFE * force + self._lost * abs(y)) @ abs(self._slope).T
        moved = moved.reshape(len(y), m, 2) + SAFE * (self._lost * self._given + self.nothing)
        return moved, SAFE * force[:, : 2 * m].reshape(len(y), m, 2)

    def holds(self, status: NDArray[np.int8], y: Array, length: Array, pushed: Array) -> Mask:
        """Return which solutions (c, q) have the signs of their combination.

        Parameters
        ----------
        status, y : combinations (c, m) and their solutions
        length, pushed : (c, m, 2) by which gaps and slips, and forces, may fail
        """
        m = len(self.mu)
        force = y[:, : 2 * m].reshape(len(y), m, 2)
        room = self._room - (y @ self._slope.T).reshape(force.shape)
        gap, slip = room[:, :, 0], -room[:, :, 1]
        opened, stuck = status == OPEN, status == STICK
        right = np.where(opened, gap >= -length[:, :, 0], force[:, :, 0] >= -pushed[:, :, 0])
        bound = self.mu * (force[:, :, 0] + pushed[:, :, 0]) + pushed[:, :, 1]
        right &= np.where(stuck, abs(force[:, :, 1]) <= bound, True)
        right &= np.where(opened | stuck | (self.mu == 0), True, status * slip >= -length[:, :, 1])
        return np.asarray(np.all(right, axis=1))

    def _allowed(self, y: Array) -> tuple[Array, Array]:
        """Return the tolerances of signs of lengths and forces of solutions (c, q), (c, m, 2) each."""
        meeting = self._given + self.nothing / self.doubtful + (abs(y) @ abs(self._slope).T).reshape(len(y), -1, 2)
        largest = np.max(abs(y), axis=1, initial=0.0)[:, None, None]
        compliance = np.broadcast_to(self._compliance, meeting.shape)
        felt = compliance > SINGULAR_SYSTEM * compliance.max(initial=0.0)
        asked = np.divide(meeting, compliance, out=np.broadcast_to(largest, meeting.shape).copy(), where=felt)
        return self.doubtful * meeting, self.doubtful * asked + FORCE_ROUNDING * largest

    def _by_state(self, status: NDArray[np.int8]) -> Iterator[Indices]:
        """Yield the open, closed, sticking and slipping contacts."""
        for mask in (status == OPEN, status != OPEN, status == STICK, (abs(status) == 1) & (self.mu > 0)):
            yield np.flatnonzero(mask)

    def sizes(self, status: NDArray[np.int8], y: Vector) -> Vector:
        """Return the tolerance of every row of `signs` for a solution (q,)."""
        length, pushed = (part[0] for part in self._allowed(y[None]))
        opened, closed, stuck, sliding = self._by_state(status)
        bound = self.mu[stuck] * pushed[stuck, 0] + pushed[stuck, 1]
        return np.concatenate([length[opened, 0], pushed[closed, 0], bound, bound, length[sliding, 1]])

    def signs(self, status: NDArray[np.int8]) -> tuple[Vector, Array]:
        """Return room and its slope in y: the signs hold where room + slope y >= 0."""
        m, unit = len(self.mu), np.eye(self._slope.shape[1])
        opened, closed, stuck, sliding = self._by_state(status)
        sign, bound = status[sliding].astype(float), self.mu[stuck, None] * unit[2 * stuck]
        none = np.zeros(len(closed) + 2 * len(stuck))
        room = np.concatenate([self._room[opened, 0], none, -sign * self._room[sliding, 1]])
        friction, slip = unit[2 * stuck + 1], sign[:, None] * self._slope[2 * sliding + 1]
        rows = [-self._slope[2 * opened], unit[2 * closed], bound - friction, bound + friction, slip]
        return room, np.vstack(rows) if m else np.zeros((0, len(unit)))

    def apart(self, one: _Found, others: list[_Found]) -> list[bool | None]:
        """Return of each of the others whether it displaces any contact differently, None if that is uncertain."""
        y, of_family = np.array([other.y for other in others]), np.zeros_like(self._given)
        sizes = np.maximum(abs(one.y), abs(y)) @ abs(self._felt).T
        change, meeting = abs((one.y - y) @ self._felt.T), sizes + self._given.ravel()[self._acting_rows]
        off = np.array([of_family if one.off is None or other.off is None else one.off + other.off for other in others])
        exact = np.array([one.off is not None and other.off is not None for other in others])[:, None]
        far = np.where(exact, off.reshape(len(others), -1)[:, self._acting_rows], PROGRAMMED * meeting)
        nearly = np.minimum(far, SAME_ANSWER * meeting + 10 * self.nothing)
        same = np.where(exact, nearly, DISPLACEMENT_ROUNDING * meeting + SAFE * self.nothing)
        surely, equal = np.any(change > np.maximum(far, same), axis=1), np.all(change <= same, axis=1)
        return [True if differs else False if agrees else None for differs, agrees in zip(surely, equal, strict=True)]

    def pushed_apart(self, problem: ContactProblem, one: _Found, others: list[_Found]) -> list[bool]:
        """Return of each of the others whether its forces differ, and not only as redundant contacts share them.

        Bodies are then displaced differently, even where that is lost in the rounding of displacements without
        contacts, as where a soft spring lets a body go far. Ties may carry a difference as redundant contacts do, which
        only the rational numbers of small problems decide.
        """
        rows, differs = sp.vstack([problem.normal, problem.tangent]), list[bool]()
        for other in others:
            off = np.inf if one.off_force is None or other.off_force is None else one.off_force + other.off_force
            change = (one.y - other.y)[: 2 * len(self.mu)].reshape(-1, 2)
            forces = (np.where(abs(change) > off, change, 0.0) / self._scale[:, None]).T.ravel()
            differs.append(bool(np.any(abs(rows.T @ forces) > BALANCED * (abs(rows).T @ abs(forces)))))
        return differs

    def moving(self, free: Array) -> Array:
        """Return the nonzero displacements of contacts by free directions (k, q) as rows (r, k)."""
        change = self._felt @ free.T
        return np.asarray(change[np.any(abs(change) > np.sqrt(SINGULAR_SYSTEM), axis=1)])


class _Signs:
    """The signs of one combination along the solutions start + free'c of an underdetermined system."""

    def __init__(self, system: _Systems, status: NDArray[np.int8], start: Vector, free: Array) -> None:
        self._start, self._free, self._moving, self._doubtful = start, free, system.moving(free), system.doubtful
        room, change = system.signs(status)
        self._left, self._slope, self._allowed = room + change @ start, change @ free.T, system.sizes(status, start)
        self._idle = np.all(abs(self._slope) <= np.sqrt(SINGULAR_SYSTEM), axis=1)

    @property
    def may_hold(self) -> bool:
        """Return whether all signs that do not depend on c hold."""
        return bool(np.all(self._left[self._idle] >= -self._allowed[self._idle]))

    def extremes(self) -> list[Vector] | None:
        """Return the extreme solutions with right signs, none if there are none, None if signs overflow."""
        from scipy.optimize import linprog

        size = self._allowed / self._doubtful
        nonzero = size[~self._idle & (size > 0)]
        step = float(np.median(nonzero)) if len(nonzero) else 1.0
        size = np.where(size > 0, size, step)
        moving = self._moving
        wanted = np.vstack([moving, -moving]) if len(moving) else np.zeros((1, len(self._free)))
        slope, room = -self._slope * (step / size)[:, None], self._left / size + self._doubtful
        if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(room)) and np.all(np.isfinite(moving))):
            return None
        found = []
        for row in wanted:
            answer = linprog(
                -row,
                A_ub=slope,
                b_ub=room,
                bounds=[(-1e3, 1e3)] * len(self._free),  # beyond a thousand times its size a family is a family
                method="highs",
            )
            if answer.x is None:
                return []
            found.append(self._start + step * self._free.T @ answer.x)
        return found
