"""A mesh of one body: points, elements, named sets and sides, checked with messages that name element, node or set."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from contactqp.elements.reference_elements import (
    KINDS,
    REFERENCES,
    Block,
    Geometry,
    Reference,
    at_rule,
    batches,
    boundary,
    facet_keys,
    find,
)
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arguments import checks, read_whole
from contactqp.model.arrays import EPS, Array, Index
from contactqp.model.problem_data import ReadOnly, read_array, read_only

Points = Array
# An element whose Jacobian falls below this part of its largest at a checked point is checked at more points.
UNEVEN = 0.5
# Points along each direction of such an element, ends included.
CLOSELY = 7


@checks
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
        The mesh is invalid, see `check_mesh`.
    """

    points: Array
    blocks: tuple[Block, ...]
    node_sets: Mapping[str, Index] = field(default_factory=dict)
    sides: Mapping[str, Index] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", read_only(read_array("mesh: points", self.points)))
        check_mesh(self.points, self.blocks)
        object.__setattr__(self, "node_sets", self._sets(self.node_sets))
        object.__setattr__(self, "sides", self._checked(self.sides))

    def __repr__(self) -> str:
        """``Mesh(153 nodes, 128 quad4, sides bottom, left, right, top)``."""
        elements = " and ".join(f"{len(block)} {block.kind.name}" for block in self.blocks)
        named = (("sides", self.sides), ("node sets", self.node_sets))
        parts = [f"{what} {', '.join(sorted(sets))}" for what, sets in named if sets]
        return f"Mesh({', '.join([f'{len(self.points)} nodes', elements, *parts])})"

    @property
    def dimension(self) -> int:
        """Return the dimension d of space, 2 or 3."""
        return int(self.points.shape[1])

    @property
    def elements(self) -> int:
        """Return the number of elements."""
        return sum(len(block) for block in self.blocks)

    @cached_property
    def boundary(self) -> Index:
        """Return all boundary facets as (p, 2) pairs (element, local facet)."""
        return read_only(boundary(self.blocks))

    def nodes(self, name: str) -> Index:
        """Return the nodes of a node set or of a side, each once, ascending.

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
        """Check node numbers and return them ascending, each once; `what` begins the message of an error.

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
        """Return the number of nodes."""
        return len(self.points)

    def number(self, node: int) -> int:
        """Return the number by which messages call a node."""
        return int(node)

    def side(self, name: str) -> tuple[Block, ...]:
        """Return the facets of a side, turned outward, one block for each kind of facet.

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
        """Return the number of the node nearest to a point.

        Raises
        ------
        InvalidProblem
            Not d finite coordinates.
        """
        x = read_array("point", point)
        if x.shape != (self.dimension,) or not np.all(np.isfinite(x)):
            raise InvalidProblem(f"point: expected {self.dimension} finite coordinates, got {shown(x.tolist())}")
        with np.errstate(over="ignore"):
            return int(np.argmin(np.linalg.norm(self.points - x, axis=1)))

    def volume(self) -> float:
        """Return the area in 2D [length^2], the volume in 3D [length^3]."""
        total = 0.0
        for block in self.blocks:
            rule = block.kind.fine_rule
            total += float((at_rule(block, self.points, rule).determinant @ rule.weights).sum())
        return total

    def mapped(self, map_points: Callable[[Array], ArrayLike]) -> Mesh:
        """Return the same mesh with other coordinates, checked again; `map_points` maps (N, d) to (N, d).

        >>> from contactqp.elements.shapes import rectangle
        >>> turned = rectangle(2.0, 1.0, (2, 1)).mapped(lambda x: -x)
        >>> turned.points.min(axis=0).tolist()
        [-2.0, -1.0]
        """
        return Mesh(read_array("mesh: mapped points", map_points(self.points)), self.blocks, self.node_sets, self.sides)

    def with_sides(self, sides: Mapping[str, Index]) -> Mesh:
        """Return the mesh with these sides, (element, local facet) each, besides those it has; each facet counts
        once.
        """
        mesh = copy.copy(self)
        object.__setattr__(mesh, "sides", {**self.sides, **self._checked(sides)})
        return mesh

    def with_node_sets(self, node_sets: Mapping[str, ArrayLike]) -> Mesh:
        """Return the mesh with these sets of nodes besides those it has."""
        mesh = copy.copy(self)
        object.__setattr__(mesh, "node_sets", {**self.node_sets, **self._sets(node_sets)})
        return mesh

    def facets_of(self, pairs: Index) -> tuple[Block, ...]:
        """Return the facets of these pairs as blocks, by kind of facet and, within a kind, in the order of the
        pairs.
        """
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
        """Return the boundary facets that have all their nodes among these, as blocks."""
        inside = np.zeros(len(self.points), dtype=bool)
        inside[nodes] = True
        facets = [Block(b.kind, b.nodes[inside[b.nodes].all(axis=1)]) for b in self.facets_of(self.boundary)]
        return tuple(block for block in facets if len(block))

    def find_facets(self, facets: Index, kind: str) -> Index:
        """Return the row in `boundary` of each facet, -1 for others; facets are given by their nodes, corners first."""
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

    def _sets(self, node_sets: Mapping[str, ArrayLike]) -> dict[str, Index]:
        return {name: read_only(checked_set(name, nodes, len(self.points))) for name, nodes in node_sets.items()}

    def _unknown(self, name: str) -> InvalidProblem:
        names = sorted({*self.node_sets, *self.sides})
        return InvalidProblem(f"mesh: there is no set {name!r}; it has {', '.join(map(repr, names)) or 'none'}")


def mesh_from_arrays(
    points: ArrayLike,
    elements: Mapping[str, ArrayLike],
    *,
    node_sets: Mapping[str, ArrayLike] | None = None,
    sides: Mapping[str, ArrayLike] | None = None,
) -> Mesh:
    """Make a mesh from plain arrays.

    Raises InvalidProblem: an unknown kind, arrays of the wrong shape, facets that are not on the boundary, a bad mesh.

    Parameters
    ----------
    points : (N, d) array, coordinates [length]
    elements : mapping of kind to (E, n) arrays of int
        Kinds as in `reference.KINDS` (``"quad4"``), nodes from 0 in VTK's order.
    node_sets : mapping of name to (k,) arrays of int, optional
    sides : mapping of name to (p, k) arrays of int, optional
        Boundary facets by their corners in any turn; the nodes after the corners may be left out.

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
    mesh = Mesh(read_array("mesh: points", points), blocks, sets)
    return mesh.with_sides(
        {name: _side(mesh, name, read_whole(f"side {name!r}", facets)) for name, facets in (sides or {}).items()}
    )


