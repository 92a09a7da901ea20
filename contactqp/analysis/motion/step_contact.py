"""Solve the contact problem of a time step: one factorisation for all steps, and one back-substitution and a small
problem in each.

A scheme states every step as a `ContactProblem` with the same stiffness and rows,

    K x + E_N'l_N + E_T'l_T + A'nu = f,    E_N x <= g,  l_N >= 0,  l_N (g - E_N x) = 0,    A x = b

with Coulomb's law for l_T. x is a displacement or a velocity, l a force or an impulse, depending on the scheme. Without
friction the forces follow from the Delassus operator W of the step,

    gap = c + W l >= 0,  l >= 0,  l gap = 0:        min 1/2 l'Wl + c'l over l >= 0

with c (m,) the gap without contact forces. The search starts from the active set of the previous step; other methods
solve the same minimisation as a separate problem, whose multipliers are the gaps. With friction the forces r (m, d) on
the body, contact by contact in the order (N, T), and gaps and slips u satisfy

    u = W r + c,    r_N >= 0,  u_N >= 0,  r_N u_N = 0,    |r_T| <= mu r_N,  r_T = -mu r_N u_T/|u_T| where u_T is not 0

In the plane the search starts from the states of the previous step; if this fails, and in space, a `LocalProblem` is
solved by the friction algorithms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import DenseCholesky
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.solving.solve import solve

# Ties are dependent if their scaled compliance (diagonal one) has a pivot below this.
DEPENDENT_TIES = 1e-10
# An unknown is at rest if its force S_jj x_j is below this part of the forces there: forces with friction have errors
# of some thousand roundings, and the tolerance of residuals is a thousand times larger.
AT_REST = 1e-12
# A force is rounding if its effect on its contact is below this part of all effects there.
NEGLIGIBLE_EFFECT = 16 * EPS
# A contact sticks if its friction is below its bound by this part.
STICKS = 1e-12
# Nonzero slips of sticking contacts above this part of the lengths are corrected.
SHARP = 1e-11
# The most contact unknowns for which the inverse is formed; a correction makes it as accurate as factors.
MOST_INVERTED = 60
# The most changes of the active set, and of frictional states; usually two or three suffice, else fallbacks are used.
MAX_CHANGES, MAX_STATE_CHANGES = 30, 10
# Gaps, slips and forces below this part of their terms are rounding.
ROUNDING_OF_STEPS = 1e-13
# The relative distance from the cone within which friction slips, and the number of refinements of forces.
ON_CONE, REFINEMENTS = 1e-9, 2
# The relative compliance added to contacts whose forces are otherwise unbounded.
SQUEEZED = 1e-13


@dataclass(frozen=True, eq=False)
class StepProblem:
    """The data of one step of a scheme; with a base the load is f - K base, which reduces cancellation."""

    load: Vector  # (n,) on x, or on x - base
    gap: Vector  # (m,); unused for contacts that are not closable
    closable: Mask | None = None  # (m,) contacts that the step may close; None: all
    slip_origin: Vector | None = None  # ((d-1) m,)
    tie_value: Vector | None = None  # (k,); None: zero
    base: Vector | None = None  # (n,)


@dataclass(frozen=True, eq=False)
class StepResult:
    """The unknown and the forces of one step, in the units of the scheme."""

    unknown: Vector  # x (n,)
    normal: Vector  # (m,)
    friction: Vector  # ((d-1) m,), zeros without friction
    tie: Vector  # (k,)
    increment: Vector  # x - base (n,)


class StepContact:
    """The solver of all steps of one template, with common stiffness, rows and friction."""

    def __init__(self, template: ContactProblem, method: str, options: dict[str, Any]) -> None:
        self.template, self._method, self._options = template, method, options
        self._condensation = condensation = condense(template)
        if condensation.rigid.count:
            raise InvalidProblem(
                "mass: together with the stiffness it leaves motions without any inertia or stiffness; this scheme "
                "needs a mass, or a stiffness, for every motion"
            )
        self._E, self._A = condensation.normal, condensation.tie
        self._pushed = np.zeros(template.contacts, dtype=bool)
        self._states = np.full(template.contacts, OPEN, dtype=np.int8)
        self._local: dict[bytes, LocalProblem] = {}  # in space, the last one, by the contacts that it is of
        self._frictional = template.frictional
        rows = self._E
        if template.frictional and condensation.tangent is not None:
            self._T = condensation.tangent.toarray()
            rows = self._local_rows()
        self._tangents = len(self._T) if template.frictional else 0
        self._rows = rows
        self._prepare_ties()
        if options:
            self._refuse_options()
        self._W = rows @ self._compliance(rows.T)

    @property
    def factorisations(self) -> int:
        return self._condensation.factorisations

    @property
    def back_substitutions(self) -> int:
        return self._condensation.back_substitutions

    def _local_rows(self) -> Array:
        """Return the rows (d m, p) that map x to gaps and slips, contact by contact -E_N before E_T."""
        m = self.template.contacts
        width = len(self._T) // max(m, 1)
        rows = np.empty((m, 1 + width, self._E.shape[1]))
        rows[:, 0], rows[:, 1:] = -self._E, self._T.reshape(m, width, -1)
        return rows.reshape(-1, self._E.shape[1])

    def _refuse_options(self) -> None:
        """Raise InvalidProblem for options that the method refuses, before the motion begins."""
        if self._frictional:
            width = 1 + len(self._T) // self.template.contacts
            still, pressed = np.array([OPEN], dtype=np.int8), -np.eye(width)[0]
            frictional_forces(np.eye(width), pressed, np.ones(1), still, self._method, self._options)
        else:
            normal_forces(np.eye(1), -np.ones(1), np.zeros(1, dtype=bool), self._method, self._options)

    def _prepare_ties(self) -> None:
        self._tied: DenseCholesky | None = None
        if not len(self._A):
            return
        self._of_ties = self._respond(self._A.T)
        self._tied = DenseCholesky(self._A @ self._of_ties)
        if self._tied.smallest_pivot < DEPENDENT_TIES:
            raise InvalidProblem("tie: expected independent rows, got rows that say the same or contradict each other")

    @cached_property
    def _inverse(self) -> Array:
        """Return S^-1 for few unknowns, as a product costs less than a call of LAPACK."""
        return self._solved(np.eye(len(self._condensation.schur)))

    def _solved(self, right: Array) -> Array:
        scale = self._condensation.scale
        return np.asarray((self._condensation.schur_factor.solve((right.T * scale).T).T * scale).T)

    def _respond(self, right: Array) -> Array:
        """Return S^-1 right, without ties."""
        if not len(right) or len(right) > MOST_INVERTED:
            return self._solved(right) if len(right) else right
        x = self._inverse @ right
        return np.asarray(x + self._inverse @ (right - self._condensation.schur @ x))

    def _compliance(self, right: Array) -> Array:
        """Return the response of the contact unknowns to loads on them, with ties satisfied."""
        if not right.size:
            return right.copy()
        x = self._respond(right)
        if self._tied is not None:
            x = x - self._of_ties @ self._tied.solve(self._A @ x)
        return x

    def solve(self, posed: StepProblem) -> StepResult:
        """Return x and the forces of one step.

        Raises
        ------
        NotConverged, NotCertified, BackendFailed
            As `solve`, for the small problem.
        """
        condensation, template = self._condensation, self.template
        reduced, inner = condensation.reduce_passing_load(posed.load)
        free = self._respond(reduced)
        gap, origin, value = self._limits(posed)
        tie = np.zeros(template.ties)
        if self._tied is not None:
            tie = self._tied.solve(self._A @ free - value)
            free = free - self._of_ties @ tie
        normal, friction = self._forces(gap - self._E @ free, posed.closable, free, origin)
        if normal.any():
            if self._frictional:
                normal, friction = self._without_negligible(normal, friction, gap - self._E @ free)
            response, change = self._response(normal, friction)
            if self._frictional and normal.any():
                better = self._sharpened(normal, friction, free - response, gap, origin)
                if better is not None:
                    normal, friction = better
                    response, change = self._response(normal, friction)
            size = abs(self._E).T @ normal
            if self._frictional:
                size = size + abs(self._T).T @ abs(friction)
            tie, free = tie - change, free - response
            # Unknowns that come to rest are set to zero exactly, without the rounding of forces.
            free[condensation.schur.diagonal() * abs(free) <= AT_REST * (abs(reduced) + size)] = 0.0
        x = condensation.expand(free, inner)
        return StepResult(x if posed.base is None else posed.base + x, normal, friction, tie, x)

    def _response(self, normal: Vector, friction: Vector) -> tuple[Vector, Vector]:
        """Return the displacement and the tie forces (k,) due to contact forces."""
        pull = self._E.T @ normal
        if self._frictional:
            pull = pull + self._T.T @ friction
        response = self._respond(pull)
        if self._tied is None:
            return response, np.zeros(len(self._A))
        change = self._tied.solve(self._A @ response)
        return response - self._of_ties @ change, change

    def _without_negligible(self, normal: Vector, friction: Vector, c: Vector) -> tuple[Vector, Vector]:
        """Return the forces without those whose effect on their contact is below the rounding of all effects there.

        All rows of a contact, and the effects of its forces, have the same unit.
        """
        m = len(normal)
        width = 1 + len(friction) // m
        force = np.column_stack([normal, friction.reshape(m, width - 1)])
        own = self._W.diagonal().reshape(m, width) * abs(force)
        meeting = (abs(self._W) @ abs(force).ravel()).reshape(m, width)
        meeting[:, 0] += abs(c)
        negligible = own <= NEGLIGIBLE_EFFECT * np.max(meeting, axis=1, keepdims=True)
        pushless, frictionless = np.all(negligible, axis=1), np.all(negligible[:, 1:], axis=1)
        force[frictionless, 1:] = 0.0
        force[pushless] = 0.0
        return force[:, 0], force[:, 1:].ravel()

    def _sharpened(
        self, normal: Vector, friction: Vector, x: Vector, gap: Vector, origin: Any
    ) -> tuple[Vector, Vector] | None:
        """Return forces corrected by the residuals of closed contacts without slip, None without improvement.

        Forces have an error of some roundings of the largest, such as a weight. On a body at rest with only small
        forces this error would cause a motion.
        """
        m, width = len(normal), len(friction) // len(normal)
        size, bound = np.linalg.norm(friction.reshape(m, width), axis=1), self.template.friction * normal  # type: ignore[operator]
        sticks = (normal > 0) & (size < (1 - STICKS) * bound)
        residual = np.column_stack([gap - self._E @ x, (self._T @ x - origin).reshape(m, width)])
        lengths = abs(self._T) @ abs(x) + abs(origin)
        slips = np.max(abs(residual[:, 1:]), axis=1) > SHARP * np.max(lengths.reshape(m, width), axis=1)
        if not np.any(sticks & slips):
            return None
        change = correction(self._W, np.column_stack([normal, -friction.reshape(m, width)]), sticks, residual)
        sharp_normal, sharp_friction = normal + change[:, 0], friction - change[:, 1:].ravel()
        if np.any(sharp_normal < 0):
            return None
        return sharp_normal, sharp_friction

    def _limits(self, posed: StepProblem) -> tuple[Vector, Any, Any]:
        """Return gap, slip origin and tie value of x - base."""
        gap, origin = posed.gap, 0.0 if posed.slip_origin is None else posed.slip_origin
        value = 0.0 if posed.tie_value is None else posed.tie_value
        if posed.base is None:
            return gap, origin, value
        base = posed.base[self._condensation.retained]
        if self._frictional:
            origin = origin - self._T @ base
        return gap - self._E @ base, origin, value - self._A @ base

    def alone(self, posed: StepProblem) -> StepResult:
        """Return the result of `solve` for the whole problem of the step, refined beyond double precision."""
        gap, origin, value = self._limits(posed)
        gap = gap if posed.closable is None else np.where(posed.closable, gap, np.inf)
        step = self.template.replace(load=posed.load, gap=gap, tie_value=np.zeros(self.template.ties) + value)
        step = step.replace(slip_origin=np.zeros(self._tangents) + origin) if self._frictional else step
        found = solve(step, self._method, **self._options)
        friction = np.zeros(0) if found.friction_force is None else found.friction_force.ravel()[: self._tangents]
        x = found.displacement if posed.base is None else posed.base + found.displacement
        return StepResult(x, found.normal_force, friction, found.tie_force, found.displacement)

    def respond_closed(self, load: Vector, closed: Indices) -> Vector:
        """Return x under a load with some contacts kept closed, E_N x = 0, and ties at zero."""
        condensation = self._condensation
        reduced, inner = condensation.reduce_load(load)
        rows = np.vstack([self._E[closed], self._A])
        free = self._respond(reduced)
        response = self._respond(rows.T)
        force, *_ = np.linalg.lstsq(rows @ response, rows @ free, rcond=None)
        return condensation.expand(free - response @ force, inner)

    def _forces(self, c: Vector, closable: Mask | None, free: Vector, origin: Any) -> tuple[Vector, Vector]:
        """Return l_N and l_T of contacts whose gaps without forces are c."""
        m = self.template.contacts
        normal, friction = np.zeros(m), np.zeros(self._tangents)
        closing = c < 0 if closable is None else (c < 0) & closable
        if not closing.any():
            self._pushed[:] = False
            return normal, friction
        looked = np.arange(m) if closable is None else np.flatnonzero(closable)
        if self._frictional:
            self._add_friction(c, self._T @ free - origin, looked, normal, friction)
        else:
            W = self._W if len(looked) == m else self._W[np.ix_(looked, looked)]
            normal[looked] = normal_forces(W, c[looked], self._pushed[looked], self._method, self._options)
        self._pushed = normal > 0
        return normal, friction

    def _add_friction(self, c: Vector, slip: Vector, looked: Indices, normal: Vector, friction: Vector) -> None:
        """Fill in the forces of contacts with friction."""
        m, width = self.template.contacts, self._tangents // self.template.contacts
        offset = np.column_stack([c, slip.reshape(m, width)])[looked].ravel()
        rows = (looked[:, None] * (1 + width) + np.arange(1 + width)).ravel()
        coefficient = self.template.friction[looked]  # type: ignore[index]
        W, start = self._W[np.ix_(rows, rows)], self._states[looked]
        if width > 1 and (key := looked.tobytes()) not in self._local:
            self._local = {key: LocalProblem(delassus=W, offset=offset, friction=coefficient, dimension=1 + width)}
        last = self._local[key] if width > 1 else None
        pressed, dragged = frictional_forces(W, offset, coefficient, start, self._method, self._options, last)
        normal[looked] = np.maximum(pressed, 0.0)
        friction.reshape(m, width)[looked] = dragged
        self._states[:] = OPEN
        if width == 1:
            self._states[looked] = states_of(pressed, dragged, coefficient)


def normal_forces(W: Array, c: Vector, start: Mask, method: str, options: dict[str, Any]) -> Vector:
    """Return l (m,) [force] of frictionless contacts, starting from a guess of the active set.

    Parameters
    ----------
    W : (m, m) array
        The Delassus operator of the step.
    c : (m,) array
        Gaps without contact forces.
    start : (m,) mask
        Contacts that are taken to push at first.
    method, options
        Options of `solve`.
    """
    if method == "active-set" and not options and (found := _by_active_set(W, c, start)) is not None:
        return found
    dual = ContactProblem(stiffness=W, load=-c, normal=-np.eye(len(c)), gap=np.zeros(len(c)))
    try:
        return np.maximum(solve(dual, method, **options).displacement, 0.0)
    except (NoEquilibrium, NotCertified, NotConverged) as error:
        # For a body squeezed between contacts, rounding of c decides whether the forces are bounded.
        if (found := _by_active_set(W + np.diag(SQUEEZED * W.diagonal()), c, start)) is not None:
            return found
        if isinstance(error, NoEquilibrium):
            raise NotConverged(f"the contacts of the step leave no room: {error}") from error
        raise


def _by_active_set(W: Array, c: Vector, start: Mask) -> Vector | None:
    """Run the primal-dual active set (Hintermueller, Ito and Kunisch 2003); None if it cycles or W is singular."""
    pushes = start | (c < 0)
    force = np.zeros(len(c))
    for _ in range(MAX_CHANGES):
        force[:] = 0.0
        if len(c) == 1:
            if pushes[0]:
                force[0] = -c[0] / W[0, 0] if W[0, 0] > 0 else np.nan
        elif np.any(pushes):
            try:
                factor = np.linalg.cholesky(W[np.ix_(pushes, pushes)])
            except np.linalg.LinAlgError:
                return None
            force[pushes] = np.linalg.solve(factor.T, np.linalg.solve(factor, -c[pushes]))
        if not np.all(np.isfinite(force)):
            return None
        gap = c + W @ force
        size = abs(c) + abs(W) @ abs(force)
        wrong_force = pushes & (force < 0)
        wrong_gap = ~pushes & (gap < -ROUNDING_OF_STEPS * size)
        if not np.any(wrong_force) and not np.any(wrong_gap):
            return force
        pushes = (pushes & ~wrong_force) | wrong_gap
    return None


def frictional_forces(
    W: Array, c: Vector, friction: Vector, start: Status, method: str, options: dict[str, Any], like: Any = None
) -> tuple[Vector, Array]:
    """Return l_N (m,) and l_T (m, d-1) [force], positive in compression, and as forces on the obstacle.

    Parameters
    ----------
    W, c : (d m, d m), (d m,) arrays
    friction : (m,) array
    start : (m,) array, the states of the step before
    method, options
        The method and options of `solve`; any method but the default solves the local problem.
    like : LocalProblem, optional, one with this W and friction, whose scales serve again
    """
    d = len(c) // len(friction)
    if d == 2 and method == "active-set" and not options and (found := _by_states(W, c, friction, start)) is not None:
        return found[:, 0], -found[:, 1:]
    if like is None:
        like = LocalProblem(delassus=W, offset=c, friction=friction, dimension=d)
    local = like.with_offsets(c, np.zeros(0))
    force = _refined(W, c, friction, np.array(solve(local, method, **options).force))
    return force[:, 0], -force[:, 1:]


def states_of(normal: Vector, friction: Array, coefficient: Vector) -> Status:
    """Return the states (m,) of forces in the plane; l_T of a contact in SLIP_ON is positive."""
    slips = abs(friction[:, 0]) >= (1 - ON_CONE) * coefficient * normal
    state = np.where(slips, np.where(friction[:, 0] >= 0, SLIP_ON, SLIP_BACK), STICK)
    return np.where(normal > 0, state, OPEN).astype(np.int8)


def correction(W: Array, force: Array, sticks: Mask, residual: Array) -> Array:
    """Return the change (m, d) of forces on the body that eliminates the residuals (m, d) of gaps and slips.

    States are unchanged, and forces of slipping contacts keep their directions.

    Parameters
    ----------
    W : (m d, m d) array, the Delassus operator of the step
    force : (m, d) array, forces on the body, contact by contact in the order (N, T)
    sticks : (m,) mask, contacts that stick
    residual : (m, d) array, gaps and slips that should vanish
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


