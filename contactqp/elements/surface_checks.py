"""Whether a surface can be worked with: one clear error that names the surface, and the facet or the node."""

from __future__ import annotations

import numpy as np

from contactqp.elements.facet import diameters, kind_of, normal_vectors, tangent_vectors
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem

# A facet whose surface element somewhere is below this part of its diameter squared (2D: of its diameter) is none.
FLAT = 1e-10


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
    if unknowns[nodes].min() < 0:
        negative = nodes[(unknowns[nodes] < 0).any(axis=1)][0]
        raise InvalidProblem(f"{name}: node {negative}: expected unknowns from 0, got {unknowns[negative].tolist()}")
    _refuse_degenerate(surface)


def check_apart(slave: Surface, master: Surface) -> None:
    """Refuse two surfaces of different dimension, or that share a node: it cannot touch itself.

    Raises
    ------
    InvalidProblem
    """
    if slave.dimension != master.dimension:
        raise InvalidProblem(
            f"{slave.name} has {slave.dimension} dimensions and {master.name} has {master.dimension}: expected the same"
        )
    mine = slave.unknowns[slave.nodes]
    shared = np.isin(mine, master.unknowns[master.nodes]).any(axis=1)
    if shared.any():
        raise InvalidProblem(f"{slave.name}: node {slave.nodes[shared][0]} belongs to {master.name} as well")


def check_distances(reach: float | None, overlap: float | None) -> None:
    """Refuse a reach that is not positive, or an overlap that is negative; None is neither.

    Raises
    ------
    InvalidProblem
    """
    if reach is not None and not (np.isfinite(reach) and reach > 0):
        raise InvalidProblem(f"reach: expected a positive length, got {reach}")
    if overlap is not None and not (np.isfinite(overlap) and overlap >= 0):
        raise InvalidProblem(f"overlap: expected a length, zero or positive, got {overlap}")


def _refuse_degenerate(surface: Surface) -> None:
    """The surface element must keep the side and stay away from zero, at the Gauss points and at the nodes."""
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
