"""A mesh of one body: points, elements, named sets of nodes and named sides of its boundary."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.elements.boundary import boundary, facet_keys, find
from contactqp.elements.geometry import Block, at_rule
from contactqp.elements.mesh_checks import check_mesh, check_set, checked_side
from contactqp.elements.reading import real_array
from contactqp.elements.reference import KINDS, REFERENCES
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index
from contactqp.model.problem_data import ReadOnly, read_only, read_whole


@dataclass(frozen=True, eq=False)
class Mesh(ReadOnly):
    """A checked mesh.

    Parameters
    ----------
    points : (N, d) array
        Coordinates of the nodes [length], d = 2 or 3.
    blocks : tuple of Block
        The elements, kind by kind; they are numbered block after block.
    node_sets : mapping of name to (k,) arrays of int
    sides : mapping of name to (p, 2) arrays of int
        Pairs (element, local facet) on the boundary.

    Raises
    ------
    InvalidProblem
        The mesh is no good: see mesh_checks.
    """

    points: NDArray[np.float64]
    blocks: tuple[Block, ...]
    node_sets: Mapping[str, Index] = field(default_factory=dict)
    sides: Mapping[str, Index] = field(default_factory=dict)

    def __post_init__(self) -> None:
        points = real_array("mesh: points", self.points)
        points.setflags(write=False)
        object.__setattr__(self, "points", points)
        check_mesh(self.points, self.blocks, self.node_sets)
        object.__setattr__(self, "sides", self._checked(self.sides))

    @property
    def dimension(self) -> int:
        """d."""
        return int(self.points.shape[1])

    @property
    def elements(self) -> int:
        """How many elements there are."""
        return sum(len(block) for block in self.blocks)

    @cached_property
    def boundary(self) -> Index:
        """All boundary facets as (p, 2) pairs (element, local facet)."""
        return read_only(boundary(self.blocks))

    def nodes(self, name: str) -> Index:
        """The nodes of a node set or of a side, each once, ascending.

        Raises
        ------
        InvalidProblem
            There is no such set.
        """
        if name in self.node_sets:
            return np.unique(self.node_sets[name])
        if name in self.sides:
            return np.unique(np.concatenate([block.nodes.ravel() for block in self.facets_of(self.sides[name])]))
        raise self._unknown(name)

    def places(self, what: str, numbers: Index) -> Index:
        """The nodes that have these numbers, ascending; `what` is what an error names first.

        Raises
        ------
        InvalidProblem
            A number is out of range.
        """
        count = self.total
        if numbers[0] < 0 or numbers[-1] >= count:
            wrong = numbers[0] if numbers[0] < 0 else numbers[-1]
            raise InvalidProblem(f"{what}: expected nodes from 0 to {count - 1}, got {wrong}")
        return numbers.astype(np.int64)

    @property
    def total(self) -> int:
        """How many nodes there are."""
        return len(self.points)

    def number(self, node: int) -> int:
        """What messages call a node."""
        return int(node)

    def side(self, name: str) -> tuple[Block, ...]:
        """The facets of a side, turned outward, one block for each kind of facet.

        The name of a node set stands for the boundary facets that have all their nodes in the set.

        Raises
        ------
        InvalidProblem
            There is no such set, or it holds no whole facet.
        """
        if name in self.sides:
            return self.facets_of(self.sides[name])
        if name not in self.node_sets:
            raise self._unknown(name)
        facets = self.facets_within(self.node_sets[name])
        if not facets:
            raise InvalidProblem(f"side {name!r} has no faces: no boundary facet has all its nodes in that node set")
        return facets

    def nearest(self, point: ArrayLike) -> int:
        """The number of the node nearest to a point.

        Raises
        ------
        InvalidProblem
            Not d finite coordinates.
        """
        x = real_array("point", point)
        if x.shape != (self.dimension,) or not np.all(np.isfinite(x)):
            raise InvalidProblem(f"point: expected {self.dimension} finite coordinates, got {x.tolist()}")
        return int(np.argmin(np.linalg.norm(self.points - x, axis=1)))

    def volume(self) -> float:
        """The area in 2D [length^2], the volume in 3D [length^3]."""
        total = 0.0
        for block in self.blocks:
            rule = block.kind.fine_rule
            total += float((at_rule(block, self.points, rule).determinant @ rule.weights).sum())
        return total

    def mapped(self, map_points: Callable[[NDArray[np.float64]], ArrayLike]) -> Mesh:
        """The same mesh with other coordinates, checked again; `map_points` maps (N, d) to (N, d).

        >>> from contactqp.elements.shapes import rectangle
        >>> turned = rectangle(2.0, 1.0, (2, 1)).mapped(lambda x: -x)
        >>> turned.points.min(axis=0).tolist()
        [-2.0, -1.0]
        """
        return Mesh(real_array("mesh: mapped points", map_points(self.points)), self.blocks, self.node_sets, self.sides)

    def with_sides(self, sides: Mapping[str, Index]) -> Mesh:
        """The same mesh with these sides, (element, local facet) each, besides those it has; each facet counts once."""
        mesh = copy.copy(self)
        object.__setattr__(mesh, "sides", {**self.sides, **self._checked(sides)})
        return mesh

    def with_node_sets(self, node_sets: Mapping[str, ArrayLike]) -> Mesh:
        """The same mesh with these sets of nodes besides those it has."""
        sets = {name: read_only(read_whole(f"node set {name!r}", nodes)) for name, nodes in node_sets.items()}
        for name, nodes in sets.items():
            check_set(name, nodes, len(self.points))
        mesh = copy.copy(self)
        object.__setattr__(mesh, "node_sets", {**self.node_sets, **sets})
        return mesh

    def facets_of(self, pairs: Index) -> tuple[Block, ...]:
        """Blocks of the facets, by kind of facet and, within a kind, in the order of the pairs."""
        found: dict[str, list[Index]] = {}
        first = 0
        for block in self.blocks:
            mine = pairs[(pairs[:, 0] >= first) & (pairs[:, 0] < first + len(block))]
            if len(mine):
                local = np.array(block.kind.facets)[mine[:, 1]]
                facets = np.take_along_axis(block.nodes[mine[:, 0] - first], local, axis=1)
                found.setdefault(block.kind.facet, []).append(facets)
            first += len(block)
        return tuple(Block(REFERENCES[kind], np.concatenate(facets)) for kind, facets in found.items())

    def facets_within(self, nodes: Index) -> tuple[Block, ...]:
        """Blocks of the boundary facets that have all their nodes among these."""
        inside = np.zeros(len(self.points), dtype=bool)
        inside[nodes] = True
        facets = [Block(b.kind, b.nodes[inside[b.nodes].all(axis=1)]) for b in self.facets_of(self.boundary)]
        return tuple(block for block in facets if len(block))

    def find_facets(self, facets: Index, kind: str) -> Index:
        """For facets given by their nodes (corners first, in any turn): their rows in `boundary`, or -1."""
        place = np.full(len(facets), -1)
        keys, rows = [], []
        first = 0
        for block in self.blocks:
            row = np.flatnonzero((self.boundary[:, 0] >= first) & (self.boundary[:, 0] < first + len(block)))
            same = REFERENCES[block.kind.facet].linear == REFERENCES[kind].linear
            if len(row) and same:
                pair = self.boundary[row]
                local = np.array(block.kind.facets)[pair[:, 1]]
                keys.append(facet_keys(np.take_along_axis(block.nodes[pair[:, 0] - first], local, axis=1), kind))
                rows.append(row)
            first += len(block)
        if keys and len(facets):
            found = find(facet_keys(facets, kind), np.concatenate(keys))
            place[found >= 0] = np.concatenate(rows)[found[found >= 0]]
        return place

    def _checked(self, sides: Mapping[str, Index]) -> dict[str, Index]:
        return {name: read_only(checked_side(name, pairs, self.blocks)) for name, pairs in sides.items()}

    def _unknown(self, name: str) -> InvalidProblem:
        known = sorted({*self.node_sets, *self.sides})
        return InvalidProblem(f"mesh: there is no set {name!r}; it has {', '.join(map(repr, known)) or 'none'}")


def mesh_from_arrays(
    points: ArrayLike,
    elements: Mapping[str, ArrayLike],
    *,
    node_sets: Mapping[str, ArrayLike] | None = None,
    sides: Mapping[str, ArrayLike] | None = None,
) -> Mesh:
    """A mesh from plain arrays.

    Parameters
    ----------
    points : (N, d) array
        Coordinates [length].
    elements : mapping of kind to (E, n) arrays of int
        Kinds as in `reference.KINDS` (``"quad4"``), nodes from 0 in VTK's order.
    node_sets : mapping of name to (k,) arrays of int, optional
    sides : mapping of name to (p, k) arrays of int, optional
        Boundary facets by their corners in any turn; the nodes after the corners may be left out.

    Raises
    ------
    InvalidProblem
        An unknown kind, arrays of the wrong shape, facets that are not on the boundary, a bad mesh.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> mesh = mesh_from_arrays(square, {"quad4": [[0, 1, 2, 3]]}, sides={"bottom": [[1, 0]]})
    >>> mesh.side("bottom")[0].nodes.tolist()
    [[0, 1]]
    """
    blocks = tuple(_block(kind, nodes) for kind, nodes in elements.items())
    sets = {
        name: read_only(read_whole(f"node set {name!r}", nodes).ravel()) for name, nodes in (node_sets or {}).items()
    }
    mesh = Mesh(real_array("mesh: points", points), blocks, sets)
    return mesh.with_sides(
        {name: _side(mesh, name, read_whole(f"side {name!r}", facets)) for name, facets in (sides or {}).items()}
    )


def _block(kind: str, nodes: ArrayLike) -> Block:
    if kind not in KINDS:
        raise InvalidProblem(f"elements: expected one of {', '.join(KINDS)}, got {kind!r}")
    numbers = read_whole(f"{kind} elements", nodes)
    expected = len(REFERENCES[kind].nodes)
    if numbers.ndim != 2 or numbers.shape[1] != expected:
        raise InvalidProblem(f"{kind} elements: expected nodes of shape (E, {expected}), got {numbers.shape}")
    return Block(REFERENCES[kind], numbers)


def _side(mesh: Mesh, name: str, facets: Index) -> Index:
    if facets.ndim != 2 or not len(facets):
        raise InvalidProblem(f"side {name!r}: expected facets of shape (p, k), p > 0, got {facets.shape}")
    for kind in dict.fromkeys(block.kind.facet for block in mesh.blocks):
        if facets.shape[1] in (len(REFERENCES[kind].nodes), REFERENCES[kind].corners):
            row = mesh.find_facets(facets, kind)
            if np.all(row >= 0):
                return mesh.boundary[row]
            at = facets[np.argmin(row)]
            raise InvalidProblem(f"side {name!r}: the facet of nodes {', '.join(map(str, at))} is not on the boundary")
    raise InvalidProblem(f"side {name!r}: facets of {facets.shape[1]} nodes fit none of the mesh's elements")
