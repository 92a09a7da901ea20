"""Reference elements: nodes, shape functions, quadrature and facets of every kind of element.

Lines, quadrilaterals and hexahedra live on [-1, 1]^d, triangles and tetrahedra on the unit simplex. Node orders are
VTK's: corners, middles of edges, centres of faces, centre. The shape functions are the nodal basis of a
stated polynomial space, so each kind is a list of nodes and a list of monomials:

    tri3, tri6, tet4, tet10         complete polynomials of degree 1 and 2
    quad4, quad9, hex8, hex27       products of polynomials of degree 1 and 2 in each coordinate
    quad8, hex20                    those of them with at most one square (serendipity: Arnold & Awanou 2011)

All weights of the quadrature rules are positive and all points lie inside. The numbers are closed forms.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, cos, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from contactqp.model.problem_data import ReadOnly


@dataclass(frozen=True, eq=False)
class Quadrature(ReadOnly):
    """Points (q, d) and weights (q,) of a rule: the integral over the reference shape is the sum of w_q f(x_q)."""

    points: NDArray[np.float64]
    weights: NDArray[np.float64]


def gauss(order: int, dimension: int) -> Quadrature:
    """Return the Gauss-Legendre rule in every direction of [-1, 1]^dimension: exact to degree 2 order - 1 in each
    coordinate.
    """
    x, w = np.polynomial.legendre.leggauss(order)
    points = np.array(list(itertools.product(x, repeat=dimension)))
    weights = np.prod(list(itertools.product(w, repeat=dimension)), axis=1)
    return Quadrature(points, weights)


def triangle(points: int) -> Quadrature:
    """Return the rule of 1, 3 or 6 points, exact to degree 1, 2 or 4 (Strang & Fix 1973, table 4.1; Dunavant 1985)."""
    if points == 1:
        return _on_simplex([(1.0, (1 / 3, 1 / 3, 1 / 3))])
    if points == 3:
        return _on_simplex([(1 / 3, (1 / 6, 1 / 6, 2 / 3))])
    root, spread = sqrt(38 - 44 * sqrt(2 / 5)), sqrt(213125 - 53320 * sqrt(10))
    near, far = (8 - sqrt(10) + root) / 18, (8 - sqrt(10) - root) / 18
    return _on_simplex(
        [
            ((620 + spread) / 3720, (near, near, 1 - 2 * near)),
            ((620 - spread) / 3720, (far, far, 1 - 2 * far)),
        ]
    )


def tetrahedron(points: int) -> Quadrature:
    """Return the rule of 1, 4, 8 or 15 points, exact to degree 1, 2, 3 or 5 (Stroud 1971, T3: 1-1, 2-1 and 5-1;
    eight: below).

    The eight points have equal weights: one barycentric coordinate is 1/4 + 3 s, the others 1/4 - s, for two values of
    s. Exact second and third moments ask for s1^2 + s2^2 = 1/40 and s1^3 + s2^3 = 1/480; then S = s1 + s2 solves
    S^3 - 3 S / 40 + 1 / 240 = 0, and its middle root leaves all points inside.
    """
    if points == 1:
        return _on_simplex([(1.0, (1 / 4,) * 4)])
    if points == 4:
        a = (5 - sqrt(5)) / 20
        return _on_simplex([(1 / 4, (a, a, a, 1 - 3 * a))])
    if points == 8:
        S = cos((acos(-sqrt(10) / 6) - 2 * pi) / 3) / sqrt(10)
        half = sqrt(1 / 80 - S**2 / 4)
        return _on_simplex(
            [(1 / 8, (1 / 4 - s, 1 / 4 - s, 1 / 4 - s, 1 / 4 + 3 * s)) for s in (S / 2 - half, S / 2 + half)]
        )
    r = sqrt(15)
    a, b, c = (7 - r) / 34, (7 + r) / 34, (5 - r) / 20
    return _on_simplex(
        [
            (16 / 135, (1 / 4,) * 4),
            ((2665 + 14 * r) / 37800, (a, a, a, 1 - 3 * a)),
            ((2665 - 14 * r) / 37800, (b, b, b, 1 - 3 * b)),
            (10 / 189, (c, c, 1 / 2 - c, 1 / 2 - c)),
        ]
    )


def _on_simplex(orbits: list[tuple[float, tuple[float, ...]]]) -> Quadrature:
    """Return every distinct permutation of the barycentric coordinates of each orbit; the weights sum to 1 / d!."""
    dimension = len(orbits[0][1]) - 1
    points: list[tuple[float, ...]] = []
    weights: list[float] = []
    for weight, barycentric in orbits:
        orbit = sorted(set(itertools.permutations(barycentric)))
        points += [corner[1:] for corner in orbit]
        weights += [weight / (1, 1, 2, 6)[dimension]] * len(orbit)
    return Quadrature(np.array(points), np.array(weights))


Nodes = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Reference(ReadOnly):
    """The reference element of one kind.

    Attributes
    ----------
    name : str
        ``"quad8"`` and the like: shape and number of nodes.
    nodes : (n, d) array
        Where the nodes lie on the reference shape.
    exponents : (n, d) array of int
        The monomials that span the shape functions.
    corners : int
        The first nodes are the corners.
    facets : tuple of tuples of int
        Local nodes of each facet in the order of `facet`, turned so that the facet's normal points out of the element
        (2D: the element is on the left when walking from the first node to the second; 3D: corners counter-clockwise
        seen from outside).
    facet : str
        The kind of the facets; empty for the lines.
    linear : str
        The kind with the same shape and the corners only.
    rule : Quadrature
        For stiffness ("full integration"): exact for an undistorted element, and for a constant stress in a curved one.
    fine_rule : Quadrature
        For loads, volumes and axial symmetry: at least degree 4 (triangles) or 5 (all others).
    """

    name: str
    nodes: NDArray[np.float64]
    exponents: NDArray[np.int64]
    corners: int
    facets: tuple[Nodes, ...]
    facet: str
    linear: str
    rule: Quadrature
    fine_rule: Quadrature

    @property
    def dimension(self) -> int:
        """Return d."""
        return int(self.nodes.shape[1])

    def shape(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return N_i at the (q, d) points: (q, n) [-]."""
        return self._monomials(points) @ self._coefficients()

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return dN_i/dxi_a at the (q, d) points: (q, n, d) [-]."""
        columns = []
        for axis in range(self.dimension):
            lowered = self.exponents.copy()
            lowered[:, axis] = np.maximum(lowered[:, axis] - 1, 0)
            factor = self.exponents[:, axis]
            columns.append((_powers(points, lowered) * factor) @ self._coefficients())
        return np.stack(columns, axis=-1)

    def _monomials(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return _powers(points, self.exponents)

    def _coefficients(self) -> NDArray[np.float64]:
        """Return the matrix whose column i holds the coefficients of N_i: multiples of 1/8 for every kind, so
        rounding makes them exact.
        """
        inverse = np.linalg.inv(self._monomials(self.nodes))
        return np.asarray(np.round(8 * inverse) / 8, dtype=np.float64)


def _powers(points: NDArray[np.float64], exponents: NDArray[np.int64]) -> NDArray[np.float64]:
    product: NDArray[np.float64] = np.prod(points[:, None, :] ** exponents, axis=2)
    return product


# Corners, edges and faces of the shapes. Faces are counter-clockwise seen from outside; edges in VTK's order.
_CORNERS: dict[str, list[tuple[int, ...]]] = {
    "line": [(-1,), (1,)],
    "tri": [(0, 0), (1, 0), (0, 1)],
    "quad": [(-1, -1), (1, -1), (1, 1), (-1, 1)],
    "tet": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "hex": [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)],
}
_EDGES: dict[str, list[Nodes]] = {
    "line": [(0, 1)],
    "tri": [(0, 1), (1, 2), (2, 0)],
    "quad": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "tet": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "hex": [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
}
_FACES: dict[str, list[Nodes]] = {
    "tet": [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
    "hex": [(0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7)],
}


def _element(
    name: str, shape: str, *, facet: str, rule: Quadrature, fine_rule: Quadrature, serendipity: bool = False
) -> Reference:
    corners = np.array(_CORNERS[shape], dtype=float)
    count, d = int(name.removeprefix(shape)), corners.shape[1]
    # The cells whose centres carry nodes: edges, then faces, then the inside, as far as the kind has them.
    cells = list(_EDGES[shape]) + (_FACES["hex"] if name == "hex27" else [])
    cells += [tuple(range(len(corners)))] if name in ("quad9", "hex27") else []
    centres = [corners[list(cell)].mean(axis=0) for cell in cells][: count - len(corners)]
    place = {frozenset(cell): len(corners) + i for i, cell in enumerate(cells[: len(centres)])}
    if shape == "line":
        facets: list[Nodes] = []
    else:
        facets = [_facet(cell, place) for cell in (_EDGES[shape] if d == 2 else _FACES[shape])]
    return Reference(
        name=name,
        nodes=np.vstack([corners, *centres]),
        exponents=_exponents(d, 1 if count == len(corners) else 2, shape in ("tri", "tet"), serendipity),
        corners=len(corners),
        facets=tuple(facets),
        facet=facet,
        linear=f"{shape}{len(corners)}",
        rule=rule,
        fine_rule=fine_rule,
    )


def _facet(corners: Nodes, place: dict[frozenset[int], int]) -> Nodes:
    """Return corners, then the middles of the edges between them in the same order, then the centre, as far as they
    exist.
    """
    edges = [frozenset(pair) for pair in zip(corners, corners[1:] + corners[:1], strict=True)]
    extra = [place[cell] for cell in [*edges, frozenset(corners)] if cell in place]
    return (*corners, *dict.fromkeys(extra))


def _exponents(dimension: int, degree: int, simplex: bool, serendipity: bool) -> NDArray[np.int64]:
    def kept(powers: Sequence[int]) -> bool:
        if simplex:
            return sum(powers) <= degree
        return not serendipity or sum(p == 2 for p in powers) <= 1

    return np.array([p for p in itertools.product(range(degree + 1), repeat=dimension) if kept(p)])


_LINE, _SQUARE, _CUBE = (gauss(3, d) for d in (1, 2, 3))
_TRIANGLE, _TETRAHEDRON = triangle(6), tetrahedron(15)

REFERENCES: dict[str, Reference] = {
    element.name: element
    for element in (
        _element("line2", "line", facet="", rule=gauss(2, 1), fine_rule=_LINE),
        _element("line3", "line", facet="", rule=_LINE, fine_rule=_LINE),
        _element("tri3", "tri", facet="line2", rule=triangle(1), fine_rule=_TRIANGLE),
        _element("tri6", "tri", facet="line3", rule=triangle(3), fine_rule=_TRIANGLE),
        _element("quad4", "quad", facet="line2", rule=gauss(2, 2), fine_rule=_SQUARE),
        _element("quad8", "quad", facet="line3", rule=_SQUARE, fine_rule=_SQUARE, serendipity=True),
        _element("quad9", "quad", facet="line3", rule=_SQUARE, fine_rule=_SQUARE),
        _element("tet4", "tet", facet="tri3", rule=tetrahedron(1), fine_rule=_TETRAHEDRON),
        _element("tet10", "tet", facet="tri6", rule=tetrahedron(8), fine_rule=_TETRAHEDRON),
        _element("hex8", "hex", facet="quad4", rule=gauss(2, 3), fine_rule=_CUBE),
        _element("hex20", "hex", facet="quad8", rule=_CUBE, fine_rule=_CUBE, serendipity=True),
        _element("hex27", "hex", facet="quad9", rule=_CUBE, fine_rule=_CUBE),
    )
}
KINDS = tuple(name for name, element in REFERENCES.items() if element.facet)
