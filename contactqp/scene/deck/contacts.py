"""Surfaces, ties and contact pairs of a deck: rows, gaps and areas, and the nodes that ADJUST moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import scipy
import scipy.sparse as sp

from contactqp.elements.mortar import pair_mortar
from contactqp.elements.nodal_pressure import node_normals
from contactqp.elements.node_to_segment import Partners, nearest_facets, pair_node_to_segment
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.pairing import Pairing, contact_rows
from contactqp.elements.reference_elements import REFERENCES, facet_keys, groups
from contactqp.elements.surface import (
    Surface,
    check_surface,
    diameters,
    kind_of,
    middle_normals,
    normal_vectors,
    tangent_vectors,
)
from contactqp.errors import InvalidProblem, counted
from contactqp.exchange.deck.model import ContactPair, DeckSurface, DeckTie, Faces, Interaction
from contactqp.model.arrays import Array, Index, Mask, Vector
from contactqp.scene.deck.groups import Topology

Points = Array
Discretisation = Literal["node-to-segment", "mortar", "points"]
NONE: Index = np.zeros(0, dtype=np.int64)
# The default tolerance of a tie relative to the mean size of the master's faces, as in CalculiX.
TIED = 0.025
# Decks may state an interference fit, but an overlap of more than a face is taken for a mistake.
DEEPEST = 1.0


@dataclass(frozen=True, eq=False)
class DeckContact:
    """One contact pair of a deck.

    Attributes
    ----------
    pair : ContactPair
    interaction : Interaction
    slave, master : Surface, over all unknowns of the deck, supported ones included
    pairing : rows over these unknowns
    labels : (m,) array of int, the slave node of each contact, by its label
    discretisation : str, ``"node-to-segment"``, ``"mortar"`` or ``"points"``
    """

    pair: ContactPair
    interaction: Interaction
    slave: Surface
    master: Surface
    pairing: Pairing
    labels: Index
    discretisation: Discretisation


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The named surfaces of a deck on a topology."""

    topology: Topology

    def surface(self, name: str, points: Points, place: str) -> Surface:
        """Return a surface with its faces, also where the deck states a list of nodes.

        Raises
        ------
        InvalidProblem
            Faces of several kinds, an element that is not there, nodes that make up no faces.
        """
        stated = self.topology.model.surfaces[name]
        facets = self._of_nodes(stated) if stated.faces is None else self._of_faces(stated)
        kinds = sorted({kind for kind, _, _ in facets})
        if len(kinds) > 1:
            raise InvalidProblem(f"{stated.place}: *SURFACE {name}: expected faces of one kind, got {', '.join(kinds)}")
        if not facets:
            raise InvalidProblem(f"{stated.place}: *SURFACE {name}: expected faces, got none (used at {place})")
        thickness = {size for _, _, size in facets}
        if len(thickness) > 1:
            raise InvalidProblem(f"{stated.place}: *SURFACE {name}: expected one thickness, got {sorted(thickness)}")
        nodes = np.concatenate([nodes for _, nodes, _ in facets])
        revolved = self.topology.revolved
        found = Surface(points, nodes, self.topology.unknowns, f"surface {name}", thickness.pop(), revolved)
        try:
            check_surface(found)
        except InvalidProblem as error:
            numbers = f"nodes are counted from 0 here, node 0 is {self.topology.labels[0]}"
            raise InvalidProblem(f"{stated.place}: *SURFACE: {error} ({numbers})") from None
        return found

    def _of_faces(self, stated: DeckSurface) -> list[tuple[str, Index, float]]:
        faces = Faces(NONE, NONE) if stated.faces is None else stated.faces
        found = self.topology.facets(faces, f"{stated.place}: *SURFACE {stated.name}")
        return [
            (group.kind.facet, group.nodes[elements][:, list(group.kind.facets[local])], group.thickness)
            for group, local, elements, _ in found
        ]

    def _of_nodes(self, stated: DeckSurface) -> list[tuple[str, Index, float]]:
        """Return the outer faces of elements all of whose nodes are in the list."""
        nodes = self.nodes(stated)
        found = []
        for kind in sorted({group.kind.facet for group in self.topology.groups}):
            mine = [group for group in self.topology.groups if group.kind.facet == kind]
            every = [group.nodes[:, list(group.kind.facets)].reshape(-1, len(REFERENCES[kind].nodes)) for group in mine]
            sizes = [np.full(len(one), group.thickness) for one, group in zip(every, mine, strict=True)]
            facets, size = np.concatenate(every), np.concatenate(sizes)
            order, new = groups(facet_keys(facets, kind))
            starts = np.flatnonzero(new)
            outer = order[starts[np.diff(np.append(starts, len(order))) == 1]]
            inside = np.sort(outer[np.isin(facets[outer], nodes).all(axis=1)])
            found += [(kind, facets[inside[size[inside] == t]], float(t)) for t in np.unique(size[inside])]
        covered = np.unique(np.concatenate([NONE, *(one.ravel() for _, one, _ in found)]))
        alone = np.setdiff1d(nodes, covered)
        if len(alone):
            label = self.topology.labels[alone[0]]
            raise InvalidProblem(
                f"{stated.place}: *SURFACE {stated.name}: node {label} has no face of an element all of whose nodes "
                "are in the list; state the surface by faces"
            )
        return found

    def nodes(self, stated: DeckSurface) -> Index:
        """Return the nodes of a surface among those with unknowns, ascending."""
        if stated.nodes is None:
            return np.unique(np.concatenate([nodes.ravel() for _, nodes, _ in self._of_faces(stated)]))
        nodes, without = self.topology.places(stated.nodes, stated.place)
        if len(without):
            raise InvalidProblem(f"{stated.place}: *SURFACE {stated.name}: node {without[0]} is in no element")
        return np.unique(nodes)


