"""The part of a surface's area that belongs to a node, and the normal there; and whether facets are too coarse.

Facets of two curved sides are too coarse where their deviation from the smooth surfaces is comparable with the gap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactqp.elements.surface import Surface, kind_of, normal_vectors, tangent_vectors
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array

# Per direction: exact for the shape functions on facets with straight edges, 1e-6 or better on curved ones.
GAUSS_POINTS = 5
# The shape functions whose integral is zero (tri6) or negative (quad8) at the corners.
NOT_POSITIVE = ("tri6", "quad8")
# An error of the pressure of this part of it is worth a word.
TOLD = 0.1
# Cosine of 30 degrees: where a facet's normal is further from the mean of its neighbours' the side has a true edge.
EDGE = np.cos(np.pi / 6)
# Facets match where the nodes of one side stand over nodes of the other, to this part of the distance between nodes.
MATCHING = 0.05
# Facets that bend less against each other are flat [radians].
FLAT = 1e-9


def tributary_areas(surface: Surface) -> NDArray[np.float64]:
    """Return a_i, the integral of N_i over the facets, one for each of `surface.nodes`, positive [area].

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
    """Return int N_i (1, x, x_0^2) dA over each facet, (p, k, 2 + d): first the nodal forces of a unit pressure
    [area].
    """
    shape, elements = _surface_elements(surface)
    x = np.einsum("qk,pkd->pqd", shape, surface.points[surface.facets])
    functions = np.concatenate([np.ones_like(x[:, :, :1]), x, x[:, :, :1] ** 2], axis=2)
    moments: NDArray[np.float64] = np.einsum("pq,qk,pqc->pkc", elements, shape, functions, optimize=True)
    return moments


def node_normals(surface: Surface) -> NDArray[np.float64]:
    """Return the unit vectors along the sum of the normals of the facets at each of `surface.nodes`, (nodes, d).

    Facets count by their surface element at the node. Where the sum vanishes (both sides of a sheet) it is zero.
    """
    normals = _normals_at(surface, kind_of(surface).nodes)  # (p, k, d)
    total = np.zeros(surface.points.shape)
    np.add.at(total, surface.facets, normals)
    total = total[surface.nodes]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)


def facet_normals(surface: Surface) -> NDArray[np.float64]:
    """Return the outward unit normal of each facet at each of its nodes, (p, k, d)."""
    normals = _normals_at(surface, kind_of(surface).nodes)
    unit: NDArray[np.float64] = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    return unit


def _surface_elements(surface: Surface) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return N_i at the Gauss points, (q, k), and dA of each facet there with its thickness or circle, (p, q)
    [area].
    """
    kind = kind_of(surface)
    xi, weights = kind.quadrature(GAUSS_POINTS)
    shape = kind.shape(xi)
    elements = np.linalg.norm(_normals_at(surface, xi), axis=2) * weights * surface.thickness
    if surface.revolved:
        elements = elements * 2 * np.pi * (surface.points[surface.facets][:, :, 0] @ shape.T)
    return shape, elements


def _summed(surface: Surface, parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the parts of facets (p, k) added up at each of `surface.nodes`."""
    total = np.bincount(surface.facets.ravel(), parts.ravel(), minlength=len(surface.points))
    return total[surface.nodes].astype(np.float64)


