"""Rigid circles, spheres and cylinders, solid or as holes: the distance to a centre or to an axis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.exact import unit_vector
from contactqp.elements.reading import positive_number, real_array
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import computes

# Closer to the centre than this part of the radius, every direction is as near as any other.
CENTRE = 1e-9


@computes
@dataclass(frozen=True, eq=False)
class _Ball(ABC):
    """What a circle and a sphere share: only the dimension differs."""

    centre: Any
    radius: float
    inside: bool = False

    def __post_init__(self) -> None:
        _check(self._name, "centre", self.centre, self.dimension)
        positive_number(f"{self._name} radius", self.radius, "length")

    @property
    @abstractmethod
    def dimension(self) -> int:
        """2 or 3."""

    @property
    def _name(self) -> str:
        return type(self).__name__.lower()

    def distance(self, points: Any) -> NDArray[np.float64]:
        """The signed distance of the (p, dimension) points, positive when open, (p,) [length]."""
        return _distance(self._radial(points), float(self.radius), self.inside)

    def normals(self, points: Any) -> NDArray[np.float64]:
        """The unit normals out of the obstacle, (p, dimension); InvalidProblem for a point at the centre."""
        return _normals(self._name, points, self._radial(points), float(self.radius), self.inside)

    def _radial(self, points: Any) -> NDArray[np.float64]:
        apart: NDArray[np.float64] = real_array("points", points) - np.asarray(self.centre, dtype=float)
        return apart


class Circle(_Ball):
    """The rigid disc |x - centre| <= radius in the plane, or the hole that it leaves.

    gap = |x - centre| - radius, n = (x - centre) / |x - centre|; both change sign if `inside`.

    Parameters
    ----------
    centre : (2,) array [length]
    radius : float
        Positive [length].
    inside : bool
        The body is inside: the obstacle is everything outside the circle.
    """

    @property
    def dimension(self) -> int:
        return 2


class Sphere(_Ball):
    """The rigid ball |x - centre| <= radius in space, or the hole that it leaves.

    gap = |x - centre| - radius, n = (x - centre) / |x - centre|; both change sign if `inside`.

    Parameters
    ----------
    centre : (3,) array [length]
    radius : float
        Positive [length].
    inside : bool
        The body is inside: the obstacle is everything outside the sphere.
    """

    @property
    def dimension(self) -> int:
        return 3


@computes
@dataclass(frozen=True, eq=False)
class Cylinder:
    """The rigid round bar of infinite length about an axis, or the bore that it leaves.

    gap = |r| - radius, n = r / |r| with r = (x - point) - ((x - point).a) a; both change sign if `inside`.

    Parameters
    ----------
    point : (3,) array
        Anywhere on the axis [length].
    axis : (3,) array
        a, of any length but zero.
    radius : float
        Positive [length].
    inside : bool
        The body is inside: the obstacle is everything outside the cylinder.
    """

    point: Any
    axis: Any
    radius: float
    inside: bool = False

    def __post_init__(self) -> None:
        _check("cylinder", "point", self.point, 3)
        _check("cylinder", "axis", self.axis, 3)
        positive_number("cylinder radius", self.radius, "length")
        unit_vector(self.axis, "cylinder axis")

    @property
    def dimension(self) -> int:
        return 3

    def distance(self, points: Any) -> NDArray[np.float64]:
        """The signed distance of the (p, 3) points, positive when open, (p,) [length]."""
        return _distance(self._radial(points), float(self.radius), self.inside)

    def normals(self, points: Any) -> NDArray[np.float64]:
        """The unit normals out of the obstacle, (p, 3); InvalidProblem for a point on the axis."""
        return _normals("cylinder", points, self._radial(points), float(self.radius), self.inside)

    def _radial(self, points: Any) -> NDArray[np.float64]:
        """From the axis to the points."""
        a = unit_vector(np.asarray(self.axis, dtype=float), "cylinder axis")
        apart = real_array("points", points) - np.asarray(self.point, dtype=float)
        radial: NDArray[np.float64] = apart - np.outer(apart @ a, a)
        return radial


def _check(name: str, what: str, vector: Any, dimension: int) -> None:
    read = real_array(f"{name} {what}", vector)
    if read.shape != (dimension,) or not np.all(np.isfinite(read)):
        raise InvalidProblem(f"{name} {what}: expected {dimension} finite components, got {vector}")


def _distance(radial: NDArray[np.float64], radius: float, inside: bool) -> NDArray[np.float64]:
    outside: NDArray[np.float64] = np.linalg.norm(radial, axis=1) - radius
    return -outside if inside else outside


def _normals(name: str, points: Any, radial: NDArray[np.float64], radius: float, inside: bool) -> NDArray[np.float64]:
    length = np.linalg.norm(radial, axis=1)
    central = np.flatnonzero(length <= CENTRE * radius)
    if central.size:
        i = int(central[0])
        raise InvalidProblem(
            f"{name}: point {i}, {np.asarray(points)[i].tolist()}, lies at the centre, where every direction is as "
            f"near: expected it at least {CENTRE:g} radii away"
        )
    normals: NDArray[np.float64] = radial / length[:, np.newaxis]
    return -normals if inside else normals
