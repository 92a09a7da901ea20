"""The elastic half-plane y <= 0 under a rigid punch or parabola without friction, in closed form: plane strain.

From one analytic function Z (Westergaard 1939; Johnson 1985, section 2.8 and 4.2), with z = x + i y and Ẑ' = Z:

    sigma_xx = Re Z - y Im Z',   sigma_yy = Re Z + y Im Z',   sigma_xy = -y Re Z'
    2 G u_x = (1 - 2 nu) Re Ẑ - y Im Z,   2 G u_y = 2 (1 - nu) Im Ẑ - y Re Z

On y = 0 no shear acts, and the pressure is p = -Re Z:

    punch      Z = -P / (pi sqrt(a^2 - z^2))                 p = P / (pi sqrt(a^2 - x^2))
    parabola   Z = -(p0 / a) (sqrt(a^2 - z^2) - i z)         p = p0 sqrt(1 - x^2 / a^2),  p0 = E* a / (2 R)

with E* = E / (1 - nu^2), the total force P = pi a p0 / 2, and the deepest point of the parabola at rest at the origin.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# The surface y = 0 is meant as the edge of the half-plane beneath, where sqrt and arcsin have their cuts.
BENEATH = 1e-300


@dataclass(frozen=True)
class Elastic:
    """Young's modulus [force / length^2] and Poisson's ratio, in plane strain."""

    modulus: float = 1.0
    poisson: float = 0.3

    @property
    def shear(self) -> float:
        """G."""
        return self.modulus / (2 * (1 + self.poisson))

    @property
    def effective(self) -> float:
        """E*."""
        return self.modulus / (1 - self.poisson**2)


class HalfPlane(ABC):
    """What Z, Ẑ and Z' give."""

    elastic: Elastic

    @abstractmethod
    def potentials(self, z: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], ...]:
        """Ẑ, Z and Z' at z, Im z < 0."""

    def displacement(self, x: Vector) -> Vector:
        """u at (p, 2) points, (p, 2) [length]."""
        integral, Z, _ = self.potentials(_complex(x))
        nu, y = self.elastic.poisson, x[:, 1]
        u = [(1 - 2 * nu) * integral.real - y * Z.imag, 2 * (1 - nu) * integral.imag - y * Z.real]
        return np.stack(u, axis=1) / (2 * self.elastic.shear)

    def gradient(self, x: Vector) -> Vector:
        """du_a/dx_b at (p, 2) points, (p, 2, 2) [-]."""
        _, Z, dZ = self.potentials(_complex(x))
        nu, y = self.elastic.poisson, x[:, 1]
        along = [(1 - 2 * nu) * Z.real - y * dZ.imag, -2 * (1 - nu) * Z.imag - y * dZ.real]
        down = [2 * (1 - nu) * Z.imag - y * dZ.real, (1 - 2 * nu) * Z.real + y * dZ.imag]
        return np.stack([np.stack(along, axis=1), np.stack(down, axis=1)], axis=1) / (2 * self.elastic.shear)

    def stress(self, x: Vector) -> Vector:
        """sigma_ab at (p, 2) points, (p, 2, 2) [force / length^2]."""
        _, Z, dZ = self.potentials(_complex(x))
        y = x[:, 1]
        shear = -y * dZ.real
        rows = [[Z.real - y * dZ.imag, shear], [shear, Z.real + y * dZ.imag]]
        return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


@dataclass(frozen=True)
class Parabola(HalfPlane):
    """A rigid parabola of radius R that touches over |x| < a."""

    half_width: float = 1.0
    radius: float = 100.0
    elastic: Elastic = Elastic()

    @property
    def peak(self) -> float:
        """p0 [force / length^2]."""
        return self.elastic.effective * self.half_width / (2 * self.radius)

    @property
    def force(self) -> float:
        """P, per thickness [force / length]."""
        return float(np.pi * self.half_width * self.peak / 2)

    def potentials(self, z: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], ...]:
        a = self.half_width
        root = np.sqrt(a - z) * np.sqrt(a + z)
        slope = -self.peak / a
        integral = (z * root + a**2 * np.arcsin(z / a) - 1j * z**2) / 2
        return slope * integral, slope * (root - 1j * z), slope * (-z / root - 1j)


@dataclass(frozen=True)
class Punch(HalfPlane):
    """A rigid flat punch over |x| < a that presses with the force P per thickness."""

    half_width: float = 1.0
    force: float = 1.0
    elastic: Elastic = Elastic()

    def potentials(self, z: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], ...]:
        a = self.half_width
        root = np.sqrt(a - z) * np.sqrt(a + z)
        size = -self.force / np.pi
        return size * np.arcsin(z / a), size / root, size * z / root**3


def _complex(x: Vector) -> NDArray[np.complex128]:
    return x[:, 0] + 1j * np.minimum(x[:, 1], -BENEATH)