def adjusted_points(surfaces: Surfaces) -> Points:
    """Return the points (N, d) after ADJUST of ties and contact pairs has moved slave nodes onto master surfaces."""
    topology = surfaces.topology
    model = topology.model
    points = model.points[topology.active][:, : topology.dimension].copy()
    flat = model.points[topology.active][:, topology.dimension :]
    if len(flat) and np.ptp(flat, axis=0).max(initial=0.0) > 0:
        raise InvalidProblem(f"{model.file}: expected plane elements at one z, got several")
    for group in topology.groups:
        group.check_shapes(points)
    for tie in model.ties:
        if tie.adjust:
            nodes, partners, master = _tied(surfaces, tie, points)
            moved = _move(points, nodes, partners, master)
            _note_moved(surfaces, tie.place, "*TIE", moved)
    for pair in model.pairs:
        if pair.adjust is not None:
            moved = _adjust(surfaces, pair, points)
            _note_moved(surfaces, pair.place, "*CONTACT PAIR, ADJUST", moved)
    return points


def _adjust(surfaces: Surfaces, pair: ContactPair, points: Points) -> Vector:
    slave = surfaces.surface(pair.slave, points, pair.place)
    master = surfaces.surface(pair.master, points, pair.place)
    nodes = slave.nodes
    partners = nearest_facets(points[nodes], node_normals(slave), master, None)
    near = partners.found & ~partners.beyond
    if isinstance(pair.adjust, np.ndarray):
        chosen, _ = surfaces.topology.places(pair.adjust, pair.place)
        near &= np.isin(nodes, chosen)
    else:
        near &= partners.gap <= float(pair.adjust or 0.0)
    return _move(points, nodes[near], _only(partners, near), master)


def _only(partners: Partners, keep: Mask) -> Partners:
    return Partners(
        partners.facet[keep], partners.xi[keep], partners.gap[keep], partners.normal[keep], partners.beyond[keep]
    )


def _move(points: Points, nodes: Index, partners: Partners, master: Surface) -> Vector:
    """Move nodes onto their projections on the master surface, in place, and return the distances."""
    shape = kind_of(master).shape(partners.xi)
    feet = np.einsum("qk,qkd->qd", shape, master.points[master.facets[partners.facet]])
    moved = np.asarray(np.linalg.norm(points[nodes] - feet, axis=1))
    points[nodes] = feet
    return moved


