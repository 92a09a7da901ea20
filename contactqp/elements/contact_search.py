"""Which facets can be near which points: balls that overlap, in n log n for facets of any sizes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactqp.model.arrays import Array

Places = NDArray[np.int64]


def overlapping_balls(points: Array, reach: Array, centres: Array, radii: Array) -> tuple[Places, Places]:
    """All (i, j) with |points_i - centres_j| <= reach_i + radii_j, ordered by i, then j.

    Parameters
    ----------
    points, centres : (p, d) and (q, d) arrays [length]
    reach, radii : (p,) and (q,) arrays [length], not negative
        One tree for each power of two of the radii, so that a few large balls do not widen every search.
    """
    found_i, found_j = [np.array([], dtype=np.int64)], [np.array([], dtype=np.int64)]
    size = np.frexp(radii)[1]
    for exponent in np.unique(size):
        group = np.flatnonzero(size == exponent)
        near = cKDTree(centres[group]).query_ball_point(points, reach + radii[group].max())
        count = np.array([len(some) for some in near], dtype=np.int64)
        i = np.repeat(np.arange(len(points)), count)
        j = group[np.concatenate([np.asarray(some, dtype=np.int64) for some in near])] if len(i) else found_j[0]
        keep = np.linalg.norm(points[i] - centres[j], axis=1) <= reach[i] + radii[j]
        found_i.append(i[keep])
        found_j.append(j[keep])
    i, j = np.concatenate(found_i), np.concatenate(found_j)
    order = np.lexsort((j, i))
    return i[order], j[order]


def bounding_balls(positions: Array) -> tuple[Array, Array]:
    """Centres (p, d) and radii (p,) of balls that hold facets with nodes at `positions` (p, k, d) [length].

    A facet is in the hull of its nodes as long as no shape function is negative; those of quadratic facets are down to
    -1/8 on lines, so that the distance to the farthest node is doubled for them.
    """
    centres = positions.mean(axis=1)
    radii = np.linalg.norm(positions - centres[:, np.newaxis], axis=2).max(axis=1)
    linear = positions.shape[1] == 2 if positions.shape[2] == 2 else positions.shape[1] <= 4
    return centres, radii * (1.0 if linear else 2.0)
