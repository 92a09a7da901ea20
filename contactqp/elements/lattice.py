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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.boundary import boundary
from contactqp.elements.geometry import Block
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference import KINDS, REFERENCES, Reference
from contactqp.errors import InvalidProblem

Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Patch:
    """A block of cells.

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
        """(2 c_0 + 1, ..., components)."""
        shape = tuple(len(axis) for axis in self.axes)
        keys = np.zeros((*shape, components), dtype=np.int64)
        for column, values in zip(self.columns, np.meshgrid(*self.axes, indexing="ij"), strict=True):
            keys[..., column] = values
        for column, value in self.fixed.items():
            keys[..., column] = value
        return keys


def lattice_mesh(
    patches: Sequence[Patch],
    kind: str,
    position: Callable[[Index], NDArray[np.float64]],
    sides: Mapping[str, Callable[[Index], NDArray[np.bool_]]],
) -> Mesh:
    """The mesh of all patches.

    Parameters
    ----------
    patches : sequence of Patch
    kind : str
        The kind of element.
    position : function
        Coordinates (N, d) of nodes with the keys (N, components) [length].
    sides : mapping of name to function
        Which keys lie on the side: a boundary facet belongs to it when all its nodes do.

    Raises
    ------
    InvalidProblem
        A kind of another dimension; a mesh that is no good.
    """
    dimension = len(patches[0].axes)
    allowed = [name for name in KINDS if REFERENCES[name].dimension == dimension]
    if kind not in allowed:
        raise InvalidProblem(f"shape: expected a kind of {', '.join(allowed)}, got {kind!r}")
    components = 1 + max(column for patch in patches for column in (*patch.columns, *patch.fixed))
    lattices = [patch.keys(components) for patch in patches]
    flat = np.concatenate([keys.reshape(-1, components) for keys in lattices])
    keys, number = _distinct(flat)
    cells, first = [], 0
    for patch, lattice in zip(patches, lattices, strict=True):
        shape = lattice.shape[:-1]
        size = int(np.prod(shape))
        cells.append(_cells(patch, number[first : first + size].reshape(shape), REFERENCES[kind]))
        first += size
    elements = np.concatenate(cells)
    used = np.unique(elements)
    renumber = np.full(len(keys), -1)
    renumber[used] = np.arange(len(used))
    keys = keys[used]
    mesh = Mesh(position(keys), (Block(REFERENCES[kind], renumber[elements]),))
    return mesh.with_sides({name: _on_side(mesh, inside(keys)) for name, inside in sides.items()})


def _distinct(keys: Index) -> tuple[Index, Index]:
    """The distinct keys, and the number of each given key among them."""
    low = keys.min(axis=0)
    shape = tuple(int(n) for n in keys.max(axis=0) - low + 1)
    packed, number = np.unique(np.ravel_multi_index(tuple((keys - low).T), shape), return_inverse=True)
    return np.stack(np.unravel_index(packed, shape), axis=1) + low, number.ravel()


def _cells(patch: Patch, nodes: Index, kind: Reference) -> Index:
    """Elements (E, n) of a patch whose lattice nodes have these numbers."""
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
    """Places (n, d) in the 3^d nodes of a cell of each simplex in it, its directions reversed where `turned`."""
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


def _on_side(mesh: Mesh, inside: NDArray[np.bool_]) -> Index:
    block = mesh.blocks[0]
    pairs = boundary(mesh.blocks)
    facets = np.take_along_axis(block.nodes[pairs[:, 0]], np.array(block.kind.facets)[pairs[:, 1]], axis=1)
    return pairs[inside[facets].all(axis=1)]
