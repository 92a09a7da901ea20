"""Solve the linear system of one combination of open, stick and slip iteratively, for bodies that are not factorised.

The states of contacts with friction come from Alart and Curnier's trial forces (1991). With stiffnesses rho of the
contact's own unknowns,

    p = l_N + rho_N (E_N u - g),    y = l_T + rho_T (E_T u - slip_origin),

a contact is closed where p > 0, sticks where |y| <= theta, and slides along t = y / |y| elsewhere; theta = mu p is
Coulomb's bound, another one Tresca's. In space the slip turns the friction: across t Newton's method has
l_T = C (E_T u - slip_origin) with C = rho_T theta / (|y| - theta).

It works in one process and on ranks: an iteration (`contactqp.linalg.contact_iteration`) provides products, sums and a
preconditioner, and everything here is collective where that is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.contact_iteration import ContactIteration, Limits
from contactqp.linalg.krylov import RESTART, flexible_gmres
from contactqp.linalg.measures import directions, lengths, ratio, reciprocal
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.solution import Answer


class FrictionalLimits(Limits, Protocol):
    """The part of a contact problem with friction that changes from load to load, as an iteration reads it."""

    @property
    def friction(self) -> Vector | None: ...  # (m,)

    @property
    def slip_origin(self) -> Array | None: ...  # (m, d-1)


# The largest C relative to rho_T; beyond it friction practically sticks across t.
STIFFEST = 1e2


@dataclass(frozen=True, eq=False)
class FrictionalAnswer(Answer):
    """Displacement and forces of a problem with tangential rows; on several ranks, those of one rank."""

    friction_force: Array  # (m, d-1)


@dataclass(frozen=True, eq=False)
class Combination:
    """The states of contacts; on several ranks, of the contacts of one rank."""

    closed: Mask  # (m,)
    stick: Mask  # (m,) a subset of the closed ones
    direction: Array  # (m, d-1) t where a contact slides, else zero
    turning: Vector  # (m,) C [force / length], zero in the plane and where nothing slides

    @property
    def flags(self) -> Mask:
        """Return flags (2, m) that identify a combination, in the plane (3, m) with the direction."""
        parts = [self.closed, self.stick]
        if self.direction.shape[1] == 1:
            parts.append(self.direction[:, 0] > 0)
        return np.stack(parts)


def combination_of(
    trial: tuple[Vector, Array], bound: Vector, stiffness: Vector, before: Combination | None = None
) -> Combination:
    """Return the states given by trial forces.

    A contact that slid `before` and would reverse its direction sticks at first, as its slip in the other direction is
    unknown.

    Parameters
    ----------
    trial : (m,) and (m, d-1) arrays, p and y [force]
    bound : (m,) array, theta [force]
    stiffness : (m,) array, rho_T [force / length]
    before : the states before
    """
    normal, y = trial
    closed, size = normal > 0, lengths(y)
    stick = closed & (size <= bound) & (bound > 0)
    if before is not None:
        stick |= closed & (bound > 0) & (np.sum(before.direction * y, axis=1) < 0)
    slides = closed & ~stick & (bound > 0)
    across = turning_stiffness(y, bound, stiffness, slides) if y.shape[1] > 1 else np.zeros(len(normal))
    return Combination(closed, stick, np.where(slides[:, None], directions(y), 0.0), across)


def turning_stiffness(y: Array, bound: Vector, stiffness: Vector, slides: Mask) -> Vector:
    """Return C (m,) [force / length], the stiffness of friction against a change of slip direction; zero without slip.

    Parameters
    ----------
    y : (m, d-1) array [force], the trial forces
    bound : (m,) array [force], the friction bounds
    stiffness : (m,) array [force / length], rho_T, by which slips enter the trial forces
    slides : (m,) mask
    """
    room = np.where(slides, lengths(y) - bound, 1.0)
    share = np.divide(bound, np.maximum(room, bound / STIFFEST), out=np.zeros_like(bound), where=slides)
    return np.asarray(stiffness * share)


class FrictionRows:
    """The rows E = [E_N; A; E_T] with limits [g; b; slip_origin].

    Attributes
    ----------
    iteration : the iteration on these rows
    m, width, plain : int, the numbers of contacts, of tangential rows of each, and of contacts and ties
    friction : (m,) array, mu, zero also where the tangential rows are zero
    limit : (m + k + (d-1) m,) array, the limits [length]
    """

    def __init__(self, problem: FrictionalLimits, iteration: ContactIteration) -> None:
        self.problem, self.iteration = problem, iteration
        m, k = len(problem.gap), len(problem.tie_value)
        origin: Any = problem.slip_origin
        self.m, self.width, self.plain = m, int(origin.shape[1]), m + k
        self.limit = np.concatenate([problem.gap, problem.tie_value, origin.ravel()])
        compliance = iteration.own_compliance
        across = compliance[self.plain :].reshape(m, self.width)
        self._felt = across > 0
        self._normal_stiffness, self.stiffness = (
            reciprocal(compliance[:m]),
            reciprocal(np.max(across, axis=1, initial=0.0)),
        )
        friction = np.zeros(m) if problem.friction is None else problem.friction
        self.friction = np.where(self.stiffness > 0, friction, 0.0)

    def tangents(self, contacts: Mask) -> Indices:
        """Return the indices of the nonzero tangential rows of some contacts."""
        return self.plain + np.flatnonzero((contacts[:, None] & self._felt).ravel())

    def bound(self, normal_force: Vector) -> Vector:
        """Return Coulomb's bound mu l_N (m,), zero in tension."""
        return np.asarray(self.friction * np.maximum(normal_force, 0.0))

    def trial(self, answer: FrictionalAnswer) -> tuple[Vector, Array]:
        """Return p (m,) and y (m, d-1). Collective."""
        beyond = self.iteration.lengths(answer.displacement) - self.limit
        slip = np.where(self._felt, beyond[self.plain :].reshape(self.m, self.width), 0.0)
        y = answer.friction_force + self.stiffness[:, None] * slip
        return answer.normal_force + self._normal_stiffness * beyond[: self.m], y

    def coulomb(self, answer: FrictionalAnswer, before: Combination | None) -> Combination:
        """Return the states of the next step of Newton's method on Coulomb's law. Collective."""
        trial = self.trial(answer)
        return combination_of(trial, self.bound(trial[0]), self.stiffness, before)

    def in_states(self, status: Status, answer: FrictionalAnswer) -> Combination:
        """Return a combination of these states (m,), in space with slip directions by an answer's trial forces."""
        closed, stick = status != OPEN, (status == STICK) & (self.friction > 0)
        slides = closed & ~stick & (self.friction > 0)
        if self.width == 1:
            return Combination(closed, stick, np.where(slides, status, 0.0)[:, None], np.zeros(self.m))
        y = self.trial(answer)[1]
        direction = np.where(slides[:, None], directions(y), 0.0)
        across = turning_stiffness(y, self.bound(answer.normal_force), self.stiffness, slides)
        return Combination(closed, stick, direction, across)

    def within_law(self, answer: FrictionalAnswer, states: Combination) -> FrictionalAnswer:
        """Return forces admissible by Coulomb's law, without tension and with friction at the bound where contacts
        slide.
        """
        full = self.bound(answer.normal_force)[:, None] * directions(answer.friction_force)
        slides = np.any(states.direction != 0, axis=1)
        friction = np.where(slides[:, None], full, answer.friction_force)
        return FrictionalAnswer(answer.displacement, np.maximum(answer.normal_force, 0.0), friction, answer.tie_force)

    def residual(self, answer: FrictionalAnswer) -> Vector:
        """Return f - K u - E'l (n,)."""
        forces = np.concatenate([answer.normal_force, answer.tie_force, answer.friction_force.ravel()])
        return self.problem.load - self.iteration.forces(forces) - self.iteration.product(answer.displacement)

    def constrained(self, states: Combination) -> Indices:
        """Return the rows that a combination constrains: closed contacts, ties, tangents where it sticks."""
        rows = [np.flatnonzero(states.closed), np.arange(self.m, self.plain), self.tangents(states.stick)]
        return np.concatenate(rows)

    def sliding(self, states: Combination) -> sp.csr_matrix:
        """Return mu t'E_T (m, t), along which the normal force of a sliding contact also acts."""
        values = self.friction[:, None] * states.direction
        by_contact = (values.ravel(), np.arange(values.size), self.width * np.arange(self.m + 1))
        return sp.csr_matrix(sp.csr_matrix(by_contact, (self.m, values.size)) @ self.tangential)

    def turning(self, states: Combination) -> sp.csr_matrix:
        """Return sqrt(C) (I - t t') ((d-1) m, m + k + (d-1) m): its products with E and the limits give the forces that
        change with the slip direction.
        """
        t, root = states.direction, np.sqrt(states.turning)
        blocks = root[:, None, None] * (np.eye(self.width) - t[:, :, None] * t[:, None, :])
        size = self.m * self.width
        column = np.repeat(np.arange(size).reshape(self.m, 1, self.width), self.width, axis=1)
        across = sp.csr_matrix((blocks.ravel(), column.ravel(), self.width * np.arange(size + 1)), (size, size))
        across.eliminate_zeros()
        return sp.csr_matrix(sp.hstack([sp.csr_matrix((size, self.plain)), across]))

    def turned_friction(self, u: Vector, states: Combination) -> Array:
        """Return C (I - t t')(E_T u - slip_origin) (m, d-1), the friction across t in space. Collective."""
        t, slip = states.direction, (self.iteration.lengths(u) - self.limit)[self.plain :].reshape(self.m, self.width)
        across = slip - np.sum(t * slip, axis=1)[:, None] * t
        return np.asarray(states.turning[:, None] * np.where(self._felt, across, 0.0))

    def sticking(self, stick: Mask) -> tuple[ContactIteration, Vector]:
        """Return the iteration on contacts, ties and the tangents of sticking contacts as further ties; its limits."""
        chosen = self.held_with(stick)
        return self.iteration.of_rows(chosen), self.limit[chosen]

    def at_rest(self, displacement: Vector, normal_force: Vector) -> tuple[Vector, Array]:
        """Return the displacement of least norm within the gaps, without slip of loaded contacts, and free motions.

        The motions (n, q) are orthonormal. Collective.
        """
        pushes = (self.friction > 0) & (normal_force > 0)
        floating = self.iteration.of_rows(self.held_with(pushes)).floating
        return floating.at_rest(displacement, normal_force, self.problem.gap)

    def held_with(self, stick: Mask) -> Indices:
        """Return the indices of all contacts and ties, and of the tangents of sticking contacts."""
        return np.concatenate([np.arange(self.plain), self.tangents(stick)])

    @property
    def tangential(self) -> sp.csr_matrix:
        """Return the tangential rows E_T over the unknowns that the rows touch."""
        return self.iteration.entries[self.plain :]


