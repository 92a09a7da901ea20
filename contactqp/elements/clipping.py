"""What two convex polygons in a plane have in common, for many pairs at once.

Polygons are (P, V, 2) arrays of vertices, counter-clockwise; those with fewer than V vertices repeat their last one.
"""

from __future__ import annotations

import numpy as np

from contactqp.model.arrays import Array


def clip(polygons: Array, windows: Array) -> Array:
    """The intersection of each polygon with the convex window of the same place, (P, W, 2).

    One edge of the windows after the other cuts off what lies on its right (Sutherland & Hodgman 1974). An empty
    intersection is a polygon without area.
    """
    for start in range(windows.shape[1]):
        a, b = windows[:, start, np.newaxis], windows[:, (start + 1) % windows.shape[1], np.newaxis]
        polygons = _cut(polygons, _cross(b - a, polygons - a))
    return polygons


def _cut(polygons: Array, side: Array) -> Array:
    """Keep where side >= 0; side is linear along the edges, (P, V)."""
    kept = side >= 0
    crossing = kept != np.roll(kept, -1, axis=1)
    rise = side - np.roll(side, -1, axis=1)
    part = np.where(crossing, side / np.where(crossing, rise, 1.0), 0.0)[:, :, np.newaxis]
    cuts = polygons + part * (np.roll(polygons, -1, axis=1) - polygons)
    vertices = np.stack([polygons, cuts], axis=2).reshape(len(polygons), 2 * polygons.shape[1], 2)
    valid = np.stack([kept, crossing], axis=2).reshape(len(polygons), 2 * polygons.shape[1])
    count = valid.sum(axis=1)
    order = np.argsort(~valid, axis=1, kind="stable")
    last = np.maximum(count - 1, 0)[:, np.newaxis]
    places = np.minimum(np.arange(max(int(count.max(initial=0)), 3)), last)
    chosen = np.take_along_axis(order, places, axis=1)
    return np.take_along_axis(vertices, chosen[:, :, np.newaxis], axis=1)


def areas(polygons: Array) -> Array:
    """Positive for counter-clockwise polygons, (P,)."""
    from_first = polygons - polygons[:, :1]
    twice: Array = _cross(from_first, np.roll(from_first, -1, axis=1)).sum(axis=1)
    return twice / 2


def triangles(polygons: Array) -> Array:
    """The fan from the first vertex, (P, V-2, 3, 2)."""
    first = np.broadcast_to(polygons[:, :1], polygons[:, 1:-1].shape)
    return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2)


def _cross(a: Array, b: Array) -> Array:
    product: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
