"""The fields of a solution on elastic bodies: displacement, stress; contact force, pressure, gap and status.

Forces [force] and pressures [force / length^2] are kept in separate arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.analysis.large.deformation import LargeSolution, LoadedBody
from contactqp.elements.deformable import ContactGeometry, ContactGroup, ObstacleContact, Supported, SupportedContact
from contactqp.elements.nonlinear_solid import NonlinearSolid
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.pairing import Pairing
from contactqp.elements.reference_elements import Reference
from contactqp.elements.solid import Body, stress_at_nodes, von_mises
from contactqp.elements.structure import Structure, System
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.model.arrays import Array, Index, Indices, Vector
from contactqp.model.problem import Units
from contactqp.model.solution import Solution
from contactqp.scene.deck.contacts import Discretisation
from contactqp.scene.deck.deck import Deck

# A contact belongs to the node at its point; a node further away than this, relative to the structure, is another one.
SAME_PLACE = 1e-9


def contact_nodes(structure: Structure, pairing: Pairing, name: str) -> tuple[Index, Index, bool]:
    """Return the body (p,) and the node within it (p,) of each contact, and whether the partner is a rigid obstacle.

    Nodes are found from the rows: a contact moves by -n.(w_i u_i + ...), so its own node is the one at its point with
    w_i > 0; the nodes of a master surface have w_i < 0.

    Raises InvalidProblem: the row of a contact touches no node of the structure at its point.
    """
    d = int(structure.bodies[0].mesh.points.shape[1])
    points = np.concatenate([body.mesh.points for body in structure.bodies])
    rows = sp.coo_array(pairing.normal)
    weight = -rows.data * pairing.direction[rows.row, rows.col % d]
    summed = sp.coo_array((weight, (rows.row, rows.col // d)), shape=(len(pairing.gap), len(points))).tocsr().tocoo()
    mine = summed.data > 0
    contact, node = summed.row[mine], summed.col[mine]
    distance = np.linalg.norm(points[node] - pairing.points[contact], axis=1)
    near = distance <= SAME_PLACE * np.ptp(points, axis=0).max()
    found = np.full(len(pairing.gap), -1)
    found[contact[near]] = node[near]
    if len(found) and found.min() < 0:
        i = int(np.argmin(found))
        raise InvalidProblem(
            f"{name}: contact {i} at {pairing.points[i].tolist()}: expected a node of the structure at this point in "
            "its row, got none"
        )
    first = np.cumsum([0, *[len(body.mesh.points) for body in structure.bodies]])
    owner = np.searchsorted(first, found, side="right") - 1
    return owner, found - first[owner], bool(np.all(rows.col // d == found[rows.row]))


# State of a contact that is not in the problem as all its nodes are supported, so that its force is not determined.
HELD = "held"


@dataclass(frozen=True, eq=False)
class BodyFields:
    """One body with its displacements, stresses and contact forces; N nodes in d dimensions.

    Attributes
    ----------
    body : Body
    displacement : (N, d) array [length]
    stress : (N, 6) array, (xx, yy, zz, xy, yz, zx), tension positive, averaged at nodes [force / length^2]
    contact_force : (N, d) array
        Forces of contact on the body at each node, -(E_N' l_N + E_T' l_T) [force]; zero away from contact.
    load : (N, d) array, nodal loads: point loads, tractions, pressures and weights [force]
    """

    body: Body
    displacement: Array
    stress: Array
    contact_force: Array
    load: Array

    @property
    def points(self) -> Array:
        """Return the initial positions of the nodes, (N, d) [length]."""
        return self.body.mesh.points

    @cached_property
    def von_mises(self) -> Vector:
        """Return the von Mises equivalent of `stress`, (N,) [force / length^2]."""
        return von_mises(self.stress)


@dataclass(frozen=True, eq=False)
class PairingFields:
    """The p contacts of one pairing.

    Attributes
    ----------
    name : str
    body, node : (p,) arrays of int, the body of each contact, as its place in ContactFields.bodies, and its node
    position : (p, d) array, initial position of the node [length]
    displacement : (p, d) array [length]
    direction : (p, d) array
        The unit normal out of the obstacle or the master surface, along which the contact pushes the body.
    force : (p,) array
        lambda_N, positive in compression [force]: in 2D for the body's thickness, in axial symmetry for the full
        circle. NaN where `status` is "held".
    pressure : (p,) array or None
        `Pairing.pressure` of the forces [force / length^2]; None for a pairing of bare points, which have no area. NaN
        where `status` is "held".
    friction : (p, d) array or None
        The friction force on the contact's own node, -E_T' l_T there [force], NaN where `status` is "held"; None
        without friction.
    shear : (p, d) array or None
        `Pairing.per_area` of that, component by component [force / length^2]; None without friction or area.
    gap : (p,) array, gap under the load, positive when open [length]
    initial_gap : (p,) array, gap before any displacement [length]
    status : (p,) array of str
        "open", "closed", "grazing", "stick" or "slip"; "held" where every node of the contact is supported, so that
        the contact is not in the problem.
    on_obstacle : whether the partner is a rigid obstacle and not another body
    """

    name: str
    body: Index
    node: Index
    position: Array
    displacement: Array
    direction: Array
    force: Vector
    pressure: Vector | None
    friction: Array | None
    shear: Array | None
    gap: Vector
    initial_gap: Vector
    status: NDArray[np.str_]
    on_obstacle: bool


@dataclass(frozen=True, eq=False)
class ContactFields:
    """All bodies and all pairings of one solution."""

    bodies: tuple[BodyFields, ...]
    pairings: tuple[PairingFields, ...]
    units: Units

    @property
    def dimension(self) -> int:
        """Return the dimension d of space, 2 or 3."""
        return self.bodies[0].body.dimension


def contact_facets(fields: ContactFields, pairing: PairingFields) -> Iterator[tuple[Reference, Index]]:
    """Yield the kinds of the boundary facets whose nodes are all contacts, and the contacts (f, n) at their nodes."""
    for number in np.unique(pairing.body):
        mesh = fields.bodies[number].body.mesh
        contact = np.full(len(mesh.points), -1)
        mine = np.flatnonzero(pairing.body == number)
        contact[pairing.node[mine]] = mine
        for block in mesh.facets_of(mesh.boundary):
            here = contact[block.nodes]
            yield block.kind, here[(here >= 0).all(axis=1)]


def contacts_of(solution: Solution, system: System, pairings: Sequence[Pairing]) -> Indices:
    """Return the places of the contacts of a solution among the rows of the pairings that its problem is made of.

    Raises InvalidProblem: the solution is not one of this system and these pairings.
    """
    kept = system.free_contacts(pairings)
    expected, got = (len(system.free), len(kept)), (len(solution.displacement), len(solution.normal_force))
    if expected != got:
        raise InvalidProblem(
            f"solution: expected {expected[0]} unknowns and {expected[1]} contacts, as the system and the pairings "
            f"have, got {got[0]} and {got[1]}: contacts=[...] are the pairings of its problem, in their order"
        )
    return kept


def contact_fields(
    system: System, pairings: Sequence[Pairing], solution: Solution, *, names: Sequence[str] | None = None
) -> ContactFields:
    """Return the fields of a solution of ``system.problem(pairings)``.

    Parameters
    ----------
    system : ``structure.assemble(supports, loads)``
    pairings : sequence of Pairing, the pairings of the problem, in the same order
    solution : Solution
    names : sequence of str, optional
        Names of the pairings, for legends; by default "contact", numbered if there are several.

    Raises
    ------
    InvalidProblem
        The solution is not one of this system and these pairings, or there is not one name for each pairing.
    """
    kept = contacts_of(solution, system, pairings)
    names = _default_names(len(pairings)) if names is None else names
    if len(names) != len(pairings):
        raise InvalidProblem(f"names: expected one for each of {len(pairings)} pairings, got {len(names)}")
    structure, d = system.structure, len(system.structure.bodies[0].axes)
    bodies = [body for body in structure.bodies if isinstance(body, Body)]
    if len(bodies) < len(structure.bodies):
        other = next(body for body in structure.bodies if not isinstance(body, Body))
        raise Unsupported(f"{other.name}: a membrane has no stresses to draw or to write")
    first = [structure.first(body.name) // d for body in bodies]
    nodes = [start + np.arange(len(body.mesh.points)) for start, body in zip(first, bodies, strict=True)]
    owners = [contact_nodes(structure, pairing, name) for pairing, name in zip(pairings, names, strict=True)]
    whole = _Whole(tuple(bodies), nodes, system.expand(solution.displacement), system.load)
    return _fields_of(whole, pairings, kept, solution, names, owners)


def fields_of_deck(deck: Deck, solution: Solution) -> ContactFields:
    """Return the fields of a solution of a deck's problem, exact or penalty, node to segment or mortar.

    Elements of one type and section are a body. Trusses and springs, which are lines, are left out.

    Raises
    ------
    InvalidProblem
        The solution is not one of this deck, or of its contact at Gauss points.
    Unsupported
        The deck has no solid elements.

    Parameters
    ----------
    deck : Deck, read by `read_deck`
    solution : Solution
    """
    parts, rows = deck.assembly.bodies, solution.problem.normal
    if not parts:
        raise Unsupported(f"{deck.model.file}: a deck without solid elements has no bodies to draw")
    count = len(deck.free)
    either: tuple[Discretisation, ...] = ("node-to-segment", "mortar") if deck.model.pairs else ("node-to-segment",)
    alike = (by for by in map(deck.contacts, either) if _same_rows(rows, by.free.normal, count))
    found = next(alike, None)
    if found is None:
        got = f"{len(solution.displacement)} unknowns and {len(solution.normal_force)} contacts"
        raise InvalidProblem(
            f"{deck.model.file}: expected a solution of its {count} unknowns by nodes or as a mortar, got one of {got}"
        )
    nodes = [unknowns[:: body.dimension] // body.dimension for _, body, unknowns in parts]
    pairings = [one.pairing for one in found.pairs]
    u = deck.expand(solution.displacement[:count])  # the unknowns of springs come last
    whole = _Whole(tuple(body for _, body, _ in parts), nodes, u, deck.assembly.load)
    owners = [(*whole.owners(pairing.nodes), False) for pairing in pairings]
    return _fields_of(whole, pairings, found.free.kept, solution, [one.pair.name for one in found.pairs], owners)


def _same_rows(rows: Any, expected: Any, count: int) -> bool:
    """Return whether rows over `count` unknowns, and over those of springs behind them, are the expected ones."""
    if rows.shape[0] != expected.shape[0] or rows.shape[1] < count:
        return False
    return not (sp.csr_array(rows)[:, :count] != expected).nnz


@dataclass(frozen=True, eq=False)
class _Whole:
    """Bodies that share one vector of unknowns, in which node i along axis k is entry d i + k.

    Attributes
    ----------
    bodies : tuple of Body
    nodes : for each body the places (N,) of its nodes among all
    displacement, load : (n,) arrays [length], [force]
    """

    bodies: tuple[Body, ...]
    nodes: Sequence[Index]
    displacement: Vector
    load: Vector

    def owners(self, nodes: Index) -> tuple[Index, Index]:
        """Return the body of each node, of several the one with most of these nodes, and the node's index within it."""
        within = [np.isin(nodes, mine) for mine in self.nodes]
        owner, place = np.full(len(nodes), -1), np.full(len(nodes), -1)
        for number in sorted(range(len(self.bodies)), key=lambda one: -np.count_nonzero(within[one])):
            here = within[number] & (owner < 0)
            owner[here], place[here] = number, np.searchsorted(self.nodes[number], nodes[here])
        return owner, place