def _note_moved(surfaces: Surfaces, place: str, what: str, moved: Vector) -> None:
    if np.any(moved > 0):
        far = f"{counted('slave node', int(np.count_nonzero(moved)))} moved, by {moved.max():.6g} at most"
        surfaces.topology.model.ledger.converted.append(f"{place}: {what}: {far}, onto the master surface")


def _tied(surfaces: Surfaces, tie: DeckTie, points: Points) -> tuple[Index, Partners, Surface]:
    """Return the slave nodes of a tie within its tolerance, their projections on the master surface, and the latter."""
    master = surfaces.surface(tie.master, points, tie.place)
    nodes = np.setdiff1d(surfaces.nodes(surfaces.topology.model.surfaces[tie.slave]), master.nodes)
    centres = master.points[master.facets].mean(axis=1)
    nearest = scipy.spatial.cKDTree(centres).query(points[nodes])[1]
    partners = nearest_facets(points[nodes], -middle_normals(master)[nearest], master, None)
    size = float(diameters(master.points[master.facets]).mean())
    near = partners.found & (abs(partners.gap) <= (tie.tolerance or TIED * size))
    return nodes[near], _only(partners, near), master


def tie_rows(surfaces: Surfaces, points: Points) -> tuple[Any, list[str]]:
    """Return the rows (k, n) of all ties, u_slave - sum N_j u_j for each axis, and their names."""
    topology = surfaces.topology
    d = topology.dimension
    rows, names = [sp.csr_array((0, topology.size))], list[str]()
    for tie in topology.model.ties:
        nodes, partners, master = _tied(surfaces, tie, points)
        loose = len(surfaces.nodes(topology.model.surfaces[tie.slave])) - len(nodes)
        far = f", {counted('slave node', loose)} beyond the tolerance or of the master itself" if loose else ""
        note(topology.model.ledger.read, f"{tie.place}: *TIE: {counted('slave node', len(nodes))} tied{far}")
        facets = master.facets[partners.facet]
        weights = np.column_stack([np.ones(len(nodes)), -kind_of(master).shape(partners.xi)])
        columns = topology.unknowns[np.column_stack([nodes, facets])]  # (q, 1 + k, d)
        row = np.arange(len(nodes) * d).reshape(len(nodes), 1, d)
        entries = [part.ravel() for part in np.broadcast_arrays(weights[:, :, None], row, columns)]
        rows.append(
            sp.csr_array(sp.coo_array((entries[0], (entries[1], entries[2])), shape=(len(nodes) * d, topology.size)))
        )
        names += [topology.name(unknown) for unknown in topology.unknowns[nodes].ravel().tolist()]
    return sp.csr_array(sp.vstack(rows, format="csr")), names


def contacts_of(surfaces: Surfaces, points: Points, discretisation: Discretisation) -> list[DeckContact]:
    """Return the contact pairs of a deck, each with its rows and gaps.

    A mortar takes linear faces in the plane and in space; all else is paired node to segment. By points, Gauss
    points of the slave's faces take the place of its nodes.

    Raises
    ------
    InvalidProblem
        A pair whose surfaces do not face each other, share a node, or overlap by more than a face; by its line.
    """
    return [_contact(surfaces, pair, points, discretisation) for pair in surfaces.topology.model.pairs]


