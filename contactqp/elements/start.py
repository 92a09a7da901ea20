"""Whether contacts start where they can: not deep inside of an obstacle, nor turned the wrong way.

Both are read off distances and normals at the contacts themselves: an obstacle need not be defined elsewhere.
"""

from __future__ import annotations

import numpy as np

from contactqp.elements.surface import Surface, middle_normals
from contactqp.model.arrays import Array

# The part of the size of a body that no interference fit overlaps by.
DEEP = 0.25
# Cosine of the angle between the outward normals of a side and of an obstacle, from which they agree.
AGREE = 0.5
CURE = "the normal of an obstacle points out of it, to where the body is"


def doubt_of_depth(depth: float, size: float, called: str, unit: str = "") -> str:
    """Return in words that a contact starts deep inside of what is called so; empty where it does not.

    `size` [length] is that of the body: its longest side, and in axial symmetry its diameter where that is longer.
    """
    if not depth > DEEP * size > 0:
        return ""
    part = f"{100 * depth / size:.2g} % of the size of its body"
    cure = f"move it or the obstacle, or turn that round; {CURE}"
    return f"it starts {depth:.6g}{unit and f' {unit}'} inside {called}, {part}, and will be dragged out: {cure}"


def doubt_of_side(surface: Surface, gap: Array, normals: Array, called: str, unit: str = "") -> str:
    """Return in words what is doubtful of the start of a side beside an obstacle; empty where nothing is.

    Where a side comes nearest to an obstacle, it faces it, but for an edge.

    Parameters
    ----------
    surface : Surface
    gap : (p,) array
        Distances of its nodes to the obstacle [length].
    normals : (p, d) array
        The obstacle's normals there.
    called : str
        What messages call the obstacle.
    unit : str
        The unit of lengths in messages.
    """
    if not len(gap):
        return ""
    nearest = int(np.argmin(gap))
    facets = np.any(surface.facets == surface.nodes[nearest], axis=1)
    outward = middle_normals(surface)[facets].mean(axis=0)
    if float(outward @ normals[nearest]) > AGREE:
        return f"the side and {called} face the same way: {CURE}; turn it round?"
    size = float(np.ptp(surface.points, axis=0).max())
    if surface.revolved:
        size = max(size, 2 * float(abs(surface.points[:, 0]).max()))
    return doubt_of_depth(-float(gap[nearest]), size, called, unit)
