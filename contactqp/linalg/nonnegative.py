"""The dual of a strictly convex contact problem: min 1/2 l'Wl - h'l over l_i >= 0 for contacts, l_i free for ties.

The dual active-set method of Goldfarb and Idnani (1983) in terms of W: each step closes the most penetrated contact and
opens those whose force reaches zero, so that the energy rises strictly and no set recurs. It ends after finitely many
steps, also with redundant contacts, as a row that depends on closed ones replaces one of them.

Linear programs are solved by HiGHS, as `scipy.optimize.linprog` calls it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector, refuse_late, seconds_left

# W has a unit diagonal: a row depends on the closed contacts if they reduce its compliance below this.
DEPENDENT = 1e-11
# The number of active rows from which their inverse is updated, and its relative error from which it is recomputed.
MANY, WORN = 200, 1e-6
# The number of steps between two checks of the time.
STEPS_UNTIMED = 8
# The energy rises with each step. If it falls by this part and beyond rounding, or does not rise in as many steps as
# there are rows, W is not accurate enough to continue.
FALLEN, ROUNDED = 1e-3, 1e-12
# Unit rows closer to dependence than this are dependent up to rounding.
DEPENDENT_BY_ROUNDING = 8 * EPS
# The rounding by which a shift may exceed gaps, relative to its lengths.
SHIFT_SLACK = 1e-15
# With more gaps than this, those that shifts on the way exceed are met, at first so many of them.
MANY_GAPS, EXCEEDED = 400, 50
# Forces of a linear program below this part of the load count as zero.
CARRIES = 1e-9
# The most steps of the simplex method for each row and unknown; one or two are usual.
SECONDS, LEAST_STEPS, STEPS_OF_A_ROW = 20.0, 1000, 5
# HiGHS' simplex method has ended processes ("double free") on costs of 1e12.
HIGHEST_COST = 1e9


class Infeasible(Exception):
    """The rows of the set and the entering one conflict, to the accuracy of W."""

    def __init__(self, rows: list[int]) -> None:
        super().__init__()
        self.rows = np.array(sorted(rows), dtype=np.intp)


def dual_active_set(W: Array, h: Vector, free: Mask, tolerance: Vector, max_steps: int) -> tuple[Vector, int, bool]:
    """Find forces l with l >= 0 off `free` and h - W l <= tolerance; return them, the steps, and whether it ended.

    Raises Infeasible: no forces exist: the rows conflict; NotConverged: the time is up.

    Parameters
    ----------
    W : (q, q) array, positive semidefinite, unit diagonal
    h : (q,) array, excess of each row without forces
    free : (q,) bool, rows whose force has no sign (ties); their excess ends at zero
    tolerance : (q,) array, excess that counts as closed
    max_steps : int
    """
    force = np.zeros(len(h))
    active = _ActiveRows(W, _independent(W, np.flatnonzero(free)))
    if active.rows:
        force[active.rows] = np.linalg.solve(W[np.ix_(active.rows, active.rows)], h[active.rows])
    highest, at = -np.inf, 0
    for step in range(max_steps):
        if step % STEPS_UNTIMED == STEPS_UNTIMED - 1:
            refuse_late("contacts open and close one by one")
        pushed = W @ force
        excess = np.where(free, 0.0, h - pushed - tolerance)
        excess[active.rows] = 0.0
        i = int(np.argmax(excess)) if len(excess) else -1
        if i < 0 or excess[i] <= 0:
            return force, step, True
        energy = float(h @ force - 0.5 * (force @ pushed))
        if energy > highest:
            highest, at = energy, step
        elif step - at > len(h) or energy < highest - max(FALLEN * abs(highest), ROUNDED * float(abs(h) @ abs(force))):
            return force, step, False  # it has converged to the accuracy of W
        _close(h, force, active, i, free)
    return force, max_steps, False


class _ActiveRows:
    """The active rows of W, with the inverse of their block if there are MANY, updated in O(q^2) by each change."""

    def __init__(self, W: Array, rows: list[int]) -> None:
        self.W, self.rows = W, rows
        self._inverse: Array | None = None

    def drag(self, i: int) -> Vector:
        """Return the reduction of active forces per unit force on row i, W_aa^-1 W_ai."""
        rows, held = self.rows, self.W[self.rows, i]
        if len(rows) < MANY:
            self._inverse = None
            return np.asarray(np.linalg.solve(self.W[np.ix_(rows, rows)], held)) if rows else np.zeros(0)
        kept = self._inverse is not None
        inverse = np.asarray(np.linalg.inv(self.W[np.ix_(rows, rows)]) if self._inverse is None else self._inverse)
        self._inverse, found, every = inverse, inverse @ held, np.zeros(len(self.W))
        every[rows] = found
        missed = held - (self.W @ every)[rows]
        if kept and np.max(abs(missed)) > WORN * np.max(abs(held)):
            self._inverse = None
            return self.drag(i)
        return found + inverse @ missed

    def append(self, i: int, drag: Vector, compliance: float) -> None:
        """Add row i with its drag and its compliance with the others closed."""
        self.rows.append(i)
        if self._inverse is not None:
            border = np.append(-drag, 1.0)
            self._inverse = np.pad(self._inverse, (0, 1)) + np.outer(border, border / compliance)

    def drop(self, k: int) -> int:
        """Remove the k-th row and return its index."""
        if self._inverse is not None:
            across = np.delete(self._inverse[k], k)
            inner = np.delete(np.delete(self._inverse, k, 0), k, 1)
            self._inverse = inner - np.outer(across, across / self._inverse[k, k])
        return self.rows.pop(k)


def _close(h: Vector, force: Vector, active: _ActiveRows, i: int, free: Mask) -> None:
    """Raise the force of row i until its excess is zero, dropping rows whose force reaches zero before."""
    W, rows = active.W, active.rows
    while True:
        drag = active.drag(i)
        compliance = W[i, i] - W[i, rows] @ drag
        excess = h[i] - W[i] @ force
        full = excess / compliance if compliance > DEPENDENT else np.inf
        falling = [k for k, j in enumerate(rows) if not free[j] and drag[k] > 0]
        ratios = [force[rows[k]] / drag[k] for k in falling]
        partial = min(ratios, default=np.inf)
        step = min(full, partial)
        if not np.isfinite(step):
            raise Infeasible([*rows, i])
        force[rows] -= step * drag
        force[i] += step
        if step == full:
            active.append(i, drag, float(compliance))
            return
        force[active.drop(falling[int(np.argmin(ratios))])] = 0.0


def _independent(W: Array, rows: Indices) -> list[int]:
    """Return the rows that do not depend on earlier ones."""
    chosen: list[int] = []
    for i in rows:
        held = W[np.ix_(chosen, chosen)]
        drag = np.linalg.solve(held, W[chosen, i]) if chosen else np.zeros(0)
        if W[i, i] - W[i, chosen] @ drag > DEPENDENT:
            chosen.append(int(i))
    return chosen


# Of a row that is left after its projection on active ones, in the measure of H, this part and less is rounding.
DEPENDS = 1e-9
# Rates of forces beneath this part of the largest do not fall; and steps after which rounding of x is taken back; and
# columns that are reflected at once.
STANDS, STEPS_BETWEEN, COLUMNS = 1e-12, 20, 16


class StrictProgram:
    """min 1/2 x'Hx - f'x subject to N x <= c, with N x = c in tied rows, by the dual active set in factors.

    With H = L L' and the rows N_a of the active set, N_a L^-T = R'Q': kept are J = L^-T Q and R (Goldfarb and Idnani
    1983), so that H and the rows count with the roots of their conditions, where `dual_active_set` squares them.

    Parameters
    ----------
    stiffness, force : (n, n) and (n,) arrays, H and f
    rows, limit, tied : (q, n), (q,) and (q,) arrays, N, c and which of them are equations

    Attributes
    ----------
    active : list of int, rows that hold x, none of which depends on others
    force : (q,) array, of the active rows, not negative but on tied ones
    conflicting : set of int, rows that depend on active ones and contradict them, which are left as they are
    ended : whether no other row is violated
    """

    def __init__(self, stiffness: Array, force: Vector, rows: Array, limit: Vector, tied: Mask) -> None:
        from scipy.linalg import solve_triangular

        self._solve = partial(solve_triangular, check_finite=False)
        self._load, self._rows, self._limit, self._tied = force, rows, limit, tied
        self._entries = sp.csr_matrix(rows)
        self._root = np.linalg.cholesky(stiffness)
        self._J, self._R, self.active = np.zeros((0, 0)), np.zeros(stiffness.shape), list[int]()
        self.force, self.conflicting, self.ended = np.zeros(0), set[int](), False

    def solve(self, start: Indices, tolerance: float, steps: Iterator[int]) -> Vector:
        """Return x, from the set of tied rows and those to start with that do not pull.

        Parameters
        ----------
        start : rows in the order in which they are made active
        tolerance : by how much a row of length one may be violated
        steps : the number of steps that are left
        """
        self._begin(np.concatenate([np.flatnonzero(self._tied), start]))
        x, self.force = self._held()
        while pulling := [k for k, i in enumerate(self.active) if self.force[k] < 0 and not self._tied[i]]:
            for k in reversed(pulling):
                self._leave(k)
            x, self.force = self._held()
        length = np.linalg.norm(self._rows, axis=1)
        length[length == 0] = 1.0
        before = set[frozenset[int]]()
        for step in steps:
            if step % STEPS_UNTIMED == 0:
                refuse_late("contacts open and close one by one")
            excess = np.where(self._tied, 0.0, (self._entries @ x - self._limit) / length - tolerance)
            excess[[*self.active, *self.conflicting]] = 0.0
            worst = int(np.argmax(excess))
            if self.ended or not excess[worst] > 0:
                self.ended = True
                break
            if (now := frozenset(self.active)) in before:
                break  # rounding decides: the energy would have risen, and no set recurs then
            before.add(now)
            x = self._closed(worst, x, steps)
            if step % STEPS_BETWEEN == 0:
                x, self.force = self._held()
        return self._held()[0]

    def _begin(self, rows: Indices) -> None:
        """Factorise the rows that are to be active, without those that depend on rows before them."""
        from scipy.linalg import qr

        while True:
            scaled = self._solve(self._root, self._rows[rows].T, lower=True)
            Q, R = qr(scaled)
            own = abs(np.diagonal(R))
            independent = own > DEPENDS * np.linalg.norm(scaled[:, : len(own)], axis=0)
            if independent.all() and len(own) == len(rows):
                break
            rows = rows[: len(own)][independent]
        self.active = [int(row) for row in rows]
        self._R[: len(rows), : len(rows)] = R[: len(rows)]
        self._J = np.asarray(self._solve(self._root, Q, lower=True, trans=1))

    def _closed(self, row: int, x: Vector, steps: Iterator[int]) -> Vector:
        """Return x when a violated row has become active, in whose way others have opened whose force reached zero."""
        pushed = 0.0
        while True:
            along = self._J.T @ self._rows[row]
            q = len(self.active)
            rate = self._solve(self._R[:q, :q], along[:q]) if q else np.zeros(0)
            left = float(np.linalg.norm(along[q:]))
            depends = left <= DEPENDS * float(np.linalg.norm(along))
            falls = (rate > STANDS * np.max(abs(rate), initial=0.0)) & ~self._tied[self.active]
            falling = np.flatnonzero(falls)
            ratios = self.force[falling] / rate[falling]
            full = np.inf if depends else float(self._rows[row] @ x - self._limit[row]) / left**2
            step = min(full, float(np.min(ratios, initial=np.inf)))
            if not np.isfinite(step) or next(steps, None) is None:
                self.conflicting.add(row)
                return self._held()[0]
            self.force, pushed = self.force - step * rate, pushed + step
            x = x if depends else x - step * (self._J[:, q:] @ along[q:])
            if step == full:
                self._join(row, along)
                self.force = np.append(self.force, pushed)
                return x
            opened = int(falling[np.argmin(ratios)])
            self.force = np.delete(self.force, opened)
            self._leave(opened)

    def _held(self) -> tuple[Vector, Vector]:
        """Return x at the minimum with the active rows held, and their forces."""
        q = len(self.active)
        free, R = self._J.T @ self._load, self._R[:q, :q]
        held = self._solve(R, self._limit[self.active], trans=1) if q else np.zeros(0)
        force = self._solve(R, free[:q] - held) if q else np.zeros(0)
        return self._J @ np.concatenate([held, free[q:]]), force

    def _join(self, row: int, along: Vector) -> None:
        """Make a row active, if it does not depend on those that are, by a reflection of J; `along` is J' times it."""
        q = len(self.active)
        left = float(np.linalg.norm(along[q:]))
        if not left > DEPENDS * float(np.linalg.norm(along)):
            return
        normal = along[q:].copy()
        end = -np.copysign(left, normal[0])
        normal[0] -= end
        normal /= np.linalg.norm(normal)
        turned = 2.0 * (self._J[:, q:] @ normal)
        for first in range(0, len(normal), COLUMNS):  # in pieces that stay in the cache
            self._J[:, q + first : q + first + COLUMNS] -= np.outer(turned, normal[first : first + COLUMNS])
        self._R[:q, q], self._R[q, q] = along[:q], end
        self.active.append(row)

    def _leave(self, place: int) -> None:
        """Remove the row in this place from the active ones, by rotations of neighbouring columns of J."""
        q = len(self.active)
        self._R[:, place : q - 1], self._R[:, q - 1] = self._R[:, place + 1 : q], 0.0
        self.active.pop(place)
        for j in range(place, q - 1):
            a, b = self._R[j, j], self._R[j + 1, j]
            size = np.hypot(a, b)
            if size > 0:
                turn = np.array([[a, b], [-b, a]]) / size
                self._R[j : j + 2, j : q - 1] = turn @ self._R[j : j + 2, j : q - 1]
                self._J[:, j : j + 2] = self._J[:, j : j + 2] @ turn.T


