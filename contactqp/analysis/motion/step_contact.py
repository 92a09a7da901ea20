"""Contact within one time step: one factorisation for all steps, one back-substitution and a small problem in each.

A scheme poses every step as a `ContactProblem` with the same stiffness and rows,

    K x + E_N'l_N + E_T'l_T + A'nu = f,    E_N x <= g,  l_N >= 0,  l_N (g - E_N x) = 0,    A x = b

with Coulomb's law for l_T. x is a displacement or a velocity, l a force or an impulse, whichever the scheme takes.

Contact forces with Coulomb friction come from the Delassus operator of the step,

    u = W r + c,    r_N >= 0,  u_N >= 0,  r_N u_N = 0,
    |r_T| <= mu r_N,  r_T = -mu r_N u_T/|u_T| where u_T is not zero

r (m, d) are forces on the body, contact by contact in the order (N, T), u gaps and slips. In the plane the states of
the step before are where the search starts: a step is then a small linear system or two. What states do not settle,
and what turns in space, is a `LocalProblem` for the algorithms of friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged
from contactqp.linalg.condensation import condense
from contactqp.linalg.factorization import DenseCholesky
from contactqp.model.arrays import Array, Vector
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.solving.solve import solve

OPEN, STICK, SLIP_ON, SLIP_BACK = 0, 1, 2, 3
States = NDArray[np.int8]  # (m,)

# Changes of states; they settle in two or three, and what cycles is left to an algorithm that cannot.
MAX_STATE_CHANGES = 10
# Gaps, slips and forces of this part of their own terms are rounding.
ROUNDING = 1e-13
# A friction force that is this near to the cone slips.
ON_CONE = 1e-9
REFINEMENTS = 2


def frictional_forces(
    W: Array, c: Vector, friction: Vector, start: States, method: str, options: dict[str, Any]
) -> tuple[Vector, NDArray[np.float64]]:
    """l_N (m,) and l_T (m, d-1) [force], positive in compression and what the body does to the obstacle.

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
    """The states (m,) of forces in the plane: l_T of a contact that slips on is positive."""
    slips = abs(friction[:, 0]) >= (1 - ON_CONE) * coefficient * normal
    state = np.where(slips, np.where(friction[:, 0] >= 0, SLIP_ON, SLIP_BACK), STICK)
    return np.where(normal > 0, state, OPEN).astype(np.int8)