def _contact(surfaces: Surfaces, pair: ContactPair, points: Points, discretisation: Discretisation) -> DeckContact:
    model = surfaces.topology.model
    slave = surfaces.surface(pair.slave, points, pair.place)
    master = surfaces.surface(pair.master, points, pair.place)
    takes = not (kind_of(slave).quadratic or kind_of(master).quadratic or slave.revolved)
    mortar = discretisation == "mortar" and takes
    overlap = DEEPEST * float(diameters(slave.points[slave.facets]).max())
    try:
        if discretisation == "points":
            pairing = _pair_points(slave, master, surfaces.topology.size)
        else:
            make = pair_mortar if mortar else pair_node_to_segment
            pairing = make(slave, master, overlap=overlap, dimension=surfaces.topology.size)
    except InvalidProblem as error:
        numbers = f"nodes are counted from 0 here, node 0 is {surfaces.topology.labels[0]}"
        raise InvalidProblem(f"{pair.place}: *CONTACT PAIR: {error} ({numbers})") from None
    kind: Discretisation = "mortar" if mortar else "points" if discretisation == "points" else "node-to-segment"
    if pair.type != "NODE TO SURFACE" and kind == "node-to-segment":
        note(model.ledger.assumed, f"{pair.place}: {pair.type}: no overlap at slave nodes")
    if (pair.slave, pair.master) in model.clearances:
        value = model.clearances[pair.slave, pair.master]
        pairing = replace(pairing, gap=np.full(len(pairing.gap), value))
    labels = surfaces.topology.labels[pairing.nodes]
    told = f"{counted('contact', len(labels))}, {kind}"
    alone = f", {counted('slave node', len(pairing.unpaired))} without a partner" if len(pairing.unpaired) else ""
    note(model.ledger.read, f"{pair.place}: *CONTACT PAIR {pair.name}: {told}{alone}")
    interaction = model.interactions[pair.interaction]
    return DeckContact(pair, interaction, slave, master, pairing, labels, kind)


def _pair_points(slave: Surface, master: Surface, dimension: int) -> Pairing:
    """Pair the Gauss points of the slave's faces, two along each direction, with the nearest points of the master.

    This is the limit of stiff springs at integration points. Each contact is named after its nearest node.
    """
    kind, other = kind_of(slave), kind_of(master)
    xi, weight = kind.quadrature(2)
    shape, count = kind.shape(xi), len(slave.facets)
    corners = slave.points[slave.facets]
    points = np.einsum("qk,pkd->pqd", shape, corners).reshape(-1, slave.dimension)
    slopes = np.tile(kind.derivatives(xi), (count, 1, 1))
    outward = normal_vectors(tangent_vectors(np.repeat(corners, len(xi), axis=0), slopes))
    size = np.linalg.norm(outward, axis=1)
    partners = nearest_facets(points, outward / size[:, None], master, None)
    near = np.flatnonzero(partners.found & ~partners.beyond)
    if not len(near):
        raise InvalidProblem(f"{slave.name} and {master.name} do not face each other")
    facet, local = np.divmod(near, len(xi))
    theirs = master.facets[partners.facet[near]]
    weights = np.concatenate([shape[local], -other.shape(partners.xi[near])], axis=1)
    columns = np.concatenate([slave.unknowns[slave.facets[facet]], master.unknowns[theirs]], axis=1)
    normals, entry = partners.normal[near], np.repeat(np.arange(len(near)), weights.shape[1])
    E_N, E_T = contact_rows(
        entry,
        weights.ravel(),
        columns.reshape(len(entry), slave.dimension),
        normals[entry],
        tangent_frames(normals)[entry],
        (len(near), dimension),
    )
    area = (size * np.tile(weight, count))[near] * slave.thickness
    area = area * (2 * np.pi * points[near, 0] if slave.revolved else 1.0)
    nodes = slave.facets[facet, np.argmax(shape[local], axis=1)]
    none = np.zeros(0, dtype=np.int64)
    return Pairing(E_N, partners.gap[near], E_T, nodes, points[near], normals, none, area)


def note(lines: list[str], line: str) -> None:
    """Add a line to a part of a ledger, once."""
    if line not in lines:
        lines.append(line)


def contact_names(contacts: Sequence[DeckContact]) -> list[str]:
    """Return the name ``node 17`` for each contact, with the pair added where a node has several."""
    if any(one.discretisation == "points" for one in contacts):
        return [f"point {i} of {one.pair.name}" for one in contacts for i in range(len(one.labels))]
    every = np.concatenate([NONE, *(one.labels for one in contacts)])
    values, count = np.unique(every, return_counts=True)
    several = set(values[count > 1].tolist())
    return [
        f"node {label} ({one.pair.name})" if label in several else f"node {label}"
        for one in contacts
        for label in one.labels.tolist()
    ]