# Added to a singular H less than this part of each diagonal entry, times their number, leaves pivots to rounding.
ROUNDS_OFF = 4.0 * float(np.finfo(float).eps)
# Programs, of which each adds less to the diagonal by this factor than the one before, until that leaves forces out of
# balance by no more than this; and lengths by which rows may be missed.
PROGRAMS, LESS, LEAVES, MISSES = 3, 0.1, 1e-9, 1e-9


def by_strict_programs(
    stiffness: Any,
    load: Vector,
    rows: Any,
    limit: Vector,
    tied: Mask,
    start: Indices,
    added: float,
    steps: Iterator[int],
) -> tuple[StrictProgram | None, Vector, float]:
    """Return the last of some strictly convex programs that ended, its solution, and how far it is from the one before.

    Unknowns without stiffness get some, which acts from where the program before has led (Rockafellar 1976).

    Parameters
    ----------
    stiffness, load, rows, limit, tied, start, steps : as in `StrictProgram`, H and N sparse
    added : what is added to the diagonal first, and more where rounding of H asks for it
    """
    dense, across = stiffness.toarray(), rows.toarray()
    program, x, moved = None, np.zeros(len(load)), np.inf
    least = ROUNDS_OFF * len(x) * dense.diagonal()
    for _ in range(PROGRAMS):
        springs = np.maximum(added, least)
        strict = StrictProgram(dense + np.diag(springs), load + springs * x, across, limit, tied)
        after = strict.solve(start, MISSES, steps)
        if not (strict.ended and np.all(np.isfinite(after))):
            break
        change = abs(after - x)
        moved, x, program = float(np.max(change, initial=0.0)), after, strict
        if np.max(springs * change, initial=0.0) <= LEAVES:
            break
        start = np.array([row for row in strict.active if not tied[row]], dtype=np.intp)
        added *= LESS
    return program, x, moved