def correction(W: Array, force: Array, sticks: NDArray[np.bool_], left: Array) -> Array:
    """The change (m, d) of forces on the body that takes away what is left (m, d) of gaps and slips.

    Contacts that push stay closed, sticking ones stuck; forces of those that slip keep their directions.
    """
    m, d = force.shape
    rows = np.zeros((m, d), dtype=bool)
    rows[:, 0], rows[:, 1:] = force[:, 0] > 0, sticks[:, None]
    held = np.flatnonzero(rows)
    way = np.eye(m * d)[:, held]
    for column, i in enumerate(held):
        if i % d == 0 and not sticks[i // d]:
            way[i : i + d, column] = force[i // d] / force[i // d, 0]
    change, *_ = np.linalg.lstsq(W[held] @ way, -left.ravel()[held], rcond=None)
    return np.asarray((way @ change).reshape(m, d))


def _by_states(W: Array, c: Vector, friction: Vector, start: States) -> Array | None:
    """Forces (m, 2) on the body whose states agree with what they do, None where the states cycle."""
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
        size = ROUNDING * (abs(W) @ abs(force).ravel() + size_of_c).reshape(m, 2)
        bound = friction * force[:, 0]
        closed, sign = state != OPEN, np.where(state == SLIP_BACK, -1.0, 1.0)
        opens = closed & (force[:, 0] < 0)
        closes = ~closed & (u[:, 0] < -size[:, 0])
        slips = (state == STICK) & (abs(force[:, 1]) > bound) & ~opens
        sticks = (state >= SLIP_ON) & (friction > 0) & (sign * u[:, 1] < -size[:, 1]) & ~opens
        if not np.any(opens | closes | slips | sticks):
            return force
        state[opens], state[closes] = OPEN, slides[closes]
        state[slips] = np.where(force[slips, 1] <= 0, SLIP_ON, SLIP_BACK)
        state[sticks] = STICK
    return None


def _in_states(W: Array, c: Vector, friction: Vector, state: States) -> Array | None:
    """Forces (m, 2) that close what is not open and stop what sticks; None where they are not determined."""
    m = len(friction)
    rows = np.column_stack([state != OPEN, state == STICK]).ravel()
    held = np.flatnonzero(rows)
    way = np.eye(2 * m)[:, held]
    pushed = held[held % 2 == 0]
    slope = np.where(state == SLIP_ON, -friction, np.where(state == SLIP_BACK, friction, 0.0))
    way[pushed + 1, np.flatnonzero(held % 2 == 0)] += slope[pushed // 2]
    try:
        force = way @ np.linalg.solve(W[held] @ way, -c[held])
    except np.linalg.LinAlgError:
        return None
    left = (W @ force + c)[held]
    size = (abs(W) @ abs(force) + abs(c))[held]
    if not np.all(abs(left) <= ON_CONE * size):  # as good as singular
        return None
    return np.asarray(force.reshape(m, 2))


def _refined(W: Array, c: Vector, friction: Vector, force: Array) -> Array:
    """Forces (m, d) on the body whose closed gaps and sticking slips vanish to rounding of their own terms.

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


# Contact forces of one time step without friction, from the Delassus operator of the step.
#
#     gap = c + W l >= 0,  l >= 0,  l gap = 0:        min 1/2 l'Wl + c'l over l >= 0
#
# c (m,) is the gap without contact forces. The active set of the step before is where the search starts; any other
# method is given the same minimum as a problem of its own, whose multipliers are the gaps.

# Changes of the active set; it settles in two or three, and what cycles is left to a method that cannot.
MAX_CHANGES = 30
# Compliance, as part of its own, that is given to contacts whose forces nothing else bounds.
SQUEEZED = 1e-13


def normal_forces(W: Array, c: Vector, start: NDArray[np.bool_], method: str, options: dict[str, Any]) -> Vector:
    """l (m,) [force] of frictionless contacts, started from a guess of those that push."""
    if method == "active-set" and not options:
        found = _by_active_set(W, c, start)
        if found is not None:
            return found
    dual = ContactProblem(stiffness=W, load=-c, normal=-np.eye(len(c)), gap=np.zeros(len(c)))
    try:
        return np.maximum(solve(dual, method, **options).displacement, 0.0)
    except (NoEquilibrium, NotCertified, NotConverged) as error:
        # Contacts that squeeze a body between them: a rounding of c decides whether the forces are bounded.
        found = _by_active_set(W + np.diag(SQUEEZED * W.diagonal()), c, start)
        if found is not None:
            return found
        if isinstance(error, NoEquilibrium):
            raise NotConverged(f"the contacts of the step leave no room: {error}") from error
        raise


def _by_active_set(W: Array, c: Vector, start: NDArray[np.bool_]) -> Vector | None:
    """The primal-dual active set (Hintermueller, Ito and Kunisch 2003); None where it cycles or W is singular."""
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
        wrong_gap = ~pushes & (gap < -ROUNDING * size)
        if not np.any(wrong_force) and not np.any(wrong_gap):
            return force
        pushes = (pushes & ~wrong_force) | wrong_gap
    return None


# Ties whose compliance on each other, scaled to a diagonal of one, has a pivot below this are dependent.
DEPENDENT = 1e-10
# An unknown whose own force S_jj x_j is this part of those that meet there is at rest: forces with friction are known
# to some thousand roundings, and what is tolerated of residuals is a thousand times as much.
AT_REST = 1e-12
# A force whose own effect on its contact is this part of all that moves it there is rounding.
DUST = 16 * np.finfo(float).eps
# A contact with friction that is less than its bound by this part sticks.
STICKS = 1e-12
# A slip that should be none is sharpened beyond this part of the lengths that meet there.
SHARP = 1e-11
# Up to so many contact unknowns have their inverse formed; a correction makes its answers as good as those of factors.
FEW = 60


@dataclass(frozen=True, eq=False)
class Posed:
    """What one step asks; where there is a base, the load is f - K base, which cancels less than f does."""

    load: Vector  # (n,) on x, or on x - base
    gap: Vector  # (m,); has no meaning where a contact is not looked at
    looked_at: NDArray[np.bool_] | None = None  # (m,) contacts that the step may close; None: all
    slip_origin: Vector | None = None  # ((d-1) m,)
    tie_value: Vector | None = None  # (k,); None: zero
    base: Vector | None = None  # (n,)


@dataclass(frozen=True, eq=False)
class Answered:
    """What a step answers, in the scheme's unknowns."""

    unknown: Vector  # x (n,)
    normal: Vector  # (m,)
    friction: Vector  # ((d-1) m,), zeros without friction
    tie: Vector  # (k,)
    increment: Vector  # x - base (n,)


class StepContact:
    """The steps of one template, whose stiffness, rows and friction are those of every step."""

    def __init__(self, template: ContactProblem, method: str, options: dict[str, Any]) -> None:
        self.template, self._method, self._options = template, method, options
        self._way = way = condense(template)
        if way.rigid.count:
            raise InvalidProblem(
                "mass: together with the stiffness it leaves motions without any inertia or stiffness; this scheme "
                "needs a mass, or a stiffness, for every motion"
            )
        self._E, self._A = way.normal, way.tie
        self._pushed = np.zeros(template.contacts, dtype=bool)
        self._states = np.full(template.contacts, OPEN, dtype=np.int8)
        self._frictional = template.frictional
        rows = self._E
        if template.frictional and way.tangent is not None:
            self._T = way.tangent.toarray()
            rows = self._local_rows()
        self._rubbing = len(self._T) if template.frictional else 0
        self._rows = rows
        self._prepare_ties()
        if options:
            self._refuse_options()
        self._W = rows @ self._compliance(rows.T)

    @property
    def factorisations(self) -> int:
        return self._way.factorisations

    @property
    def back_substitutions(self) -> int:
        return self._way.back_substitutions

    def _local_rows(self) -> Array:
        """(d m, p): contact by contact -E_N before E_T; they map x to gap and slip, forces on the body to loads."""
        m = self.template.contacts
        width = len(self._T) // max(m, 1)
        rows = np.empty((m, 1 + width, self._E.shape[1]))
        rows[:, 0], rows[:, 1:] = -self._E, self._T.reshape(m, width, -1)
        return rows.reshape(-1, self._E.shape[1])

    def _refuse_options(self) -> None:
        """What a method says of its options at the first contact it says before the motion begins."""
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
        if self._tied.smallest_pivot < DEPENDENT:
            raise InvalidProblem("tie: expected independent rows, got rows that say the same or contradict each other")

    @cached_property
    def _inverse(self) -> Array:
        """S^-1 of few unknowns: a product costs less than LAPACK's door."""
        return self._solved(np.eye(len(self._way.schur)))

    def _solved(self, right: Array) -> Array:
        scale = self._way.scale
        return np.asarray((self._way.schur_factor().solve((right.T * scale).T).T * scale).T)

    def _respond(self, right: Array) -> Array:
        """S^-1 right, without ties."""
        if not len(right) or len(right) > FEW:
            return self._solved(right) if len(right) else right
        x = self._inverse @ right
        return np.asarray(x + self._inverse @ (right - self._way.schur @ x))

    def _compliance(self, right: Array) -> Array:
        """The response of the contact unknowns to loads on them, ties held."""
        if not right.size:
            return right.copy()
        x = self._respond(right)
        if self._tied is not None:
            x = x - self._of_ties @ self._tied.solve(self._A @ x)
        return x

    def solve(self, posed: Posed) -> Answered:
        """x and the forces of one step.

        Raises
        ------
        NotConverged, NotCertified, BackendFailed
            As `solve`, of the small problem.
        """
        way, template = self._way, self.template
        reduced, inner = way.reduce_passing_load(posed.load)
        free = self._respond(reduced)
        gap, origin, value = self._limits(posed)
        tie = np.zeros(template.ties)
        if self._tied is not None:
            tie = self._tied.solve(self._A @ free - value)
            free = free - self._of_ties @ tie
        normal, friction = self._forces(gap - self._E @ free, posed.looked_at, free, origin)
        if normal.any():
            if self._frictional:
                normal, friction = self._without_dust(normal, friction, gap - self._E @ free)
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
            # What comes to rest does so exactly, and not up to the rounding of the forces that stop it.
            free[way.schur.diagonal() * abs(free) <= AT_REST * (abs(reduced) + size)] = 0.0
        x = way.expand(free, inner)
        return Answered(x if posed.base is None else posed.base + x, normal, friction, tie, x)

    def _response(self, normal: Vector, friction: Vector) -> tuple[Vector, Vector]:
        """What contact forces move, and the tie forces (k,) that they call up."""
        pull = self._E.T @ normal
        if self._frictional:
            pull = pull + self._T.T @ friction
        response = self._respond(pull)
        if self._tied is None:
            return response, np.zeros(len(self._A))
        change = self._tied.solve(self._A @ response)
        return response - self._of_ties @ change, change

    def _without_dust(self, normal: Vector, friction: Vector, c: Vector) -> tuple[Vector, Vector]:
        """Forces without those that move their own contact by less than the rounding of what moves it in all.

        All rows of a contact are in one unit of length, and so are the effects of its forces.
        """
        m = len(normal)
        width = 1 + len(friction) // m
        force = np.column_stack([normal, friction.reshape(m, width - 1)])
        own = self._W.diagonal().reshape(m, width) * abs(force)
        meeting = (abs(self._W) @ abs(force).ravel()).reshape(m, width)
        meeting[:, 0] += abs(c)
        dust = own <= DUST * np.max(meeting, axis=1, keepdims=True)
        pushless, rubless = np.all(dust, axis=1), np.all(dust[:, 1:], axis=1)
        force[rubless, 1:] = 0.0
        force[pushless] = 0.0
        return force[:, 0], force[:, 1:].ravel()

    def _sharpened(
        self, normal: Vector, friction: Vector, x: Vector, gap: Vector, origin: Any
    ) -> tuple[Vector, Vector] | None:
        """Forces corrected by what is left at contacts that push and do not slip, or None where nothing is to be had.

        Forces are known to some roundings of the largest, such as a weight. Where others are all that acts on a body
        that comes to rest, that moves it, by a rounding that is as large as anything that moves there.
        """
        m, width = len(normal), len(friction) // len(normal)
        size, bound = np.linalg.norm(friction.reshape(m, width), axis=1), self.template.friction * normal  # type: ignore[operator]
        sticks = (normal > 0) & (size < (1 - STICKS) * bound)
        left = np.column_stack([gap - self._E @ x, (self._T @ x - origin).reshape(m, width)])
        lengths = abs(self._T) @ abs(x) + abs(origin)
        slips = np.max(abs(left[:, 1:]), axis=1) > SHARP * np.max(lengths.reshape(m, width), axis=1)
        if not np.any(sticks & slips):
            return None
        change = correction(self._W, np.column_stack([normal, -friction.reshape(m, width)]), sticks, left)
        sharp_normal, sharp_friction = normal + change[:, 0], friction - change[:, 1:].ravel()
        if np.any(sharp_normal < 0):
            return None
        return sharp_normal, sharp_friction

    def _limits(self, posed: Posed) -> tuple[Vector, Any, Any]:
        """Gap, slip origin and tie value of x - base."""
        gap, origin = posed.gap, 0.0 if posed.slip_origin is None else posed.slip_origin
        value = 0.0 if posed.tie_value is None else posed.tie_value
        if posed.base is None:
            return gap, origin, value
        base = posed.base[self._way.retained]
        if self._frictional:
            origin = origin - self._T @ base
        return gap - self._E @ base, origin, value - self._A @ base

    def held(self, load: Vector, closed: NDArray[np.intp]) -> Vector:
        """x under a load with some contacts held closed, E_N x = 0, and ties at zero."""
        way = self._way
        reduced, inner = way.reduce_load(load)
        rows = np.vstack([self._E[closed], self._A])
        free = self._respond(reduced)
        response = self._respond(rows.T)
        force, *_ = np.linalg.lstsq(rows @ response, rows @ free, rcond=None)
        return way.expand(free - response @ force, inner)

    def _forces(
        self, c: Vector, looked_at: NDArray[np.bool_] | None, free: Vector, origin: Any
    ) -> tuple[Vector, Vector]:
        """l_N and l_T of contacts whose gaps without forces are c."""
        m = self.template.contacts
        normal, friction = np.zeros(m), np.zeros(self._rubbing)
        closing = c < 0 if looked_at is None else (c < 0) & looked_at
        if not closing.any():
            self._pushed[:] = False
            return normal, friction
        looked = np.arange(m) if looked_at is None else np.flatnonzero(looked_at)
        if self._frictional:
            self._rub(c, self._T @ free - origin, looked, normal, friction)
        else:
            W = self._W if len(looked) == m else self._W[np.ix_(looked, looked)]
            normal[looked] = normal_forces(W, c[looked], self._pushed[looked], self._method, self._options)
        self._pushed = normal > 0
        return normal, friction

    def _rub(self, c: Vector, slip: Vector, looked: NDArray[np.intp], normal: Vector, friction: Vector) -> None:
        """Fill in the forces of contacts with friction."""
        m, width = self.template.contacts, self._rubbing // self.template.contacts
        offset = np.column_stack([c, slip.reshape(m, width)])[looked].ravel()
        rows = (looked[:, None] * (1 + width) + np.arange(1 + width)).ravel()
        coefficient = self.template.friction[looked]  # type: ignore[index]
        W, start = self._W[np.ix_(rows, rows)], self._states[looked]
        pressed, rubbed = frictional_forces(W, offset, coefficient, start, self._method, self._options)
        normal[looked] = np.maximum(pressed, 0.0)
        friction.reshape(m, width)[looked] = rubbed
        self._states[:] = OPEN
        if width == 1:
            self._states[looked] = states_of(pressed, rubbed, coefficient)
