"""How the normal of a rigid obstacle turns from point to point: the Hessian of its signed distance."""

from __future__ import annotations

import numpy as np

from contactqp.elements.exact import unit_vector
from contactqp.elements.obstacle import Obstacle, Plane
from contactqp.elements.round_obstacle import Circle, Cylinder, Sphere
from contactqp.model.arrays import Array

# Where truncation (step^2) and rounding (eps / step) of a central difference meet.
RELATIVE_STEP = float(np.cbrt(np.finfo(float).eps))


def distance_hessians(obstacle: Obstacle, points: Array) -> Array:
    """d n / d x of each of the (p, d) points, (p, d, d), symmetric [1 / length].

    A plane has none; a circle, a sphere or a cylinder has (1 - n n') / r without the part along the axis, r the
    distance from the centre or the axis. Of any other obstacle the normals are differenced.

    >>> distance_hessians(Circle([0.0, 0.0], 1.0), np.array([[0.0, 2.0]])).tolist()
    [[[0.5, 0.0], [0.0, 0.0]]]
    """
    d = points.shape[1]
    if isinstance(obstacle, Plane) or not len(points):
        return np.zeros((len(points), d, d))
    if not isinstance(obstacle, Circle | Sphere | Cylinder):
        return _differences(obstacle, points)
    n = np.asarray(obstacle.normals(points), dtype=float)
    distance = np.asarray(obstacle.distance(points), dtype=float)
    outside = -1.0 if obstacle.inside else 1.0
    r = float(obstacle.radius) + outside * distance
    across = np.eye(d) - n[:, :, None] * n[:, None, :]
    if isinstance(obstacle, Cylinder):
        a = unit_vector(np.asarray(obstacle.axis, dtype=float), "cylinder axis")
        across -= np.outer(a, a)
    return np.asarray(across * (outside / r)[:, None, None])


def _differences(obstacle: Obstacle, points: Array) -> Array:
    size = np.max(abs(points)) + np.max(abs(np.asarray(obstacle.distance(points), dtype=float)))
    h = RELATIVE_STEP * float(size or 1.0)
    columns = [(obstacle.normals(points + h * e) - obstacle.normals(points - h * e)) / (2 * h) for e in _axes(points)]
    found = np.stack(columns, axis=2).astype(float)
    return np.asarray((found + np.swapaxes(found, 1, 2)) / 2)


def _axes(points: Array) -> Array:
    return np.eye(points.shape[1])
