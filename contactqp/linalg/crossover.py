"""Vertices: which of closed contacts that depend on each other carry the load, and which only touch.

Where more contacts close than the unknowns can tell apart, an interior point spreads the load over all of them, and
rounding of the data makes their gaps contradict each other: to hold all of them closed at once is impossible in the
last digits. A linear program, scaled to what they contradict each other by, goes to a vertex (the crossover of interior
point methods, Megiddo 1991; the scaling is that of iterative refinement, Gleixner, Steffy and Wolter 2016).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.extended import ExtendedAnswer, extend, extended_rows, residuals_of
from contactqp.linalg.sparse_saddle import ClosedState, Effort, nearest_state, solved_on
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem

# Forces of a linear program beneath this part of what they carry are none.
CARRIES = 1e-9
# Closed contacts and ties that are met to this part of the largest length do not contradict each other: it is far
# beyond all rounding of doubles.
MET_TOGETHER = 1e-20
# Unknowns move by so many times what contradicts at most, and open contacts that near may close.
FARTHEST = 1e3
SECONDS = 20.0


def with_least_forces(state: ClosedState, effort: Effort) -> ClosedState:
    """Return the state with the least sum of forces that its closed contacts can have, none of them tension.

    Repeated rows may share a force in ways without end, and an interior point may have pressed them against each other
    without bound. A linear program chooses contacts that carry it; the answer is solved anew on these.
    """
    problem, closed = state.problem, np.flatnonzero(state.closed)
    carried = _carried(problem, state.answer)
    size = float(np.max(abs(carried), initial=0.0)) or 1.0
    count, ties = len(closed), problem.ties
    found = _solved(
        np.concatenate([np.ones(count), np.zeros(ties)]),
        A_eq=sp.hstack([problem.normal[closed].T, problem.tie.T], format="csr"),
        b_eq=carried / size,
        bounds=[(0, None)] * count + [(None, None)] * ties,
    )
    if found is None:
        return state
    force, kept = np.zeros(problem.contacts), state.closed.copy()
    force[closed] = size * found.x[:count]
    kept[closed] = found.x[:count] > CARRIES
    start = ExtendedAnswer(state.answer.displacement, extend(force), extend(size * found.x[count:]))
    least = solved_on(problem, kept, start, effort)
    return least if least.holds else state


def without_conflict(state: ClosedState, effort: Effort) -> ClosedState:
    """Return a state that holds closed only contacts that can be closed together, if there is one."""
    if not state.solved or state.length_residual <= MET_TOGETHER:
        return state
    conflict = state.length * state.length_residual
    vertex = vertex_near(state.problem, state.answer, conflict, effort)
    if vertex is None or not vertex.holds or vertex.residual > max(MET_TOGETHER, state.force_residual):
        return state
    return vertex


def vertex_near(problem: ContactProblem, answer: ExtendedAnswer, length: float, effort: Effort) -> ClosedState | None:
    """Return the state at the vertex that is nearest to an answer, in units of a length by which it may be off.

    From gaps g - E u and ties b - A u that the answer leaves, the change v of u in units of this length d solves

        minimise  (K u - f)' v    subject to    E v <= (g - E u) / d,    A v = (b - A u) / d,    |v_j| <= FARTHEST

    whose multipliers are the forces; contacts without one only touch, and may open.
    """
    left = residuals_of(extended_rows(problem), problem, answer)
    gap, tie = left.gap.double() / length, left.tie.double() / length
    if not problem.contacts:
        return None  # ties leave no choice
    near = np.flatnonzero(gap <= FARTHEST)
    carried = _carried(problem, answer)
    size = float(np.max(abs(carried), initial=0.0)) or 1.0
    found = _solved(
        -carried / size,
        **_given("ub", problem.normal[near], gap[near]),
        **_given("eq", problem.tie, tie),
        bounds=(-FARTHEST, FARTHEST),
    )
    if found is None:
        return None
    force, closed = np.zeros(problem.contacts), np.zeros(problem.contacts, dtype=bool)
    force[near] = -size * found.ineqlin.marginals if len(near) else 0.0
    closed[near] = force[near] > 0
    of_ties = -size * found.eqlin.marginals if problem.ties else np.zeros(0)
    start = ExtendedAnswer(answer.displacement + extend(length * found.x), extend(force), extend(of_ties))
    return nearest_state(problem, closed, start, effort)


def _carried(problem: ContactProblem, answer: ExtendedAnswer) -> Vector:
    """Return f - K u (n,), which the forces of contacts and ties balance [force]."""
    none = extend(np.zeros(problem.contacts)), extend(np.zeros(problem.ties))
    resting = ExtendedAnswer(answer.displacement, *none)
    return residuals_of(extended_rows(problem), problem, resting).force.double()


def _given(kind: str, rows: Any, limits: Vector) -> dict[str, Any]:
    return {f"A_{kind}": rows, f"b_{kind}": limits} if rows.shape[0] else {}


def _solved(cost: Vector, **constraints: Any) -> Any:
    """Solve a linear program by the simplex method; None where it fails or returns a number that is not finite."""
    from scipy.optimize import linprog

    options = {"time_limit": SECONDS, "primal_feasibility_tolerance": CARRIES, "dual_feasibility_tolerance": CARRIES}
    try:
        found = linprog(cost, method="highs-ds", options=options, **constraints)
    except ValueError:
        return None
    return found if found.x is not None and found.status == 0 else None