def _fields_of(
    whole: _Whole,
    pairings: Sequence[Pairing],
    kept: Indices,
    solution: Solution,
    names: Sequence[str],
    owners: Sequence[tuple[Index, Index, bool]],
) -> ContactFields:
    """Return the fields of bodies and pairings.

    Parameters
    ----------
    whole : bodies with displacements and loads
    pairings, names : sequences of Pairing and of str
    kept : the contacts of the solution, counted through all pairings
    solution : Solution
    owners : for each pairing the body and the node of each contact, and whether its partner is an obstacle
    """
    sizes = [len(pairing.gap) for pairing in pairings]
    force, status = np.full(sum(sizes), np.nan), np.full(sum(sizes), HELD, dtype="<U8")
    force[kept], status[kept] = solution.normal_force, solution.contact_status
    friction = None
    if solution.friction_force is not None:
        friction = np.full((sum(sizes), solution.friction_force.shape[1]), np.nan)
        friction[kept] = solution.friction_force
    on_nodes = _contact_forces(pairings, np.asarray(kept), solution, len(whole.load))
    bodies, load = [], whole.load.copy()
    for body, nodes in zip(whole.bodies, whole.nodes, strict=True):
        mine = (body.dimension * nodes[:, None] + np.arange(body.dimension)).ravel()
        own, pushed, acting = (v[mine].reshape(body.mesh.points.shape) for v in (whole.displacement, on_nodes, load))
        bodies.append(BodyFields(body, own, stress_at_nodes(body, own.ravel()), pushed, acting))
        load[mine] = 0.0  # the load on a node of several bodies is drawn at the first one
    fields, end = [], 0
    for pairing, name, size, at in zip(pairings, names, sizes, owners, strict=True):
        here = slice(end, end + size)
        end += size
        dragged = None if friction is None else friction[here]
        fields.append(_pairing_fields(whole, bodies, pairing, name, at, force[here], dragged, status[here]))
    return ContactFields(tuple(bodies), tuple(fields), solution.problem.units)


