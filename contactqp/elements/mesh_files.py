"""Meshes from files, by meshlane or by the reader of Abaqus files, and from scikit-fem."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.abaqus import Cells, mesh_from_cells, read_abaqus
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import REFERENCES, Block, Reference, at_rule
from contactqp.errors import BackendMissing, InvalidProblem
from contactqp.model.arguments import checked
from contactqp.model.arrays import Index

MESHIO_KINDS = {
    "vertex": "node", "line": "line2", "line3": "line3",
    "triangle": "tri3", "triangle6": "tri6", "quad": "quad4", "quad8": "quad8", "quad9": "quad9",
    "tetra": "tet4", "tetra10": "tet10",
    "hexahedron": "hex8", "hexahedron20": "hex20", "hexahedron27": "hex27",
}  # fmt: skip
LONGEST_REASON = 200


@checked
def read_mesh(path: str | Path, *, part: str | None = None, drop_unconnected: bool = False) -> Mesh:
    """Read a mesh from a file: Abaqus or CalculiX ``.inp``, Gmsh ``.msh``, VTU and whatever else meshlane reads.

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
        The file is not there or cannot be read, holds elements of a kind not offered, or a mesh that is no good.
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
    """Make a mesh from a ``meshlane.Mesh``, or one of meshio; as `read_mesh`."""
    return mesh_from_cells(_cells_of_meshlane(mesh), part=part, drop_unconnected=drop_unconnected)


def mesh_from_skfem(mesh: Any, *, part: str | None = None) -> Mesh:
    """Make a mesh from a scikit-fem mesh of triangles, quadrilaterals, tetrahedra or hexahedra, linear or quadratic.

    Its boundaries become sides and its subdomains groups of elements. scikit-fem does not turn its elements in one
    sense: those with a negative Jacobian are mirrored, which changes the order of their nodes only.

    Raises
    ------
    InvalidProblem
        A mesh of another kind, or one that is no good.
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
        with contextlib.redirect_stderr(printed), contextlib.redirect_stdout(printed):
            return meshlane.read(file)
    except (SystemExit, Exception) as error:
        # Its readers raise whatever they stumble over, and some print their reason and leave the interpreter.
        reason = printed.getvalue().strip() or f"{type(error).__name__}: {error}"
        raise InvalidProblem(f"meshlane cannot read it ({' '.join(reason.split())[:LONGEST_REASON]})") from error


def _cells_of_meshlane(mesh: Any) -> Cells:
    cells = []
    for block in mesh.cells:
        if block.type not in MESHIO_KINDS:
            kinds = ", ".join(MESHIO_KINDS)
            raise InvalidProblem(f"mesh: expected cells of {kinds}, got {block.type}")
        kind, nodes = MESHIO_KINDS[block.type], np.asarray(block.data, dtype=np.int64)
        width = 1 if kind == "node" else len(REFERENCES[kind].nodes)
        if nodes.ndim != 2 or nodes.shape[1] != width:  # what is left of a file that is cut off
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
    """Return Gmsh's physical groups from the tags of the cells: tags are counted for each dimension by itself."""
    names = {(int(tag), int(dimension)): name for name, (tag, dimension) in mesh.field_data.items()}
    groups: dict[str, list[Index]] = {}
    for i, (block, values) in enumerate(zip(mesh.cells, tags, strict=True)):
        for tag in np.unique(values):
            if tag:  # 0 is no group
                name = names.get((int(tag), int(block.dim)), str(tag))
                members = groups.setdefault(name, [np.zeros(0, dtype=np.int64) for _ in mesh.cells])
                members[i] = np.flatnonzero(values == tag)
    return groups


def _is_flag(values: Any) -> bool:
    array = np.asarray(values)
    whole = array.ndim == 1 and (np.issubdtype(array.dtype, np.integer) or array.dtype == bool)
    return bool(whole and array.any() and np.isin(array, (0, 1)).all())


def _unit(kind: Reference) -> NDArray[np.float64]:
    """Return the nodes with the square and the cube on [0, 1]^d, as scikit-fem has them."""
    return (kind.nodes + 1) / 2 if kind.linear.startswith(("quad", "hex")) else kind.nodes


def _match(kind: Reference, points: NDArray[np.float64]) -> list[int]:
    """Return, for each node of the kind, its place among the points; shorter where a node is not among them."""
    if points.shape[1] != kind.dimension:
        return []
    near = abs(_unit(kind)[:, None] - points).max(axis=2) < 1e-9
    return [int(np.argmax(row)) for row in near if row.any()]
