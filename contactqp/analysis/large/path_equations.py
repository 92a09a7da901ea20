"""Compute equilibria of unknown load: equilibrium on a set of closed contacts with an additional equation, the
control.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.large.active_kkt import determinant_sign, solve_system
from contactqp.analysis.large.constrained_newton import Balance
from contactqp.analysis.large.deformation import Forces, Instant, LoadedBody, NewtonIteration
from contactqp.analysis.large.newton_step import NewtonSettings, Target, stationary_step
from contactqp.errors import InvalidProblem, NotConverged
from contactqp.model.arrays import Mask, Vector, refuse_late

# The most Newton steps; on a fixed set a few suffice, or it fails.
ITERATIONS = 20
# The least cosine of the angle between directions of successive points on a path.
SHARP = 0.5


class Control(Protocol):
    """The equation c(u, t) = 0 that determines a point of the path; c is a length."""

    def value(self, now: Instant, t: float) -> float:
        """Return c [length]."""

    def row(self, now: Instant, t: float) -> tuple[Vector, float]:
        """Return dc/du and dc/dt."""


@dataclass(frozen=True, eq=False)
class Sphere:
    """The distance from a point of the path: |u - u_0|^2 + scale^2 (t - t_0)^2 = radius^2 (Crisfield 1981)."""

    displacement: Vector
    load_factor: float
    scale: float
    radius: float

    def value(self, now: Instant, t: float) -> float:
        """Return (distance^2 - radius^2) / (2 radius)."""
        apart, rise = now.displacement - self.displacement, self.scale * (t - self.load_factor)
        return float(apart @ apart + rise * rise - self.radius**2) / (2 * self.radius)

    def row(self, now: Instant, t: float) -> tuple[Vector, float]:
        """Return (u - u_0) / radius and scale^2 (t - t_0) / radius."""
        return (now.displacement - self.displacement) / self.radius, self.scale**2 * (
            t - self.load_factor
        ) / self.radius


@dataclass(frozen=True, eq=False)
class Unknown:
    """The control that prescribes the value of one unknown."""

    place: int
    wanted: float

    def value(self, now: Instant, t: float) -> float:  # noqa: ARG002
        """Return u_j minus the prescribed value."""
        return float(now.displacement[self.place] - self.wanted)

    def row(self, now: Instant, t: float) -> tuple[Vector, float]:  # noqa: ARG002
        """Return the unit vector j, and 0."""
        row = np.zeros(len(now.displacement))
        row[self.place] = 1.0
        return row, 0.0


@dataclass(frozen=True, eq=False)
class Touch:
    """The control that a contact touches without force, where it closes or opens."""

    contact: int

    def value(self, now: Instant, t: float) -> float:  # noqa: ARG002
        """Return minus the gap of the contact."""
        return -float(now.contact.gap[self.contact])

    def row(self, now: Instant, t: float) -> tuple[Vector, float]:  # noqa: ARG002
        """Return the contact's row of E_N, and 0."""
        return np.asarray(now.contact.normal[[self.contact]].toarray())[0], 0.0


@dataclass(frozen=True, eq=False)
class PathPoint:
    """An equilibrium of the path."""

    now: Instant
    load_factor: float
    forces: Forces
    balance: Balance | None = None

    @property
    def displacement(self) -> Vector:
        """Return the displacement u (n,) of a point on the path [length]."""
        return self.now.displacement


@dataclass(frozen=True, eq=False)
class Direction:
    """The tangent of a path, of length 1: |v|^2 + scale^2 t'^2 = 1."""

    displacement: Vector  # v
    load_factor: float  # t'
    normal: Vector  # (m,) rates of the normal forces
    tie: Vector
    sense: float  # sign of the determinant of the derivatives of the equations with this direction as the last row

    def turned(self) -> Direction:
        """Return the opposite direction along the path."""
        return Direction(-self.displacement, -self.load_factor, -self.normal, -self.tie, -self.sense)