def _default_names(count: int) -> list[str]:
    return ["contact"] if count == 1 else [f"contact {i + 1}" for i in range(count)]


def _contact_forces(pairings: Sequence[Pairing], kept: Index, solution: Solution, size: int) -> Vector:
    """Return -(E_N' l_N + E_T' l_T) on all unknowns, (n,) [force]; contacts of supported nodes add nothing."""
    total, first = np.zeros(size), 0
    for pairing in pairings:
        here = (kept >= first) & (kept < first + len(pairing.gap))
        rows = kept[here] - first
        total -= pairing.normal[rows].T @ solution.normal_force[here]
        if solution.friction_force is not None:
            friction = np.zeros((len(pairing.gap), solution.friction_force.shape[1]))
            friction[rows] = solution.friction_force[here]
            total -= pairing.tangent.T @ friction.ravel()
        first += len(pairing.gap)
    return total


def _pairing_fields(
    whole: _Whole,
    bodies: Sequence[BodyFields],
    pairing: Pairing,
    name: str,
    own: tuple[Index, Index, bool],
    force: Vector,
    friction: Array | None,
    status: NDArray[np.str_],
) -> PairingFields:
    owner, node, on_obstacle = own
    displacement, among_all = np.empty(pairing.points.shape), np.empty(len(node), dtype=np.int64)
    for number in np.unique(owner):
        mine = owner == number
        displacement[mine], among_all[mine] = bodies[number].displacement[node[mine]], whole.nodes[number][node[mine]]
    dragged = None if friction is None else _friction_on_nodes(pairing, among_all, friction)
    return PairingFields(
        name=name,
        body=owner,
        node=node,
        position=pairing.points,
        displacement=displacement,
        direction=pairing.direction,
        force=force,
        pressure=None if pairing.projection is None else pairing.pressure(force),
        friction=dragged,
        shear=None
        if dragged is None or pairing.projection is None
        else np.column_stack([pairing.per_area(component) for component in dragged.T]),
        gap=np.asarray(pairing.gap - pairing.normal @ whole.displacement),
        initial_gap=pairing.gap,
        status=status,
        on_obstacle=on_obstacle,
    )


