"""From the cells of other programs to a Mesh: which are elements, which are sides, and which belong to one part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.geometry import Block
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference import KINDS, REFERENCES
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index


@dataclass(frozen=True, eq=False)
class Cells:
    """A mesh as programs write it: cells of all dimensions, and named groups of them.

    Attributes
    ----------
    points : (N, 2 or 3) array
        Coordinates [length].
    cells : sequence of (kind, nodes)
        A kind of `reference.REFERENCES`, or ``"node"``; nodes (E, n) of int.
    groups : mapping of name to one index array for each entry of `cells`
    node_sets : mapping of name to node numbers
    """

    points: NDArray[np.float64]
    cells: Sequence[tuple[str, Index]]
    groups: Mapping[str, Sequence[Index]] = field(default_factory=dict)
    node_sets: Mapping[str, Index] = field(default_factory=dict)


def mesh_from_cells(source: Cells, *, part: str | None = None, drop_unconnected: bool = False) -> Mesh:
    """The mesh of one body.

    The cells of the highest dimension are the elements. A group of cells one dimension lower is a side where it lies on
    the boundary; every other group is a set of nodes. Points in 3D with plane elements must have one and the same z,
    which is left out.

    Parameters
    ----------
    source : Cells
    part : str, optional
        A group of elements that makes up the body. What belongs to other parts only is left out.
    drop_unconnected : bool
        Leave nodes out that no element uses (such as the centres of arcs that Gmsh writes) instead of refusing them.

    Raises
    ------
    InvalidProblem
        No elements, an unknown part, plane elements out of plane, a side that is on the boundary only in part, a mesh
        that is no good.
    """
    dimension = max((REFERENCES[kind].dimension for kind, _ in source.cells if kind != "node"), default=0)
    if dimension < 2:
        raise InvalidProblem("mesh: expected plane elements or solid ones, got none")
    elements = _elements(source, dimension, part)
    used = np.zeros(len(source.points), dtype=bool)
    for nodes in elements.values():
        used[nodes] = True
    kept = used if part is not None or drop_unconnected else np.ones(len(used), dtype=bool)
    renumber = np.where(kept, np.cumsum(kept) - 1, -1)
    blocks = tuple(Block(REFERENCES[kind], renumber[nodes]) for kind, nodes in elements.items())
    mesh = Mesh(_flat(source.points, dimension)[kept], blocks)
    sides: dict[str, Index] = {}
    node_sets = {name: renumber[np.asarray(nodes, dtype=np.int64)] for name, nodes in source.node_sets.items()}
    for name, members in source.groups.items():
        chosen = [(kind, renumber[nodes[m]]) for (kind, nodes), m in zip(source.cells, members, strict=True) if len(m)]
        inside = [(kind, nodes[(nodes >= 0).all(axis=1)]) for kind, nodes in chosen]
        side = _side(mesh, name, inside, whole=part is None)
        if len(side):
            sides[name] = side
        elif name != part:
            flat = [np.zeros(0, dtype=np.int64), *[nodes.ravel() for _, nodes in inside]]
            node_sets.setdefault(name, np.concatenate(flat))
    found = {name: np.unique(nodes[nodes >= 0]) for name, nodes in node_sets.items()}
    if part is not None:
        found = {name: nodes for name, nodes in found.items() if len(nodes)}
    return mesh.with_node_sets(found).with_sides(sides)


def _elements(source: Cells, dimension: int, part: str | None) -> dict[str, Index]:
    """The nodes of the elements, kind by kind."""
    if part is not None and part not in source.groups:
        known = ", ".join(map(repr, sorted(source.groups))) or "none"
        raise InvalidProblem(f"mesh: there is no group {part!r}; it has {known}")
    found: dict[str, list[Index]] = {}
    for i, (kind, nodes) in enumerate(source.cells):
        chosen = nodes if part is None else nodes[source.groups[part][i]]
        if kind != "node" and REFERENCES[kind].dimension == dimension and len(chosen):
            if kind not in KINDS:
                raise InvalidProblem(f"mesh: expected elements of {', '.join(KINDS)}, got {kind}")
            found.setdefault(kind, []).append(chosen)
    if not found:
        raise InvalidProblem(f"mesh: the group {part!r} has no elements of dimension {dimension}")
    return {kind: np.concatenate(chosen) for kind, chosen in found.items()}


def _side(mesh: Mesh, name: str, cells: Sequence[tuple[str, Index]], *, whole: bool) -> Index:
    """The boundary facets among these cells, (p, 2); with `whole` all the facets must be there, or none."""
    lower = [(k, nodes) for k, nodes in cells if k != "node" and REFERENCES[k].dimension == mesh.dimension - 1]
    rows = [mesh.find_facets(nodes, kind) for kind, nodes in lower]
    row = np.concatenate([np.zeros(0, dtype=np.int64), *rows])
    inside = np.count_nonzero(row < 0)
    if whole and 0 < inside < len(row):
        raise InvalidProblem(
            f"side {name!r}: {inside} of its {len(row)} facets are not on the boundary; expected all of them, or, "
            "where it parts two bodies, the one body as `part`"
        )
    side: Index = mesh.boundary[row[row >= 0]]
    return side


def _flat(points: NDArray[np.float64], dimension: int) -> NDArray[np.float64]:
    if points.shape[1] == dimension:
        return points
    z = points[:, 2]
    if np.ptp(z) > 1e-12 * np.ptp(points[:, :2]):  # files carry 12 digits or more
        raise InvalidProblem(f"mesh: expected plane elements with one z, got z from {z.min():.6g} to {z.max():.6g}")
    return points[:, :2]
