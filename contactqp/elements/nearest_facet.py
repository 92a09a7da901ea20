"""Which facet of a surface is nearest to a point, among those that face it; where its surface ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactqp.elements.closest_point import Foot, closest_point
from contactqp.elements.contact_search import bounding_balls, overlapping_balls
from contactqp.elements.facet import FacetKind, diameters, kind_of, middle_normals, normal_vectors, tangent_vectors
from contactqp.elements.surface import Surface

Array = NDArray[np.float64]
Places = NDArray[np.int64]

# Cosine: two normals further than this over 90 degrees apart face each other; walls at right angles never do.
FACING = 1e-6
# Feet closer together than this part of the facet are one point.
SAME = 1e-9
# A point may stand over the end of a surface by this part of the facet: meshes of flush bodies differ by rounding.
FLUSH = 1e-6


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
    kind, positions = kind_of(surface), surface.points[surface.facets]
    middle = middle_normals(surface)
    centres, radii = bounding_balls(positions)
    corner = surface.points[surface.nodes]
    everywhere = np.linalg.norm(points - corner.mean(axis=0), axis=1) + np.ptp(corner, axis=0).sum()
    limit = everywhere if reach is None else np.minimum(everywhere, reach)
    search = np.minimum(cKDTree(corner).query(points)[0], limit)
    active, found = np.arange(len(points)), _Found.nothing(points)
    while active.size:
        # Wider by rounding, so that all facets that share the foot are found.
        i, j = overlapping_balls(points[active], search[active] * (1 + SAME), centres, radii + SAME * radii)
        i = active[i]
        facing = (normals[i] * middle[j]).sum(axis=1) < -FACING
        i, j = i[facing], j[facing]
        foot = closest_point(kind, positions[j], points[i])
        best = np.full(len(points), np.inf)
        np.minimum.at(best, i, foot.distance)
        # A facet beyond the radius of this search may have nearer ones beside it that were not looked at.
        done = (best[active] <= search[active] * (1 + SAME)) | (search[active] >= limit[active])
        settled = np.isin(i, active[done]) & (foot.distance <= limit[i] * (1 + SAME))
        found.add(i[settled], j[settled], foot.xi[settled], foot.position[settled], foot.distance[settled])
        active = active[~done]
        wider = np.where(np.isfinite(best[active]), best[active], 2 * search[active])
        search[active] = np.minimum(np.maximum(wider, radii.min()), limit[active])
    return _chosen(kind, surface, points, found)


@dataclass(eq=False)
class _Found:
    """Points i, facets j and the feet between them, gathered search by search."""

    i: Places
    j: Places
    foot: Foot

    @staticmethod
    def nothing(points: Array) -> _Found:
        none, d = np.array([], dtype=np.int64), points.shape[1]
        return _Found(none, none, Foot(np.zeros((0, d - 1)), np.zeros((0, d)), np.zeros(0)))

    def add(self, i: Places, j: Places, xi: Array, position: Array, distance: Array) -> None:
        self.i, self.j = np.concatenate([self.i, i]), np.concatenate([self.j, j])
        self.foot = Foot(
            np.vstack([self.foot.xi, xi]),
            np.vstack([self.foot.position, position]),
            np.concatenate([self.foot.distance, distance]),
        )


def _chosen(kind: FacetKind, surface: Surface, points: Array, found: _Found) -> Partners:
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
    ends = _over_the_end(kind, surface, j, foot.xi, tangents, normals, apart, FLUSH * size)
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
