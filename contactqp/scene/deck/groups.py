"""Group the elements of a deck by kind and section, and number the unknowns of their nodes and their faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from contactqp.elements.abaqus import HEX_FACES
from contactqp.elements.material import Material, Model
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import REFERENCES, Block, Geometry, Reference, gauss, tetrahedron
from contactqp.elements.scalars import places_among
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem, counted
from contactqp.exchange.deck.model import AXES, DeckMaterial, DeckModel, Elements, Faces, Section
from contactqp.model.arrays import Array, Index

# Both programs integrate the quadratic tetrahedron with four points; other rules differ on curved edges.
_TETRAHEDRON = replace(REFERENCES["tet10"], rule=tetrahedron(4))
_REDUCED = {
    "hex20": replace(REFERENCES["hex20"], rule=gauss(2, 3)),
    "quad8": replace(REFERENCES["quad8"], rule=gauss(2, 2), fine_rule=gauss(2, 2)),
}
_SHAPES = {"3": "tri3", "4": "quad4", "6": "tri6", "8": "quad8"}
_SOLIDS = {"4": "tet4", "8": "hex8", "10": "tet10", "20": "hex20"}
_MODELS: dict[str, Model] = {
    "C3D": "3d",
    "CPE": "plane-strain",
    "CPS": "plane-stress",
    "CAX": "axisymmetric",
}
# Notes where CalculiX, which replaces plane elements by solid ones, differs from the computation here.
_DIFFERS = {
    "CPS": "no stress across the plane at any point; CalculiX leaves the thickness at each node free, which is stiffer",
    "CAX": "of the full circle; CalculiX takes a wedge of 2 degrees with plane sides, which differs by some 1e-4",
    "CAX3": "half of the pressure on an edge goes to either end in CalculiX, whatever their radii",
}
_EXPANDED = "as CalculiX has them: the thickness at each node is an unknown, which is stiffer than plane stress"
LINKS = ("T2D2", "T3D2", "SPRINGA")


@dataclass(frozen=True, eq=False)
class Group:
    """Solid elements of one type and one section.

    Attributes
    ----------
    type : str
    kind : Reference
    labels : (E,) array of int
    nodes : (E, n) array of int, their nodes, counted among the nodes that have unknowns
    model : str
    material : DeckMaterial
    thickness : 1 in space and in axial symmetry
    section : Section
    """

    type: str
    kind: Reference
    labels: Index
    nodes: Index
    model: Model
    material: DeckMaterial
    thickness: float
    section: Section

    def body(self, points: Array, labels: Index) -> tuple[Body, Index]:
        """Return the elements as a body, and the index in the deck of each of its nodes.

        Raises
        ------
        InvalidProblem
            An element that is turned inside out or flat, by its label.
        """
        self.check_shapes(points)
        used, inverse = np.unique(self.nodes, return_inverse=True)
        block = Block(self.kind, inverse.reshape(self.nodes.shape))
        material = Material(
            self.material.modulus, self.material.poisson, self.material.density, name=f"material {self.material.name}"
        )
        name = f"elements {self.type} of material {self.material.name}"
        try:
            mesh = Mesh(points[used], (block,))
        except InvalidProblem as error:
            first = f"its element 0 is {self.labels[0]}, its node 0 is {labels[used[0]]}"
            raise InvalidProblem(f"{name}: {error} ({first})") from None
        return Body(mesh, material, self.model, self.thickness, name), used

    def check_shapes(self, points: Array) -> None:
        """Refuse elements that are turned inside out or flat, by their labels."""
        ordered = np.sort(self.nodes, axis=1)
        twice = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
        if twice.size:
            raise InvalidProblem(
                f"element {self.labels[twice[0]]} ({self.type}): a node stands in it twice; collapsed elements are "
                "not offered, tetrahedra are"
            )
        corners = points[self.nodes]
        at = np.vstack([self.kind.rule.points, self.kind.fine_rule.points])
        with np.errstate(over="ignore", invalid="ignore"):
            determinant = Geometry(self.kind, corners, at).determinant.min(axis=1)
        bad = np.flatnonzero(~(determinant > 0))
        if bad.size:
            raise InvalidProblem(
                f"element {self.labels[bad[0]]} ({self.type}): its Jacobian is {determinant[bad[0]]:.3g}; expected a "
                "positive one: its nodes are in the wrong order, or it is flat"
            )


@dataclass(frozen=True, eq=False)
class Topology:
    """The nodes, elements and unknowns of a deck, independent of coordinates.

    Attributes
    ----------
    model : DeckModel
    active : (N,) array of int, the nodes with unknowns, those of elements and equations, as indices of `model.labels`
    groups : sequence of Group
    links : sequence of (Elements, sizes), trusses and springs with the area or the stiffness of each
    expanded : whether elements of plane stress are those of CalculiX, with unknown thicknesses behind all displacements
    """

    model: DeckModel
    active: Index
    groups: Sequence[Group]
    links: Sequence[tuple[Elements, Array, Sequence[DeckMaterial | None]]]
    expanded: bool = False

    @property
    def dimension(self) -> int:
        """Return the number of unknowns of a node, 2 or 3."""
        return self.model.dimension

    @property
    def size(self) -> int:
        """Return the number of all unknowns, held ones included."""
        return self.unknowns.size + len(self._thick)

    @cached_property
    def _thick(self) -> Array:
        """Return node and thickness of each unknown change of thickness, (w, 2), one for each thickness at a node."""
        plane = [group for group in self.groups if self.expanded and group.model == "plane-stress"]
        every = [
            np.column_stack([nodes, np.full(len(nodes), group.thickness)])
            for group in plane
            for nodes in [np.unique(group.nodes)]
        ]
        return np.unique(np.concatenate([np.zeros((0, 2)), *every]), axis=0)

    @property
    def thicknesses(self) -> Index:
        """Return the indices in u of the changes of thickness."""
        return np.arange(self.unknowns.size, self.size)

    def thicknesses_of(self, group: Group) -> Index:
        """Return the index in u of the change of thickness at each node of a group's elements, (E, n)."""
        mine = np.flatnonzero(self._thick[:, 1] == group.thickness)
        found = mine[np.searchsorted(self._thick[mine, 0], group.nodes)]
        return np.asarray(self.unknowns.size + found)

    @cached_property
    def labels(self) -> Index:
        """Return the labels of the nodes with unknowns, ascending."""
        return self.model.labels[self.active]

    @cached_property
    def unknowns(self) -> Index:
        """Return the index in u of the displacement of each node along each axis, (N, d)."""
        return np.arange(len(self.active) * self.dimension).reshape(-1, self.dimension)

    @property
    def revolved(self) -> bool:
        """Return whether the deck is axisymmetric."""
        return any(group.model == "axisymmetric" for group in self.groups)

    def name(self, unknown: int) -> str:
        """Return ``17.y``, the name of an unknown, or ``thickness of node 17``."""
        if unknown >= self.unknowns.size:
            node, size = self._thick[unknown - self.unknowns.size]
            several = np.count_nonzero(self._thick[:, 0] == node) > 1
            return f"thickness of node {self.labels[int(node)]}{f' where it is {size:g}' if several else ''}"
        return f"{self.labels[unknown // self.dimension]}.{AXES[unknown % self.dimension]}"

    def places(self, labels: Index, place: str) -> tuple[Index, Index]:
        """Return the nodes with unknowns among some labels, and the labels of those without.

        Raises
        ------
        InvalidProblem
            A label that no node has; `place` says where it stands.
        """
        at, there = places_among(self.model.labels, labels)
        if not there.all():
            raise InvalidProblem(f"{place}: there is no node {labels[~there][0]}")
        among, active = places_among(self.active, at)
        return among[active], labels[~active]

    def check_elements(self, labels: Index, place: str) -> None:
        """Refuse labels of elements that are not there."""
        every = np.concatenate([group.labels for group in self.model.elements])
        missing = labels[~np.isin(labels, every)]
        if len(missing):
            raise InvalidProblem(f"{place}: there is no element {missing[0]}")

    def facets(self, faces: Faces, place: str) -> list[tuple[Group, int, Index, Index]]:
        """Return the faces of solid elements: group, number of the facet, elements of the group, entries of `faces`.

        Raises
        ------
        InvalidProblem
            An element does not exist, is not a solid, or lacks this face.
        """
        self.check_elements(faces.elements, place)
        found = []
        seen = np.zeros(len(faces.elements), dtype=bool)
        for group in self.groups:
            at, inside = places_among(group.labels, faces.elements)
            seen |= inside
            for number in np.unique(faces.face[inside]).tolist():
                local = HEX_FACES[number - 1] if group.kind.corners == 8 else number - 1
                if local >= len(group.kind.facets):
                    element = faces.elements[inside & (faces.face == number)][0]
                    raise InvalidProblem(f"{place}: element {element} ({group.type}) has no face {number}")
                entries = np.flatnonzero(inside & (faces.face == number))
                found.append((group, local, at[entries], entries))
        if not seen.all():
            raise InvalidProblem(f"{place}: element {faces.elements[~seen][0]} has no faces; expected solid elements")
        return found


