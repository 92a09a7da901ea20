"""Elements and facets seen at many points: small triangles that follow curved edges, and the edges themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactqp.elements.geometry import Block, facet_keys
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import Reference
from contactqp.model.arrays import Array, Index

# Pieces that an edge is cut into: a parabola in 6 chords is off by 1/144 of its rise.
CURVED_PIECES = 6
# Elements beyond which nobody sees the curve of a single one.
MANY = 20_000


@dataclass(frozen=True, eq=False)
class Pieces:
    """Reference points (q, d) of one kind of element or facet, and the triangles (t, 3) between them."""

    points: Array
    triangles: Index


def pieces(kind: Reference, cuts: int) -> Pieces:
    """The triangle or quadrilateral cut into cuts^2 triangles, or 2 cuts^2."""
    steps = np.arange(cuts + 1)
    i, j = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    a, b = (a.ravel() for a in np.meshgrid(steps[:-1], steps[:-1], indexing="ij"))
    corner = (cuts + 1) * a + b
    lower = np.stack([corner, corner + cuts + 1, corner + 1], axis=1)
    upper = np.stack([corner + cuts + 1, corner + cuts + 2, corner + 1], axis=1)
    if kind.linear.startswith("tri"):
        inside = i + j <= cuts
        place = np.cumsum(inside) - 1
        triangles = np.concatenate([lower[a + b < cuts], upper[a + b < cuts - 1]])
        return Pieces(np.stack([i, j], axis=1)[inside] / cuts, place[triangles])
    return Pieces(2 * np.stack([i, j], axis=1) / cuts - 1, np.concatenate([lower, upper]))


def cuts(block: Block) -> int:
    """How often to cut each edge of a block's elements; a bilinear field on a quadrilateral is no linear one."""
    if len(block) > MANY:
        return 1
    if len(block.kind.nodes) > block.kind.corners:
        return CURVED_PIECES
    return 1 if block.kind.linear == "tri3" else 2


def sample(block: Block, values: Array, points: Array) -> Array:
    """N_i values_i of the nodal values (N, c) at the (q, d) reference points of each element: (E, q, c)."""
    return np.asarray(np.matmul(block.kind.shape(points), values[block.nodes]))


def edges(mesh: Mesh) -> tuple[Block, ...]:
    """Every edge of a plane mesh once, the inner ones too, by kind."""
    total = sum(len(block) for block in mesh.blocks)
    counts = np.concatenate([np.full(len(block), len(block.kind.facets)) for block in mesh.blocks])
    element = np.repeat(np.arange(total), counts)
    local = np.arange(len(element)) - np.repeat(np.cumsum(counts) - counts, counts)
    return tuple(_distinct(block) for block in mesh.facets_of(np.stack([element, local], axis=1)))


def _distinct(block: Block) -> Block:
    _, first = np.unique(facet_keys(block.nodes, block.kind.name), axis=0, return_index=True)
    return Block(block.kind, block.nodes[first])


def edge_points(block: Block) -> Array:
    """Reference points (q, 1) along the lines of a block: its ends, or as many as a curve needs."""
    count = CURVED_PIECES if block.kind.name == "line3" else 1
    return np.linspace(-1.0, 1.0, count + 1)[:, np.newaxis]


def outline_points(kind: Reference) -> Array:
    """Reference points (q, 2) once around a triangle or quadrilateral, along its edges."""
    corners = kind.nodes[: kind.corners]
    count = CURVED_PIECES if len(kind.nodes) > kind.corners else 1
    along = np.arange(count)[:, np.newaxis] / count
    following = np.roll(corners, -1, axis=0)
    return np.concatenate([start + along * (end - start) for start, end in zip(corners, following, strict=True)])
