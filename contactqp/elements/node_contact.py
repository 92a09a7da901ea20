"""The rows of one contact: a node against a rigid obstacle, or two nodes against each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from contactqp.elements.obstacle import Obstacle, Plane, tangents
from contactqp.elements.scalars import Number, Numbers, unit_vector


@dataclass(frozen=True, eq=False)
class ContactRows:
    """One contact on the unknowns of its nodes: E_N u <= gap, slip E_T u."""

    normal: Numbers  # (nodes * dimension,)
    gap: Number  # positive when open
    tangent: Numbers  # (dimension - 1, nodes * dimension)


def against_plane(point: Any, plane: Plane) -> ContactRows:
    """Return the rows against a plane, E_N = -n', gap = (x - point).n: moving against the obstacle's normal closes
    the gap.

    Course chapter, Example 2.10: on a floor, n = (0, 1), E_N = (0, -1).
    """
    n = plane.outward()
    gap: Number = plane.distance(np.asarray(point)[np.newaxis, :])[0]
    return ContactRows(normal=-n, gap=gap, tangent=tangents(n))


def against_surface(point: Any, obstacle: Obstacle) -> ContactRows:
    """Return the rows against any obstacle, in floats, with its normal nearest to the point."""
    at = np.asarray(point, dtype=float)[np.newaxis, :]
    n = np.array([float(x) for x in obstacle.normals(at)[0]], dtype=object)
    return ContactRows(normal=-n, gap=float(obstacle.distance(at)[0]), tangent=tangents(n))


def between_nodes(first: Any, second: Any, direction: Any) -> ContactRows:
    """Return the rows of two nodes, E_N = (n', -n'), gap = (x_2 - x_1).n with n = direction / |direction| from the
    first to the second.

    Course chapter, Example 2.13: E_N = (1, -1) for two bars on one line. The tangents are those of the second node's
    surface, whose normal points back at the first: E_T = (t, -t).
    """
    n = unit_vector(direction, "contact direction")
    gap: Number = np.dot(np.asarray(second) - np.asarray(first), n)
    along = tangents(-n)
    return ContactRows(normal=np.concatenate([n, -n]), gap=gap, tangent=np.hstack([along, -along]))
