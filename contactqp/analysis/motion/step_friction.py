"""Contact forces of one time step with Coulomb friction, from the Delassus operator of the step.

    u = W r + c,    r_N >= 0,  u_N >= 0,  r_N u_N = 0,
    |r_T| <= mu r_N,  r_T = -mu r_N u_T/|u_T| where u_T is not zero

r (m, d) are forces on the body, contact by contact in the order (N, T), u gaps and slips. In the plane the states of
the step before are where the search starts: a step is then a small linear system or two. What states do not settle,
and what turns in space, is a `LocalProblem` for the algorithms of friction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK
from contactqp.model.local_problem import LocalProblem
from contactqp.solving.solve import solve

States = NDArray[np.int8]  # (m,)

# Changes of states; they settle in two or three, and what cycles is left to an algorithm that cannot.
MAX_CHANGES = 10
# Gaps, slips and forces of this part of their own terms are rounding.
ROUNDING = 1e-13
# A friction force that is this near to the cone slips.
ON_CONE = 1e-9
REFINEMENTS = 2


def frictional_forces(
    W: Array, c: Vector, friction: Vector, start: States, method: str, options: dict[str, Any]
) -> tuple[Vector, NDArray[np.float64]]:
    """Return l_N (m,) and l_T (m, d-1) [force], positive in compression and what the body does to the obstacle.

    Parameters
    ----------
    W : (d m, d m) array
    c : (d m,) array
    friction : (m,) array
        mu.
    start : (m,) array
        The states of the step before.
    method, options
        Of `solve`, for the local problem; any but the default is what solves it.
    """
    m = len(friction)
    d = len(c) // m
    if d == 2 and method == "active-set" and not options:
        found = _by_states(W, c, friction, start)
        if found is not None:
            return found[:, 0], -found[:, 1:]
    local = LocalProblem(delassus=W, offset=c, friction=friction, dimension=d)
    force = _refined(W, c, friction, np.array(solve(local, method, **options).force))
    return force[:, 0], -force[:, 1:]


def states_of(normal: Vector, friction: Array, coefficient: Vector) -> States:
    """Return the states (m,) of forces in the plane; l_T of a contact in SLIP_ON is positive."""
    slips = abs(friction[:, 0]) >= (1 - ON_CONE) * coefficient * normal
    state = np.where(slips, np.where(friction[:, 0] >= 0, SLIP_ON, SLIP_BACK), STICK)
    return np.where(normal > 0, state, OPEN).astype(np.int8)


def correction(W: Array, force: Array, sticks: NDArray[np.bool_], residual: Array) -> Array:
    """Return the change (m, d) of forces on the body that removes the residuals (m, d) of gaps and slips.

    Contacts that push stay closed, sticking ones stuck; forces of those that slip keep their directions.

    Parameters
    ----------
    W : (m d, m d) array
        The Delassus operator of the step.
    force : (m, d) array
        Forces on the body, contact by contact in the order (N, T).
    sticks : (m,) mask
        Contacts that stick.
    residual : (m, d) array
        Gaps and slips that should vanish.
    """
    m, d = force.shape
    rows = np.zeros((m, d), dtype=bool)
    rows[:, 0], rows[:, 1:] = force[:, 0] > 0, sticks[:, None]
    constrained = np.flatnonzero(rows)
    columns = np.eye(m * d)[:, constrained]
    for column, i in enumerate(constrained):
        if i % d == 0 and not sticks[i // d]:
            columns[i : i + d, column] = force[i // d] / force[i // d, 0]
    change, *_ = np.linalg.lstsq(W[constrained] @ columns, -residual.ravel()[constrained], rcond=None)
    return np.asarray((columns @ change).reshape(m, d))


def _by_states(W: Array, c: Vector, friction: Vector, start: States) -> Array | None:
    """Return forces (m, 2) on the body that agree with their states, or None where the states cycle."""
    m = len(friction)
    state = start.copy()
    size_of_c, seen = abs(c), set()
    slides = np.where(c[1::2] >= 0, SLIP_ON, SLIP_BACK)
    state[(state == OPEN) & (c[::2] < 0)] = slides[(state == OPEN) & (c[::2] < 0)]
    state[(friction == 0) & (state == STICK)] = SLIP_ON
    for _ in range(MAX_CHANGES):
        if state.tobytes() in seen:
            return None
        seen.add(state.tobytes())
        force = _in_states(W, c, friction, state)
        if force is None:
            return None
        u = (W @ force.ravel() + c).reshape(m, 2)
        size = ROUNDING * (abs(W) @ abs(force).ravel() + size_of_c).reshape(m, 2)
        bound = friction * force[:, 0]
        closed, sign = state != OPEN, np.where(state == SLIP_BACK, -1.0, 1.0)
        opens = closed & (force[:, 0] < 0)
        closes = ~closed & (u[:, 0] < -size[:, 0])
        slips = (state == STICK) & (abs(force[:, 1]) > bound) & ~opens
        sticks = (abs(state) == SLIP_ON) & (friction > 0) & (sign * u[:, 1] < -size[:, 1]) & ~opens
        if not np.any(opens | closes | slips | sticks):
            return force
        state[opens], state[closes] = OPEN, slides[closes]
        state[slips] = np.where(force[slips, 1] <= 0, SLIP_ON, SLIP_BACK)
        state[sticks] = STICK
    return None


def _in_states(W: Array, c: Vector, friction: Vector, state: States) -> Array | None:
    """Return forces (m, 2) that close what is not open and stop what sticks, or None where they are not determined."""
    m = len(friction)
    rows = np.column_stack([state != OPEN, state == STICK]).ravel()
    constrained = np.flatnonzero(rows)
    columns = np.eye(2 * m)[:, constrained]
    pushed = constrained[constrained % 2 == 0]
    slope = np.where(state == SLIP_ON, -friction, np.where(state == SLIP_BACK, friction, 0.0))
    columns[pushed + 1, np.flatnonzero(constrained % 2 == 0)] += slope[pushed // 2]
    try:
        force = columns @ np.linalg.solve(W[constrained] @ columns, -c[constrained])
    except np.linalg.LinAlgError:
        return None
    residual = (W @ force + c)[constrained]
    size = (abs(W) @ abs(force) + abs(c))[constrained]
    if not np.all(abs(residual) <= ON_CONE * size):  # as good as singular
        return None
    return np.asarray(force.reshape(m, 2))


def _refined(W: Array, c: Vector, friction: Vector, force: Array) -> Array:
    """Refine forces (m, d) on the body until closed gaps and sticking slips vanish to rounding of their own terms.

    A step may hardly move what large forces hold: the answer to the contacts, right to a part of the largest force, is
    then no better than the velocities that are left.
    """
    pushes = force[:, 0] > 0
    sticks = pushes & (np.linalg.norm(force[:, 1:], axis=1) < (1 - ON_CONE) * friction * force[:, 0])
    if not np.any(pushes):
        return force
    for _ in range(REFINEMENTS):
        refined = force + correction(W, force, sticks, (W @ force.ravel() + c).reshape(force.shape))
        inside = np.linalg.norm(refined[:, 1:], axis=1) <= friction * refined[:, 0] * (1 + ON_CONE)
        if not np.all(refined[pushes, 0] > 0) or not np.all(inside | ~pushes):
            break
        force = refined
    return force