def topology_of(model: DeckModel, *, expanded: bool = False) -> Topology:
    """Return the groups of a deck's elements and the nodes that have unknowns; plane stress `expanded` as in Topology.

    Raises InvalidProblem: elements without a section or with two, undefined or inelastic materials, undefined nodes, or
    axisymmetric elements beside others.
    """
    used = [group.nodes.ravel() for group in model.elements] + [one.nodes for one in model.equations]
    wanted = np.unique(np.concatenate(used))
    at, there = places_among(model.labels, wanted)
    if not there.all():
        raise InvalidProblem(_of_missing_node(model, int(wanted[~there][0])))
    renumber = {kind.type: kind for kind in model.elements}
    sections = _Sections(model)
    groups, links = [], []
    for elements in model.elements:
        nodes = np.searchsorted(wanted, elements.nodes)
        if elements.type in LINKS:
            links.append(sections.of_links(replace(elements, nodes=nodes)))
        else:
            groups.extend(sections.groups(elements, nodes))
    if len({group.model == "axisymmetric" for group in groups}) > 1:
        raise InvalidProblem(f"{model.file}: expected axisymmetric elements alone, got {', '.join(renumber)}")
    unused = len(model.labels) - len(at)
    if unused:
        model.ledger.ignored.append(f"{counted('node', unused)} in no element and no equation")
    for section in model.sections:
        groups_of_it = [group for group in groups if group.section is section]
        if section.size is not None and any(group.model in ("3d", "axisymmetric") for group in groups_of_it):
            model.ledger.ignored.append(f"{section.place}: *SOLID SECTION: a thickness, which solids have not")
    for kind in model.types():
        told = [_DIFFERS[name] for name in dict.fromkeys((kind[:3], kind)) if name in _DIFFERS]
        told = [_EXPANDED] if expanded and kind.startswith("CPS") else told
        model.ledger.assumed.extend(f"{kind}: {one}" for one in told)
    return Topology(model, at, groups, links, expanded)


