"""Read meshes from files, by meshlane or the reader of Abaqus files, convert those of scikit-fem, and make structured
ones.

A structured mesh consists of patches of an integer lattice, cut into elements of any kind. The key of a node is its
integer coordinates in half cells, so that even keys are corners and odd ones the middle nodes of quadratic elements.
Nodes of different patches with the same key are one node. Quadrilaterals and hexahedra are the cells themselves;
simplices are the 2 triangles or 6 tetrahedra on the monotone paths between two opposite corners of a cell (Kuhn 1960),
which fit together because the paths run towards growing absolute keys.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import itertools
import os
import shutil
import tempfile
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from contactqp.elements.abaqus import Cells, mesh_from_cells, read_abaqus
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import KINDS, REFERENCES, Block, Reference, at_rule
from contactqp.errors import BackendMissing, InvalidProblem, shown
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class Patch:
    """A block of cells of the integer lattice, and the keys of its nodes.

    Attributes
    ----------
    axes : sequence of (2 c + 1,) arrays of int
        The keys along each of its d directions, c cells each; the directions are right-handed in space.
    columns : sequence of int, the component of the key that each direction runs through
    fixed : mapping of component to value, the other components that are not 0
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
        """Return one of several equal slabs of cells across the longest direction, None for parts beyond the number of
        cells.
        """
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
    """The description of a structured mesh, which is made whole or, on several processes, in parts.

    Nodes are numbered in the order of their keys, so that every part has the numbers of the whole.

    Raises InvalidProblem: a kind of another dimension.

    Parameters
    ----------
    patches : sequence of Patch
    kind : str, the kind of element
    position : function, coordinates (N, d) of nodes with the keys (N, components) [length]
    sides : mapping of name to function
        Returns which keys lie on the side; a boundary facet belongs to it when all its nodes do.
    nearest : mapping of name to (d,) point, node sets of one node, the nearest to the point [length]
    """

    patches: Sequence[Patch]
    kind: str
    position: Callable[[Index], Array]
    sides: Mapping[str, Callable[[Index], Mask]]
    nearest: Mapping[str, Array] = field(default_factory=dict)

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
        """Return the keys (N, components) of integer codes."""
        low, shape = self.frame
        return np.stack(np.unravel_index(codes, shape), axis=1) + low

    def elements(self, part: int = 0, parts: int = 1) -> Index:
        """Return the integer codes (E, n) of the elements' nodes, ordered as their keys, for one of `parts` equal
        parts.
        """
        low, shape = self.frame
        found = [np.zeros((0, len(self.reference.nodes)), dtype=np.int64)]
        for patch in self.patches:
            piece = patch.part(part, parts)
            if piece is not None:
                codes = np.ravel_multi_index(tuple(np.moveaxis(piece.keys(len(shape)) - low, -1, 0)), shape)
                found.append(_cells(piece, codes, self.reference))
        return np.concatenate(found)

    def on_side(self, name: str, codes: Index) -> Mask:
        """Return which of these nodes lie on a side."""
        return self.sides[name](self.keys(codes))

    def mesh(self) -> Mesh:
        """Return the whole mesh.

        Raises
        ------
        InvalidProblem
            The mesh is invalid.
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
    """Return the positions (n, d) of each simplex's nodes among the 3^d of a cell, with directions reversed where
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


MESHIO_KINDS = {
    "vertex": "node", "line": "line2", "line3": "line3",
    "triangle": "tri3", "triangle6": "tri6", "quad": "quad4", "quad8": "quad8", "quad9": "quad9",
    "tetra": "tet4", "tetra10": "tet10",
    "hexahedron": "hex8", "hexahedron20": "hex20", "hexahedron27": "hex27",
}  # fmt: skip
LONGEST_REASON = 200


