"""Which facet of a surface is nearest to a point, among those that face it; where its surface ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactqp.elements.closest_point import Foot, closest_point
from contactqp.elements.contact_search import bounding_balls, overlapping_balls
from contactqp.elements.facet import FacetKind, diameters, kind_of, middle_normals, normal_vectors, tangent_vectors
from contactqp.elements.faceting import kinks
from contactqp.elements.surface import Surface
from contactqp.model.arrays import Array

Places = NDArray[np.int64]

# Cosine: two normals further than this over 90 degrees apart face each other; walls at right angles never do.
FACING = 1e-6
# Feet closer together than this part of the facet are one point.
SAME = 1e-9
# A point may stand over the end of a surface by this part of the facet: meshes of flush bodies differ by rounding.
FLUSH = 1e-6
# A curved side's normal at its end is off the last facet's by about the kink at that facet's other end, by twice that
# where the facet is much longer than its neighbour. A point in the direction of the true normal stands over the end.
BENT = 2.0
# Points times facets looked at together: some 300 MB where every facet has to be looked at.
PAIRS = 20_000_000


@dataclass(frozen=True, eq=False)
class Partners:
    """The nearest facing facet of each of p points; facet is -1 where there is none."""

    facet: Places  # (p,)
    xi: Array  # (p, d-1)
    gap: Array  # (p,) signed distance, positive outside the facets' body [length]
    normal: Array  # (p, d) unit vectors, out of the facets' body
    beyond: NDArray[np.bool_]  # (p,) the point stands over the end of the surface

    @property
    def found(self) -> NDArray[np.bool_]:
        return self.facet >= 0


def nearest_facets(points: Array, normals: Array, surface: Surface, reach: float | None) -> Partners:
    """The facets of `surface` nearest to the points, among those with a normal against the point's.

    Where the foot is inside a facet the normal is the facet's. On an edge or a corner between facets it is the
    direction of the point from there, the gradient of the distance; and for a point on the edge the facets' mean.

    Parameters
    ----------
    points, normals : (p, d) arrays
        The points and the outward unit normals of the body that they belong to.
    surface : Surface
    reach : float, optional
        Facets further away than this are none [length].
    """
    corner = surface.points[surface.nodes]
    everywhere = np.linalg.norm(points - corner.mean(axis=0), axis=1) + np.ptp(corner, axis=0).sum()
    limit = everywhere if reach is None else np.minimum(everywhere, reach)
    search = np.minimum(cKDTree(corner).query(points)[0], limit)
    blocks = len(points) // max(PAIRS // len(surface.facets), 1000) + 1
    found = [
        part
        for block in np.array_split(np.arange(len(points)), blocks)
        for part in _search(block, points, normals, surface, search, limit)
    ]
    return _chosen(surface, points, _Found.joined(found))


@dataclass(frozen=True, eq=False)
class _Found:
    """Points i, facets j, and the feet of the points on the facets."""

    i: Places
    j: Places
    foot: Foot

    def only(self, keep: NDArray[np.bool_]) -> _Found:
        foot = Foot(self.foot.xi[keep], self.foot.position[keep], self.foot.distance[keep])
        return _Found(self.i[keep], self.j[keep], foot)

    @staticmethod
    def joined(parts: list[_Found]) -> _Found:
        feet = [part.foot for part in parts]
        foot = Foot(
            np.concatenate([foot.xi for foot in feet]),
            np.concatenate([foot.position for foot in feet]),
            np.concatenate([foot.distance for foot in feet]),
        )
        return _Found(np.concatenate([part.i for part in parts]), np.concatenate([part.j for part in parts]), foot)


def _search(
    active: Places, points: Array, normals: Array, surface: Surface, search: Array, limit: Array
) -> Iterator[_Found]:
    """The facing facets nearest to the `active` points, all that are as near: ever further out, up to `limit`."""
    kind, positions, middle = kind_of(surface), surface.points[surface.facets], middle_normals(surface)
    centres, radii = bounding_balls(positions)
    best = np.full(len(points), np.inf)
    while active.size:
        # Wider by rounding, so that all facets that share the foot are found.
        i, j = overlapping_balls(points[active], search[active] * (1 + SAME), centres, radii * (1 + SAME))
        i = active[i]
        facing = (normals[i] * middle[j]).sum(axis=1) < -FACING
        i, j = i[facing], j[facing]
        found = _Found(i, j, closest_point(kind, positions[j], points[i]))
        np.minimum.at(best, i, found.foot.distance)
        # A facet beyond the radius of this search may have nearer ones beside it that were not looked at.
        done = (best <= search * (1 + SAME)) | (search >= limit)
        near = found.foot.distance <= np.minimum(best[i] + SAME * radii[j], limit[i] * (1 + SAME))
        yield found.only(near & done[i])
        active = active[~done[active]]
        wider = np.where(np.isfinite(best[active]), best[active], 2 * search[active])
        search[active] = np.minimum(np.maximum(wider, radii.min()), limit[active])


def _chosen(surface: Surface, points: Array, found: _Found) -> Partners:
    """One of the nearest facets of each point, the first; the normal, and the end of the surface, from all of them."""
    kind = kind_of(surface)
    p, d = points.shape
    i, j, foot = found.i, found.j, found.foot
    best = np.lexsort((j, foot.distance, i))
    first = best[np.unique(i[best], return_index=True)[1]]
    chosen = np.full(p, -1)
    chosen[i[first]] = first
    positions = surface.points[surface.facets[j]]
    size = diameters(positions)
    same = np.linalg.norm(foot.position - foot.position[chosen[i]], axis=1) <= SAME * size
    tangents = tangent_vectors(positions, kind.derivatives(foot.xi))
    normals = normal_vectors(tangents)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    apart = points[i] - foot.position
    height = (apart * normals).sum(axis=1)
    over = np.linalg.norm(apart - height[:, np.newaxis] * normals, axis=1)
    perpendicular = over <= SAME * size
    mean, upright = np.zeros((p, d)), np.zeros((p, d))
    np.add.at(mean, i[same], normals[same])
    np.add.at(upright, i[same & perpendicular], normals[same & perpendicular])
    has = chosen >= 0
    c = chosen[has]
    is_upright = np.bincount(i[same & perpendicular], minlength=p)[has] > 0
    side = np.where((apart[c] * mean[has]).sum(axis=1) < 0, -1.0, 1.0)[:, np.newaxis]
    direction = np.where(is_upright[:, np.newaxis], upright[has], side * apart[c])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    kink = np.linalg.norm(kinks(surface), axis=2).max(axis=1)[j]
    flush = FLUSH * size + BENT * kink * np.linalg.norm(apart, axis=1)
    ends = _over_the_end(kind, surface, j, foot.xi, tangents, normals, apart, flush)
    beyond = np.zeros(p, dtype=bool)
    beyond[i[same & ends]] = True
    normal, gap, xi, facet = np.zeros((p, d)), np.zeros(p), np.zeros((p, d - 1)), np.full(p, -1)
    normal[has], xi[has], facet[has] = direction, foot.xi[c], j[c]
    gap[has] = (apart[c] * direction).sum(axis=1)
    return Partners(facet, xi, gap, normal, beyond)


def _over_the_end(
    kind: FacetKind,
    surface: Surface,
    facet: Places,
    xi: Array,
    tangents: Array,
    normals: Array,
    apart: Array,
    flush: Array,
) -> NDArray[np.bool_]:
    """Whether a point stands outside an edge that belongs to one facet only, (q,)."""
    corners = np.sort(surface.facets[:, kind.edges], axis=2).reshape(-1, kind.edges.shape[1])
    _, inverse, count = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    last = (count[inverse.ravel()] == 1).reshape(len(surface.facets), -1)
    over = np.zeros(len(facet), dtype=bool)
    for e, edge in enumerate(kind.edges):
        start, along = kind.nodes[edge[0]], kind.nodes[edge[-1]] - kind.nodes[edge[0]]
        from_start = xi - start
        if kind.nodes.shape[1] == 1:
            off_edge = np.abs(from_start[:, 0])
            outward = np.sign(start[0]) * tangents[:, :, 0]
        else:
            off_edge = np.abs(from_start[:, 0] * along[1] - from_start[:, 1] * along[0])
            outward = np.cross(tangents @ along, normals)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        over |= last[facet, e] & (off_edge <= FLUSH) & ((apart * outward).sum(axis=1) > flush)
    return over
