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
from contactqp.linalg.runtime import refuse_late
from contactqp.linalg.sparse_saddle import (
    BALANCED,
    ClosedState,
    Effort,
    nearest_state,
    solved_on,
    with_right_signs,
)
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
# Forces of so many times what is unbalanced stay; and how often what remains is balanced anew.
LARGE_FORCE, ROUNDS = 1e6, 6


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


def refined(state: ClosedState, effort: Effort) -> ClosedState:
    """Return a state in which contacts carry what the forces of a state leave unbalanced, if there is one.

    Forces far beneath the largest decide which contacts close at a degenerate vertex, and neither an interior point nor
    a linear program in the units of the problem tells them from nothing. In units d of the residual
    r = f - K u - E'l - A'nu and D of a length, the change v of u solves

        minimise  -(r + E_w' l_w)' v / d    subject to    E_s v = (g - E u)_s / D,    E_w v <= (g - E u)_w / D,
                                                          A v = (b - A u) / D,    |v_j| <= FARTHEST, d / (D K_jj)

    s being the contacts whose forces are large beside d, w the others, whose forces the multipliers replace.
    """
    problem = state.problem
    for _ in range(ROUNDS):
        if state.holds and state.force_residual <= BALANCED:
            break
        refuse_late("a vertex was found")
        force, length = state.left.force.double(), state.length / FARTHEST
        size = float(np.max(abs(force)))
        start = _vertex_in_units(state, size, length) if size > 0 else None
        if start is None:
            break
        closed = start.normal_force.double() > 0
        after = with_right_signs(solved_on(problem, closed, start, effort), effort)
        if not after.holds or (state.holds and not after.better_than(state)):
            break
        state = after
    return state


def _vertex_in_units(state: ClosedState, size: float, length: float) -> ExtendedAnswer | None:
    """Return the answer that the linear program of `refined` leads to in units of a force and a length."""
    problem, answer = state.problem, state.answer
    carried, gap = answer.normal_force.double(), state.left.gap.double() / length
    large = carried > LARGE_FORCE * size
    kept, others = np.flatnonzero(large), np.flatnonzero(~large)
    cost = -state.left.force.double() / size - problem.normal[others].T @ (carried[others] / size)
    equal = sp.vstack([problem.normal[kept], problem.tie], format="csr")
    yields = size / length / np.where(problem.diagonal > 0, problem.diagonal, np.finfo(float).tiny)
    farthest = np.minimum(FARTHEST, yields)
    found = _solved(
        cost,
        **_given("ub", problem.normal[others], gap[others]),
        **_given("eq", equal, np.concatenate([gap[kept], state.left.tie.double() / length])),
        bounds=np.column_stack([-farthest, farthest]),
    )
    if found is None:
        return None
    change, tie = np.zeros(problem.contacts), -size * found.eqlin.marginals if equal.shape[0] else np.zeros(0)
    change[others] = -size * found.ineqlin.marginals - carried[others] if len(others) else 0.0
    change[kept] = tie[: len(kept)]
    force = (answer.normal_force + extend(change)).positive_part()
    return ExtendedAnswer(
        answer.displacement + extend(length * found.x), force, answer.tie_force + extend(tie[len(kept) :])
    )


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
