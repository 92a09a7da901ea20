"""The rows of a frictional problem on this rank: contacts, ties and tangents, and what iterates come to on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.iteration import DistributedIteration
from contactqp.distributed.problem import DistributedProblem
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb import directions, lengths

# What each contact of a rank does under friction: Alart and Curnier's trial forces, contact by contact.
#
# With stiffnesses rho of the contact's own unknowns,
#
#     p = l_N + rho_N (E_N u - g),    y = l_T + rho_T (E_T u - slip_origin),
#
# a contact is closed where p > 0, sticks where |y| <= theta, and slides along t = y / |y| elsewhere; theta = mu p is
# Coulomb's bound, another one Tresca's. In space the slip turns the friction: across t Newton's method has l_T = C (E_T
# u - slip_origin) with C = rho_T theta / (|y| - theta).

Flags = NDArray[np.bool_]

# C is at most so many times rho_T: what turns harder than that as good as sticks across t.
STIFFEST = 1e2


@dataclass(frozen=True, eq=False)
class Iterate:
    """Displacement and forces of one rank, of which nothing is known."""

    displacement: Vector  # (n_here,)
    normal: Vector  # (m_here,) l_N
    rub: Array  # (m_here, d-1) l_T
    tie: Vector  # (k_here,)


@dataclass(frozen=True, eq=False)
class States:
    """What the contacts of one rank do."""

    closed: Flags  # (m_here,)
    stick: Flags  # (m_here,) some of the closed ones
    direction: Array  # (m_here, d-1) t where a contact slides, else zero
    turning: Vector  # (m_here,) C [force / length], zero in the plane and where nothing slides

    @property
    def flags(self) -> Flags:
        """What tells one combination from another: (m_here, 2) in space, with both directions in the plane."""
        parts = [self.closed, self.stick]
        if self.direction.shape[1] == 1:
            parts.append(self.direction[:, 0] > 0)
        return np.stack(parts)


def states(trial: tuple[Vector, Array], bound: Vector, stiffness: Vector, before: States | None = None) -> States:
    """From p (m,) and y (m, d-1), the bounds (m,) and rho_T (m,).

    A contact that slid `before` and turns against itself sticks at first: its slip was the wrong way, which says little
    of how far it would go the other way.
    """
    push, y = trial
    closed, size = push > 0, lengths(y)
    stick = closed & (size <= bound) & (bound > 0)
    if before is not None:
        stick |= closed & (bound > 0) & (np.sum(before.direction * y, axis=1) < 0)
    slides = closed & ~stick & (bound > 0)
    turning = np.zeros(len(push))
    if y.shape[1] > 1:
        room = np.where(slides, size - bound, 1.0)
        share = np.divide(bound, np.maximum(room, bound / STIFFEST), out=np.zeros_like(bound), where=slides)
        turning = stiffness * share
    return States(closed, stick, np.where(slides[:, None], directions(y), 0.0), turning)


class FrictionRows:
    """E = [E_N; A; E_T] of one rank with limits [g; b; slip_origin].

    Attributes
    ----------
    way : DistributedIteration
        Whose rows these are.
    mu : (m_here,) array
        Zero too where no unknown feels the tangential rows.
    limit : (m_here + k_here + (d-1) m_here,) array [length]
    """

    def __init__(self, problem: DistributedProblem, way: DistributedIteration) -> None:
        self.problem, self.way = problem, way
        m, k = problem.contacts, problem.ties
        origin: Any = problem.slip_origin
        self.m, self.width, self.plain = m, int(origin.shape[1]), m + k
        self.limit = np.concatenate([problem.gap, problem.tie_value, origin.ravel()])
        compliance = way.own_compliance
        across = compliance[self.plain :].reshape(m, self.width)
        self._felt = across > 0
        self._push, self.stiffness = _inverse(compliance[:m]), _inverse(np.max(across, axis=1, initial=0.0))
        friction = np.zeros(m) if problem.friction is None else problem.friction
        self.mu = np.where(self.stiffness > 0, friction, 0.0)

    def tangents(self, contacts: NDArray[np.bool_]) -> NDArray[np.intp]:
        """The tangential rows of some contacts that an unknown feels."""
        return self.plain + np.flatnonzero((contacts[:, None] & self._felt).ravel())

    def load_of(self, rub: Array) -> Vector:
        """E_T'l_T (n_here,). Collective."""
        force = np.zeros(self.way.rows.count)
        force[self.plain :] = rub.ravel()
        return self.way.forces(force)

    def trial(self, iterate: Iterate) -> tuple[Vector, Array]:
        """p (m,) and y (m, d-1). Collective."""
        over = self.way.lengths(iterate.displacement) - self.limit
        slip = np.where(self._felt, over[self.plain :].reshape(self.m, self.width), 0.0)
        return iterate.normal + self._push * over[: self.m], iterate.rub + self.stiffness[:, None] * slip

    def coulomb(self, iterate: Iterate, before: States | None) -> States:
        """The states that Newton's method on Coulomb's law goes on with. Collective."""
        trial = self.trial(iterate)
        return states(trial, self.mu * np.maximum(trial[0], 0.0), self.stiffness, before)

    def within(self, iterate: Iterate, chosen: States) -> Iterate:
        """Forces that Coulomb's law allows: no tension, friction of the bound's size where a contact slides."""
        normal = np.maximum(iterate.normal, 0.0)
        full = (self.mu * normal)[:, None] * directions(iterate.rub)
        slides = np.any(chosen.direction != 0, axis=1)
        return Iterate(iterate.displacement, normal, np.where(slides[:, None], full, iterate.rub), iterate.tie)

    def outer(self, iterate: Iterate) -> Vector:
        """f - E'l (n_here,). Collective."""
        return np.asarray(
            self.problem.load - self.way.forces(np.concatenate([iterate.normal, iterate.tie, iterate.rub.ravel()]))
        )

    def held(self, chosen: States) -> NDArray[np.intp]:
        """The rows that a combination holds: closed contacts, ties, tangents where it sticks."""
        rows = [np.flatnonzero(chosen.closed), np.arange(self.m, self.plain), self.tangents(chosen.stick)]
        return np.concatenate(rows)

    def pushing(self, chosen: States) -> sp.csr_matrix:
        """mu t'E_T (m, t): what a normal force brings along where its contact slides."""
        return sp.csr_matrix(_by_contact(self.mu[:, None] * chosen.direction) @ self.tangential)

    def turning(self, chosen: States) -> tuple[sp.csr_matrix, Vector]:
        """sqrt(C) (I - t t')E_T ((d-1) m, t), and the same of the slip origins ((d-1) m,)."""
        t, root = chosen.direction, np.sqrt(chosen.turning)
        blocks = root[:, None, None] * (np.eye(self.width) - t[:, :, None] * t[:, None, :])
        size = self.m * self.width
        column = np.repeat(np.arange(size).reshape(self.m, 1, self.width), self.width, axis=1)
        across = sp.csr_matrix((blocks.ravel(), column.ravel(), self.width * np.arange(size + 1)), (size, size))
        return sp.csr_matrix(across @ self.tangential), np.asarray(across @ self.limit[self.plain :])

    def across(self, u: Vector, chosen: States) -> Array:
        """C (I - t t')(E_T u - slip_origin) (m, d-1): what turns friction in space. Collective."""
        slip = (self.way.lengths(u) - self.limit)[self.plain :].reshape(self.m, self.width)
        t = chosen.direction
        along = np.sum(t * slip, axis=1)[:, None] * t
        return np.asarray(chosen.turning[:, None] * np.where(self._felt, slip - along, 0.0))

    def sticking(self, stick: NDArray[np.bool_]) -> tuple[DistributedIteration, Vector]:
        """The iteration on contacts, ties and the tangents of contacts that stick, as more ties, and their limits."""
        chosen = np.concatenate([np.arange(self.plain), self.tangents(stick)])
        return self.way.standing(self.way.rows.entries[chosen]), self.limit[chosen]

    @property
    def tangential(self) -> sp.csr_matrix:
        """E_T over what the rows touch."""
        return self.way.rows.entries[self.plain :]


def _by_contact(values: Array) -> sp.csr_matrix:
    """(m, m w) with the values (m, w) of a contact at its tangential rows."""
    m, width = values.shape
    return sp.csr_matrix((values.ravel(), np.arange(m * width), width * np.arange(m + 1)), (m, m * width))


def _inverse(size: Vector) -> Vector:
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
