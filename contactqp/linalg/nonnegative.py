"""The dual of a strictly convex contact problem: min 1/2 l'Wl - h'l over l_i >= 0 for contacts, l_i free for ties.

The dual active-set method of Goldfarb and Idnani (1983) in terms of W: each step closes the most penetrated contact and
opens those whose force it drives through zero, so the energy rises strictly and no set of contacts comes twice. It
ends after finitely many steps, with redundant contacts too: a row that depends on closed ones replaces one of them
instead of joining them.

Linear programs are solved by HiGHS, as `scipy.optimize.linprog` calls it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.model.arrays import Array, Indices, Mask, Vector

# W has a unit diagonal: a row whose own compliance falls below this once the closed contacts are held depends on them.
DEPENDENT = 1e-11
# A shift within gaps may overshoot them by this part of its lengths: a few roundings.
SHIFT_SLACK = 1e-15
# Forces of a linear program beneath this part of what they carry are none.
CARRIES = 1e-9
# Steps of the simplex method for every row and unknown: programs that end take one or two.
SECONDS, LEAST_STEPS, STEPS_OF_A_ROW = 20.0, 1000, 5
# HiGHS' simplex method has ended processes ("double free") on costs of 1e12.
HIGHEST_COST = 1e9


class Infeasible(Exception):
    """The rows of the set and the one that was to join them conflict, to the accuracy of W."""

    def __init__(self, rows: list[int]) -> None:
        super().__init__()
        self.rows = np.array(sorted(rows), dtype=np.intp)


def dual_active_set(W: Array, h: Vector, free: Mask, tolerance: Vector, max_steps: int) -> tuple[Vector, int, bool]:
    """Find forces l with l >= 0 off `free` and h - W l <= tolerance; return them, the steps, and whether it ended.

    Raises Infeasible: no forces exist: the rows conflict.

    Parameters
    ----------
    W : (q, q) array, positive semidefinite, unit diagonal
    h : (q,) array, excess of each row without forces
    free : (q,) bool, rows whose force has no sign (ties); their excess ends at zero
    tolerance : (q,) array, excess that counts as closed
    max_steps : int
    """
    force = np.zeros(len(h))
    active = _independent(W, np.flatnonzero(free))
    if active:
        force[active] = np.linalg.solve(W[np.ix_(active, active)], h[active])
    for step in range(max_steps):
        excess = np.where(free, 0.0, h - W @ force - tolerance)
        excess[active] = 0.0
        i = int(np.argmax(excess)) if len(excess) else -1
        if i < 0 or excess[i] <= 0:
            return force, step, True
        _close(W, h, force, active, i, free)
    return force, max_steps, False


def _close(W: Array, h: Vector, force: Vector, active: list[int], i: int, free: Mask) -> None:
    """Raise the force of row i until its excess is gone, dropping rows whose force reaches zero on the way."""
    while True:
        drag = np.linalg.solve(W[np.ix_(active, active)], W[active, i]) if active else np.zeros(0)
        compliance = W[i, i] - W[i, active] @ drag
        excess = h[i] - W[i] @ force
        full = excess / compliance if compliance > DEPENDENT else np.inf
        falling = [k for k, j in enumerate(active) if not free[j] and drag[k] > 0]
        ratios = [force[active[k]] / drag[k] for k in falling]
        partial = min(ratios, default=np.inf)
        step = min(full, partial)
        if not np.isfinite(step):
            raise Infeasible([*active, i])
        force[active] -= step * drag
        force[i] += step
        if step == full:
            active.append(i)
            return
        dropped = active.pop(falling[int(np.argmin(ratios))])
        force[dropped] = 0.0


def _independent(W: Array, rows: Indices) -> list[int]:
    """Return the rows that do not depend on rows before them."""
    chosen: list[int] = []
    for i in rows:
        held = W[np.ix_(chosen, chosen)]
        drag = np.linalg.solve(held, W[chosen, i]) if chosen else np.zeros(0)
        if W[i, i] - W[i, chosen] @ drag > DEPENDENT:
            chosen.append(int(i))
    return chosen


def forces_without_tension(rows: Array, resultant: Vector, pushing_only: Mask) -> tuple[Vector, float]:
    """Return forces l (q,), not negative on `pushing_only`, for which |rows'l - resultant| is least, and this residual.

    The residual is NaN where the least squares of Lawson and Hanson (1974) ended without an answer.
    """
    from scipy.optimize import nnls

    columns = np.vstack([rows, -rows[~pushing_only]]).T
    try:
        share, residual = nnls(columns, resultant, maxiter=30 * columns.shape[1])
    except RuntimeError:  # too many steps
        return np.zeros(len(rows)), np.nan
    force = share[: len(rows)].copy()
    force[~pushing_only] -= share[len(rows) :]
    return force, float(residual)


def shift_within_gaps(rows: Array, gap: Vector, wanted: Vector) -> Vector:
    """Return the nearest shift that leaves no contact penetrated: min |a - wanted| subject to rows a <= gap.

    Where there is none, as between contacts that touch on both sides and are penetrated by rounding, those that are
    penetrated stay so.
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
    """Return rows and limits of a linear program as `highs` takes them, "ub" or "eq"; nothing where there are none."""
    return {f"A_{kind}": rows, f"b_{kind}": limits} if rows.shape[0] else {}


def highs(cost: Vector, **constraints: Any) -> Any:
    """Solve a linear program as `linprog` takes it by the simplex method; None where it fails or costs are high."""
    from scipy.optimize import linprog

    if not np.max(abs(cost), initial=0.0) <= HIGHEST_COST:
        return None
    size = len(cost) + sum(len(constraints.get(limits, ())) for limits in ("b_ub", "b_eq"))
    options = dict.fromkeys(("primal_feasibility_tolerance", "dual_feasibility_tolerance"), CARRIES)
    options |= {"time_limit": SECONDS, "maxiter": LEAST_STEPS + STEPS_OF_A_ROW * size}
    try:
        found = linprog(cost, method="highs-ds", options=options, **constraints)
    except ValueError:
        return None
    return found if found.x is not None and found.status == 0 else None
