"""Whether contacts start where they can: not deep inside of an obstacle, nor turned the wrong way."""

from __future__ import annotations

import numpy as np

from contactqp.elements.obstacle import Obstacle
from contactqp.elements.surface import Surface, middle_normals
from contactqp.model.arrays import Array

# Parts of the size of a body: an overlap that no interference fit has, and one that is rounding.
DEEP, ROUNDING = 0.1, 1e-9
# Cosine of the angle between the outward normals of a side and of an obstacle, from which they agree.
AGREE = 0.5
CURE = "the normal of an obstacle points out of it, to where the body is"
TURN = f"{CURE}; turn it round?"


def doubt_of_points(points: Array, gap: Array, obstacle: Obstacle, called: str, body: Array) -> str:
    """Return in words what is doubtful of the start of points beside an obstacle; empty where nothing is.

    Parameters
    ----------
    points : (p, d) array
        The points that may touch [length].
    gap : (p,) array
        Their distances to the obstacle [length].
    obstacle : Obstacle
    called : str
        What messages call the obstacle.
    body : (N, d) array
        The other points of their body [length].
    """
    size = float(np.ptp(np.concatenate([points, body]), axis=0).max(initial=0.0)) if len(points) else 0.0
    depth = -float(np.min(gap, initial=0.0))
    if depth <= ROUNDING * size:
        return ""
    if len(body) and float(obstacle.distance(body.mean(axis=0)[np.newaxis])[0]) < -depth:
        return (
            f"it starts {depth:.6g} inside {called}, and the rest of its body lies deeper still: {CURE}; turn it round?"
        )
    if depth > DEEP * size > 0:
        return (
            f"it starts {depth:.6g} inside {called}, {100 * depth / size:.2g} % of the size of its body, and will be "
            f"dragged out: move it or the obstacle; {CURE}"
        )
    return ""


def doubt_of_side(surface: Surface, gap: Array, normals: Array, obstacle: Obstacle, called: str) -> str:
    """Return in words what is doubtful of the start of a side beside an obstacle; empty where nothing is.

    `gap` (p,) and `normals` (p, d) are the obstacle's at the nodes of the surface.
    """
    nodes = surface.nodes
    worst = int(np.argmin(gap))
    size = float(np.ptp(surface.points, axis=0).max())
    if gap[worst] <= ROUNDING * size:
        facets = np.any(surface.facets == nodes[worst], axis=1)
        outward = middle_normals(surface)[facets].mean(axis=0)
        if float(outward @ normals[worst]) > AGREE:
            return f"the side and {called} face the same way: {TURN}"
    return doubt_of_points(surface.points[nodes], gap, obstacle, called, surface.points)
