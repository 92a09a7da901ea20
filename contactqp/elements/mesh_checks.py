"""What a mesh must satisfy before it becomes a body; every refusal names the element, the node or the set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.boundary import facet_keys
from contactqp.elements.geometry import Block, Geometry, batches
from contactqp.elements.reference import REFERENCES, Reference
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index

Points = NDArray[np.float64]

# An element whose Jacobian, where it is looked at, falls below this part of its largest is looked at more closely.
UNEVEN = 0.5
# Points along each direction of such an element, ends included.
CLOSELY = 7


def check_mesh(points: Points, blocks: Sequence[Block], node_sets: Mapping[str, Index]) -> None:
    """All the checks of this file.

    Raises
    ------
    InvalidProblem
        Coordinates not finite, no elements, node numbers out of range, a node twice in one element, two elements on
        the same nodes, an inverted or flat element, linear elements beside quadratic ones, a node in no element, an
        empty set.
    """
    _check_points(points, blocks)
    first = 0
    for block in blocks:
        _check_numbers(points, block, first)
        first += len(block)
    _check_duplicates(blocks)
    _check_neighbours(blocks)
    first = 0
    for block in blocks:
        _check_jacobians(points, block, first)
        first += len(block)
    _check_connected(points, blocks)
    for name, nodes in node_sets.items():
        check_set(name, nodes, len(points))


def describe(block: Block, element: int, first: int) -> str:
    """``element 12 (quad4, nodes 3, 4, 8, 7)``."""
    return f"element {first + element} ({block.kind.name}, nodes {', '.join(map(str, block.nodes[element]))})"


def _check_points(points: Points, blocks: Sequence[Block]) -> None:
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InvalidProblem(f"mesh: expected points of shape (N, 2) or (N, 3), got {points.shape}")
    infinite = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if infinite.size:
        raise InvalidProblem(f"mesh: node {infinite[0]} is at {points[infinite[0]].tolist()}; expected finite numbers")
    if not sum(len(block) for block in blocks):
        raise InvalidProblem("mesh: expected elements, got none")


def _check_numbers(points: Points, block: Block, first: int) -> None:
    if block.kind.dimension != points.shape[1]:
        raise InvalidProblem(f"mesh: {block.kind.name} elements in {points.shape[1]}D")
    outside = np.flatnonzero(((block.nodes < 0) | (block.nodes >= len(points))).any(axis=1))
    if outside.size:
        raise InvalidProblem(f"{describe(block, outside[0], first)}: expected nodes from 0 to {len(points) - 1}")
    ordered = np.sort(block.nodes, axis=1)
    again = ordered[:, 1:] == ordered[:, :-1]
    twice = np.flatnonzero(again.any(axis=1))
    if twice.size:
        e = twice[0]
        node = ordered[e, 1:][again[e]][0]
        raise InvalidProblem(f"{describe(block, e, first)}: degenerate, node {node} stands in it twice")


def _check_duplicates(blocks: Sequence[Block]) -> None:
    """No two elements on the same corners, whatever their kinds."""
    numbers = np.concatenate([np.arange(len(block)) for block in blocks])
    owner = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
    first = np.repeat(np.cumsum([0, *map(len, blocks[:-1])]), [len(block) for block in blocks])
    width = max(block.kind.corners for block in blocks)
    corners = np.full((len(numbers), width), -1)
    for i, block in enumerate(blocks):
        corners[owner == i, : block.kind.corners] = np.sort(block.nodes[:, : block.kind.corners], axis=1)
    order = np.lexsort(corners.T)
    same = np.flatnonzero((corners[order][1:] == corners[order][:-1]).all(axis=1))
    if same.size:
        a, b = sorted((int(order[same[0]]), int(order[same[0] + 1])))
        here = describe(blocks[owner[b]], int(numbers[b]), int(first[b]))
        raise InvalidProblem(f"{here}: duplicate, it lies on the corners of element {a}")


def _check_neighbours(blocks: Sequence[Block]) -> None:
    """Where a linear element has a quadratic neighbour, the middle node between them would hang loose."""
    kinds = {block.kind.facet for block in blocks if len(block)}
    if len(kinds) == len({REFERENCES[kind].linear for kind in kinds}):
        return
    facets, owners, names = [], [], []
    first = 0
    for block in blocks:
        local = block.nodes[:, list(block.kind.facets)].reshape(len(block) * len(block.kind.facets), -1)
        key = facet_keys(local, block.kind.facet)
        facets.append(np.pad(key, ((0, 0), (0, 3 - key.shape[1])), constant_values=-1))
        owners.append(np.repeat(np.arange(len(block)) + first, len(block.kind.facets)))
        names.append(np.full(len(local), local.shape[1]))
        first += len(block)
    key, owner, size = np.concatenate(facets), np.concatenate(owners), np.concatenate(names)
    order = np.lexsort(key.T)
    shared = (key[order][1:] == key[order][:-1]).all(axis=1) & (size[order][1:] != size[order][:-1])
    if shared.any():
        i = int(np.argmax(shared))
        a, b = sorted(owner[order][i : i + 2].tolist())
        raise InvalidProblem(
            f"mesh: elements {a} and {b} share a facet, and only one of them has a middle node on it; expected "
            "linear elements beside linear ones and quadratic ones beside quadratic ones"
        )


def _check_jacobians(points: Points, block: Block, first: int) -> None:
    """det J > 0 at the quadrature points, >= 0 at the nodes, up to the rounding of the coordinates.

    Where it is uneven the element is looked at on a lattice too: between those points it may still fold.
    """
    kind = block.kind
    seen = np.vstack([kind.rule.points, kind.fine_rule.points])
    lattice = _lattice(kind)
    for part in batches(block, len(seen) * kind.dimension**2):
        corners = points[part.nodes]
        with np.errstate(over="ignore", invalid="ignore"):  # coordinates near the end of the floats: refused below
            size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
            # A determinant multiplies d differences of coordinates, each rounded to eps times the coordinate.
            largest = np.abs(corners).max(axis=(1, 2))
            rounding = 16 * np.finfo(float).eps * size ** (kind.dimension - 1) * (size + largest)
            inside = Geometry(kind, corners, seen).determinant
            at_nodes = Geometry(kind, corners, kind.nodes).determinant
        worst = np.minimum(inside.min(axis=1), at_nodes.min(axis=1))
        best = np.maximum(inside.max(axis=1), at_nodes.max(axis=1))
        if not np.isfinite(best + rounding).all():
            e = int(np.argmin(np.isfinite(best + rounding)))
            raise InvalidProblem(f"{describe(part, e, first)}: its coordinates, up to {largest[e]:.3g}, are too large")
        uneven = np.flatnonzero((worst >= -rounding) & (worst < UNEVEN * best))
        for some in batches(Block(kind, uneven[:, None]), len(lattice) * kind.dimension**2):
            rows = some.nodes[:, 0]
            closely = Geometry(kind, corners[rows], lattice).determinant.min(axis=1)
            worst[rows] = np.minimum(worst[rows], closely)
        inverted = np.flatnonzero(worst < -rounding)
        if inverted.size:
            e = int(inverted[0])
            folded = f", worst near its node {part.nodes[e][np.argmin(at_nodes[e])]}" if inside[e].max() > 0 else ""
            turn = "counter-clockwise" if kind.dimension == 2 else "in the order of VTK"
            raise InvalidProblem(
                f"{describe(part, e, first)}: inverted, its Jacobian is {worst[e]:.3g}{folded}; expected a positive "
                f"one, with the corners {turn}"
            )
        flat = np.flatnonzero(inside.min(axis=1) <= rounding)
        if flat.size:
            e = int(flat[0])
            measure = "area" if kind.dimension == 2 else "volume"
            raise InvalidProblem(f"{describe(part, e, first)}: degenerate, it has no {measure} somewhere inside")
        first += len(part)


def _lattice(kind: Reference) -> Points:
    """Evenly spaced points of the reference element, its corners included."""
    simplex = kind.linear.startswith(("tri", "tet"))
    line = np.linspace(0.0 if simplex else -1.0, 1.0, CLOSELY)
    grid = np.stack(np.meshgrid(*[line] * kind.dimension), axis=-1).reshape(-1, kind.dimension)
    return grid[grid.sum(axis=1) <= 1 + 1e-9] if simplex else grid


def _check_connected(points: Points, blocks: Sequence[Block]) -> None:
    used = np.zeros(len(points), dtype=bool)
    for block in blocks:
        used[block.nodes] = True
    loose = np.flatnonzero(~used)
    if loose.size:
        at = ", ".join(f"{x:.6g}" for x in points[loose[0]])
        raise InvalidProblem(
            f"mesh: node {loose[0]} at ({at}) belongs to no element ({loose.size} such node(s)); "
            "expected every node in an element"
        )


def check_set(name: str, nodes: Index, count: int) -> None:
    """A named set of nodes: whole numbers from 0 to count - 1, at least one."""
    if nodes.ndim != 1 or not np.issubdtype(nodes.dtype, np.integer):
        raise InvalidProblem(f"node set {name!r}: expected whole numbers, got {nodes.dtype} of shape {nodes.shape}")
    if not nodes.size:
        raise InvalidProblem(f"node set {name!r} is empty; expected at least one node")
    outside = nodes[(nodes < 0) | (nodes >= count)]
    if outside.size:
        raise InvalidProblem(f"node set {name!r}: expected nodes from 0 to {count - 1}, got {outside[0]}")


def checked_side(name: str, pairs: Index, blocks: Sequence[Block]) -> Index:
    """A named side as a set of facets: (element, local facet) pairs that the mesh has, at least one, each once."""
    if not len(pairs):
        raise InvalidProblem(f"side {name!r} is empty; expected at least one facet")
    facets = np.repeat([len(block.kind.facets) for block in blocks], [len(block) for block in blocks])
    known = (pairs[:, 0] >= 0) & (pairs[:, 0] < len(facets)) & (pairs[:, 1] >= 0)
    known[known] &= pairs[known, 1] < facets[pairs[known, 0]]
    if not known.all():
        element, facet = pairs[np.argmin(known)]
        raise InvalidProblem(f"side {name!r}: there is no facet {facet} of an element {element}")
    _, first = np.unique(pairs, axis=0, return_index=True)
    once: Index = pairs[np.sort(first)]
    return once
