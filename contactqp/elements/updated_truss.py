"""Truss bars in their current configuration: Cauchy stress and Almansi strain, the updated Lagrangian form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.elements.green_truss import NonlinearTruss
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, computes

# How the area follows the length L: A_n / A_0 for a stretch L / L0.
VOLUMES = ("isochoric", "constant area")


@computes
@dataclass(frozen=True, eq=False)
class UpdatedTruss:
    """The bars of a truss seen from where they are: the same forces and tangents as its total Lagrangian form.

    With the length L and the unit direction n of a bar now, and its area A_n,

        eps_A = (L^2 - L0^2) / (2 L^2)                  Almansi's strain
        E*    = C (A0 / A_n) (L / L0)^3                 the modulus of the law, pushed forward
        sigma = (A0 / A_n) (L / L0) S                   Cauchy's stress; E* eps_A where S = E eps (the law "green")
        F     = A_n sigma n                             on its end, -F on its start
        K     = (A_n / L) (E* n n' + sigma 1)

    where S and C are those of the law of the truss. (K is often written with 1 - n n' in place of 1; the modulus beside
    it is then E* + sigma.)

    Parameters
    ----------
    truss : NonlinearTruss
    volume : "isochoric" or "constant area"
        A_n = A0 L0 / L or A0. Stresses are different, forces and tangents are not: the law is of the bar at rest.

    Raises
    ------
    InvalidProblem
        Another volume law; on use, a bar that has shrunk to a point.

    Notes
    -----
    Course section 2.5, (2.88)-(2.93), with sigma, not sigma_G, in (2.90), no factor 1/2 in the geometric part of
    (2.92), and E replaced by E*. With E itself (2.92) is the tangent of another law: that of sigma = E eps_Green where
    the volume is kept, or of the engineering strain where the area is.
    """

    truss: NonlinearTruss
    volume: str = "isochoric"

    def __post_init__(self) -> None:
        if self.volume not in VOLUMES:
            raise InvalidProblem(f"volume: expected one of {', '.join(VOLUMES)}, got {self.volume!r}")

    @property
    def dimension(self) -> int:
        """n = N d."""
        return self.truss.dimension

    def length(self, displacement: ArrayLike) -> Array:
        """L of every bar, (B,) [length]."""
        return np.asarray(np.linalg.norm(self._apart(displacement), axis=1))

    def area(self, displacement: ArrayLike) -> Array:
        """A_n of every bar, (B,) [length^2]."""
        area = np.asarray(self.truss.area)
        return area if self.volume == "constant area" else area * self.truss.length / self._length(displacement)

    def almansi_strain(self, displacement: ArrayLike) -> Array:
        """(L^2 - L0^2) / (2 L^2) of every bar, (B,)."""
        L, L0 = self._length(displacement), self.truss.length
        return (L - L0) * (L + L0) / (2 * L**2)

    def cauchy_stress(self, displacement: ArrayLike) -> Array:
        """sigma of every bar, (B,), positive in tension [force / length^2]."""
        L, truss = self._length(displacement), self.truss
        stress = truss.modulus * truss.bar_law.stress(self._green(displacement))
        return np.asarray(truss.area / self.area(displacement) * L / truss.length * stress)

    def current_modulus(self, displacement: ArrayLike) -> Array:
        """E* of every bar, (B,) [force / length^2]."""
        L, truss = self._length(displacement), self.truss
        modulus = truss.modulus * truss.bar_law.modulus(self._green(displacement))
        return np.asarray(modulus * truss.area / self.area(displacement) * (L / truss.length) ** 3)

    def energy(self, displacement: ArrayLike) -> float:
        """The sum over the bars of A_n L w / J, w / J the energy of a unit of the volume now; inf for a bar of no
        length."""
        if np.any(self.length(displacement) == 0):
            return float("inf")
        truss = self.truss
        density = truss.modulus * truss.bar_law.energy(self._green(displacement))
        volume = self.area(displacement) * self._length(displacement)
        grown = volume / (truss.area * truss.length)
        return float(np.sum(volume * density / grown))

    def internal_force(self, displacement: ArrayLike) -> Array:
        """A_n sigma n, at all unknowns: (n,) [force]."""
        direction = self._apart(displacement) / self._length(displacement)[:, None]
        force = self.area(displacement) * self.cauchy_stress(displacement)
        return self.truss.summed(force[:, None] * direction)

    def tangent(self, displacement: ArrayLike) -> Any:
        """The derivative of `internal_force`: (n, n) CSC [force / length]."""
        L = self._length(displacement)
        n = self._apart(displacement) / L[:, None]
        per_length = (self.area(displacement) / L)[:, None, None]
        axial = self.current_modulus(displacement)[:, None, None] * (n[:, :, None] * n[:, None, :])
        along = self.cauchy_stress(displacement)[:, None, None] * np.eye(n.shape[1])
        return self.truss.assembled(per_length * (axial + along))

    def _apart(self, displacement: ArrayLike) -> Array:
        x = self.truss.positions(displacement)
        return np.asarray(x[self.truss.bars[:, 1]] - x[self.truss.bars[:, 0]])

    def _length(self, displacement: ArrayLike) -> Array:
        L = self.length(displacement)
        gone = np.flatnonzero(L == 0)
        if gone.size:
            raise InvalidProblem(f"truss bar {gone[0]} has shrunk to a point: it has no direction")
        return L

    def _green(self, displacement: ArrayLike) -> Array:
        """Green's strain from Almansi's: eps_A / (1 - 2 eps_A)."""
        eps = self.almansi_strain(displacement)
        return eps / (1 - 2 * eps)
