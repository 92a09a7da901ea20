"""Structured meshes: patches of an integer lattice, glued where their keys agree, cut into elements of any kind.

Each node carries a key, a few whole numbers. Keys count half cells, so that even keys are corners and odd ones the
middles that quadratic elements need. Nodes of different patches with the same key are one node. Quadrilaterals and
hexahedra are the cells themselves; simplices are the 2 triangles or 6 tetrahedra on the monotone paths between two
opposite corners of a cell (Kuhn 1960), which fit together because the paths run towards growing absolute keys.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import KINDS, REFERENCES, Block, Reference
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arrays import Index


@dataclass(frozen=True, eq=False)
class Patch:
    """A block of cells of the integer lattice, and the keys of its nodes.

    Attributes
    ----------
    axes : sequence of (2 c + 1,) arrays of int
        The keys along each of its d directions, c cells each; the directions are right-handed in space.
    columns : sequence of int
        The component of the key that each direction runs through.
    fixed : mapping of component to value
        The other components that are not 0.
    """

    axes: Sequence[Index]
    columns: Sequence[int]
    fixed: Mapping[int, int] = field(default_factory=dict)

    def keys(self, components: int) -> Index:
        """Return the keys of the lattice nodes, (2 c_0 + 1, ..., components)."""
        shape = tuple(len(axis) for axis in self.axes)
        keys = np.zeros((*shape, components), dtype=np.int64)
        for column, values in zip(self.columns, np.meshgrid(*self.axes, indexing="ij"), strict=True):
            keys[..., column] = values
        for column, value in self.fixed.items():
            keys[..., column] = value
        return keys

    def ends(self, components: int) -> tuple[Index, Index]:
        """Return the smallest and the largest value of each component of the keys."""
        low = np.zeros(components, dtype=np.int64)
        low[list(self.fixed)] = list(self.fixed.values())
        high = low.copy()
        for axis, column in zip(self.axes, self.columns, strict=True):
            low[column], high[column] = axis.min(), axis.max()
        return low, high

    def part(self, part: int, parts: int) -> Patch | None:
        """Return one of several equal slabs of cells across the longest direction; None where there are fewer cells."""
        along = int(np.argmax([len(axis) for axis in self.axes]))
        count = (len(self.axes[along]) - 1) // 2
        begin, end = (count * (part + i) // parts for i in range(2))
        if begin == end:
            return None
        axes = list(self.axes)
        axes[along] = axes[along][2 * begin : 2 * end + 1]
        return Patch(axes, self.columns, self.fixed)


@dataclass(frozen=True, eq=False)
class Lattice:
    """A mesh before it is made: all of it, or the part of one of several processes.

    Nodes are numbered in the order of their keys, so that every part has the numbers of the whole.

    Parameters
    ----------
    patches : sequence of Patch
    kind : str
        The kind of element.
    position : function
        Coordinates (N, d) of nodes with the keys (N, components) [length].
    sides : mapping of name to function
        Which keys lie on the side: a boundary facet belongs to it when all its nodes do.
    nearest : mapping of name to (d,) point
        Node sets of one node, the nearest to the point [length].

    Raises
    ------
    InvalidProblem
        A kind of another dimension.
    """

    patches: Sequence[Patch]
    kind: str
    position: Callable[[Index], NDArray[np.float64]]
    sides: Mapping[str, Callable[[Index], NDArray[np.bool_]]]
    nearest: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        dimension = len(self.patches[0].axes)
        allowed = [name for name in KINDS if REFERENCES[name].dimension == dimension]
        if self.kind not in allowed:
            raise InvalidProblem(f"shape: expected a kind of {', '.join(allowed)}, got {shown(self.kind)}")

    @property
    def reference(self) -> Reference:
        """Return the kind of element."""
        return REFERENCES[self.kind]

    @cached_property
    def frame(self) -> tuple[Index, tuple[int, ...]]:
        """Return the lowest value of each component of the keys, and how many values it may have."""
        components = 1 + max(column for patch in self.patches for column in (*patch.columns, *patch.fixed))
        ends = np.array([patch.ends(components) for patch in self.patches])
        low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
        return low, tuple(int(n) for n in high - low + 1)

    def keys(self, codes: Index) -> Index:
        """Return the keys (N, components) that these codes stand for."""
        low, shape = self.frame
        return np.stack(np.unravel_index(codes, shape), axis=1) + low

    def elements(self, part: int = 0, parts: int = 1) -> Index:
        """Return the codes (E, n) of the elements' nodes, which are ordered as the keys are; or an equal part of
        them.
        """
        low, shape = self.frame
        found = [np.zeros((0, len(self.reference.nodes)), dtype=np.int64)]
        for patch in self.patches:
            piece = patch.part(part, parts)
            if piece is not None:
                codes = np.ravel_multi_index(tuple(np.moveaxis(piece.keys(len(shape)) - low, -1, 0)), shape)
                found.append(_cells(piece, codes, self.reference))
        return np.concatenate(found)

    def on_side(self, name: str, codes: Index) -> NDArray[np.bool_]:
        """Return which of these nodes lie on a side."""
        return self.sides[name](self.keys(codes))

    def mesh(self) -> Mesh:
        """Return the whole mesh.

        Raises
        ------
        InvalidProblem
            A mesh that is no good.
        """
        codes = self.elements()
        used, numbers = np.unique(codes, return_inverse=True)
        mesh = Mesh(self.position(self.keys(used)), (Block(self.reference, numbers.reshape(codes.shape)),))
        pairs = mesh.boundary
        facets = np.take_along_axis(
            mesh.blocks[0].nodes[pairs[:, 0]], np.array(self.reference.facets)[pairs[:, 1]], axis=1
        )
        sides = {name: pairs[self.on_side(name, used)[facets].all(axis=1)] for name in self.sides}
        nearest = {name: np.array([mesh.nearest(point)]) for name, point in self.nearest.items()}
        return mesh.with_sides(sides).with_node_sets(nearest)


def _cells(patch: Patch, nodes: Index, kind: Reference) -> Index:
    """Return the elements (E, n) of a patch whose lattice nodes have these numbers."""
    d = nodes.ndim
    counts = [(length - 1) // 2 for length in nodes.shape]
    cells = np.empty((int(np.prod(counts)), *(3,) * d), dtype=np.int64)
    for offset in itertools.product(range(3), repeat=d):
        window = tuple(slice(o, o + 2 * c - 1, 2) for o, c in zip(offset, counts, strict=True))
        place: tuple[Any, ...] = (slice(None), *offset)
        cells[place] = nodes[window].ravel()
    if kind.linear.startswith(("quad", "hex")):
        local = np.round(kind.nodes).astype(int) + 1
        return cells[(slice(None), *local.T)]
    falling = [abs(axis[2::2]) < abs(axis[:-2:2]) for axis in patch.axes]
    backwards = np.stack([grid.ravel() for grid in np.meshgrid(*falling, indexing="ij")], axis=1)
    found = []
    for turned in itertools.product((False, True), repeat=d):
        group = cells[(backwards == turned).all(axis=1)]
        found += [group[(slice(None), *local.T)] for local in _simplices(kind, turned)]
    return np.concatenate(found)


def _simplices(kind: Reference, turned: tuple[bool, ...]) -> list[Index]:
    """Return the places (n, d) in the 3^d nodes of a cell of each simplex in it, its directions reversed where
    `turned`.
    """
    found = []
    d = kind.dimension
    for path in itertools.permutations(range(d)):
        corners = np.zeros((d + 1, d))
        for step, axis in enumerate(path):
            corners[step + 1 :, axis] = 2
        corners[:, list(turned)] = 2 - corners[:, list(turned)]
        if np.linalg.det(corners[1:] - corners[0]) < 0:
            corners[[-2, -1]] = corners[[-1, -2]]
        found.append(np.round(REFERENCES[kind.linear].shape(kind.nodes) @ corners).astype(np.int64))
    return found
