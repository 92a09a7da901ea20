"""Mortar segments: the common parts of slave and master facets, and the integrals of a mortar over them.

Each slave facet has an auxiliary plane (in 2D a line): through its centre, across its normal n there. Master facets are
projected onto it along n and clipped with the slave facet (Puso & Laursen 2004; in 2D: Wriggers 2006, section 9.3).
Many pairs of convex polygons are clipped at once: they are (P, V, 2) arrays of vertices, counter-clockwise; those with
fewer than V vertices repeat their last one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import scipy
import scipy.sparse as sp

from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.surface import (
    FacetKind,
    Surface,
    bounding_balls,
    diameters,
    middle_normals,
    overlapping_balls,
    solve_small,
    tangent_vectors,
    triangle_quadrature,
)
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Index, Mask

# Facets face each other when their normals are within 60 degrees of opposite: -cos 60.
FACING = -0.5
# Common parts below this part of the slave facet are rounding.
SLIVER = 1e-12
# Balls searched at a time: some 100 MB.
BLOCK = 20_000
# Points at a time: some 100 MB.
INTEGRALS_BLOCK = 200_000
# Gauss points per direction. Three are exact where both facets are affine images of their reference elements. Elsewhere
# shape functions are not polynomials on the plane: they branch where the facet's Jacobian determinant J, linear in xi,
# would vanish, and the error falls as b^(2 points), b = (max J - min J) / (max J + min J) (Bernstein 1912: 1 / b is the
# sum of the half axes of the largest ellipse without the branch point). So many points keep it below 1e-13.
GAUSS_POINTS = (3, 5, 7, 10, 16, 24, 32)
QUADRATURE_ERROR, AFFINE = 1e-13, 1e-10
NEWTON_STEPS = 50
CONVERGED = 1e-12


@dataclass(frozen=True, eq=False)
class Segments:
    """The s common parts of slave and master facets, in the coordinates of the slave facets' planes [length]."""

    slave: Index  # (s,) facets
    master: Index  # (s,) facets
    slave_corners: Array  # (s, k, d-1)
    slave_height: Array  # (s, k) along n over the plane
    master_corners: Array  # (s, l, d-1)
    master_height: Array  # (s, l)
    common: Array  # intervals (s, 2, 1) or convex polygons (s, V, 2)