def _by_states(W: Array, c: Vector, friction: Vector, start: Status) -> Array | None:
    """Return forces (m, 2) on the body that agree with their states, None if the states cycle."""
    m = len(friction)
    state = start.copy()
    size_of_c, seen = abs(c), set()
    slides = np.where(c[1::2] >= 0, SLIP_ON, SLIP_BACK)
    state[(state == OPEN) & (c[::2] < 0)] = slides[(state == OPEN) & (c[::2] < 0)]
    state[(friction == 0) & (state == STICK)] = SLIP_ON
    for _ in range(MAX_STATE_CHANGES):
        if state.tobytes() in seen:
            return None
        seen.add(state.tobytes())
        force = _in_states(W, c, friction, state)
        if force is None:
            return None
        u = (W @ force.ravel() + c).reshape(m, 2)
        size = ROUNDING_OF_STEPS * (abs(W) @ abs(force).ravel() + size_of_c).reshape(m, 2)
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


def _in_states(W: Array, c: Vector, friction: Vector, state: Status) -> Array | None:
    """Return forces (m, 2) with zero gaps of closed contacts and zero slips of sticking ones, None if not unique."""
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
    if not np.all(abs(residual) <= ON_CONE * size):  # numerically singular
        return None
    return np.asarray(force.reshape(m, 2))


def _refined(W: Array, c: Vector, friction: Vector, force: Array) -> Array:
    """Refine forces (m, d) on the body until closed gaps and sticking slips vanish up to rounding of their terms.

    Otherwise errors relative to the largest force may be as large as the velocities of a step with little motion.
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