@dataclass(frozen=True, eq=False)
class PathEquations:
    """f_int(u) + E_B' l + A' nu = t f, gap_B = 0, A u = b_0 + t b_1, and the control."""

    loaded: LoadedBody
    load: Vector  # f, at the load factor 1
    tie_start: Vector
    tie_rate: Vector
    settings: NewtonSettings
    scale: float  # length of one unit of load factor

    def target(self, t: float) -> Target:
        """Return load and tie values at a load factor."""
        return Target(t * self.load, self.tie_start + t * self.tie_rate)

    def point(
        self, u: Vector, t: float, forces: Forces, closed: Mask, control: Control, *, finished: bool = True
    ) -> PathPoint:
        """Return the equilibrium near a guess by Newton's method on the closed contacts, without checking open
        contacts.

        Parameters
        ----------
        u : (n,) array [length]
            The guess.
        t : float
            The load factor of the guess.
        forces : Forces
            The forces of contacts and ties in the guess; their curvature enters the first tangent.
        closed : (m,) mask
            The contacts whose gaps are zero.
        control : Control
            The last equation.
        finished : bool
            Whether the point is to have its `balance`, with the residuals of a step more.

        Raises
        ------
        NotConverged
        """
        started, iterations, B = time.perf_counter(), [], np.flatnonzero(closed)
        now = self._at(u)
        for _ in range(ITERATIONS):
            refuse_late("the next step of Newton's method")
            K = self.loaded.hessian(now, forces)
            c_u, c_t = control.row(now, t)
            open_tie = self.tie_start + t * self.tie_rate - self.loaded.tie @ now.displacement
            right = [t * self.load - now.internal, now.contact.gap[B], open_tie, np.array([-control.value(now, t)])]
            matrix = self._bordered(K, now, B, c_u, np.zeros(len(B)), c_t)
            du, normal, tie, dt = self._split(solve_system(matrix, np.concatenate(right)), B)
            before, t = now, float(t + dt)
            now, forces = self._at(before.displacement + du), Forces(normal, tie)
            target = self.target(t)
            off = self.loaded.tie @ now.displacement - target.tie_value
            errors = np.abs(np.concatenate([now.contact.gap[B], off, np.array([control.value(now, t)])]))
            allowed = now.contact.rounding
            rounding = np.concatenate([allowed[B], np.zeros(len(off)), np.max(allowed, initial=0.0, keepdims=True)])
            residual = self.loaded.imbalance(now, K, target.load, forces, errors, rounding, self.settings.tolerance)
            iterations.append(NewtonIteration(residual.force, residual.length, 1.0, 0.0, changed=False))
            if residual.nothing:
                if not finished:
                    return PathPoint(now, t, forces)
                grazing = control.contact if isinstance(control, Touch) else None
                step = stationary_step(self.loaded, before, K, target, du, forces, grazing)
                spent = time.perf_counter() - started
                return PathPoint(now, t, forces, Balance(now, forces, before, step, tuple(iterations), spent))
        raise NotConverged(f"Newton's method: {ITERATIONS} iterations leave {residual.size:.3g} of forces and lengths")

    def direction(
        self, point: PathPoint, closed: Mask, row: Vector, row_t: float, row_forces: Vector | None = None
    ) -> Direction:
        """Return the tangent of the path on a set of closed contacts with positive row.v + row_t t' + ...

        Parameters
        ----------
        point : PathPoint
            Where the tangent is taken.
        closed : (m,) mask
            The contacts that stay closed.
        row, row_t : (n,) array, float
            The coefficients of the rates of displacement and load factor in the sum whose sign is chosen.
        row_forces : (m,) array, optional
            Those of the rates of normal forces, zero by default.

        Raises
        ------
        NotConverged
            There is none, or several (a bifurcation).
        """
        B, now = np.flatnonzero(closed), point.now
        K = self.loaded.hessian(now, point.forces)
        forces = np.zeros(len(B)) if row_forces is None else row_forces[B]
        right = np.zeros(len(self.load) + len(B) + len(self.tie_rate) + 1)
        right[-1] = 1.0
        matrix = self._bordered(K, now, B, row, forces, row_t)
        v, normal, tie, rate = self._split(solve_system(matrix, right), B)
        size = max(float(np.max(abs(v), initial=0.0)), self.scale * abs(rate)) or 1.0
        length = size * float(np.hypot(np.linalg.norm(v / size), self.scale * rate / size))
        if not np.isfinite(length) or length == 0:
            raise NotConverged("the path has no direction there")
        # The determinant is linear in its last row and vanishes for rows orthogonal to the direction, so that this is
        # also its sign with the direction as the last row.
        return Direction(v / length, rate / length, normal / length, tie / length, determinant_sign(matrix))

    def onwards(self, point: PathPoint, closed: Mask, before: Direction) -> Direction:
        """Return the tangent that continues a direction.

        Along a path the sign of the determinant is constant, even at sharp turns; it changes at branch points, which a
        path crosses without a turn. At a limit of the load the displacement does not turn either.
        """
        found = self.direction(point, closed, before.displacement, self.scale**2 * before.load_factor)
        v, w = found.displacement, before.displacement
        straight = float(v @ w) > SHARP * float(np.linalg.norm(v) * np.linalg.norm(w))
        crossed = straight and self.cosine(before, found) > SHARP
        return found if found.sense == before.sense or crossed else found.turned()

    def cosine(self, one: Direction, other: Direction) -> float:
        """Return the cosine of the angle between two directions."""
        return float(one.displacement @ other.displacement + self.scale**2 * one.load_factor * other.load_factor)

    def distance(self, one: PathPoint, other: PathPoint) -> float:
        """Return the length whose square is |u - u_0|^2 + scale^2 (t - t_0)^2."""
        apart = other.displacement - one.displacement
        return float(np.hypot(np.linalg.norm(apart), self.scale * (other.load_factor - one.load_factor)))

    def _at(self, u: Vector) -> Instant:
        try:
            return self.loaded.at(u)
        except InvalidProblem as error:
            raise NotConverged(str(error)) from error

    def _bordered(self, K: Any, now: Instant, B: Any, row: Vector, row_forces: Vector, row_t: float) -> Any:
        """Return the derivatives of the equations by u, l_B, nu and t, with a last row."""
        b, k = len(B), len(self.tie_rate)
        rows = sp.vstack([now.contact.normal[B], self.loaded.tie], format="csr")
        loads = sp.csr_array(np.concatenate([-self.load, np.zeros(b), -self.tie_rate])[:, None])
        border = sp.csr_array(np.concatenate([row, row_forces, np.zeros(k)])[None, :])
        inner = sp.bmat([[K, rows.T], [rows, None]], format="csr") if b + k else sp.csr_array(K)
        return sp.bmat([[inner, loads], [border, sp.csr_array([[row_t]])]], format="csc")

    def _split(self, found: Vector, B: Any) -> tuple[Vector, Vector, Vector, float]:
        """Split a solution into u, (m,) l, nu and t."""
        n, b, k = len(self.load), len(B), len(self.tie_rate)
        normal = np.zeros(self.loaded.contacts)
        normal[B] = found[n : n + b]
        return found[:n], normal, found[n + b : n + b + k], float(found[-1])