def _block(kind: str, nodes: ArrayLike) -> Block:
    if kind not in KINDS:
        raise InvalidProblem(f"elements: expected one of {', '.join(KINDS)}, got {shown(kind)}")
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


def check_mesh(points: Points, blocks: Sequence[Block]) -> None:
    """Check everything that a mesh must satisfy.

    Raises
    ------
    InvalidProblem
        Coordinates not finite, no elements, node numbers out of range, a node twice in one element, two elements on
        the same nodes, an inverted or flat element, linear elements beside quadratic ones, a node in no element.
    """
    _check_points(points, blocks)
    starts = np.cumsum([0, *map(len, blocks)]).tolist()
    for block, first in zip(blocks, starts, strict=False):
        _check_numbers(points, block, first)
    _check_duplicates(blocks)
    _check_neighbours(blocks)
    for block, first in zip(blocks, starts, strict=False):
        _check_jacobians(points, block, first)
    _check_connected(points, blocks)


def describe(block: Block, element: int, first: int) -> str:
    """Describe an element: ``element 12 (quad4, nodes 3, 4, 8, 7)``."""
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
    """Refuse two elements on the same corners, whatever their kinds."""
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
    """Refuse a linear element beside a quadratic one, since the middle node between them would be unconnected."""
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
    """Require det J > 0 at the quadrature points, >= 0 at the nodes, up to the rounding of the coordinates.

    Where det J varies strongly the element is also checked on a lattice of points, between which it may fold.
    """
    kind = block.kind
    seen = np.vstack([kind.rule.points, kind.fine_rule.points])
    lattice = _lattice(kind)
    for part in batches(block, len(seen) * kind.dimension**2):
        corners = points[part.nodes]
        with np.errstate(over="ignore", invalid="ignore"):  # coordinates that overflow are refused below
            size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
            # A determinant multiplies d differences of coordinates, each rounded to eps times the coordinate.
            largest = np.abs(corners).max(axis=(1, 2))
            rounding = 16 * EPS * size ** (kind.dimension - 1) * (size + largest)
            inside = Geometry(kind, corners, seen).determinant
            at_nodes = Geometry(kind, corners, kind.nodes).determinant
            worst = np.minimum(inside.min(axis=1), at_nodes.min(axis=1))
            best = np.maximum(inside.max(axis=1), at_nodes.max(axis=1))
            held = np.isfinite(best + rounding)
        if not held.all():
            e = int(np.argmin(held))
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
    """Return evenly spaced points of the reference element, its corners included."""
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


def checked_set(name: str, given: ArrayLike, count: int) -> Index:
    """Return a named set of nodes: whole numbers from 0 to count - 1, at least one."""
    nodes = read_whole(f"node set {name!r}", given)
    if nodes.ndim != 1:
        raise InvalidProblem(f"node set {name!r}: expected whole numbers one by one, got shape {nodes.shape}")
    if not nodes.size:
        raise InvalidProblem(f"node set {name!r} is empty; expected at least one node")
    outside = nodes[(nodes < 0) | (nodes >= count)]
    if outside.size:
        raise InvalidProblem(f"node set {name!r}: expected nodes from 0 to {count - 1}, got {outside[0]}")
    return nodes


def checked_side(name: str, given: ArrayLike, blocks: Sequence[Block]) -> Index:
    """Return a named side as a set of facets: (element, local facet) pairs of the mesh, one or more, each once."""
    pairs = read_whole(f"side {name!r}", given)
    if not pairs.size:
        raise InvalidProblem(f"side {name!r} is empty; expected at least one facet")
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InvalidProblem(f"side {name!r}: expected (element, local facet) pairs, got shape {pairs.shape}")
    facets = np.repeat([len(block.kind.facets) for block in blocks], [len(block) for block in blocks])
    there = (pairs[:, 0] >= 0) & (pairs[:, 0] < len(facets)) & (pairs[:, 1] >= 0)
    there[there] &= pairs[there, 1] < facets[pairs[there, 0]]
    if not there.all():
        element, facet = pairs[np.argmin(there)]
        raise InvalidProblem(f"side {name!r}: there is no facet {facet} of an element {element}")
    _, first = np.unique(pairs, axis=0, return_index=True)
    return np.asarray(pairs[np.sort(first)])
