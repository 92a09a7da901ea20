"""A part of a body's boundary for contact: nodes, facets, and the indices of their displacements in u.

Facets have reference coordinates, shape functions with derivatives, normals and Gauss points. An invalid surface raises
InvalidProblem, which names the surface and the facet or node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from contactqp.elements.scalars import moderate_number
from contactqp.errors import InvalidProblem, counted
from contactqp.model.arguments import checks, read_whole
from contactqp.model.arrays import Array, Index, Mask
from contactqp.model.problem_data import ReadOnly, read_array, read_only

_LINE = np.array([[-1.0], [1.0]])
_TRIANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_P2 = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
# A facet is degenerate if its surface element is below this part of its diameter squared (2D: of its diameter).
FLAT = 1e-10
# Sides may overlap by this part of the length h of a facet: the polygons of two round bodies that fit, a shaft in its
# bore, overlap by h^2 / (8 R), which is 5 % of h as long as h < 0.4 R.
OVERLAP = 0.05
# The range of lengths of a surface, whose fourth powers must not overflow.
SMALLEST, LARGEST = 1e-75, 1e75


@checks
@dataclass(frozen=True, eq=False)
class Surface(ReadOnly):
    """Facets of a body's boundary, oriented so that their normals point out of the body.

    Parameters
    ----------
    points : (N, d) array
        Coordinates of all nodes of the body [length], d = 2 or 3.
    facets : (p, k) array of int
        Node numbers of each facet. 2D: its ends, then the middle if quadratic (k = 2 or 3); walking from the first end
        to the second the body lies on the left, so the outward normal of a tangent (t_x, t_y) is (t_y, -t_x). 3D: its
        corners, counter-clockwise seen from outside (k = 3 or 4), then the middles of the edges between them in the
        same order (k = 6 or 8), then the centre (k = 9).
    unknowns : (N, d) array of int
        unknowns[i, a] is the index in u of node i's displacement along axis a.
    name : str
        Used in every message.
    thickness : float
        The thickness of a plane body [length], to all of which forces refer. With 1 they are per unit thickness.
    revolved : bool
        The surface of an axisymmetric body, about x = 0: forces are those of the full circle.
    unknown_count : int, optional
        The number of all unknowns in u, as a `Structure` knows it. By default one more than the largest in `unknowns`.

    Raises
    ------
    InvalidProblem
        Arrays of other types than real numbers or integers, a thickness that is not positive.
    """

    points: Array
    facets: Index
    unknowns: Index
    name: str = "surface"
    thickness: float = 1.0
    revolved: bool = False
    unknown_count: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", read_only(read_array(f"{self.name}: points", self.points)))
        for what in ("facets", "unknowns"):
            object.__setattr__(self, what, read_only(read_whole(f"{self.name}: {what}", getattr(self, what))))
        if self.points.ndim != 2:
            raise InvalidProblem(f"{self.name}: points: expected shape (N, d), got {self.points.shape}")
        moderate_number(f"{self.name}: thickness", self.thickness, "length")

    def __repr__(self) -> str:
        return f"Surface({self.name}, {counted('facet', len(self.facets))})"

    @property
    def dimension(self) -> int:
        """Return the number of dimensions of space, 2 or 3."""
        return int(self.points.shape[1])

    @property
    def nodes(self) -> Index:
        """Return the nodes of the facets, each once, in ascending order."""
        return read_only(np.unique(self.facets))


@dataclass(frozen=True, eq=False)
class FacetKind:
    """The reference element of facets: N_j is a sum of the monomials `powers`, one at node j and zero at the others.

    Parameters
    ----------
    name : str
    corners : int, how many of the nodes are corners; they come first
    nodes : (k, d-1) array
        Reference coordinates xi: lines and quadrilaterals on [-1, 1], triangles on xi_1, xi_2 >= 0, xi_1 + xi_2 <= 1.
    powers : (k, d-1) array of int, row j is the monomial xi_1^powers[j, 0] xi_2^powers[j, 1]
    edges : (e, 1 or 2) array of int
        The corners of each edge, in the facet's own sense; a line's "edges" are its two ends.
    """

    name: str
    corners: int
    nodes: Array
    powers: Index
    edges: Index

    @property
    def quadratic(self) -> bool:
        return len(self.nodes) > self.corners

    @property
    def triangular(self) -> bool:
        return self.corners == 3

    @property
    def centre(self) -> Array:
        """Return the mean of the corners, (d-1,)."""
        middle: Array = self.nodes[: self.corners].mean(axis=0)
        return middle

    @cached_property
    def _coefficients(self) -> Array:
        return np.asarray(np.linalg.inv(self._monomials(self.nodes, ())), dtype=np.float64)

    def _monomials(self, xi: Array, axes: tuple[int, ...]) -> Array:
        """Return the monomials at the (q, d-1) points, differentiated once along each of `axes`, (q, k)."""
        order = np.bincount(np.array(axes, dtype=int), minlength=self.powers.shape[1])
        factor = np.ones(len(self.powers))
        for axis, times in enumerate(order):
            for t in range(times):
                factor *= self.powers[:, axis] - t
        remaining: Index = np.maximum(self.powers - order, 0)
        values = np.tile(factor, (len(xi), 1))
        for axis in range(xi.shape[1]):
            x = xi[:, axis]
            values *= np.stack([np.ones_like(x), x, x * x], axis=1)[:, remaining[:, axis]]
        return values

    def _combined(self, monomials: Array) -> Array:
        """Combine monomials to shape functions without BLAS, whose threads take longer to start than the product."""
        values: Array = np.einsum("qm,mk->qk", monomials, self._coefficients)
        return values

    def shape(self, xi: Array) -> Array:
        """Return N_j at the (q, d-1) points, (q, k)."""
        return self._combined(self._monomials(xi, ()))

    def derivatives(self, xi: Array) -> Array:
        """Return dN_j / dxi_a, (q, k, d-1)."""
        axes = range(self.powers.shape[1])
        return np.stack([self._combined(self._monomials(xi, (a,))) for a in axes], axis=2)

    def second_derivatives(self, xi: Array) -> Array:
        """Return d2N_j / dxi_a dxi_b, (q, k, d-1, d-1)."""
        axes = range(self.powers.shape[1])
        rows = [[self._combined(self._monomials(xi, (a, b))) for b in axes] for a in axes]
        return np.moveaxis(np.array(rows), (0, 1), (2, 3))

    def inside(self, xi: Array, tolerance: float) -> Mask:
        """Return whether the points lie in the reference element, or outside it by at most `tolerance`, (q,)."""
        if self.triangular:
            within: Mask = (xi.min(axis=1) >= -tolerance) & (xi.sum(axis=1) <= 1 + tolerance)
        else:
            within = np.abs(xi).max(axis=1) <= 1 + tolerance
        return within

    def quadrature(self, points: int) -> tuple[Array, Array]:
        """Return Gauss points (q, d-1) and weights (q,) of the reference element, `points` along each direction."""
        if self.triangular:
            return triangle_quadrature(points)
        at, weight = np.polynomial.legendre.leggauss(points)
        axes = self.nodes.shape[1]
        grid = np.stack(np.meshgrid(*[at] * axes, indexing="ij"), axis=-1).reshape(-1, axes)
        weights = np.prod(np.stack(np.meshgrid(*[weight] * axes, indexing="ij"), axis=-1), axis=-1).ravel()
        return grid, weights


def triangle_quadrature(points: int) -> tuple[Array, Array]:
    """Return Gauss points (q, 2) and weights (q,) on the triangle xi_1, xi_2 >= 0, xi_1 + xi_2 <= 1: q = points^2.

    The square's Gauss-Legendre rule collapsed onto the triangle (Stroud 1971): exact to the degree 2 points - 2.
    """
    at, weight = np.polynomial.legendre.leggauss(points)
    s, w = (at + 1) / 2, weight / 2
    first, second = np.meshgrid(s, s, indexing="ij")
    xi = np.stack([first * (1 - second), second], axis=-1).reshape(-1, 2)
    return xi, (np.outer(w, w) * (1 - second)).ravel()


def _middles(corners: Array) -> Array:
    return (corners + np.roll(corners, -1, axis=0)) / 2


def _kind(name: str, corners: Array, others: list[Array], powers: Sequence[tuple[int, ...]]) -> FacetKind:
    number = np.arange(len(corners))
    edges = number[:, np.newaxis] if corners.shape[1] == 1 else np.stack([number, np.roll(number, -1)], axis=1)
    return FacetKind(name, len(corners), np.vstack([corners, *others]), np.array(powers), edges)


# By (d, k), in the node order that Surface states.
KINDS = {
    (2, 2): _kind("line2", _LINE, [], [(0,), (1,)]),
    (2, 3): _kind("line3", _LINE, [np.zeros((1, 1))], [(0,), (1,), (2,)]),
    (3, 3): _kind("tri3", _TRIANGLE, [], _P2[:3]),
    (3, 6): _kind("tri6", _TRIANGLE, [_middles(_TRIANGLE)], _P2),
    (3, 4): _kind("quad4", _SQUARE, [], [(0, 0), (1, 0), (0, 1), (1, 1)]),
    (3, 8): _kind("quad8", _SQUARE, [_middles(_SQUARE)], [*_P2, (2, 1), (1, 2)]),
    (3, 9): _kind("quad9", _SQUARE, [_middles(_SQUARE), np.zeros((1, 2))], [*_P2, (2, 1), (1, 2), (2, 2)]),
}


def kind_of(surface: Surface) -> FacetKind:
    """Return the kind of a surface's facets.

    Raises InvalidProblem: no kind of facet in this dimension has that number of nodes.
    """
    key = (surface.points.shape[1], surface.facets.shape[1])
    if key not in KINDS:
        known = ", ".join(f"{kind.name} (d = {d}, k = {k})" for (d, k), kind in KINDS.items())
        raise InvalidProblem(f"{surface.name}: no facet has {key[1]} nodes in {key[0]} dimensions; known are {known}")
    return KINDS[key]


def tangent_vectors(positions: Array, derivatives: Array) -> Array:
    """Return dx / dxi_a of facets with nodes at `positions` (q, k, d): (q, d, d-1) [length]."""
    tangents: Array = np.einsum("qkd,qka->qda", positions, derivatives)
    return tangents


def normal_vectors(tangents: Array) -> Array:
    """Return the outward normals, as long as the surface element: dA = |n| dxi; tangents (q, d, d-1), result (q, d)."""
    if tangents.shape[1] == 2:
        return np.stack([tangents[:, 1, 0], -tangents[:, 0, 0]], axis=1)
    return np.cross(tangents[:, :, 0], tangents[:, :, 1])


def middle_normals(surface: Surface) -> Array:
    """Return the outward unit normal at the centre of each facet, (p, d)."""
    kind = kind_of(surface)
    derivatives = np.repeat(kind.derivatives(kind.centre[np.newaxis]), len(surface.facets), axis=0)
    normals = normal_vectors(tangent_vectors(surface.points[surface.facets], derivatives))
    unit: Array = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def solve_small(matrices: Array, vectors: Array) -> Array:
    """Return A^-1 b for many A of one or two rows, (q, a, a) and (q, a), by Cramer's rule, some 20 times faster than
    LAPACK.
    """
    if matrices.shape[1] == 1:
        return vectors / matrices[:, 0]
    (a, b), (c, d) = np.moveaxis(matrices, 0, 2)
    x, y = vectors.T
    solution: Array = np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, np.newaxis]
    return solution


def diameters(positions: Array) -> Array:
    """Return the largest distance between two nodes of each facet, positions (q, k, d), result (q,) [length]."""
    apart = positions[:, :, np.newaxis, :] - positions[:, np.newaxis, :, :]
    longest: Array = np.sqrt((apart**2).sum(axis=3)).max(axis=(1, 2))
    return longest


def check_surface(surface: Surface) -> None:
    """Refuse surfaces without facets, with wrong shapes or numbers, and with degenerate or folded facets.

    Raises
    ------
    InvalidProblem
    """
    name, points, facets, unknowns = surface.name, surface.points, surface.facets, surface.unknowns
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InvalidProblem(f"{name}: points: expected shape (N, 2) or (N, 3), got {points.shape}")
    if facets.ndim != 2 or not len(facets):
        raise InvalidProblem(f"{name}: facets: expected shape (p, k) with at least one facet, got {facets.shape}")
    if unknowns.shape != points.shape:
        raise InvalidProblem(f"{name}: unknowns: expected shape {points.shape} as points, got {unknowns.shape}")
    outside = np.argwhere((facets < 0) | (facets >= len(points)))
    if outside.size:
        f, j = outside[0]
        raise InvalidProblem(f"{name}: facet {f}: expected nodes from 0 to {len(points) - 1}, got {int(facets[f, j])}")
    nodes = surface.nodes
    wrong = nodes[~np.isfinite(points[nodes]).all(axis=1)]
    if wrong.size:
        raise InvalidProblem(f"{name}: node {wrong[0]}: expected finite coordinates, got {points[wrong[0]].tolist()}")
    _refuse_beyond_range(surface)
    if unknowns[nodes].min() < 0:
        negative = nodes[(unknowns[nodes] < 0).any(axis=1)][0]
        raise InvalidProblem(f"{name}: node {negative}: expected unknowns from 0, got {unknowns[negative].tolist()}")
    _refuse_degenerate(surface)


def check_apart(slave: Surface, master: Surface) -> None:
    """Refuse two surfaces of different dimension, or that share a node, which cannot touch itself.

    Raises
    ------
    InvalidProblem
    """
    if slave.dimension != master.dimension:
        raise InvalidProblem(
            f"{slave.name} has {slave.dimension} dimensions and {master.name} has {master.dimension}: expected the same"
        )
    _refuse_two_counts(slave, master)
    mine = slave.unknowns[slave.nodes]
    shared = np.isin(mine, master.unknowns[master.nodes]).any(axis=1)
    if shared.any():
        raise InvalidProblem(f"{slave.name}: node {slave.nodes[shared][0]} belongs to {master.name} as well")


def _refuse_two_counts(slave: Surface, master: Surface) -> None:
    """Refuse surfaces that use the same unknowns for different nodes, as when both bodies count from zero."""
    _, mine, theirs = np.intersect1d(slave.unknowns[:, 0], master.unknowns[:, 0], return_indices=True)
    if not np.array_equal(slave.points[mine], master.points[theirs]):
        raise InvalidProblem(
            f"{slave.name} and {master.name}: expected unknowns of one structure, and each body counts its own from 0; "
            "structure.surface(body, side) has those of the structure"
        )


def check_distances(reach: float | None, overlap: float | None) -> None:
    """Refuse a reach that is not positive, or an overlap that is negative; None is allowed.

    Raises
    ------
    InvalidProblem
    """
    if reach is not None and not 0 < reach < np.inf:
        raise InvalidProblem(f"reach: expected a positive length, got {reach}")
    if overlap is not None and not 0 <= overlap < np.inf:
        raise InvalidProblem(f"overlap: expected a length, zero or positive, got {overlap}")


def _refuse_beyond_range(surface: Surface) -> None:
    """Refuse lengths whose fourth powers, squares of areas, would overflow."""
    corners = surface.points[surface.facets]
    size = np.abs(corners - corners[:, :1]).max(axis=(1, 2))
    far, flat = np.abs(corners).max(axis=(1, 2)), np.where(size > 0, size, SMALLEST)
    bad = (far > LARGEST) | (flat < SMALLEST)
    if bad.any():
        f = int(np.argmax(bad))
        got = far[f] if far[f] > LARGEST else size[f]
        raise InvalidProblem(
            f"{surface.name}: facet {f} (nodes {surface.facets[f].tolist()}): expected lengths from {SMALLEST:g} to "
            f"{LARGEST:g}, got {got:.3g}: choose another unit of length"
        )


def _refuse_degenerate(surface: Surface) -> None:
    """Refuse facets whose surface element changes sign or vanishes at a Gauss point or a node."""
    kind = kind_of(surface)
    positions = surface.points[surface.facets]
    middle = normal_vectors(
        tangent_vectors(positions, np.repeat(kind.derivatives(kind.centre[None]), len(positions), 0))
    )
    smallest = FLAT * diameters(positions) ** (surface.dimension - 1)
    for xi in np.vstack([kind.quadrature(3)[0], kind.nodes]):
        here = normal_vectors(tangent_vectors(positions, np.repeat(kind.derivatives(xi[None]), len(positions), 0)))
        size = np.linalg.norm(here, axis=1)
        bad = (size <= smallest) | ((here * middle).sum(axis=1) <= 0)
        if bad.any():
            f = int(np.argmax(bad))
            raise InvalidProblem(
                f"{surface.name}: facet {f} (nodes {surface.facets[f].tolist()}) is degenerate or folded: "
                f"expected a surface element of one sign, got {size[f]:.3g} at the reference point {xi.tolist()}"
            )


def overlapping_balls(points: Array, reach: Array, centres: Array, radii: Array) -> tuple[Index, Index]:
    """Return all (i, j) with |points_i - centres_j| <= reach_i + radii_j, ordered by i, then j.

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
        near = scipy.spatial.cKDTree(centres[group]).query_ball_point(points, reach + radii[group].max())
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
    """Return centres (p, d) and radii (p,) of balls that hold facets with nodes at `positions` (p, k, d) [length].

    A facet is in the hull of its nodes as long as no shape function is negative; those of quadratic facets are down to
    -1/8 on lines, so that the distance to the farthest node is doubled for them.
    """
    centres = positions.mean(axis=1)
    radii = np.linalg.norm(positions - centres[:, np.newaxis], axis=2).max(axis=1)
    linear = positions.shape[1] == 2 if positions.shape[2] == 2 else positions.shape[1] <= 4
    return centres, radii * (1.0 if linear else 2.0)
