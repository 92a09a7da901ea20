"""Mortar segments: what a slave facet and a master facet have in common.

Each slave facet has an auxiliary plane (in 2D a line): through its centre, across its normal n there. Master facets are
projected onto it along n and clipped with the slave facet (Puso & Laursen 2004; in 2D: Wriggers 2006, section 9.3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactqp.elements import clipping
from contactqp.elements.contact_search import bounding_balls, overlapping_balls
from contactqp.elements.facet import diameters, middle_normals
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array

Places = NDArray[np.int64]

# Facets face each other when their normals are within 60 degrees of opposite: -cos 60.
FACING = -0.5
# Common parts below this part of the slave facet are rounding.
SLIVER = 1e-12
# Balls searched at a time: some 100 MB.
BLOCK = 20_000


@dataclass(frozen=True, eq=False)
class Segments:
    """The s common parts of slave and master facets, in the coordinates of the slave facets' planes [length]."""

    slave: Places  # (s,) facets
    master: Places  # (s,) facets
    slave_corners: Array  # (s, k, d-1)
    slave_height: Array  # (s, k) along n over the plane
    master_corners: Array  # (s, l, d-1)
    master_height: Array  # (s, l)
    common: Array  # intervals (s, 2, 1) or convex polygons (s, V, 2)


def segments(slave: Surface, master: Surface, reach: float | None) -> Iterator[Segments]:
    """All segments between two surfaces of linear facets, some slave facets at a time.

    Parameters
    ----------
    slave, master : Surface
        line2, or tri3 and quad4 in any combination.
    reach : float, optional
        How far a slave facet looks for master facets along its normal, on either side [length]. By default three times
        the distance from its centre to the nearest master node, plus its diameter.

    Raises
    ------
    InvalidProblem
        Two master facets behind each other cover the same part of a slave facet.
    """
    positions, others = slave.points[slave.facets], master.points[master.facets]
    normals, other_normals = middle_normals(slave), middle_normals(master)
    for s, m in _candidates(positions, others, normals, master, reach):
        facing = (normals[s] * other_normals[m]).sum(axis=1) < FACING
        s, m = s[facing], m[facing]
        mine, their = positions[s], others[m]
        centre, n = mine.mean(axis=1)[:, np.newaxis], normals[s]
        axes = tangent_frames(n)
        mine_in, their_in = (np.einsum("skd,sad->ska", x - centre, axes) for x in (mine, their))
        common = _common(mine_in, their_in)
        size = _sizes(common)
        keep = size > SLIVER * diameters(mine) ** (slave.dimension - 1)
        _refuse_double_cover(slave, master, s[keep], m[keep], common[keep], size[keep])
        heights = [np.einsum("skd,sd->sk", (x - centre)[keep], n[keep]) for x in (mine, their)]
        yield Segments(s[keep], m[keep], mine_in[keep], heights[0], their_in[keep], heights[1], common[keep])


def _candidates(
    positions: Array, others: Array, normals: Array, master: Surface, reach: float | None
) -> Iterator[tuple[Places, Places]]:
    """Master facets whose balls touch the tube that a slave facet's ball sweeps along its normal."""
    centres, radii = bounding_balls(positions)
    other_centres, other_radii = bounding_balls(others)
    if reach is None:
        far = 3 * cKDTree(master.points[master.nodes]).query(centres)[0] + 2 * radii
    else:
        far = np.full(len(centres), float(reach))
    half = radii + np.median(other_radii)
    balls = np.ceil(far / (2 * half)).astype(np.int64)
    count = 2 * balls + 1
    ends = np.flatnonzero(np.diff(np.cumsum(count) // BLOCK)) + 1
    for block in np.split(np.arange(len(centres)), ends):
        of = np.repeat(block, count[block])
        first = np.repeat(np.cumsum(count[block]) - count[block], count[block])
        along = 2 * half[of] * (np.arange(len(of)) - first - balls[of])
        middle = centres[of] + along[:, np.newaxis] * normals[of]
        i, m = overlapping_balls(middle, np.hypot(half, radii)[of], other_centres, other_radii)
        pairs = np.unique(np.stack([of[i], m], axis=1), axis=0)
        s, m = pairs.T
        apart = other_centres[m] - centres[s]
        height = (apart * normals[s]).sum(axis=1)
        beside = np.linalg.norm(apart - height[:, np.newaxis] * normals[s], axis=1)
        near = (beside <= radii[s] + other_radii[m]) & (np.abs(height) <= far[s] + radii[s] + other_radii[m])
        yield s[near], m[near]


def _common(mine: Array, theirs: Array) -> Array:
    """Intervals (s, 2, 1) or polygons (s, V, 2) that both facets cover."""
    if mine.shape[2] == 1:
        low = np.maximum(mine.min(axis=1), theirs.min(axis=1))
        high = np.minimum(mine.max(axis=1), theirs.max(axis=1))
        return np.stack([low, high], axis=1)
    return clipping.clip(theirs[:, ::-1], mine)  # the master facet faces the plane: its corners run clockwise on it


def _sizes(common: Array) -> Array:
    """Lengths or areas, (s,)."""
    return common[:, 1, 0] - common[:, 0, 0] if common.shape[2] == 1 else clipping.areas(common)


def _refuse_double_cover(slave: Surface, master: Surface, s: Places, m: Places, common: Array, size: Array) -> None:
    """Common parts of one slave facet must not overlap."""
    middle = common.mean(axis=1)
    radii = np.linalg.norm(common - middle[:, np.newaxis], axis=2).max(axis=1, initial=0.0)
    # One more coordinate keeps the slave facets apart.
    placed = np.column_stack([s * (10 * np.abs(common).max(initial=0.0)), middle])
    i, j = overlapping_balls(placed, radii, placed, radii)
    beside = (master.facets[m[i], :, np.newaxis] == master.facets[m[j], np.newaxis, :]).any(axis=(1, 2))
    i, j = i[(i < j) & ~beside], j[(i < j) & ~beside]
    twice = _sizes(_common(common[i], common[j][:, ::-1]))  # both run counter-clockwise
    wrong = twice > 1e-6 * np.minimum(size[i], size[j])
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InvalidProblem(
            f"{slave.name}: facet {s[i[at]]} sees the facets {m[i[at]]} and {m[j[at]]} of {master.name} one behind the "
            "other: expected each part to face one facet; give `reach`, or a smaller master surface"
        )
