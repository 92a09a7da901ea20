"""Elastic laws of a bar at any strain: energy, second Piola-Kirchhoff stress and its modulus against Green's strain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from contactqp.model.arrays import Array


class BarLaw(Protocol):
    """w(eps) per unit volume and unit modulus, with S = w' and C = w''; eps = (L^2 - L0^2) / (2 L0^2) is Green's.

    `length_free` says that the law has no singularity where the bar has shrunk to a point, 1 + 2 eps = 0.
    """

    @property
    def length_free(self) -> bool: ...

    def energy(self, eps: Any) -> Array:
        """w [-]."""

    def stress(self, eps: Any) -> Array:
        """S = dw/deps [-]."""

    def modulus(self, eps: Any) -> Array:
        """C = d2w/deps2 [-]."""


@dataclass(frozen=True)
class GreenLaw:
    """Saint Venant-Kirchhoff: w = eps^2 / 2, S = eps, C = 1 (course section 2.5)."""

    length_free: bool = True

    def energy(self, eps: Any) -> Array:
        """eps^2 / 2."""
        return np.asarray(np.square(eps) / 2)

    def stress(self, eps: Any) -> Array:
        """eps."""
        return np.asarray(eps, dtype=float)

    def modulus(self, eps: Any) -> Array:
        """1."""
        return np.ones_like(np.asarray(eps, dtype=float))


@dataclass(frozen=True)
class EngineeringLaw:
    """Linear in the elongation: e = L / L0 - 1, w = e^2 / 2; the force N = E A0 e."""

    length_free: bool = False

    def energy(self, eps: Any) -> Array:
        """e^2 / 2."""
        return np.asarray(np.square(_elongation(eps)) / 2)

    def stress(self, eps: Any) -> Array:
        """e / (1 + e)."""
        e = _elongation(eps)
        return np.asarray(e / (1 + e))

    def modulus(self, eps: Any) -> Array:
        """1 / (1 + e)^3."""
        return np.asarray(1 / (1 + _elongation(eps)) ** 3)


@dataclass(frozen=True)
class LogarithmicLaw:
    """Hencky: h = log(L / L0), w = h^2 / 2; the force N = E A0 h L0 / L.

    The force is greatest at h = 1: a bar under a greater dead load tears.
    """

    length_free: bool = False

    def energy(self, eps: Any) -> Array:
        """h^2 / 2."""
        return np.asarray(np.square(np.log1p(2 * np.asarray(eps)) / 2) / 2)

    def stress(self, eps: Any) -> Array:
        """h / (1 + 2 eps)."""
        return np.asarray(np.log1p(2 * np.asarray(eps)) / 2 / (1 + 2 * np.asarray(eps)))

    def modulus(self, eps: Any) -> Array:
        """(1 - 2 h) / (1 + 2 eps)^2."""
        square = 1 + 2 * np.asarray(eps)
        return np.asarray((1 - np.log(square)) / square / square)  # squared, a great strain would overflow


@dataclass(frozen=True)
class LawOfEachBar:
    """One law for each of B bars: eps is (B,). If one of them cannot bear a bar of no length, all are kept from it."""

    laws: tuple[BarLaw, ...]

    @property
    def length_free(self) -> bool:
        return all(law.length_free for law in self.laws)

    def energy(self, eps: Any) -> Array:
        """w of each."""
        return self._of_each("energy", eps)

    def stress(self, eps: Any) -> Array:
        """S of each."""
        return self._of_each("stress", eps)

    def modulus(self, eps: Any) -> Array:
        """C of each."""
        return self._of_each("modulus", eps)

    def _of_each(self, name: str, eps: Any) -> Array:
        strains, values = np.asarray(eps, dtype=float), np.empty(len(self.laws))
        for law, bars in self._groups():
            values[bars] = getattr(law, name)(strains[bars])
        return values

    def _groups(self) -> Iterator[tuple[BarLaw, list[int]]]:
        """The distinct laws, and the bars that follow them."""
        for law in dict.fromkeys(self.laws):
            yield law, [i for i, other in enumerate(self.laws) if other == law]


LAWS: dict[str, BarLaw] = {"green": GreenLaw(), "engineering": EngineeringLaw(), "logarithmic": LogarithmicLaw()}


def _elongation(eps: Any) -> Array:
    """e = sqrt(1 + 2 eps) - 1, without the cancellation."""
    eps = np.asarray(eps, dtype=float)
    return np.asarray(2 * eps / (1 + np.sqrt(1 + 2 * eps)))
