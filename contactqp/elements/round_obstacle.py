"""Rigid circles, spheres and cylinders, solid or as holes, and the paraboloid of Hertz's theory.

Distances are to a centre or to an axis; the paraboloid has the gap of Hertz's theory, or the true distance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from contactqp.elements.obstacle import points_near
from contactqp.elements.scalars import keep_own, positive_number, unit_vector
from contactqp.errors import InvalidProblem, shown
from contactqp.linalg.measures import lengths
from contactqp.model.arguments import checks
from contactqp.model.arrays import EPS, Array, computes
from contactqp.model.problem_data import ReadOnly, read_array

# Closer to the centre than this part of the radius the normal is not defined.
CENTRE = 1e-9
Measure = Literal["axis", "normal"]
# Newton's method from above on a convex function roughly takes a third off a cube, then doubles the digits.
NEWTON_STEPS = 100


@checks
@computes
@dataclass(frozen=True, eq=False)
class _Ball(ReadOnly, ABC):
    """The common part of a circle and a sphere: only the dimension differs."""

    centre: Any
    radius: float
    inside: bool = False

    def __post_init__(self) -> None:
        _check(self._name, "centre", self.centre, self.dimension)
        positive_number(f"{self._name} radius", self.radius, "length")
        keep_own(self, "centre")

    @property
    @abstractmethod
    def dimension(self) -> int:
        """Return the dimension of space, 2 or 3."""

    @property
    def _name(self) -> str:
        return type(self).__name__.lower()

    def distance(self, points: Any) -> Array:
        """Return the signed distance of the (p, dimension) points, positive when open, (p,) [length]."""
        return _distance(self._radial(points), float(self.radius), self.inside)

    def normals(self, points: Any) -> Array:
        """Return the unit normals out of the obstacle, (p, dimension); InvalidProblem for a point at the centre."""
        return _normals(self._name, points, self._radial(points), float(self.radius), self.inside)

    def _radial(self, points: Any) -> Array:
        apart: Array = points_near(self, points).astype(float) - np.asarray(self.centre, dtype=float)
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
        """Return the dimension of space, 2."""
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
        """Return the dimension of space, 3."""
        return 3


@checks
@computes
@dataclass(frozen=True, eq=False)
class Cylinder(ReadOnly):
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
        unit_vector(np.asarray(self.axis, dtype=float), "cylinder axis")
        keep_own(self, "point", "axis")

    @property
    def dimension(self) -> int:
        """Return the dimension of space, 2 or 3."""
        return 3

    def distance(self, points: Any) -> Array:
        """Return the signed distance of the (p, 3) points, positive when open, (p,) [length]."""
        return _distance(self._radial(points), float(self.radius), self.inside)

    def normals(self, points: Any) -> Array:
        """Return the unit normals out of the obstacle, (p, 3); InvalidProblem for a point on the axis."""
        return _normals("cylinder", points, self._radial(points), float(self.radius), self.inside)

    def _radial(self, points: Any) -> Array:
        """Return the vectors from the axis to the points."""
        a = unit_vector(np.asarray(self.axis, dtype=float), "cylinder axis")
        apart = points_near(self, points).astype(float) - np.asarray(self.point, dtype=float)
        radial: Array = apart - np.outer(apart @ a, a)
        return radial


def _check(name: str, what: str, vector: Any, dimension: int) -> None:
    read = read_array(f"{name} {what}", vector)
    if read.shape != (dimension,) or not np.all(np.isfinite(read)):
        raise InvalidProblem(f"{name} {what}: expected {dimension} finite components, got {shown(vector)}")


def _distance(radial: Array, radius: float, inside: bool) -> Array:
    outside: Array = lengths(radial) - radius
    return -outside if inside else outside


def _normals(name: str, points: Any, radial: Array, radius: float, inside: bool) -> Array:
    length = lengths(radial)
    central = np.flatnonzero(length <= CENTRE * radius)
    if central.size:
        i = int(central[0])
        raise InvalidProblem(
            f"{name}: point {i}, {np.asarray(points)[i].tolist()}, lies at the centre, where every direction is as "
            f"near: expected it at least {CENTRE:g} radii away"
        )
    normals: Array = radial / length[:, np.newaxis]
    return -normals if inside else normals


@checks
@computes
@dataclass(frozen=True, eq=False)
class Paraboloid(ReadOnly):
    """The rigid obstacle behind z = -r^2 / (2 R): z along the axis from the apex, r the distance from the axis.

    In two dimensions it is a parabola (the cylinder of Hertz's line contact). The body is on the side that the axis
    points to. A rigid indenter that comes from above has the axis (0, 0, -1): it is r^2 / (2 R) above its apex.

    Parameters
    ----------
    apex : (2,) or (3,) array [length]
    axis : array of the same size
        Out of the obstacle, of any length but zero.
    radius : float
        R, the radius of curvature at the apex, positive [length].
    inside : bool
        The body is inside a bowl: the obstacle is behind z = +r^2 / (2 R).
    measure : "axis" or "normal"
        How the gap is measured. "axis", the default: along the axis, gap = z + r^2 / (2 R) and n = axis everywhere.
        That is the gap and the pressure's direction of Hertz's theory (Johnson 1985, sections 3.1 and 4.1), so that
        solutions converge to his formulas; it is larger than the distance by the part r^2 / (2 R^2) of it.
        "normal": the Euclidean distance to the surface and its unit normal, as for contact on the flank.
    """

    apex: Any
    axis: Any
    radius: float
    inside: bool = False
    measure: Measure = "axis"

    def __post_init__(self) -> None:
        apex, axis = (read_array(f"paraboloid {what}", getattr(self, what)) for what in ("apex", "axis"))
        sizes = apex.shape, axis.shape
        if sizes not in (((2,), (2,)), ((3,), (3,))):
            raise InvalidProblem(f"paraboloid: expected an apex and an axis of two or three components, got {sizes}")
        if not np.all(np.isfinite([apex, axis])):
            raise InvalidProblem(f"paraboloid: expected finite apex and axis, got {self.apex} and {self.axis}")
        positive_number("paraboloid radius", self.radius, "length")
        unit_vector(axis, "paraboloid axis")
        keep_own(self, "apex", "axis")

    @property
    def dimension(self) -> int:
        """Return the dimension of space, 2 or 3."""
        return len(self.apex)

    def distance(self, points: Any) -> Array:
        """Return the gaps of the (p, dimension) points by the chosen measure, positive when open, (p,) [length]."""
        z, radial = self._coordinates(points)
        if self.measure == "axis":
            along: Array = z + self._sign * (radial * (radial / (2 * self.radius))).sum(axis=1)
            return along
        foot, normals = self._foot(z, radial)
        apart = np.outer(z, self._along) + radial - foot
        distances: Array = (apart * normals).sum(axis=1)
        return distances

    def normals(self, points: Any) -> Array:
        """Return the unit vectors along which the gaps are measured, (p, dimension).

        Raises
        ------
        InvalidProblem
            measure="normal" and a point that has no single nearest point (on the axis, beyond the focal length R).
        """
        z, radial = self._coordinates(points)
        return np.tile(self._along, (len(z), 1)) if self.measure == "axis" else self._foot(z, radial)[1]

    @property
    def _along(self) -> Array:
        return unit_vector(np.asarray(self.axis, dtype=float), "paraboloid axis")

    @property
    def _sign(self) -> float:
        """Return the sign of the curvature: the surface is z = -sign r^2 / (2 R)."""
        return -1.0 if self.inside else 1.0

    def _coordinates(self, points: Any) -> tuple[Array, Array]:
        """Return z, (p,), and the vectors from the axis to the points, (p, dimension)."""
        apart = points_near(self, points).astype(float) - np.asarray(self.apex, dtype=float)
        z = apart @ self._along
        return z, apart - np.outer(z, self._along)

    def _foot(self, z: Array, radial: Array) -> tuple[Array, Array]:
        """Return the nearest points on the surface, from the apex, and the unit normals there.

        In units of R the foot at the distance rho from the axis satisfies rho^3 + p rho = q, p = 2 (1 + s z), q = 2 r,
        with s = 1 for a solid and -1 for a bowl; the nearest is the largest root.
        """
        R, s = float(self.radius), self._sign
        r = lengths(radial)
        p, q = 2 * (1 + s * (z / R)), 2 * (r / R)
        lost = np.flatnonzero((r == 0) & (p <= 0))
        if lost.size:
            raise InvalidProblem(
                f"paraboloid: point {lost[0]} lies on the axis {abs(z[lost[0]]):.6g} from the apex, beyond the radius "
                f"{R:.6g}: expected a point with one nearest point on the surface"
            )
        rho = _largest_root(p, q)
        outwards = radial / np.where(r > 0, r, 1.0)[:, np.newaxis]
        foot = (R * rho)[:, np.newaxis] * outwards - np.outer(s * R * (rho * (rho / 2)), self._along)
        normals = self._along + s * rho[:, np.newaxis] * outwards
        return foot, normals / lengths(normals)[:, np.newaxis]


def _largest_root(p: Array, q: Array) -> Array:
    """Return the largest root of x^3 + p x = q >= 0, by Newton's method from above, monotone as the cubic is convex.

    The equation is scaled so that no power overflows.
    """
    size = np.maximum(np.cbrt(q), np.sqrt(np.abs(p)))
    size = np.ldexp(1.0, np.frexp(np.where(size > 0, size, 1.0))[1])
    p, q = p / size / size, q / size / size / size
    x: Array = np.cbrt(q) + np.sqrt(np.maximum(-p, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        x = np.where(p > 0, np.minimum(x, q / p), x)
    for _ in range(NEWTON_STEPS):
        slope = 3 * x**2 + p
        step = np.where(slope > 0, (x**3 + p * x - q) / np.where(slope > 0, slope, 1.0), 0.0)
        x = x - step
        if np.all(np.abs(step) <= 4 * EPS * x):
            break
    return x * size
