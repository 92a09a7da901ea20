"""The rigid obstacles of a scene in floats."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.obstacle import Obstacle, Plane
from contactqp.elements.round_obstacle import Circle, Cylinder, Paraboloid, Sphere
from contactqp.errors import InvalidProblem
from contactqp.scene.units import number, vector

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData


def obstacle(scene: SceneData, name: str) -> Obstacle:
    """Return the rigid obstacle of that name."""
    item = scene.obstacle(name)
    where = {key: vector(scene.system, getattr(item, key) or ()) for key in ("point", "centre", "apex")}
    normal, axis = (np.array([float(x) for x in vector or ()]) for vector in (item.normal, item.axis))
    radius = 0.0 if item.radius is None else number(scene.system, item.radius)
    inside = bool(item.inside)
    if item.kind == "plane":
        return Plane(where["point"], normal)
    if item.kind == "circle":
        return Circle(where["centre"], radius, inside)
    if item.kind == "sphere":
        return Sphere(where["centre"], radius, inside)
    if item.kind == "cylinder":
        return Cylinder(where["point"], axis, radius, inside)
    return Paraboloid(where["apex"], axis, radius, inside, item.measure or "axis")


def height_of(item: Obstacle, name: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the z of the obstacle's upper surface over (p, 2) points, -inf where there is none [length].

    Raises
    ------
    InvalidProblem
        An obstacle that does not lie below a surface z(x, y): of another kind, a hole, or turned to another side.
    """
    if isinstance(item, Plane) and float(item.outward()[2]) > 0:
        n = np.asarray(item.outward(), dtype=float)
        return np.asarray(item.point[2] - (points - np.asarray(item.point[:2])) @ n[:2] / n[2])
    if isinstance(item, Sphere) and not item.inside:
        below = item.radius**2 - _squares(points, item.centre)
        return np.where(below >= 0, item.centre[2] + np.sqrt(np.maximum(below, 0)), -np.inf)
    if isinstance(item, Paraboloid) and not item.inside and not np.any(item.axis[:2]) and item.axis[2] > 0:
        return np.asarray(item.apex[2] - _squares(points, item.apex) / (2 * item.radius))
    raise InvalidProblem(
        "expected an obstacle below the membrane (a plane whose normal points up, a sphere, or a paraboloid with the "
        f"axis +z, none of them a hole), got {name!r}"
    )


def _squares(points: NDArray[np.float64], centre: Any) -> NDArray[np.float64]:
    """Return r^2 of the points from the vertical through the centre."""
    squares: NDArray[np.float64] = ((points - np.asarray(centre, dtype=float)[:2]) ** 2).sum(axis=1)
    return squares