def segments(slave: Surface, master: Surface, reach: float | None) -> Iterator[Segments]:
    """Yield the segments between two surfaces of linear facets, in parts: each has those of some slave facets.

    Raises InvalidProblem: two master facets behind each other cover the same part of a slave facet.

    Parameters
    ----------
    slave, master : line2, or tri3 and quad4 in any combination
    reach : float, optional
        The distance within which master facets are searched along the normal, on either side [length]. By default three
        times the distance from its centre to the nearest master node, plus its diameter.
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
) -> Iterator[tuple[Index, Index]]:
    """Return the master facets whose balls touch the tube that a slave facet's ball sweeps along its normal."""
    centres, radii = bounding_balls(positions)
    other_centres, other_radii = bounding_balls(others)
    if reach is None:
        far = 3 * scipy.spatial.cKDTree(master.points[master.nodes]).query(centres)[0] + 2 * radii
    else:
        ends = np.concatenate(
            [
                centres - radii[:, np.newaxis],
                centres + radii[:, np.newaxis],
                other_centres - other_radii[:, np.newaxis],
                other_centres + other_radii[:, np.newaxis],
            ]
        )
        farthest = float(np.linalg.norm(np.ptp(ends, axis=0)))  # nothing lies beyond
        far = np.full(len(centres), min(float(reach), farthest))
    half = radii + np.median(other_radii)
    # Tubes are cut off at the length that a block of balls covers, as there are fewer facets than that.
    balls = np.ceil(np.minimum(far / (2 * half), BLOCK)).astype(np.int64)
    all_facets = balls == BLOCK
    count = np.where(all_facets, len(other_centres), 2 * balls + 1)
    ends = np.flatnonzero(np.diff(np.cumsum(count) // BLOCK)) + 1
    for block in np.split(np.arange(len(centres)), ends):
        swept = block[~all_facets[block]]
        of = np.repeat(swept, count[swept])
        first = np.repeat(np.cumsum(count[swept]) - count[swept], count[swept])
        along = 2 * half[of] * (np.arange(len(of)) - first - balls[of])
        middle = centres[of] + along[:, np.newaxis] * normals[of]
        i, m = overlapping_balls(middle, np.hypot(half, radii)[of], other_centres, other_radii)
        found = np.unique(np.stack([of[i], m], axis=1), axis=0)
        every = np.stack(np.meshgrid(block[all_facets[block]], np.arange(len(other_centres)), indexing="ij"), axis=-1)
        s, m = np.concatenate([found, every.reshape(-1, 2)]).T
        apart = other_centres[m] - centres[s]
        height = (apart * normals[s]).sum(axis=1)
        beside = np.linalg.norm(apart - height[:, np.newaxis] * normals[s], axis=1)
        near = (beside <= radii[s] + other_radii[m]) & (np.abs(height) <= far[s] + radii[s] + other_radii[m])
        yield s[near], m[near]


def _common(mine: Array, theirs: Array) -> Array:
    """Return the intervals (s, 2, 1) or polygons (s, V, 2) that both facets cover."""
    if mine.shape[2] == 1:
        low = np.maximum(mine.min(axis=1), theirs.min(axis=1))
        high = np.minimum(mine.max(axis=1), theirs.max(axis=1))
        return np.stack([low, high], axis=1)
    return clip(theirs[:, ::-1], mine)  # the master facet faces the plane: its corners run clockwise on it


def _sizes(common: Array) -> Array:
    """Return the lengths or areas of segments, (s,)."""
    return common[:, 1, 0] - common[:, 0, 0] if common.shape[2] == 1 else areas(common)


def _refuse_double_cover(slave: Surface, master: Surface, s: Index, m: Index, common: Array, size: Array) -> None:
    """Refuse common parts of one slave facet that overlap."""
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


@dataclass(frozen=True, eq=False)
class Integrals:
    """The integrals over each of s segments: N are the slave facet's shape functions, M the master's, dA is the
    plane's.
    """

    shape: Array  # (s, k) int N_i dA
    mass: Array  # (s, k, k) int N_i N_j dA
    coupling: Array  # (s, k, l) int N_i M_j dA
    gap: Array  # (s, k) int N_i gap dA, gap along n from slave to master, positive when open
    least_gap: Array  # (s,) the smallest gap at a Gauss point [length]

    def only(self, keep: Mask) -> Integrals:
        """Return the integrals over some of the segments."""
        return Integrals(**{f.name: getattr(self, f.name)[keep] for f in fields(self)})


def integrate(slave: FacetKind, master: FacetKind, segments: Segments) -> Integrals:
    """Return the integrals over all segments, exact for lines, triangles and parallelograms.

    Raises InvalidProblem: a quadrilateral is so warped that its projection onto the plane is folded.
    """
    owner, cells, sizes = _cells(segments.common)
    bend = np.maximum(_distortion(segments.slave_corners), _distortion(segments.master_corners))[owner]
    enough = [QUADRATURE_ERROR ** (1 / (2 * points)) for points in GAUSS_POINTS[1:-1]]
    rule = np.searchsorted([AFFINE, *enough], bend)
    order, parts = [], []
    for which, points in enumerate(GAUSS_POINTS):
        group = np.flatnonzero(rule == which)
        for block in np.array_split(group, len(group) * points**2 // INTEGRALS_BLOCK + 1):
            at, weight = _gauss_points(cells[block], sizes[block], points)
            parts.append(_over_cells(slave, master, segments, owner[block], at, weight))
            order.append(owner[block])
    return _summed(np.concatenate(order), joined(parts), len(segments.slave))


def _summed(owner: Index, cells: Integrals, s: int) -> Integrals:
    """Return the integrals over segments from those over their cells."""
    total = sp.csr_array((np.ones(len(owner)), (owner, np.arange(len(owner)))), shape=(s, len(owner)))
    least = np.full(s, np.inf)
    np.minimum.at(least, owner, cells.least_gap)

    def sums(values: Array) -> Array:
        shape = values.shape[1:]
        return np.asarray(total @ values.reshape(len(values), math.prod(shape))).reshape(s, *shape)

    return Integrals(sums(cells.shape), sums(cells.mass), sums(cells.coupling), sums(cells.gap), least)


def _cells(common: Array) -> tuple[Index, Array, Array]:
    """Return intervals or triangles: the segment each belongs to (c,), its vertices (c, d, d-1), its length or area
    (c,).
    """
    if common.shape[2] == 1:
        return np.arange(len(common)), common, common[:, 1, 0] - common[:, 0, 0]
    fans = triangles(common)
    sizes = areas(fans.reshape(-1, 3, 2)).reshape(fans.shape[:2])
    owner, which = np.nonzero(sizes)
    return owner, fans[owner, which], sizes[owner, which]


def _gauss_points(cells: Array, sizes: Array, points: int) -> tuple[Array, Array]:
    """Return Gauss points (c, q, d-1) and weights (c, q)."""
    if cells.shape[2] == 1:
        xi, weight = np.polynomial.legendre.leggauss(points)
        barycentric = np.stack([(1 - xi) / 2, (1 + xi) / 2], axis=1)
    else:
        corner, weight = triangle_quadrature(points)
        barycentric = np.column_stack([1 - corner.sum(axis=1), corner])
    return np.matmul(barycentric, cells), sizes[:, np.newaxis] * weight / weight.sum()


def _over_cells(
    slave: FacetKind, master: FacetKind, segments: Segments, owner: Index, at: Array, weight: Array
) -> Integrals:
    N = _shape_at(slave, segments.slave_corners[owner], at)
    M = _shape_at(master, segments.master_corners[owner], at)
    behind = np.matmul(N, segments.slave_height[owner][:, :, np.newaxis])[:, :, 0]
    gap = np.matmul(M, segments.master_height[owner][:, :, np.newaxis])[:, :, 0] - behind
    weighted = (N * weight[:, :, np.newaxis]).transpose(0, 2, 1)
    return Integrals(
        shape=weighted.sum(axis=2),
        mass=np.matmul(weighted, N),
        coupling=np.matmul(weighted, M),
        gap=np.matmul(weighted, gap[:, :, np.newaxis])[:, :, 0],
        least_gap=gap.min(axis=1, initial=np.inf),
    )


def joined(parts: list[Integrals]) -> Integrals:
    """Return the integrals of several lists of segments, one after the other."""
    return Integrals(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Integrals)})


def _distortion(corners: Array) -> Array:
    """Return (max J - min J) / (max J + min J) over the corners of quadrilaterals, 0 for lines and triangles, (s,)."""
    if corners.shape[1] < 4:
        return np.zeros(len(corners))
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    J = np.abs(ahead[..., 0] * back[..., 1] - ahead[..., 1] * back[..., 0])
    ratio: Array = np.ptp(J, axis=1) / (J.max(axis=1) + J.min(axis=1))
    return ratio


def _shape_at(kind: FacetKind, corners: Array, at: Array) -> Array:
    """Return the shape functions at points (c, q, d-1) of the plane, where facets have corners (c, k, d-1): (c, q,
    k).

    The reference coordinates are found by Newton's method; one step for lines, triangles and parallelograms.
    """
    points = at.reshape(-1, at.shape[2])
    xi = np.repeat(kind.centre[np.newaxis], len(points), axis=0)
    for _ in range(NEWTON_STEPS):
        shape = kind.shape(xi).reshape(*at.shape[:2], len(kind.nodes))
        slopes = kind.derivatives(xi)
        off = (at - np.matmul(shape, corners)).reshape(points.shape)
        step = solve_small(tangent_vectors(np.repeat(corners, at.shape[1], axis=0), slopes), off)
        if np.abs(step).max(initial=0.0) <= CONVERGED:
            return shape
        xi = xi + step
    raise InvalidProblem(f"mortar: a {kind.name} is so warped that its projection along the slave's normal is folded")


def clip(polygons: Array, windows: Array) -> Array:
    """Return the intersection of each polygon with the convex window of the same place, (P, W, 2).

    One edge of the windows after the other cuts off what lies on its right (Sutherland & Hodgman 1974). An empty
    intersection is a polygon without area.
    """
    for start in range(windows.shape[1]):
        a, b = windows[:, start, np.newaxis], windows[:, (start + 1) % windows.shape[1], np.newaxis]
        polygons = _cut(polygons, _cross(b - a, polygons - a))
    return polygons


def _cut(polygons: Array, side: Array) -> Array:
    """Cut away where side < 0; side is linear along the edges, (P, V)."""
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
    """Return the areas of polygons, positive where counter-clockwise, (P,)."""
    from_first = polygons - polygons[:, :1]
    twice: Array = _cross(from_first, np.roll(from_first, -1, axis=1)).sum(axis=1)
    return twice / 2


def triangles(polygons: Array) -> Array:
    """Return the fan of triangles from the first vertex, (P, V-2, 3, 2)."""
    first = np.broadcast_to(polygons[:, :1], polygons[:, 1:-1].shape)
    return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2)


def _cross(a: Array, b: Array) -> Array:
    product: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