def nonnegative_least_squares(matrix: Array, right: Vector) -> tuple[Vector, float]:
    """Minimise |matrix x - right| over x >= 0 by the algorithm of Lawson and Hanson (1974); return x and this residual.

    The residual is NaN, and x zero, where that takes too many steps, or SciPy before 1.15 meets a singular system. A
    matrix without columns is treated here, as it crashes SciPy 1.17.
    """
    from scipy.optimize import nnls

    none = np.zeros(matrix.shape[1])
    if not matrix.size:
        return none, float(np.linalg.norm(right))
    try:
        share, residual = nnls(matrix, right, maxiter=30 * matrix.shape[1])
    except (RuntimeError, np.linalg.LinAlgError):
        return none, np.nan
    return np.asarray(share), float(residual)


def forces_without_tension(rows: Array, resultant: Vector, pushing_only: Mask) -> tuple[Vector, float]:
    """Return forces l (q,), not negative on `pushing_only`, for which |rows'l - resultant| is least, and this residual.

    The residual is NaN, and the forces are zero, if the least squares do not converge.
    """
    share, residual = nonnegative_least_squares(np.vstack([rows, -rows[~pushing_only]]).T, resultant)
    force = share[: len(rows)].copy()
    force[~pushing_only] -= share[len(rows) :]
    return force, residual


