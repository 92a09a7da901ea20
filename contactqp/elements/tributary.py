"""What belongs to a node of a surface: its part of the area, and its normal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.facet import kind_of, normal_vectors, tangent_vectors
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem

# Per direction: exact for the shape functions on facets with straight edges, 1e-6 or better on curved ones.
GAUSS_POINTS = 5
# The shape functions whose integral is zero (tri6) or negative (quad8) at the corners.
NOT_POSITIVE = ("tri6", "quad8")


def tributary_areas(surface: Surface) -> NDArray[np.float64]:
    """a_i = integral of N_i over the facets, one for each of `surface.nodes`, positive [area].

    In 2D the integral is over the thickness, a_i = t integral of N_i ds, so that with t = 1 areas and forces are both
    per unit thickness; on a revolved surface over full circles, a_i = integral of 2 pi r N_i ds.

    The integrals of six-node triangles and eight-node quadrilaterals are zero (tri6) or negative (quad8, -1/12 of the
    facet's area) at the corners, that of revolved quadratic facets is zero at a node on the axis. For these the areas
    are a_i = A_f int N_i^2 / sum_j int N_j^2 on each facet (Hinton, Rock & Zienkiewicz 1976): positive and of the right
    sum. Such an area is a weight of its node; no pressure comes from dividing by it, but from
    contactqp.elements.nodal_pressure.

    Raises
    ------
    InvalidProblem
        An area that is not positive: a middle node far off the middle of its facet.
    """
    kind = kind_of(surface)
    shape, elements = _surface_elements(surface)
    if kind.name in NOT_POSITIVE or (surface.revolved and kind.quadratic):
        squares = elements @ shape**2
        parts = squares * (elements.sum(axis=1) / squares.sum(axis=1))[:, np.newaxis]
    else:
        parts = elements @ shape
    areas = _summed(surface, parts)
    if areas.min() <= 0:
        node = int(surface.nodes[np.argmin(areas)])
        raise InvalidProblem(
            f"{surface.name}: node {node}: expected a positive tributary area, got {areas.min():.3g}: "
            "its facets are too distorted"
        )
    return areas


def nodal_moments(surface: Surface) -> NDArray[np.float64]:
    """int N_i (1, x, x_0^2) dA over each facet, (p, k, 2 + d): first the nodal forces of a unit pressure [area]."""
    shape, elements = _surface_elements(surface)
    x = np.einsum("qk,pkd->pqd", shape, surface.points[surface.facets])
    functions = np.concatenate([np.ones_like(x[:, :, :1]), x, x[:, :, :1] ** 2], axis=2)
    moments: NDArray[np.float64] = np.einsum("pq,qk,pqc->pkc", elements, shape, functions, optimize=True)
    return moments


def node_normals(surface: Surface) -> NDArray[np.float64]:
    """The unit vectors along the sum of the normals of the facets at each of `surface.nodes`, (nodes, d).

    Facets count by their surface element at the node. Where the sum vanishes (both sides of a sheet) it is zero.
    """
    normals = _normals_at(surface, kind_of(surface).nodes)  # (p, k, d)
    total = np.zeros(surface.points.shape)
    np.add.at(total, surface.facets, normals)
    total = total[surface.nodes]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)


def facet_normals(surface: Surface) -> NDArray[np.float64]:
    """The outward unit normal of each facet at each of its nodes, (p, k, d)."""
    normals = _normals_at(surface, kind_of(surface).nodes)
    unit: NDArray[np.float64] = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    return unit


def _surface_elements(surface: Surface) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """N_i at the Gauss points, (q, k), and dA of each facet there with its thickness or circle, (p, q) [area]."""
    kind = kind_of(surface)
    xi, weights = kind.quadrature(GAUSS_POINTS)
    shape = kind.shape(xi)
    elements = np.linalg.norm(_normals_at(surface, xi), axis=2) * weights * surface.thickness
    if surface.revolved:
        elements = elements * 2 * np.pi * (surface.points[surface.facets][:, :, 0] @ shape.T)
    return shape, elements


def _summed(surface: Surface, parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """The parts of facets (p, k) added up at each of `surface.nodes`."""
    total = np.bincount(surface.facets.ravel(), parts.ravel(), minlength=len(surface.points))
    return total[surface.nodes].astype(np.float64)


def _normals_at(surface: Surface, xi: NDArray[np.float64]) -> NDArray[np.float64]:
    """The normal vectors of all facets at the reference points, as long as the surface element, (p, q, d)."""
    kind = kind_of(surface)
    positions = surface.points[surface.facets]
    derivatives = kind.derivatives(xi)
    at = [
        normal_vectors(tangent_vectors(positions, np.broadcast_to(here, (len(positions), *here.shape))))
        for here in derivatives
    ]
    return np.stack(at, axis=1)