def _normals_at(surface: Surface, xi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the normal vectors of all facets at the reference points, as long as the surface element, (p, q, d)."""
    kind = kind_of(surface)
    positions = surface.points[surface.facets]
    derivatives = kind.derivatives(xi)
    at = [
        normal_vectors(tangent_vectors(positions, np.broadcast_to(here, (len(positions), *here.shape))))
        for here in derivatives
    ]
    return np.stack(at, axis=1)


def faceting_notes(slave: Surface, master: Surface, gap: Array) -> tuple[str, ...]:
    """Return a note where both sides are curved, do not match, and their facets change the pressure by a tenth or
    more.

    Facets of length L that are off by the sagitta f = L theta / 8, with the angle theta = L / R that they span, overlap
    by about f more where a corner meets the middle of another. Over a length L that takes the pressure E f / L, while
    to close a gap or interference g of the bodies takes E g / R. From node to node the pressure changes by the part
    (f / theta) / g of that, though its mean by f / g alone. Quadratic facets are off by what is left of the kinks
    between them (`deviation`).
    """
    largest = float(np.max(np.abs(gap), initial=0.0))
    errors = deviation(slave), deviation(master)
    if min(errors) == 0 or nodes_over(slave, master) is not None:
        return ()
    wave = sum(float(np.max(bow / np.maximum(turn, FLAT))) for bow, turn in (_bows(slave), _bows(master)))
    if wave < TOLD * largest:
        return ()
    part = f"about {wave / largest:.2g} times what it takes to close that" if largest > 0 else "as much as itself"
    return (
        f"{slave.name} on {master.name}: both sides are curved and their facets do not match: they are off by up to "
        f"{errors[0]:.3g} and {errors[1]:.3g} [length] where gap or interference is at most {largest:.3g}, so that the "
        f"facets change the pressure by {part} from node to node; finer or quadratic elements, or facets that match, "
        "are needed",
    )


def deviation(surface: Surface) -> float:
    """Return the largest distance between the facets and the smooth surface through their nodes, estimated [length].

    Along the line s L t between two corners of a facet the smooth surface leaves it at the slopes k.t, with the kinks
    k = n - n_f of the smooth normal against the facet's: by k.t L s (1 - s) at most, L (|k_i.t| + |k_j.t|) / 8 in the
    middle. On quadratic facets, which have a node there, by k.t L s (1 - s) (1 - 2 s)^2, a quarter of that. Edges of
    more than 30 degrees are no curvature.
    """
    return float(np.max(_bows(surface)[0]))


def _bows(surface: Surface) -> tuple[Array, Array]:
    """Return how far each line between two corners of a facet is off the smooth surface [length], and its normal's
    turn.
    """
    kind, kink = kind_of(surface), kinks(surface)
    smooth = facet_normals(surface)[:, : kind.corners] + kink
    i, j = np.triu_indices(kind.corners, 1)
    line = surface.points[surface.facets[:, j]] - surface.points[surface.facets[:, i]]
    bend = np.abs((kink[:, i] * line).sum(axis=2)) + np.abs((kink[:, j] * line).sum(axis=2))
    bend[bend <= FLAT * np.linalg.norm(line, axis=2)] = 0.0
    return bend / (32 if kind.quadratic else 8), np.linalg.norm(smooth[:, i] - smooth[:, j], axis=2)


def kinks(surface: Surface) -> Array:
    """Return n - n_f in each corner of each facet, (f, corners, d): zero where it has no neighbour, or at a true
    edge.
    """
    corners = kind_of(surface).corners
    smooth = np.zeros(surface.points.shape)
    smooth[surface.nodes] = node_normals(surface)
    kink: Array = smooth[surface.facets[:, :corners]] - facet_normals(surface)[:, :corners]
    kink[(kink**2).sum(axis=2) > 2 * (1 - EDGE)] = 0.0
    return kink


def same_facets(slave: Surface, master: Surface) -> bool:
    """Say whether a facet of the master with as many nodes, each at its place, faces each facet of the slave."""
    over = nodes_over(slave, master)
    if over is None or slave.facets.shape[1] != master.facets.shape[1]:
        return False
    partner = np.sort(over[np.searchsorted(slave.nodes, slave.facets)], axis=1)
    both = np.concatenate([np.unique(np.sort(master.facets, axis=1), axis=0), np.unique(partner, axis=0)])
    return len(np.unique(both, axis=0)) == len(master.facets)


def nodes_over(slave: Surface, master: Surface) -> NDArray[np.int64] | None:
    """Return the master node that faces each of `slave.nodes`, where each has one: offsets along the side vanish."""
    points, others, normals = slave.points[slave.nodes], master.points[master.nodes], node_normals(slave)
    _, nearest = cKDTree(others).query(points)
    apart = others[nearest] - points
    along = apart - (apart * normals).sum(axis=1, keepdims=True) * normals
    spacing = cKDTree(points).query(points, k=2)[0][:, 1]
    return master.nodes[nearest] if (np.linalg.norm(along, axis=1) <= MATCHING * spacing).all() else None