def least_closing(rows: Array, ties: Array, excess: Vector) -> Vector:
    """Return the minimum-norm least-squares solution w (p,) of rows w = -excess, ties w = 0.

    Rows that are dependent up to rounding count as dependent.
    """
    every = np.vstack([rows, ties])
    size = np.linalg.norm(every, axis=1)
    wanted = np.concatenate([-excess, np.zeros(len(ties))]) / size
    return np.asarray(np.linalg.lstsq(every / size[:, None], wanted, rcond=DEPENDENT_BY_ROUNDING)[0])


def shift_within_gaps(rows: Array, gap: Vector, wanted: Vector) -> Vector:
    """Return the nearest shift that leaves no contact penetrated: min |a - wanted| subject to rows a <= gap.

    If there is none, as between two contacts penetrated by rounding, these remain penetrated.
    """
    length = np.linalg.norm(rows, axis=1)
    within = _shift_within_many if len(rows) > MANY_GAPS else _shift_within
    return within(rows / length[:, None], gap / length, wanted)


def _shift_within(unit: Array, room: Vector, wanted: Vector) -> Vector:
    none = np.zeros(len(room), dtype=bool)
    slack = SHIFT_SLACK * (abs(room) + abs(unit) @ abs(wanted))
    try:
        force, _, _ = dual_active_set(unit @ unit.T, unit @ wanted - room, none, slack, 50 * len(room) + 50)
    except Infeasible:
        return _shift_within(unit, np.maximum(room, 0.0), wanted) if np.any(room < 0) else np.zeros(len(wanted))
    return np.asarray(wanted - unit.T @ force)


