"""Meshes from Abaqus and CalculiX input files, and from the cells of other programs.

Of an input file the keywords NODE, ELEMENT, NSET, ELSET and SURFACE are read, and all others are ignored. The cells of
a file become the elements and sides of a Mesh. Keywords and formats: Abaqus keywords reference guide; face numbers S1,
S2, ...: Abaqus elements guide.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import KINDS, REFERENCES, Block
from contactqp.elements.scalars import places_among
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Index

LARGEST_LABEL = 2**53  # larger integers are not floats
MOST_GENERATED = 10**7
# Families of element names, and the kind for each number of nodes behind them. Suffixes H, I, M, R are formulations.
_TYPES = (
    (r"(?:CPS|CPE|CPEG|CAX)(\d+)", {"3": "tri3", "4": "quad4", "6": "tri6", "8": "quad8"}),
    (r"C3D(\d+)", {"4": "tet4", "8": "hex8", "10": "tet10", "20": "hex20", "27": "hex27"}),
    (r"(?:S|M3D|SFM3D|R3D)(\d)", {"3": "tri3", "4": "quad4", "6": "tri6", "8": "quad8"}),
    (r"(?:T2D|T3D|B2|B3|R2D)(\d)", {"1": "line2", "2": "line2", "3": "line3"}),
)
# Abaqus' faces S1, S2, ... as indices of Reference.facets; other kinds are numbered in the same order.
HEX_FACES = (4, 5, 2, 1, 3, 0)


@dataclass(frozen=True, eq=False)
class Cells:
    """A mesh in the form of other programs: cells of all dimensions, and named groups of them.

    Attributes
    ----------
    points : (N, 2 or 3) array, coordinates [length]
    cells : sequence of (kind, nodes), a kind of `reference.REFERENCES`, or ``"node"``; nodes (E, n) of int
    groups : mapping of name to one index array for each entry of `cells`
    node_sets : mapping of name to node numbers
    """

    points: Array
    cells: Sequence[tuple[str, Index]]
    groups: Mapping[str, Sequence[Index]] = field(default_factory=dict)
    node_sets: Mapping[str, Index] = field(default_factory=dict)


def mesh_from_cells(source: Cells, *, part: str | None = None, drop_unconnected: bool = False) -> Mesh:
    """Return the mesh of one body.

    The cells of the highest dimension are the elements. A group of cells one dimension lower is a side where it lies on
    the boundary; every other group is a set of nodes. Points in 3D with plane elements must have one and the same z,
    which is left out.

    Raises InvalidProblem: no elements, an unknown part, plane elements out of plane, a side that is on the boundary
    only in part, an invalid mesh.

    Parameters
    ----------
    source : Cells
    part : str, optional
        The group of elements that forms the body; cells and nodes of other parts are left out.
    drop_unconnected : bool
        Leave nodes out that no element uses (such as the centres of arcs that Gmsh writes) instead of refusing them.
    """
    dimension = max((REFERENCES[kind].dimension for kind, _ in source.cells if kind != "node"), default=0)
    if dimension < 2:
        raise InvalidProblem("mesh: expected plane elements or solid ones, got none")
    elements = _imported_elements(source, dimension, part)
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


def _imported_elements(source: Cells, dimension: int, part: str | None) -> dict[str, Index]:
    """Return the nodes of the elements, kind by kind."""
    if part is not None and part not in source.groups:
        names = ", ".join(map(repr, sorted(source.groups))) or "none"
        raise InvalidProblem(f"mesh: there is no group {part!r}; it has {names}")
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
    """Return the boundary facets among these cells, (p, 2); with `whole`, none unless all cells are on the boundary."""
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


def _flat(points: Array, dimension: int) -> Array:
    if points.shape[1] == dimension:
        return points
    z = points[:, 2]
    if np.ptp(z) > 1e-12 * np.ptp(points[:, :2]):  # files carry 12 digits or more
        raise InvalidProblem(f"mesh: expected plane elements with one z, got z from {z.min():.6g} to {z.max():.6g}")
    return points[:, :2]


@dataclass
class _Reading:
    """The parts of a file read so far; names are in upper case, as Abaqus ignores case."""

    labels: list[Index] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    elements: list[tuple[str, Index, Index]] = field(default_factory=list)  # kind, labels, labels of the nodes
    node_sets: dict[str, Index] = field(default_factory=dict)
    element_sets: dict[str, Index] = field(default_factory=dict)
    surfaces: dict[str, list[tuple[Index, int]]] = field(default_factory=dict)  # labels of elements, face number


def read_abaqus(text: str) -> Cells:
    """Read the cells of an input file with one part.

    Raises InvalidProblem: several parts or instances, included files, an element type that is not offered, lines that
    do not fit, a label given twice, a set of unknown elements or nodes, an empty surface.
    """
    reading = _Reading()
    parts = 0
    for keyword, options, lines in _sections(text):
        if keyword in ("PART", "INSTANCE"):
            parts += keyword == "INSTANCE"
            if parts > 1 or (keyword == "INSTANCE" and lines):
                raise InvalidProblem("expected one part in its own place, got several instances or a moved one")
        elif keyword == "INCLUDE":
            raise InvalidProblem("*INCLUDE is not followed; expected one file")
        elif keyword == "NODE":
            _nodes(reading, options, lines)
        elif keyword == "ELEMENT":
            _elements(reading, options, lines)
        elif keyword in ("NSET", "ELSET"):
            sets = reading.node_sets if keyword == "NSET" else reading.element_sets
            _extend(sets, _option(keyword, options, keyword), _members(sets, options, lines))
        elif keyword == "SURFACE":
            _surface(reading, options, lines)
    return _cells(reading)


def _sections(text: str) -> Iterator[tuple[str, dict[str, str], list[str]]]:
    """Yield each keyword with its options and its data lines."""
    lines = [line.strip().upper() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("**")]
    starts = [i for i, line in enumerate(lines) if line.startswith("*")]
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=False):
        data = lines[start + 1 : end]
        head = lines[start]
        while head.endswith(",") and data:
            head += data.pop(0)
        keyword, *options = (word.strip() for word in head[1:].split(","))
        pairs = (option.partition("=") for option in options if option)
        yield keyword, {key.strip(): value.strip().strip('"') for key, _, value in pairs}, data


def _option(keyword: str, options: dict[str, str], name: str) -> str:
    if name not in options:
        raise InvalidProblem(f"*{keyword:.40}: expected {name}=...")
    return options[name]


def _numbers(keyword: str, lines: list[str], kind: type) -> Array | Index:
    words = [word.strip() for line in lines for word in line.rstrip(",").split(",")]
    try:
        return np.array(words, dtype=kind)
    except (ValueError, OverflowError) as error:
        raise InvalidProblem(f"*{keyword:.40}: expected numbers ({str(error)[:100]})") from None


def _nodes(reading: _Reading, options: dict[str, str], lines: list[str]) -> None:
    if not lines:
        return
    width = len(lines[0].rstrip(",").split(","))
    values = _numbers("NODE", lines, float)
    if width not in (3, 4) or len(values) != width * len(lines):
        raise InvalidProblem("*NODE: expected a label and two or three coordinates on each line, of one length")
    table = values.reshape(-1, width)
    if not np.all((abs(table[:, 0]) < LARGEST_LABEL) & (table[:, 0] == np.round(table[:, 0]))):
        raise InvalidProblem("*NODE: expected whole numbers as labels")
    labels = table[:, 0].astype(np.int64)
    reading.labels.append(labels)
    reading.points.append(np.column_stack([table[:, 1:], np.zeros((len(table), 4 - width))]))
    if "NSET" in options:
        _extend(reading.node_sets, options["NSET"], labels)


def _elements(reading: _Reading, options: dict[str, str], lines: list[str]) -> None:
    name = _option("ELEMENT", options, "TYPE")
    found = ((re.match(pattern, name), kinds) for pattern, kinds in _TYPES)
    kind = next((kinds.get(match.group(1), "") for match, kinds in found if match), "")
    if not kind:
        raise InvalidProblem(f"*ELEMENT: the type {name:.40} is not offered")
    count = len(REFERENCES[kind].nodes)
    values = _numbers("ELEMENT", lines, int)
    if len(values) % (count + 1):
        raise InvalidProblem(f"*ELEMENT, TYPE={name:.40}: expected a label and {count} nodes for each element")
    table = values.reshape(-1, count + 1).astype(np.int64)
    reading.elements.append((kind, table[:, 0], table[:, 1:]))
    if "ELSET" in options:
        _extend(reading.element_sets, options["ELSET"], table[:, 0])


def _members(sets: dict[str, Index], options: dict[str, str], lines: list[str]) -> Index:
    if "GENERATE" in options:
        return np.concatenate([np.zeros(0, dtype=np.int64), *[_generated(line) for line in lines]])
    words = [word.strip() for line in lines for word in line.split(",") if word.strip()]
    return np.concatenate([np.zeros(0, dtype=np.int64), *[_labels(sets, word) for word in words]])


def _generated(line: str) -> Index:
    """Return the labels of ``first, last, step``; the step is 1 unless stated."""
    words = [word.strip() for word in line.rstrip(",").split(",")]
    if len(words) not in (2, 3) or not all(_is_label(word) for word in words) or words[2:] == ["0"]:
        raise InvalidProblem(f"GENERATE: expected a first and a last label and a positive step, got {line[:60]!r}")
    first, last, *step = map(int, words)
    if (last - first) // (step[0] if step else 1) > MOST_GENERATED:
        raise InvalidProblem(f"GENERATE: expected at most {MOST_GENERATED} labels, got {line[:60]!r}")
    return np.arange(first, last + 1, *step, dtype=np.int64)


def _is_label(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) < len(str(LARGEST_LABEL))


def _labels(sets: dict[str, Index], word: str) -> Index:
    """Return a label, or the members of a set defined above; prefixes of instances are ignored."""
    name = word.rpartition(".")[2]
    if _is_label(name):
        return np.array([int(name)])
    if name not in sets:
        raise InvalidProblem(f"there is no set {name:.40} at this place; it has {', '.join(sets)[:200] or 'none'}")
    return sets[name]


def _extend(sets: dict[str, Index], name: str, labels: Index) -> None:
    sets[name] = np.concatenate([sets.get(name, np.zeros(0, dtype=np.int64)), labels])


def _surface(reading: _Reading, options: dict[str, str], lines: list[str]) -> None:
    name = _option("SURFACE", options, "NAME")
    if options.get("TYPE", "ELEMENT") == "NODE":
        _extend(reading.node_sets, name, _members(reading.node_sets, {}, [line.split(",")[0] for line in lines]))
        return
    faces = reading.surfaces.setdefault(name, [])
    for line in lines:
        members, _, face = (word.strip() for word in line.partition(","))
        if not re.fullmatch(r"S[1-6]", face):
            raise InvalidProblem(f"*SURFACE {name:.40}: expected a face S1 to S6, got {face[:40]!r}")
        faces.append((_labels(reading.element_sets, members), int(face[1])))


def _cells(reading: _Reading) -> Cells:
    if not reading.points or not reading.elements:
        raise InvalidProblem("expected *NODE and *ELEMENT, got none")
    labels = np.concatenate(reading.labels)
    _refuse_twice("node", labels)
    cells = [(kind, _places("node", labels, nodes)) for kind, _, nodes in reading.elements]
    own = [element_labels for _, element_labels, _ in reading.elements]
    every = np.concatenate(own)
    _refuse_twice("element", every)
    for name, members in reading.element_sets.items():
        _places(f"element, in the set {name},", every, members)
    groups = {name: [np.flatnonzero(np.isin(e, m)) for e in own] for name, m in reading.element_sets.items()}
    node_sets = {name: _places(f"node, in the set {name},", labels, m) for name, m in reading.node_sets.items()}
    facets: dict[str, list[tuple[str, Index]]] = {}
    for name, faces in reading.surfaces.items():
        for members, face in faces:
            _places(f"element, in the surface {name},", every, members)
            for (kind, nodes), element_labels in zip(cells[: len(own)], own, strict=True):
                local = REFERENCES[kind].facets
                place = HEX_FACES[face - 1] if kind.startswith("hex") else face - 1
                chosen = nodes[np.isin(element_labels, members)]
                if len(chosen) and place >= len(local):
                    raise InvalidProblem(f"*SURFACE {name:.40}: {kind} elements have no face S{face}")
                if len(chosen):
                    facets.setdefault(name, []).append((REFERENCES[kind].facet, chosen[:, local[place]]))
    empty = next((name for name in reading.surfaces if name not in facets), None)
    if empty is not None:
        raise InvalidProblem(f"side {empty!r} is empty; expected at least one facet")
    none = np.zeros(0, dtype=np.int64)
    added = [(name, cell) for name, found in facets.items() for cell in found]
    groups = {name: [*members, *[none] * len(added)] for name, members in groups.items()}
    for name in facets:
        mine = [np.arange(len(nodes)) if owner == name else none for owner, (_, nodes) in added]
        groups[name] = [*[none] * len(own), *mine]
    return Cells(np.concatenate(reading.points), [*cells, *[cell for _, cell in added]], groups, node_sets)


def _refuse_twice(what: str, labels: Index) -> None:
    ordered = np.sort(labels)
    again = ordered[1:][ordered[1:] == ordered[:-1]]
    if again.size:
        raise InvalidProblem(f"expected one {what} with the label {again[0]}, got several")


def _places(what: str, labels: Index, wanted: Index) -> Index:
    """Return the indices of the `wanted` among all labels."""
    places, there = places_among(labels, wanted)
    if not there.all():
        raise InvalidProblem(f"there is no {what} with the label {np.asarray(wanted)[~there][0]}")
    return places
