"""The dual of a strictly convex contact problem: min 1/2 l'Wl - h'l over l_i >= 0 for contacts, l_i free for ties.

The dual active-set method of Goldfarb and Idnani (1983) in terms of W: each step closes the most penetrated contact and
opens those whose force reaches zero, so that the energy rises strictly and no set recurs. It ends after finitely many
steps, also with redundant contacts, as a row that depends on closed ones replaces one of them.

`Sharing` treats the many distributions of a force over contacts with dependent rows.

Linear programs are solved by HiGHS, as `scipy.optimize.linprog` calls it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.model.arrays import Array, Indices, Mask, Vector, refuse_late, seconds_left
from contactqp.model.problem import ContactProblem

# W has a unit diagonal: a row depends on the closed contacts if they reduce its compliance below this.
DEPENDENT = 1e-11
# The number of active rows from which their inverse is updated, and its relative error from which it is recomputed.
MANY, WORN = 200, 1e-6
# The number of steps between two checks of the time.
STEPS_UNTIMED = 8
# The energy rises with each step. If it falls by this part and beyond rounding, or does not rise in as many steps as
# there are rows, W is not accurate enough to continue.
FALLEN, ROUNDED = 1e-3, 1e-12
# The rounding by which a shift may exceed gaps, relative to its lengths.
SHIFT_SLACK = 1e-15
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


def nonnegative_least_squares(matrix: Array, right: Vector) -> tuple[Vector, float]:
    """Minimise |matrix x - right| over x >= 0 by the algorithm of Lawson and Hanson (1974); return x and this residual.

    The residual is NaN, and x zero, where that takes too many steps. A matrix without columns is treated here, as it
    crashes SciPy 1.17.
    """
    from scipy.optimize import nnls

    none = np.zeros(matrix.shape[1])
    if not matrix.size:
        return none, float(np.linalg.norm(right))
    try:
        share, residual = nnls(matrix, right, maxiter=30 * matrix.shape[1])
    except RuntimeError:  # too many steps
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


def shift_within_gaps(rows: Array, gap: Vector, wanted: Vector) -> Vector:
    """Return the nearest shift that leaves no contact penetrated: min |a - wanted| subject to rows a <= gap.

    If there is none, as between two contacts penetrated by rounding, these remain penetrated.
    """
    length = np.linalg.norm(rows, axis=1)
    unit, room = rows / length[:, None], gap / length
    none = np.zeros(len(room), dtype=bool)
    slack = SHIFT_SLACK * (abs(room) + abs(unit) @ abs(wanted))
    try:
        force, _, _ = dual_active_set(unit @ unit.T, unit @ wanted - room, none, slack, 50 * len(room) + 50)
    except Infeasible:
        return shift_within_gaps(rows, np.maximum(gap, 0.0), wanted) if np.any(gap < 0) else np.zeros(len(wanted))
    return np.asarray(wanted - unit.T @ force)


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
# Shared forces below this part of the largest count as zero.
SEEN = 1e-6


class Sharing:
    """The possible distributions of a resultant over touching contacts and ties, in the root of energy.

    A problem's energy changes with gaps dg and tie values db at the rate -min(l'dg + nu'db) over all of them, and where
    that is least contacts whose force may be more than nothing stay closed: what `stay` tells (Dempe 2002, of programs
    with several multipliers).

    Parameters
    ----------
    problem : ContactProblem
    contacts : (q,) array, those that touch
    units : scale of unknowns (n,), and lengths of normal, tangential and tied rows in it
    """

    def __init__(
        self, problem: ContactProblem, contacts: Indices, units: tuple[Vector, Vector, Vector, Vector]
    ) -> None:
        unit, normal, _, tie = units
        lengths = np.concatenate([normal[contacts], tie])
        rows = sp.csc_array(sp.vstack([problem.normal[contacts], problem.tie]))
        self._felt, self._unit, self._contacts = np.flatnonzero(np.diff(rows.indptr)), unit, contacts
        self._lengths = np.where(lengths > 0, lengths, 1.0)
        self.rows: Array = rows[:, self._felt].toarray() * unit[self._felt] / self._lengths[:, None]
        self._limits = [(0.0, None)] * len(contacts) + [(None, None)] * problem.ties
        _, sizes, basis = np.linalg.svd(self.rows, full_matrices=False)
        self._basis = basis[sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0)]

    def _projected(self, resultant: Vector) -> Vector:
        """Return a force (n,) along what the rows span."""
        return np.asarray(self._basis @ (resultant * self._unit)[self._felt])

    def takes_part(self, grazes: Mask) -> bool:
        """Return whether grazing contacts (q,) can carry forces, among themselves or of the others."""
        grazing = np.concatenate([grazes, np.zeros(len(self.rows) - len(grazes), dtype=bool)])
        resultant = np.append(np.zeros(self.rows.shape[1]), 1.0)
        _, residual = forces_without_tension(np.column_stack([self.rows, grazing]), resultant, grazing)
        return not residual > CARRIES

    def only(self, ties: bool) -> bool:
        """Return whether the forces of contacts, or with `ties` those of ties, are unique."""
        of_contacts, of_ties = np.split(self.rows, [len(self._contacts)])
        own, others = (of_ties, of_contacts) if ties else (of_contacts, of_ties)
        own = own[np.any(own != 0, axis=1)]  # rows of zeros have no force
        return len(self._basis) == len(own) + _rank(others)

    def _cost(self, gap: Vector, tie_value: Vector) -> Vector:
        """Return the cost of unit forces as gaps (m,) and tie values (k,) change, scaled to a maximum of one."""
        cost = np.concatenate([gap[self._contacts], tie_value]) / self._lengths
        return np.asarray(cost / (np.max(abs(cost), initial=0.0) or 1.0))

    def _least(self, resultant: Vector, cost: Vector) -> tuple[Any, Array, Vector]:
        """Return the linear program of the forces of least cost, its rows and their resultant."""
        from scipy.optimize import linprog

        span, told = self._basis @ self.rows.T, self._projected(resultant)
        told = told / (np.max(abs(told), initial=0.0) or 1.0)
        return linprog(cost, A_eq=span, b_eq=told, bounds=self._limits, method="highs-ds"), span, told

    def carrying(self, resultant: Vector, gap: Vector, tie_value: Vector) -> Indices | None:
        """Return independent contacts that carry the resultant as gaps (m,) and tie values (k,) change."""
        least, _, _ = self._least(resultant, self._cost(gap, tie_value))
        if least.status != 0:
            return None
        force = least.x[: len(self._contacts)]
        return np.asarray(self._contacts[force > CARRIES * np.max(abs(least.x), initial=0.0)], dtype=np.intp)

    def joining(self, resultant: Vector, carrying: Indices, may: Indices) -> Indices:
        """Return contacts among `may`, independent of the carrying ones and of ties, that carry the rest.

        Parameters
        ----------
        resultant : (n,) array, the force that all of them exert
        carrying, may : contacts whose forces have any sign, and contacts that can push
        """
        free = np.concatenate([np.isin(self._contacts, carrying), np.ones(len(self.rows) - len(self._contacts), bool)])
        _, sizes, basis = np.linalg.svd(self.rows[free], full_matrices=False)
        held = basis[sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0)]
        places = np.flatnonzero(np.isin(self._contacts, np.setdiff1d(may, carrying)))
        told = (resultant * self._unit)[self._felt]
        rest, rows = (one - (one @ held.T) @ held for one in (told, self.rows[places]))
        pushing = np.linalg.norm(rows, axis=1) > DEPENDENT_ROWS
        size = np.linalg.norm(rest)
        if not (pushing.any() and size > CARRIES * np.linalg.norm(told)):
            return carrying[:0]
        force, _ = forces_without_tension(rows[pushing], rest / size, np.ones(int(pushing.sum()), dtype=bool))
        return np.asarray(self._contacts[places[pushing][force > CARRIES]], dtype=np.intp)

    def stay(self, resultant: Vector, gap: Vector, tie_value: Vector) -> Indices | None:
        """Return the contacts that stay closed as gaps (m,) and tie values (k,) change, None if impossible."""
        from scipy.optimize import linprog

        cost = self._cost(gap, tie_value)
        least, span, told = self._least(resultant, cost)
        if least.status != 0:
            return None
        span, told = np.vstack([span, cost]), np.append(told, least.fun)
        stays = []
        for place, contact in enumerate(self._contacts):
            most = linprog(-np.eye(len(cost))[place], A_eq=span, b_eq=told, bounds=self._limits)
            if most.status == 3 or (most.status == 0 and -most.fun > SEEN):
                stays.append(contact)
        return np.array(stays, dtype=np.intp)

    def alone(self, contacts: Indices, resultant: Vector) -> tuple[Vector, Array]:
        """Return forces of these contacts alone with this resultant, and a basis (q, p) of what may be added."""
        ties = np.ones(len(self.rows) - len(self._contacts), dtype=bool)
        places = np.concatenate([np.isin(self._contacts, contacts), ties])
        rows, lengths = self.rows[places], self._lengths[places]
        force = np.linalg.lstsq(rows.T, (resultant * self._unit)[self._felt], rcond=DEPENDENT_ROWS)[0]
        turned, sizes, _ = np.linalg.svd(rows)
        more = turned[:, int(np.sum(sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0))) :]
        more = np.where(abs(more) > DEPENDENT_ROWS, more, 0.0)  # rounding of unique forces
        return (force / lengths)[: len(contacts)], (more / lengths[:, None])[: len(contacts)]

    def reach(self, resultant: Vector, rate: Vector) -> float:
        """Return the largest step x for which contacts can exert resultant + x rate without tension."""
        return longest_step(self._basis @ self.rows.T, self._projected(resultant), self._projected(rate), self._limits)


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


def _rank(rows: Array) -> int:
    sizes = np.linalg.svd(rows, compute_uv=False) if rows.size else np.zeros(0)
    return int(np.sum(sizes > DEPENDENT_ROWS * np.max(sizes, initial=0.0)))


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