def _shift_within_many(unit: Array, room: Vector, wanted: Vector) -> Vector:
    """Return the shift of `shift_within_gaps` where rows are many, by those only that shifts on the way exceed."""
    met, shift = np.zeros(len(room), dtype=bool), wanted
    slack = 2 * SHIFT_SLACK * (abs(room) + abs(unit) @ abs(wanted))
    while np.any((beyond := np.where(met, 0.0, unit @ shift - room - slack)) > 0):
        met |= beyond >= max(np.partition(beyond, -EXCEEDED)[-EXCEEDED], np.finfo(float).tiny)
        shift = _shift_within(unit[met], room[met], wanted)
    return shift


def given_rows(kind: str, rows: Any, limits: Vector) -> dict[str, Any]:
    """Return rows and limits of a linear program as arguments of `highs`, "ub" or "eq", none without rows."""
    return {f"A_{kind}": rows, f"b_{kind}": limits} if rows.shape[0] else {}


def highs(cost: Vector, **constraints: Any) -> Any:
    """Solve a linear program in the form of `linprog` by the simplex method; None if it fails or costs are too
    large.
    """
    from scipy.optimize import linprog

    if not np.max(abs(cost), initial=0.0) <= HIGHEST_COST:
        return None
    size = len(cost) + sum(len(constraints.get(limits, ())) for limits in ("b_ub", "b_eq"))
    options = dict.fromkeys(("primal_feasibility_tolerance", "dual_feasibility_tolerance"), CARRIES)
    seconds = min(SECONDS, seconds_left() or SECONDS)
    options |= {"time_limit": seconds, "maxiter": LEAST_STEPS + STEPS_OF_A_ROW * size}
    try:
        found = linprog(cost, method="highs-ds", options=options, **constraints)
    except ValueError:
        return None
    return found if found.x is not None and found.status == 0 else None


# Unit rows are dependent up to this part of the largest singular value.
DEPENDENT_ROWS = 1e-10


def longest_step(span: Array, told: Vector, turns: Vector, limits: Sequence[tuple[float | None, None]]) -> float:
    """Return the largest step x for which span forces = told + x turns has forces within limits; 0 where it has none.

    Parameters
    ----------
    span : (r, q) array
    told, turns : (r,) arrays, what is exerted and how it changes
    limits : q pairs, the least and the largest of each force, None where there is none
    """
    from scipy.optimize import linprog

    size, speed = (float(np.max(abs(one), initial=0.0)) or 1.0 for one in (told, turns))
    cost = np.append(np.zeros(len(limits)), -1.0)
    equations = np.column_stack([span, -turns / speed])
    most = linprog(cost, A_eq=equations, b_eq=told / size, bounds=[*limits, (0.0, None)])
    return float(-most.fun * size / speed) if most.status == 0 else np.inf if most.status == 3 else 0.0


def width_within(turns: Array, signs: Vector, far: float) -> float:
    """Return the largest width of the set of z with signs + turns z >= 0 and |z| <= far, 0 if it is empty."""
    from scipy.optimize import linprog

    along, ends = np.cos(np.arange(1.0, turns.shape[1] + 1)), []
    for sign in (1.0, -1.0):
        end = linprog(sign * along, A_ub=-turns, b_ub=signs, bounds=(-far, far))
        if end.status != 0:
            return 0.0 if end.status == 2 else np.inf
        ends.append(float(end.fun))
    return -sum(ends)


def width_of(forms: Array, turns: Array, signs: Vector, far: float) -> float:
    """Return the largest range of the linear forms, forms z, over z with signs + turns z >= 0 and |z| <= far.

    It is infinite if the linear program fails.

    Parameters
    ----------
    forms, turns : (p, k), (q, k)
    signs : (q,), none of them negative
    far : the largest component of z
    """
    widest = 0.0
    for form in forms:
        ends = [highs(sign * form, **given_rows("ub", -turns, signs), bounds=(-far, far)) for sign in (1.0, -1.0)]
        widest = max(widest, np.inf if None in ends else -sum(float(end.fun) for end in ends))
    return widest