def _friction_on_nodes(pairing: Pairing, node: Index, friction: Array) -> Array:
    """Return -sum_k t_k l_T,k (p, d) on the contacts' own nodes, t_k being the unit tangents of the rows there."""
    count, each = friction.shape
    d = pairing.points.shape[1]
    rows = sp.coo_array(pairing.tangent)
    contact = rows.row // each
    own = rows.col // d == node[contact]
    tangent = np.zeros((count * each, d))
    np.add.at(tangent, (rows.row[own], rows.col[own] % d), rows.data[own])
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    tangent = tangent / np.where(length > 0, length, 1.0)
    return np.asarray(-np.einsum("pk,pkd->pd", friction, tangent.reshape(count, each, d)))


def fields_of_solid(solution: Solution) -> ContactFields | None:
    """Return the fields of a solid at a large deformation, None for other bodies and contacts of other kinds.

    Positions are those of the deformed body, so that the obstacle is at x - gap n; stresses are not computed and are
    NaN.
    """
    loaded = solution.problem._computed.assembly
    if not isinstance(solution, LargeSolution) or not isinstance(loaded, LoadedBody):
        return None
    supported = loaded.body if isinstance(loaded.body, Supported) else None
    solid = loaded.body if supported is None else supported.body
    parts = [] if loaded.contact is None else list(_parts(loaded.contact))
    if not isinstance(solid, NonlinearSolid) or not all(isinstance(part, ObstacleContact) for part in parts):
        return None
    body, load = solid.body, np.zeros(solid.dimension)
    if supported is None:
        u, load = solution.displacement, solution.load
    else:
        u = supported.expand(solution.displacement)
        load[supported.free] = solution.load
    return ContactFields(
        (_body_fields(body, u, load),), tuple(_pairings(solution, parts, body)), units=solution.problem.units
    )


