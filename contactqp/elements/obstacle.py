"""Rigid obstacles: where they are, how far a point is from them, and the directions along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.exact import Numbers, unit_vector
from contactqp.elements.reading import real_array
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import computes


class Obstacle(Protocol):
    """A rigid obstacle, known by its signed distance."""

    @property
    def dimension(self) -> int: ...

    def distance(self, points: Any) -> Numbers:
        """The signed distance of each of the (p, dimension) points [length]: the gap, positive when open."""

    def normals(self, points: Any) -> Numbers:
        """The unit vectors along which the distance grows fastest, out of the obstacle, (p, dimension)."""


@computes
@dataclass(frozen=True, eq=False)
class Plane:
    """The rigid half-space behind the plane through `point`; bodies are on the side that `normal` points to.

    Parameters
    ----------
    point, normal : (dimension,) arrays
        In one, two or three dimensions; the normal may have any length but zero.
    """

    point: Any
    normal: Any

    def __post_init__(self) -> None:
        point, normal = (real_array(f"plane {what}", getattr(self, what)) for what in ("point", "normal"))
        if point.shape != normal.shape or point.shape not in ((1,), (2,), (3,)):
            raise InvalidProblem(
                f"plane: expected a point and a normal of one, two or three components, got shapes "
                f"{point.shape} and {normal.shape}"
            )
        for what, vector in (("point", point), ("normal", normal)):
            if not np.all(np.isfinite(vector)):
                raise InvalidProblem(f"plane {what}: expected finite components, got {vector}")
        self.outward()

    @property
    def dimension(self) -> int:
        return len(self.point)

    def outward(self) -> Numbers:
        """The unit normal n, out of the obstacle."""
        return unit_vector(self.normal, "plane normal")

    def distance(self, points: Any) -> Numbers:
        """(x - point).n of each of the (p, dimension) points [length]: the gap, positive when open."""
        gap: Numbers = (np.asarray(points) - np.asarray(self.point)) @ self.outward()
        return gap

    def normals(self, points: Any) -> Numbers:
        """n for each of the (p, dimension) points."""
        return np.tile(self.outward(), (len(points), 1))


def tangents(normal: Numbers) -> Numbers:
    """The (dimension - 1, dimension) unit vectors along a surface with the unit normal n.

    2D: t = (n_2, -n_1), so that a floor with n = (0, 1) has t = (1, 0). 3D: t_1 is the projection of the axis furthest
    from n, t_2 = n x t_1.

    >>> tangents(np.array([0.0, 1.0])).tolist()
    [[1.0, -0.0]]
    >>> tangents(np.array([0.0, 0.0, 1.0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    if len(normal) == 1:
        return np.zeros((0, 1), dtype=int)
    if len(normal) == 2:
        return np.array([[normal[1], -normal[0]]])
    axis = np.zeros(3, dtype=int)
    axis[int(np.argmin([abs(float(c)) for c in normal]))] = 1
    first = unit_vector(axis - np.dot(axis, normal) * normal, "tangent")
    a, b, c = normal
    x, y, z = first
    return np.array([first, [b * z - c * y, c * x - a * z, a * y - b * x]])


def tangent_frames(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """`tangents` of each of the (p, d) unit normals, (p, d-1, d)."""
    p, d = normals.shape
    if d == 1:
        return np.zeros((p, 0, 1))
    if d == 2:
        return np.stack([normals[:, 1], -normals[:, 0]], axis=1)[:, np.newaxis, :]
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = axis - (axis * normals).sum(axis=1, keepdims=True) * normals
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first)], axis=1)
