"""What each contact of a rank does under friction: Alart and Curnier's trial forces, contact by contact.

With stiffnesses rho of the contact's own unknowns,

    p = l_N + rho_N (E_N u - g),    y = l_T + rho_T (E_T u - slip_origin),

a contact is closed where p > 0, sticks where |y| <= theta, and slides along t = y / |y| elsewhere; theta = mu p is
Coulomb's bound, another one Tresca's. In space the slip turns the friction: across t Newton's method has
l_T = C (E_T u - slip_origin) with C = rho_T theta / (|y| - theta).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb_cone import directions, lengths

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