@checked
def read_mesh(path: str | Path, *, part: str | None = None, drop_unconnected: bool = False) -> Mesh:
    """Read a mesh from a file: Abaqus or CalculiX ``.inp``, Gmsh ``.msh``, VTU and other formats of meshlane.

    Parameters
    ----------
    path : str or Path
    part : str, optional
        The group of elements that makes up the body (physical group, ELSET, flag); by default all elements.
    drop_unconnected : bool
        Leave nodes out that no element uses instead of refusing them.

    Raises
    ------
    InvalidProblem
        The file does not exist or cannot be read, has elements of a kind not offered, or holds an invalid mesh.
    BackendMissing
        meshlane is not installed.

    Notes
    -----
    Named sets are Gmsh's physical groups (those without a name are called by their tag), NSET, ELSET and SURFACE of
    Abaqus files (their names in upper case), and, in formats without sets such as VTU, flags: integer point or cell
    data of 0 and 1 only, the members being 1. Abaqus files are read here and not by meshlane, which knows neither
    CPE, CAX nor SURFACE and gives ELSETs to the wrong elements where an ELEMENT has none.
    """
    file = Path(path)
    if not os.path.isfile(file):
        raise InvalidProblem(f"mesh: there is no file {str(path)!r}")
    try:
        if file.suffix.lower() == ".inp":
            # Comments in any encoding must not keep a file of ASCII keywords and numbers from being read.
            source = read_abaqus(file.read_text(encoding="utf-8", errors="replace"))
        else:
            source = _cells_of_meshlane(_read_by_meshlane(file))
        return mesh_from_cells(source, part=part, drop_unconnected=drop_unconnected)
    except (InvalidProblem, OSError) as error:
        raise InvalidProblem(f"{file.name}: {error}") from None


def mesh_from_meshlane(mesh: Any, *, part: str | None = None, drop_unconnected: bool = False) -> Mesh:
    """Make a mesh from a ``meshlane.Mesh`` or a mesh of meshio; `part` and `drop_unconnected` are as in `read_mesh`."""
    return mesh_from_cells(_cells_of_meshlane(mesh), part=part, drop_unconnected=drop_unconnected)


def mesh_from_skfem(mesh: Any, *, part: str | None = None) -> Mesh:
    """Make a mesh from a scikit-fem mesh of triangles, quadrilaterals, tetrahedra or hexahedra, linear or quadratic.

    Its boundaries become sides and its subdomains groups of elements. Elements of scikit-fem with a negative Jacobian
    are mirrored, which changes only the order of their nodes.

    Raises InvalidProblem: a mesh of another kind, or an invalid one.
    """
    local = np.asarray(mesh.elem().doflocs, dtype=float)
    kind = next((k for k in REFERENCES.values() if k.facet and len(_match(k, local)) == len(local)), None)
    if kind is None:
        raise InvalidProblem(f"mesh: {type(mesh).__name__} of scikit-fem has no counterpart here")
    points = np.ascontiguousarray(mesh.doflocs.T)
    nodes = np.asarray(mesh.dofs.element_dofs, dtype=np.int64)[_match(kind, local)].T
    block = Block(kind, nodes)
    mirrored = _match(kind, _unit(kind)[:, [1, 0, *range(2, kind.dimension)]])
    turned = at_rule(block, points, kind.fine_rule).determinant.mean(axis=1) < 0
    nodes[turned] = nodes[turned][:, mirrored]
    facet = REFERENCES[kind.facet].linear
    every = np.asarray(mesh.facets.T, dtype=np.int64)
    none = np.zeros(0, dtype=np.int64)
    groups = {name: [none, np.asarray(rows)] for name, rows in (mesh.boundaries or {}).items()}
    groups |= {name: [np.asarray(rows), none] for name, rows in (mesh.subdomains or {}).items()}
    return mesh_from_cells(Cells(points, [(kind.name, nodes), (facet, every)], groups), part=part)


def _read_by_meshlane(file: Path) -> Any:
    try:
        meshlane = importlib.import_module("meshlane")
    except ImportError:
        raise BackendMissing(f"reading {file.name} needs meshlane: pip install meshlane") from None
    printed = io.StringIO()
    try:
        streams = contextlib.redirect_stderr(printed), contextlib.redirect_stdout(printed)
        with streams[0], streams[1], _without_mark(file) as plain:
            return meshlane.read(plain)
    except (SystemExit, Exception) as error:
        # meshlane's readers raise arbitrary exceptions, and some print their reason and exit.
        reason = printed.getvalue().strip() or f"{type(error).__name__}: {error}"
        raise InvalidProblem(f"meshlane cannot read it ({' '.join(reason.split())[:LONGEST_REASON]})") from error


