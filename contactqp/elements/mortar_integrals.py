"""What a mortar integrates over the segments of two surfaces."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.elements import clipping
from contactqp.elements.facet import FacetKind, solve_small, tangent_vectors, triangle_quadrature
from contactqp.elements.mortar_segments import Segments
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array

Places = NDArray[np.int64]

# Gauss points per direction. Three are exact where both facets are affine images of their reference elements. Elsewhere
# shape functions are no polynomials on the plane: they branch where the facet's Jacobian determinant J, linear in xi,
# would vanish, and the error falls as b^(2 points), b = (max J - min J) / (max J + min J) (Bernstein 1912: 1 / b is the
# sum of the half axes of the largest ellipse without the branch point). So many points keep it below 1e-13.
GAUSS_POINTS = (3, 5, 7, 10, 16, 24, 32)
QUADRATURE_ERROR, AFFINE = 1e-13, 1e-10
# Points at a time: some 100 MB.
BLOCK = 200_000
NEWTON_STEPS = 50
CONVERGED = 1e-12


@dataclass(frozen=True, eq=False)
class Integrals:
    """Over each of s segments: N are the slave facet's shape functions, M the master's, dA is the plane's."""

    shape: Array  # (s, k) int N_i dA
    mass: Array  # (s, k, k) int N_i N_j dA
    coupling: Array  # (s, k, l) int N_i M_j dA
    gap: Array  # (s, k) int N_i gap dA, gap along n from slave to master, positive when open
    least_gap: Array  # (s,) the smallest gap at a Gauss point [length]

    def only(self, keep: NDArray[np.bool_]) -> Integrals:
        """Over some of the segments."""
        return Integrals(**{f.name: getattr(self, f.name)[keep] for f in fields(self)})


def integrate(slave: FacetKind, master: FacetKind, segments: Segments) -> Integrals:
    """Integrals over all segments, exact for lines, triangles and parallelograms.

    Raises
    ------
    InvalidProblem
        A quadrilateral is so warped that its projection onto the plane is folded.
    """
    owner, cells, sizes = _cells(segments.common)
    bend = np.maximum(_distortion(segments.slave_corners), _distortion(segments.master_corners))[owner]
    enough = [QUADRATURE_ERROR ** (1 / (2 * points)) for points in GAUSS_POINTS[1:-1]]
    rule = np.searchsorted([AFFINE, *enough], bend)
    order, parts = [], []
    for which, points in enumerate(GAUSS_POINTS):
        group = np.flatnonzero(rule == which)
        for block in np.array_split(group, len(group) * points**2 // BLOCK + 1):
            at, weight = _gauss_points(cells[block], sizes[block], points)
            parts.append(_over_cells(slave, master, segments, owner[block], at, weight))
            order.append(owner[block])
    return _summed(np.concatenate(order), joined(parts), len(segments.slave))


def _summed(owner: Places, cells: Integrals, s: int) -> Integrals:
    """The integrals over segments from those over their cells."""
    total = sp.csr_array((np.ones(len(owner)), (owner, np.arange(len(owner)))), shape=(s, len(owner)))
    least = np.full(s, np.inf)
    np.minimum.at(least, owner, cells.least_gap)

    def sums(values: Array) -> Array:
        shape = values.shape[1:]
        return np.asarray(total @ values.reshape(len(values), math.prod(shape))).reshape(s, *shape)

    return Integrals(sums(cells.shape), sums(cells.mass), sums(cells.coupling), sums(cells.gap), least)


def _cells(common: Array) -> tuple[Places, Array, Array]:
    """Intervals or triangles: the segment each belongs to (c,), its vertices (c, d, d-1), its length or area (c,)."""
    if common.shape[2] == 1:
        return np.arange(len(common)), common, common[:, 1, 0] - common[:, 0, 0]
    fans = clipping.triangles(common)
    sizes = clipping.areas(fans.reshape(-1, 3, 2)).reshape(fans.shape[:2])
    owner, which = np.nonzero(sizes)
    return owner, fans[owner, which], sizes[owner, which]


def _gauss_points(cells: Array, sizes: Array, points: int) -> tuple[Array, Array]:
    """(c, q, d-1) and weights (c, q)."""
    if cells.shape[2] == 1:
        xi, weight = np.polynomial.legendre.leggauss(points)
        barycentric = np.stack([(1 - xi) / 2, (1 + xi) / 2], axis=1)
    else:
        corner, weight = triangle_quadrature(points)
        barycentric = np.column_stack([1 - corner.sum(axis=1), corner])
    return np.matmul(barycentric, cells), sizes[:, np.newaxis] * weight / weight.sum()


def _over_cells(
    slave: FacetKind, master: FacetKind, segments: Segments, owner: Places, at: Array, weight: Array
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
    """The integrals of several lists of segments, one after the other."""
    return Integrals(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Integrals)})


def _distortion(corners: Array) -> Array:
    """(max J - min J) / (max J + min J) over the corners of quadrilaterals; 0 for lines and triangles, (s,)."""
    if corners.shape[1] < 4:
        return np.zeros(len(corners))
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    J = np.abs(ahead[..., 0] * back[..., 1] - ahead[..., 1] * back[..., 0])
    ratio: Array = np.ptp(J, axis=1) / (J.max(axis=1) + J.min(axis=1))
    return ratio


def _shape_at(kind: FacetKind, corners: Array, at: Array) -> Array:
    """The shape functions at points (c, q, d-1) of the plane, where facets have corners (c, k, d-1): (c, q, k).

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