def _of_missing_node(model: DeckModel, label: int) -> str:
    for group in model.elements:
        rows = np.flatnonzero((group.nodes == label).any(axis=1))
        if rows.size:
            return f"{group.place}: *ELEMENT: element {group.labels[rows[0]]}: there is no node {label}"
    equation = next(one for one in model.equations if label in one.nodes)
    return f"{equation.place}: *EQUATION: there is no node {label}"


class _Sections:
    """The section of each element of a deck."""

    def __init__(self, model: DeckModel) -> None:
        self.model = model
        self.labels = np.sort(np.concatenate([group.labels for group in model.elements]))
        self.section = np.full(len(self.labels), -1)
        for number, section in enumerate(model.sections):
            self._give(section.elements, number, section.place)
        self.spring = np.full(len(self.labels), np.nan)
        for spring in model.springs:
            self.spring[self._at(spring.elements, spring.place)] = spring.stiffness

    def _at(self, elements: Index, place: str) -> Index:
        at, there = places_among(self.labels, elements)
        if not there.all():
            raise InvalidProblem(f"{place}: there is no element {elements[~there][0]}")
        return at

    def _give(self, elements: Index, number: int, place: str) -> None:
        at = self._at(elements, place)
        twice = np.flatnonzero(self.section[at] >= 0)
        if twice.size:
            raise InvalidProblem(f"{place}: *SOLID SECTION: element {elements[twice[0]]} has a section already")
        self.section[at] = number

    def groups(self, elements: Elements, nodes: Index) -> list[Group]:
        """Return solid elements by section."""
        numbers = self.section[self._at(elements.labels, elements.place)]
        if np.any(numbers < 0):
            label = elements.labels[numbers < 0][0]
            raise InvalidProblem(f"{elements.place}: element {label} has no *SOLID SECTION")
        kind = _kind(elements.type)
        model = _MODELS[elements.type[:3]]
        found = []
        for number in np.unique(numbers).tolist():
            section, mine = self.model.sections[number], numbers == number
            thickness = 1.0 if model in ("3d", "axisymmetric") or section.size is None else section.size
            material = self._material(section)
            found.append(
                Group(elements.type, kind, elements.labels[mine], nodes[mine], model, material, thickness, section)
            )
        return found

    def of_links(self, elements: Elements) -> tuple[Elements, Array, Sequence[DeckMaterial | None]]:
        """Return trusses with their areas and materials, springs with their stiffness."""
        at = self._at(elements.labels, elements.place)
        if elements.type == "SPRINGA":
            sizes = self.spring[at]
            if np.isnan(sizes).any():
                label = elements.labels[np.isnan(sizes)][0]
                raise InvalidProblem(f"{elements.place}: element {label} has no *SPRING")
            return elements, sizes, [None] * len(at)
        sections = [self.model.sections[number] if number >= 0 else None for number in self.section[at].tolist()]
        for label, section in zip(elements.labels.tolist(), sections, strict=True):
            if section is None or section.size is None:
                raise InvalidProblem(f"{elements.place}: element {label} has no *SOLID SECTION with an area")
        chosen = [section for section in sections if section is not None]
        areas = np.array([section.size for section in chosen], dtype=float)
        return elements, areas, [self._material(section) for section in chosen]

    def _material(self, section: Section) -> DeckMaterial:
        if section.material not in self.model.materials:
            has = ", ".join(self.model.materials) or "none"
            raise InvalidProblem(f"{section.place}: there is no material {section.material}; it has {has}")
        material = self.model.materials[section.material]
        if not material.modulus > 0:
            raise InvalidProblem(f"{material.place}: material {material.name} has no *ELASTIC")
        return material


def _kind(type_: str) -> Reference:
    reduced, nodes = type_.endswith("R"), type_.rstrip("R")[3:]
    kind = REFERENCES[_SOLIDS[nodes] if type_.startswith("C3D") else _SHAPES[nodes]]
    if kind.name == "tet10":
        return _TETRAHEDRON
    kind = _REDUCED[kind.name] if reduced else kind
    # Both programs integrate axisymmetric elements with the points of the plane element.
    return replace(kind, fine_rule=kind.rule) if type_.startswith("CAX") else kind