@contextlib.contextmanager
def _without_mark(file: Path) -> Iterator[Path]:
    """Yield the file, or a copy without the byte order mark of UTF-8; XML files may keep it."""
    with file.open("rb") as marked:
        if marked.read(3) != BOM_UTF8 or marked.read(1) == b"<":
            yield file
            return
        marked.seek(3)
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder, file.name)
            with copy.open("wb") as plain:
                shutil.copyfileobj(marked, plain)
            yield copy


def _cells_of_meshlane(mesh: Any) -> Cells:
    cells = []
    for block in mesh.cells:
        if block.type not in MESHIO_KINDS:
            kinds = ", ".join(MESHIO_KINDS)
            raise InvalidProblem(f"mesh: expected cells of {kinds}, got {block.type}")
        kind, nodes = MESHIO_KINDS[block.type], np.asarray(block.data, dtype=np.int64)
        width = 1 if kind == "node" else len(REFERENCES[kind].nodes)
        if nodes.ndim != 2 or nodes.shape[1] != width:  # as in a truncated file
            raise InvalidProblem(f"mesh: expected {width} nodes a {kind}, got nodes of shape {nodes.shape}")
        cells.append((kind, nodes))
    groups: dict[str, list[Index]] = {}
    for name, members in mesh.cell_sets.items():
        if not name.startswith("gmsh:"):
            groups[name] = [np.asarray([] if m is None else m, dtype=np.int64) for m in members]
    for key, values in mesh.cell_data.items():
        if key == "gmsh:physical":
            groups = _physical(mesh, values) | groups
        elif mesh.cells and _is_flag(np.concatenate([np.ravel(v) for v in values])):
            groups.setdefault(key, [np.flatnonzero(v) for v in values])
    node_sets = {name: np.asarray(nodes, dtype=np.int64) for name, nodes in mesh.point_sets.items()}
    for key, values in mesh.point_data.items():
        if _is_flag(values):
            node_sets.setdefault(key, np.flatnonzero(values))
    return Cells(np.asarray(mesh.points, dtype=float), cells, groups, node_sets)


def _physical(mesh: Any, tags: Any) -> dict[str, list[Index]]:
    """Return Gmsh's physical groups from the tags of the cells, which are numbered for each dimension separately."""
    names = {(int(tag), int(dimension)): name for name, (tag, dimension) in mesh.field_data.items()}
    groups: dict[str, list[Index]] = {}
    for i, (block, values) in enumerate(zip(mesh.cells, tags, strict=True)):
        for tag in np.unique(values):
            if tag:  # 0 is not a group
                name = names.get((int(tag), int(block.dim)), str(tag))
                members = groups.setdefault(name, [np.zeros(0, dtype=np.int64) for _ in mesh.cells])
                members[i] = np.flatnonzero(values == tag)
    return groups


def _is_flag(values: Any) -> bool:
    array = np.asarray(values)
    whole = array.ndim == 1 and (np.issubdtype(array.dtype, np.integer) or array.dtype == bool)
    return bool(whole and array.any() and np.isin(array, (0, 1)).all())


def _unit(kind: Reference) -> Array:
    """Return the nodes with the square and the cube on [0, 1]^d, as scikit-fem has them."""
    return (kind.nodes + 1) / 2 if kind.linear.startswith(("quad", "hex")) else kind.nodes


def _match(kind: Reference, points: Array) -> list[int]:
    """Return the index among the points of each node of the kind; nodes that are not there are left out."""
    if points.shape[1] != kind.dimension:
        return []
    near = abs(_unit(kind)[:, None] - points).max(axis=2) < 1e-9
    return [int(np.argmax(row)) for row in near if row.any()]
