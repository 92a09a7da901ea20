"""Whether the facets of two curved sides are too coarse for the gap between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactqp.elements.facet import kind_of
from contactqp.elements.surface import Surface
from contactqp.elements.tributary import facet_normals, node_normals
from contactqp.model.arrays import Array

# An error of the pressure of this part of it is worth a word.
TOLD = 0.1
# Cosine of 30 degrees: where a facet's normal is further from the mean of its neighbours' the side has a true edge.
EDGE = np.cos(np.pi / 6)
# Facets match where the nodes of one side stand over nodes of the other, to this part of the distance between nodes.
MATCHING = 0.05
# Facets that bend less against each other are flat [radians].
FLAT = 1e-9


def faceting_notes(slave: Surface, master: Surface, gap: Array) -> tuple[str, ...]:
    """A sentence, where both sides are curved, do not match, and their facets change the pressure by a tenth or more.

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
    """The largest distance between the facets and the smooth surface through their nodes, estimated [length].

    Along the line s L t between two corners of a facet the smooth surface leaves it at the slopes k.t, with the kinks
    k = n - n_f of the smooth normal against the facet's: by k.t L s (1 - s) at most, L (|k_i.t| + |k_j.t|) / 8 in the
    middle. On quadratic facets, which have a node there, by k.t L s (1 - s) (1 - 2 s)^2, a quarter of that. Edges of
    more than 30 degrees are no curvature.
    """
    return float(np.max(_bows(surface)[0]))


def _bows(surface: Surface) -> tuple[Array, Array]:
    """How far each line between two corners of a facet is off the smooth surface [length], and its normal's turn."""
    kind, kink = kind_of(surface), kinks(surface)
    smooth = facet_normals(surface)[:, : kind.corners] + kink
    i, j = np.triu_indices(kind.corners, 1)
    line = surface.points[surface.facets[:, j]] - surface.points[surface.facets[:, i]]
    bend = np.abs((kink[:, i] * line).sum(axis=2)) + np.abs((kink[:, j] * line).sum(axis=2))
    bend[bend <= FLAT * np.linalg.norm(line, axis=2)] = 0.0
    return bend / (32 if kind.quadratic else 8), np.linalg.norm(smooth[:, i] - smooth[:, j], axis=2)


def kinks(surface: Surface) -> Array:
    """n - n_f in each corner of each facet, (f, corners, d): zero where it has no neighbour, or at a true edge."""
    corners = kind_of(surface).corners
    smooth = np.zeros(surface.points.shape)
    smooth[surface.nodes] = node_normals(surface)
    kink: Array = smooth[surface.facets[:, :corners]] - facet_normals(surface)[:, :corners]
    kink[(kink**2).sum(axis=2) > 2 * (1 - EDGE)] = 0.0
    return kink


def same_facets(slave: Surface, master: Surface) -> bool:
    """Whether a facet of the master with as many nodes, each at its place, faces each facet of the slave."""
    over = nodes_over(slave, master)
    if over is None or slave.facets.shape[1] != master.facets.shape[1]:
        return False
    partner = np.sort(over[np.searchsorted(slave.nodes, slave.facets)], axis=1)
    both = np.concatenate([np.unique(np.sort(master.facets, axis=1), axis=0), np.unique(partner, axis=0)])
    return len(np.unique(both, axis=0)) == len(master.facets)


def nodes_over(slave: Surface, master: Surface) -> NDArray[np.int64] | None:
    """The master node that faces each of `slave.nodes`, where each has one: offsets along the side vanish."""
    points, others, normals = slave.points[slave.nodes], master.points[master.nodes], node_normals(slave)
    _, nearest = cKDTree(others).query(points)
    apart = others[nearest] - points
    along = apart - (apart * normals).sum(axis=1, keepdims=True) * normals
    spacing = cKDTree(points).query(points, k=2)[0][:, 1]
    return master.nodes[nearest] if (np.linalg.norm(along, axis=1) <= MATCHING * spacing).all() else None
