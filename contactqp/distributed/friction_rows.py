"""The rows of a frictional problem on one rank, and the states of its contacts by Alart and Curnier's trial forces.

With stiffnesses rho of the contact's own unknowns,

    p = l_N + rho_N (E_N u - g),    y = l_T + rho_T (E_T u - slip_origin),

a contact is closed where p > 0, sticks where |y| <= theta, and slides along t = y / |y| elsewhere; theta = mu p is
Coulomb's bound, another one Tresca's. In space the slip turns the friction: across t Newton's method has
l_T = C (E_T u - slip_origin) with C = rho_T theta / (|y| - theta).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.distributed.iteration import DistributedIteration
from contactqp.distributed.problem import DistributedProblem
from contactqp.model.arrays import Array, Indices, Mask, Vector
from contactqp.model.coulomb import directions, lengths
from contactqp.model.solution import Answer

# C is at most so many times rho_T: friction that turns harder as good as sticks across t.
STIFFEST = 1e2


@dataclass(frozen=True, eq=False)
class FrictionalAnswer(Answer):
    """Displacement and forces on one rank of a problem with tangential rows."""

    friction_force: Array  # (m_here, d-1)


@dataclass(frozen=True, eq=False)
class Combination:
    """The states of the contacts of one rank."""

    closed: Mask  # (m_here,)
    stick: Mask  # (m_here,) some of the closed ones
    direction: Array  # (m_here, d-1) t where a contact slides, else zero
    turning: Vector  # (m_here,) C [force / length], zero in the plane and where nothing slides

    @property
    def flags(self) -> Mask:
        """Flags (2, m_here) that tell one combination from another; in the plane (3, m_here), with the direction."""
        parts = [self.closed, self.stick]
        if self.direction.shape[1] == 1:
            parts.append(self.direction[:, 0] > 0)
        return np.stack(parts)


def combination_of(
    trial: tuple[Vector, Array], bound: Vector, stiffness: Vector, before: Combination | None = None
) -> Combination:
    """Return the states that trial forces give.

    A contact that slid `before` and turns against itself sticks at first: it slid the wrong way, which says little of
    how far it would slide the other way.

    Parameters
    ----------
    trial : (m,) and (m, d-1) arrays
        p and y [force].
    bound : (m,) array
        theta [force].
    stiffness : (m,) array
        rho_T [force / length].
    before : Combination, optional
        The states before.
    """
    normal, y = trial
    closed, size = normal > 0, lengths(y)
    stick = closed & (size <= bound) & (bound > 0)
    if before is not None:
        stick |= closed & (bound > 0) & (np.sum(before.direction * y, axis=1) < 0)
    slides = closed & ~stick & (bound > 0)
    turning = np.zeros(len(normal))
    if y.shape[1] > 1:
        room = np.where(slides, size - bound, 1.0)
        share = np.divide(bound, np.maximum(room, bound / STIFFEST), out=np.zeros_like(bound), where=slides)
        turning = stiffness * share
    return Combination(closed, stick, np.where(slides[:, None], directions(y), 0.0), turning)


class FrictionRows:
    """The rows E = [E_N; A; E_T] of one rank with limits [g; b; slip_origin].

    Attributes
    ----------
    iteration : DistributedIteration
        The iteration on these rows.
    m, width, plain : int
        The numbers of contacts, of tangential rows of each, and of contacts and ties.
    friction : (m_here,) array
        mu, which is zero also where no unknown feels the tangential rows.
    limit : (m_here + k_here + (d-1) m_here,) array
        The limits [length].
    """

    def __init__(self, problem: DistributedProblem, iteration: DistributedIteration) -> None:
        self.problem, self.iteration = problem, iteration
        m, k = problem.contacts, problem.ties
        origin: Any = problem.slip_origin
        self.m, self.width, self.plain = m, int(origin.shape[1]), m + k
        self.limit = np.concatenate([problem.gap, problem.tie_value, origin.ravel()])
        compliance = iteration.own_compliance
        across = compliance[self.plain :].reshape(m, self.width)
        self._felt = across > 0
        self._normal_stiffness, self.stiffness = _inverse(compliance[:m]), _inverse(np.max(across, axis=1, initial=0.0))
        friction = np.zeros(m) if problem.friction is None else problem.friction
        self.friction = np.where(self.stiffness > 0, friction, 0.0)

    def tangents(self, contacts: Mask) -> Indices:
        """Return the numbers of the tangential rows of some contacts that an unknown feels."""
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
        """Return the states that Newton's method on Coulomb's law goes on with. Collective."""
        trial = self.trial(answer)
        return combination_of(trial, self.bound(trial[0]), self.stiffness, before)

    def within_law(self, answer: FrictionalAnswer, states: Combination) -> FrictionalAnswer:
        """Return forces that Coulomb's law allows: no tension, and friction of the bound where a contact slides."""
        full = self.bound(answer.normal_force)[:, None] * directions(answer.friction_force)
        slides = np.any(states.direction != 0, axis=1)
        friction = np.where(slides[:, None], full, answer.friction_force)
        return FrictionalAnswer(answer.displacement, np.maximum(answer.normal_force, 0.0), friction, answer.tie_force)

    def constrained(self, states: Combination) -> Indices:
        """Return the rows that a combination constrains: closed contacts, ties, tangents where it sticks."""
        rows = [np.flatnonzero(states.closed), np.arange(self.m, self.plain), self.tangents(states.stick)]
        return np.concatenate(rows)

    def sliding(self, states: Combination) -> sp.csr_matrix:
        """Return mu t'E_T (m, t), along which the normal force of a sliding contact acts too."""
        values = self.friction[:, None] * states.direction
        by_contact = (values.ravel(), np.arange(values.size), self.width * np.arange(self.m + 1))
        return sp.csr_matrix(sp.csr_matrix(by_contact, (self.m, values.size)) @ self.tangential)

    def turning(self, states: Combination) -> tuple[sp.csr_matrix, Vector]:
        """Return sqrt(C) (I - t t')E_T ((d-1) m, t), and sqrt(C) (I - t t') slip_origin ((d-1) m,)."""
        t, root = states.direction, np.sqrt(states.turning)
        blocks = root[:, None, None] * (np.eye(self.width) - t[:, :, None] * t[:, None, :])
        size = self.m * self.width
        column = np.repeat(np.arange(size).reshape(self.m, 1, self.width), self.width, axis=1)
        across = sp.csr_matrix((blocks.ravel(), column.ravel(), self.width * np.arange(size + 1)), (size, size))
        return sp.csr_matrix(across @ self.tangential), np.asarray(across @ self.limit[self.plain :])

    def turned_friction(self, u: Vector, states: Combination) -> Array:
        """Return C (I - t t')(E_T u - slip_origin) (m, d-1), the friction across t in space. Collective."""
        t, slip = states.direction, (self.iteration.lengths(u) - self.limit)[self.plain :].reshape(self.m, self.width)
        across = slip - np.sum(t * slip, axis=1)[:, None] * t
        return np.asarray(states.turning[:, None] * np.where(self._felt, across, 0.0))

    def sticking(self, stick: Mask) -> tuple[DistributedIteration, Vector]:
        """Return the iteration on contacts, ties and the tangents of sticking contacts as further ties; its limits."""
        chosen = np.concatenate([np.arange(self.plain), self.tangents(stick)])
        return self.iteration.with_rows(self.iteration.rows.entries[chosen]), self.limit[chosen]

    @property
    def tangential(self) -> sp.csr_matrix:
        """E_T over the unknowns that the rows touch."""
        return self.iteration.rows.entries[self.plain :]


def _inverse(size: Vector) -> Vector:
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