# The most steps of GMRES on one combination, and of restarts with a new residual.
STEPS, ROUNDS = 600, 4
# A restart reduces the residual to AIM of the requirement, within these limits.
AIM, TIGHTEST, LOOSEST = 0.1, 1e-7, 0.3
# The part of the tolerance for equilibrium, and the rounding relative to the forces that meet.
EQUILIBRIUM, BALANCED = 0.3, 4 * EPS


class CombinationSystem:
    """The linear system of one combination of open, stick and slip, unsymmetric where something slides.

    With H the constrained rows (closed contacts, ties, tangents that stick), G = H + mu t'E_T at the normals of
    contacts that slide, and the turning of slip directions in space as a stiffness C of the tangents,

        (K + E_T'C E_T) u + G'l = f + E_T'C o,    H u = h.

    GMRES searches along displacements M r admissible by H and reduces the residuals left by the forces on G,

        P_G (K + E_T'C E_T) P_H M y = P_G r,    u = u_0 + P_H M y,

    where P_H and P_G are the projections of `contactqp.linalg.krylov`. Friction proportional to l_N is part of the
    system, so that only the combination, and in space the directions, are iterated.
    """

    def __init__(self, rows: FrictionRows, states: Combination) -> None:
        iteration = rows.iteration
        self._rows, self._iteration, self._states = rows, iteration, states
        self._active = rows.constrained(states)
        H, limit = iteration.entries[self._active], rows.limit[self._active]
        sliding = rows.sliding(states)[states.closed]
        G = H + sp.vstack([sliding, sp.csr_matrix((H.shape[0] - sliding.shape[0], H.shape[1]))])
        holding = rows.sticking(states.stick | (states.turning > 0))[0]
        self._on_h, self._on_g = (
            holding.at_rest(iteration.constrained(sp.csr_matrix(entries), limit), states.closed) for entries in (H, G)
        )
        self._turning: sp.csr_matrix | None = None
        across = rows.turning(states)
        if iteration.any(states.turning > 0):
            self._turning, self._origin = sp.csr_matrix(across @ iteration.entries), across @ rows.limit
        self._smooth = iteration.smoother(self._active, across)
        self._scale = np.sqrt(iteration.diagonal)
        self._last: tuple[Vector, Vector, Vector] | None = None  # the last x, r and P_H M r
        self._meeting: tuple[Vector, Vector] | None = None  # the last x, and the forces that meet there

    def closed(self, u: Vector) -> Vector:
        """Return a displacement moved onto the limits of the constrained rows."""
        x = u.copy()
        self._on_h.close(x)
        return x

    def unbalanced(self, x: Vector) -> Vector:
        """Return the residual at a displacement that forces on G cannot balance."""
        return self._on_g.balanced(self._residual(x))

    def _residual(self, x: Vector) -> Vector:
        """Return f + E_T'C o - (K + E_T'C E_T) x."""
        residual = self._rows.problem.load - self._iteration.product(x)
        if self._turning is not None:
            beyond = self._iteration.lengths_of(self._turning, x) - self._origin
            residual -= self._iteration.forces_of(self._turning, beyond)
        return np.asarray(residual)

    def error(self, unbalanced: Vector, along: Vector | None = None) -> float:
        """Return |r'P_H M r|, about the squared error in energy; `along` is P_H M r if known."""
        return abs(self._iteration.dot(unbalanced, self._along(unbalanced) if along is None else along))

    def error_at(self, x: Vector) -> float:
        """Return the error of a displacement, reusing the residual of `solved`."""
        return self.error(*self._looked_at(x))

    def _looked_at(self, x: Vector) -> tuple[Vector, Vector]:
        """Return r and P_H M r at a displacement; the last ones are kept."""
        if self._last is None or self._last[0] is not x:
            unbalanced = self.unbalanced(x)
            self._last = x, unbalanced, self._along(unbalanced)
        return self._last[1:]

    def solved(self, x: Vector, tolerance: float, energy: float, most: int = ROUNDS * STEPS) -> Vector:
        """Solve from a displacement on the limits until equilibrium and energy converge, or GMRES stagnates.

        Parameters
        ----------
        x : (n,) array
            The start, on the limits of the constrained rows.
        tolerance : float
            The tolerance of the equilibrium at each unknown, of which the part EQUILIBRIUM is aimed at.
        energy : float
            The error in energy, as a part of the energy norm of x.
        most : int
            Steps of GMRES in all.
        """
        last = self._iteration.krylov_iterations + most
        for _ in range(ROUNDS):
            unbalanced, along = self._looked_at(x)
            if self._small(x, unbalanced, BALANCED):
                break
            error, work = self.error(unbalanced, along), self._work(x)
            if self._balanced(x, unbalanced, tolerance) and error <= energy**2 * work:
                break
            left = last - self._iteration.krylov_iterations
            if left <= 0:
                break
            reduction = self._reduction(x, unbalanced, tolerance, energy * np.sqrt(work), error)
            x = self._improved(x, unbalanced, along, reduction, min(left, STEPS))
        return x

    def enough(self, x: Vector, residual: Vector, tolerance: float, energy: float, floor: float = 0.0) -> bool:
        """Return whether a residual is small at every unknown, and in energy small or below `floor`.

        Parameters
        ----------
        x : (n,) array [length], the displacement
        residual : (n,) array [force], what it leaves out of balance
        tolerance : the tolerance of the certificate, a part of which is left at most at every unknown
        energy : the largest error in energy, relative to that of the displacement
        floor : float [energy], the square of an error in energy that is small enough, whatever the displacement
        """
        if not self._balanced(x, residual, tolerance):
            return False
        return self.error(residual) <= max(energy**2 * self._work(x), floor)

    def _balanced(self, x: Vector, residual: Vector, tolerance: float) -> bool:
        return self._small(x, residual, EQUILIBRIUM * tolerance)

    def _small(self, x: Vector, residual: Vector, part: float) -> bool:
        return not self._iteration.any(~(self._parts(x, residual) <= part))

    def _parts(self, x: Vector, residual: Vector) -> Vector:
        """Return a residual relative to the forces that meet (n,)."""
        if self._meeting is None or self._meeting[0] is not x:
            self._meeting = x, self._iteration.product_sizes(x) + abs(self._rows.problem.load)
        return ratio(abs(residual), self._meeting[1])

    def _work(self, x: Vector) -> float:
        return self._iteration.dot(x, self._iteration.product(x))

    def _reduction(self, x: Vector, residual: Vector, tolerance: float, energy: float, error: float) -> float:
        """Return the required reduction of a residual, limited by rounding; `energy` is that of the error allowed."""
        left = float(self._iteration.largest(np.max(self._parts(x, residual), initial=0.0, keepdims=True))[0])
        allowed = energy / float(np.sqrt(error)) if error > 0 else np.inf
        balanced = EQUILIBRIUM * tolerance / left if left > 0 else np.inf
        return float(np.clip(AIM * min(allowed, balanced), TIGHTEST, LOOSEST))

    def improved(self, x: Vector, reduction: float) -> Vector:
        """Return x after GMRES has reduced its unbalanced residual by `reduction`, or as far as possible."""
        unbalanced = self.unbalanced(x)
        return x if self._small(x, unbalanced, BALANCED) else self._improved(x, unbalanced, None, reduction, STEPS)

    def _improved(self, x: Vector, unbalanced: Vector, along: Vector | None, reduction: float, most: int) -> Vector:
        scale, iteration, steps = self._scale, self._iteration, 0
        residual = unbalanced / scale
        aim = reduction * iteration.norm(residual)

        def preconditioned(y: Vector) -> Vector:
            iteration.refuse_late("GMRES came to an end")
            return self._along(scale * y)

        def product(z: Vector) -> Vector:
            return np.asarray(self._on_g.balanced(self._stiffness(z)) / scale)

        while (size := iteration.norm(residual)) > aim and steps < most:
            few = min(RESTART, most - steps)
            found, taken = flexible_gmres(
                preconditioned, product, iteration.dots, residual, aim / size, few, None if steps else along
            )
            iteration.krylov_iterations += taken
            x, steps = np.asarray(x + found), steps + taken
            if taken < few or steps >= most:
                break
            residual = self.unbalanced(x) / scale
        return x

    def answer(self, x: Vector) -> FrictionalAnswer:
        """Return a displacement with its forces; friction across t is that of Newton's method."""
        rows, states = self._rows, self._states
        force = np.zeros(len(rows.limit))
        force[self._active] = self._on_g.forces(self._residual(x))
        normal, tie, friction = np.split(force, [rows.m, rows.plain])
        sliding = rows.bound(normal)[:, None] * states.direction
        friction = friction.reshape(rows.m, rows.width) + sliding + rows.turned_friction(x, states)
        return FrictionalAnswer(x, normal, friction, tie)

    def _along(self, r: Vector) -> Vector:
        """Return P_H M r."""
        z = self._smooth(r)
        self._on_h.admit(z)
        return z

    def _stiffness(self, x: Vector) -> Vector:
        force = self._iteration.product(x)
        if self._turning is not None:
            force += self._iteration.forces_of(self._turning, self._iteration.lengths_of(self._turning, x))
        return force
