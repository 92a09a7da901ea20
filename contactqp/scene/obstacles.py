"""The rigid obstacles of a scene of bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from contactqp.elements.obstacle import Obstacle, Plane
from contactqp.elements.paraboloid import Paraboloid
from contactqp.elements.round_obstacle import Circle, Cylinder, Sphere
from contactqp.scene.units import number, vector

if TYPE_CHECKING:
    from contactqp.scene.schema import Scene


def obstacle(scene: Scene, name: str) -> Obstacle:
    """The rigid obstacle of that name."""
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