def _parts(contact: ContactGeometry) -> Iterator[ContactGeometry]:
    """Yield the contact geometries inside groups and supports, in the order of their contacts."""
    if isinstance(contact, SupportedContact):
        yield from _parts(contact.geometry)
    elif isinstance(contact, ContactGroup):
        for part in contact.parts:
            yield from _parts(part)
    else:
        yield contact


def _body_fields(body: Body, u: Vector, load: Vector) -> BodyFields:
    shape = body.mesh.points.shape
    return BodyFields(
        body=body,
        displacement=u.reshape(shape),
        stress=np.full((shape[0], 6), np.nan),
        contact_force=np.full(shape, np.nan),
        load=load.reshape(shape),
    )


def _pairings(solution: LargeSolution, parts: list[ContactGeometry], body: Body) -> Iterator[PairingFields]:
    first = 0
    for number, part in enumerate(parts):
        if not isinstance(part, ObstacleContact) or solution.position is None:
            continue
        here = slice(first, first + part.contacts)
        first += part.contacts
        now = solution.position[here]
        direction = np.asarray(part.obstacle.normals(now), dtype=float)
        friction = None
        if solution.friction_force is not None:
            friction = -np.einsum("pi,pij->pj", solution.friction_force[here], tangent_frames(direction))
        yield PairingFields(
            name="contact" if len(parts) == 1 else f"contact {number + 1}",
            body=np.zeros(part.contacts, dtype=np.int64),
            node=np.asarray(part.unknowns[:, 0] // body.dimension, dtype=np.int64),
            position=now,
            displacement=np.zeros_like(now),
            direction=direction,
            force=solution.normal_force[here],
            pressure=None,
            friction=friction,
            shear=None,
            gap=solution.gap[here],
            initial_gap=solution.gap[here],
            status=np.asarray(solution.contact_status)[here],
            on_obstacle=True,
        )
