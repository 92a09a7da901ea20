"""From a scene of elastic bodies to its contact problem, in floats: meshes, structure, supports, loads, pairs.

An entry of the scene's contacts becomes many contacts of the problem, one for each paired node. `ContactEntries`
selects the forces and gaps of an entry from those of the problem.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from contactqp.elements import loads, solid
from contactqp.elements.material import Material
from contactqp.elements.mesh import Mesh
from contactqp.elements.mortar import pair_mortar
from contactqp.elements.nodal_pressure import nodal_pressure
from contactqp.elements.node_to_segment import pair_node_to_segment
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.pairing import Pairing, doubt_of_side, pair_scalar, paired
from contactqp.elements.solid import Membrane, stress_at_nodes
from contactqp.elements.structure import Part, Structure, System
from contactqp.elements.structure import Support as Held
from contactqp.elements.surface import OVERLAP, Surface, diameters
from contactqp.errors import InvalidProblem, SceneError
from contactqp.model.arrays import BUILD, Array, Index, Mask, Vector, stage
from contactqp.model.problem import ContactProblem, Units
from contactqp.model.solution import Solution
from contactqp.scene.geometry import body_mesh, height_of, nearest_node, obstacle, warn_of_start
from contactqp.scene.schema import GRAVITY, Factors, end_time, factors_at, has_corners
from contactqp.scene.units import number, vector

if TYPE_CHECKING:
    from contactqp.scene.schema import Contact, SceneData
    from contactqp.scene.schema_bodies import Body, PointLoad, Support


class ContactAnswer(Protocol):
    """The arrays of a solution that entries are selected from, for all contacts of the problem."""

    @property
    def normal_force(self) -> Vector:
        """Return lambda_N, (m,) [force]."""

    @property
    def friction_force(self) -> Array | None:
        """Return lambda_T, (m, d-1) [force]."""

    @property
    def gap(self) -> Vector:
        """Return the gaps, (m,) [length]."""

    @property
    def contact_status(self) -> Any:
        """Return the statuses, (m,)."""


@dataclass(frozen=True, eq=False)
class PairedContact:
    """One entry of the scene's contacts: many contacts in the problem, one for each paired node.

    Attributes
    ----------
    name : str
    body : the body or membrane that touches; of two bodies the slave
    pairing : Pairing
    friction : Fraction
    """

    name: str
    body: str
    pairing: Pairing
    friction: Fraction


@dataclass(frozen=True, eq=False)
class ContactEntries(ABC):
    """The entries of the scene's contacts, in their order."""

    contacts: tuple[PairedContact, ...]

    @property
    @abstractmethod
    def kept(self) -> Index:
        """Return which rows of all pairings are contacts of the problem, those with a free unknown."""

    @property
    @abstractmethod
    def given(self) -> Vector:
        """Return the prescribed displacement of every unknown in the rows, 0 for free ones."""

    @property
    def row_names(self) -> list[str]:
        """Return ``floor 12`` for each row of all pairings: its entry in the scene and its node."""
        return [f"{contact.name} {node}" for contact in self.contacts for node in contact.pairing.nodes]

    @property
    def row_friction(self) -> Vector | None:
        """Return the coefficient of each row of all pairings; None where nothing has friction."""
        each = [np.full(len(contact.pairing.gap), float(contact.friction)) for contact in self.contacts]
        friction = np.concatenate([np.zeros(0), *each])
        return friction if friction.any() else None

    @property
    def notes(self) -> list[str]:
        """Return the notes of the pairings, entry by entry."""
        return [f"{contact.name}: {note}" for contact in self.contacts for note in contact.pairing.notes]

    def place(self, name: str) -> int:
        """Return the index of an entry of the scene's contacts."""
        return [contact.name for contact in self.contacts].index(name)

    def normal_forces(self, name: str, solution: ContactAnswer) -> Vector:
        """Return lambda_N of each paired node of one entry, (p,) [force]; 0 where only supported nodes meet."""
        return self.of_entry(name, solution.normal_force, 0.0)

    def pressures(self, name: str, solution: ContactAnswer) -> Vector:
        """Return the pressure at each paired node of one entry, (p,) [force / length^2], positive in compression.

        NaN where all nodes of the contact are supported, so that its force is unknown; see `Pairing.pressure`.
        """
        forces = self.of_entry(name, solution.normal_force, np.nan)
        return self.contacts[self.place(name)].pairing.pressure(forces)

    def friction_tractions(self, name: str, solution: ContactAnswer) -> Vector:
        """Return lambda_T per area of each paired node along the axes, (p, d) [force / length^2].

        NaN where only supported nodes meet.
        """
        unknown = np.isnan(self.of_entry(name, solution.normal_force, np.nan))
        vectors = np.where(unknown[:, np.newaxis], np.nan, self.friction_vectors(name, solution))
        pairing = self.contacts[self.place(name)].pairing
        return np.column_stack([pairing.per_area(component) for component in vectors.T])

    def friction_vectors(self, name: str, solution: ContactAnswer) -> Vector:
        """Return lambda_T of each paired node of one entry along the axes, (p, d) [force].

        It acts on the obstacle or the other body.
        """
        pairing = self.contacts[self.place(name)].pairing
        frames, along = tangent_frames(pairing.direction), self.tangential(name, solution.friction_force)
        return np.asarray(np.einsum("pk,pkd->pd", along, frames))

    def closed(self, name: str, solution: ContactAnswer) -> Mask:
        """Return which paired nodes of one entry have a contact force, (p,)."""
        return self._has_status(name, solution, "closed", "stick", "slip")

    def stuck(self, name: str, solution: ContactAnswer) -> Mask:
        """Return which paired nodes of one entry have a contact force and stick, (p,)."""
        return self._has_status(name, solution, "stick")

    def _has_status(self, name: str, solution: ContactAnswer, *statuses: str) -> Mask:
        return self.of_entry(name, np.isin(solution.contact_status, statuses).astype(float), 0.0) > 0

    def gaps(self, name: str, solution: ContactAnswer) -> Vector:
        """Return the gap of each paired node of one entry, (p,), positive when open.

        Where all nodes of the contact are supported it follows from the prescribed displacements.
        """
        pairing = self.contacts[self.place(name)].pairing
        gaps = self.of_entry(name, solution.gap, np.nan)
        return np.where(np.isnan(gaps), pairing.gap - pairing.normal @ self.given, gaps)

    def tangential(self, name: str, values: Any) -> Vector:
        """Return values (m, d-1) of the problem's contacts at each paired node of one entry, (p, d-1).

        0 where only supported nodes meet, and without friction.
        """
        width = self.contacts[self.place(name)].pairing.points.shape[1] - 1
        if values is None:
            return np.zeros((len(self.contacts[self.place(name)].pairing.gap), width))
        return np.column_stack([self.of_entry(name, values[:, k], 0.0) for k in range(width)])

    def of_entry(self, name: str, values: Any, otherwise: float) -> Vector:
        """Return the values (p,) of one entry from those (m,) of the problem's contacts; `otherwise` at rows not in the
        problem.
        """
        sizes = [len(contact.pairing.gap) for contact in self.contacts]
        every = np.full(sum(sizes), otherwise)
        every[self.kept] = values
        start = sum(sizes[: self.place(name)])
        return every[start : start + sizes[self.place(name)]]


@dataclass(frozen=True, eq=False)
class BodyModel(ContactEntries):
    """The structure, supports, loads and pairs of a scene of bodies, all numbers in the scene's units."""

    scene: SceneData
    structure: Structure
    system: System
    supports: tuple[Held, ...]
    loads: Mapping[str, Vector]  # full values on all unknowns, by name

    @cached_property
    def problem(self) -> ContactProblem:
        """Return the contact problem on the free unknowns."""
        with stage(BUILD):
            return self.system.problem(
                [contact.pairing for contact in self.contacts],
                friction=self.row_friction,
                units=Units(length=self.scene.units.length, force=self.scene.units.force),
                names=self.row_names,
            )

    @property
    def kept(self) -> Index:
        """Return which rows of all pairings are contacts of the problem."""
        return self.system.free_contacts([contact.pairing for contact in self.contacts])

    @property
    def given(self) -> Vector:
        """Return the displacements that supports prescribe (n,), 0 at free unknowns."""
        return self.system.given

    def load_on_all(self, time: Fraction) -> Vector:
        """Return the load on all unknowns at a pseudo-time of the load path; without corners, a factor on all loads."""
        if not has_corners(self.scene):
            return float(time) * self.system.load
        return sum_of(self.loads, factors_at(self.scene, time), self.structure.size)

    def load_at(self, time: Fraction) -> Vector:
        """Return the right-hand side under that load; prescribed displacements stay."""
        return np.asarray((self.load_on_all(time) - self.structure.stiffness @ self.system.given)[self.system.free])

    def displacement(self, solution: Solution) -> Vector:
        """Return u of all unknowns, prescribed ones included."""
        return self.system.expand(solution.displacement)

    def node_at(self, body: str, point: ArrayLike) -> int:
        """Return the node of a body at a point."""
        return nearest_node(self.structure.body(body), point, f"the body {body!r}")

    def displacement_at(self, body: str, node: int, solution: Solution) -> Vector:
        """Return the displacement of a node of a body, (d,) [length]."""
        return np.asarray(self.structure.displacements(body, self.displacement(solution))[node])

    def stress_at(self, body: str, node: int, solution: Solution) -> Vector:
        """Return the stress at a node of a body, (6,), the mean over its elements."""
        u = self.structure.displacements(body, self.displacement(solution))
        return np.asarray(stress_at_nodes(self.structure.solid(body), u.ravel())[node])

    def resultant(self, name: str, solution: Solution) -> Vector:
        """Return the sum of -E_N' lambda of one entry over the nodes of its body, of two bodies the slave, (d,)."""
        contact = self.contacts[self.place(name)]
        forces = -(contact.pairing.normal.T @ self.normal_forces(name, solution))
        return np.asarray(self.structure.displacements(contact.body, forces).sum(axis=0))

    def ranges(self, body: str, field: Vector) -> Vector:
        """Return the lowest and the highest value of a field on all unknowns, at the nodes of a body, (d, 2)."""
        values = self.structure.displacements(body, field)
        return np.stack([values.min(axis=0), values.max(axis=0)], axis=1)

    def free_motions(self, solution: Solution) -> Array:
        """Return the directions of the solution's free motions, (q, all unknowns); supports stand still."""
        return np.array([self.velocity(motion.direction) for motion in solution.free_motions])

    def largest(self, rows: Array, i: int) -> tuple[Vector, int]:
        """Return the column of `rows` (q, all unknowns) in which row i is largest, and its index."""
        at = int(np.argmax(np.abs(rows[i])))
        return rows[:, at].copy(), at

    def energy(self, solution: Solution, time: Fraction) -> float:
        """Return 1/2 u'Ku - f'u of all unknowns, prescribed ones included."""
        u = self.displacement(solution)
        return float(u @ (self.structure.stiffness @ u) / 2 - self.load_on_all(time) @ u)

    def support_force(self, support: int, solution: Solution, time: Fraction) -> float:
        """Return the force of an entry of the scene's supports on its body, along its axis [force]."""
        return float(self.support_forces(solution, time)[self.held_by(support)].sum())

    def velocity(self, free: Vector) -> Vector:
        """Return v of all unknowns from that of the free ones; supports stand still."""
        every = np.zeros(self.structure.size)
        every[self.system.free] = free
        return every

    def support_forces(self, solution: Solution, time: Fraction) -> Vector:
        """Return the support forces on the bodies at all unknowns, 0 at free ones [force]."""
        pressed = self.system.load - self.load_on_all(time)
        for contact in self.contacts:
            pressed = pressed + contact.pairing.normal.T @ self.normal_forces(contact.name, solution)
            if solution.friction_force is not None:
                along = self.tangential(contact.name, solution.friction_force)
                pressed = pressed + contact.pairing.tangent.T @ along.ravel()
        return self.system.support_forces(self.displacement(solution), pressed)

    def held_by(self, support: int) -> Index:
        """Return the indices of the unknowns that an entry of the scene's supports fixes."""
        entry = self.supports[support]
        body = self.structure.body(entry.body)
        nodes = loads.node_numbers(body, entry.nodes)
        return self.structure.first(body.name) + len(body.axes) * nodes + int(entry.axis)


def body_model(scene: SceneData) -> BodyModel:
    """Return the meshes, structure, supports, loads and pairs of a scene.

    Raises
    ------
    SceneError
        An invalid part of the scene; the message begins with its key.
    """
    bodies: list[Part] = []
    for i, body in enumerate(scene.bodies):
        with at_key(f"bodies[{i}] ({body.name!r})"):
            bodies.append(solid_body(scene, body, body_mesh(scene, body)))
    for i, membrane in enumerate(scene.membranes):
        with at_key(f"membranes[{i}] ({membrane.name!r})"):
            tension = number(scene.system, membrane.tension)
            bodies.append(Membrane(body_mesh(scene, membrane), tension, name=membrane.name))
    with at_key("bodies"):
        whole = Structure(bodies)
    acting = list(loads_of(scene, whole))
    supports = list(supports_of(scene, whole))
    with at_key("supports"):
        system = whole.assemble(supports, [load for _, load in acting])
    by_name: dict[str, Vector] = {}
    if has_corners(scene):
        for name, _ in acting:
            by_name[name] = whole.assemble((), [load for other, load in acting if other == name]).load
        system = replace(system, load=sum_of(by_name, factors_at(scene, end_time(scene)), whole.size))
    contacts = []
    for i, contact in enumerate(scene.contacts):
        with at_key(f"contacts[{i}] ({contact.name!r})"):
            if contact.membrane is not None:
                contacts.append(_membrane_contact(scene, whole, contact, contact.membrane))
            else:
                contacts.append(paired_contact(scene, whole, contact))
    return BodyModel(tuple(contacts), scene, whole, system, tuple(supports), by_name)


def solid_body(scene: SceneData, body: Body, mesh: Mesh) -> solid.Body:
    """Return an elastic body of the scene on its mesh."""
    density = 0.0 if body.density is None else number(scene.system, body.density)
    material = Material(number(scene.system, body.modulus), float(body.poisson), density, name="material")
    thickness = 1.0 if body.thickness is None else number(scene.system, body.thickness)
    return solid.Body(mesh, material, body.model, thickness=thickness, name=body.name)


def sum_of(loads: Mapping[str, Vector], factors: Factors, size: int) -> Vector:
    """Return the sum of the loads times their factors, (size,) [force]."""
    return sum((float(factors.of(name)) * load for name, load in loads.items()), np.zeros(size))


# A function from a body, a point and a name for messages to the index of the node at that point.
NodeAt = Callable[[Part, ArrayLike, str], int]


@contextmanager
def at_key(where: str) -> Iterator[None]:
    """Turn errors of the elements into SceneError with the key of the entry."""
    try:
        yield
    except InvalidProblem as error:
        raise SceneError(f"{where}: {error}") from None


def _nodes(scene: SceneData, whole: Structure, place: Support | PointLoad, node_at: NodeAt) -> str | int:
    if place.near is None:
        whole.body(place.body).mesh.nodes(place.nodes)
        return place.nodes
    return node_at(whole.body(place.body), vector(scene.system, place.near), f"the body {place.body!r}")


def supports_of(scene: SceneData, whole: Structure, node_at: NodeAt = nearest_node) -> Iterator[Held]:
    """Yield the supports of a scene in the structure's form."""
    for i, support in enumerate(scene.supports):
        with at_key(f"supports[{i}] ({support.name!r})"):
            nodes = _nodes(scene, whole, support, node_at)
        value = 0.0 if support.value is None else number(scene.system, support.value)
        yield Held(support.body, nodes, whole.body(support.body).axes.index(support.axis), value)


def loads_of(scene: SceneData, whole: Structure, node_at: NodeAt = nearest_node) -> Iterator[tuple[str, loads.Load]]:
    """Yield every load with its name; the weight of bodies is called "gravity"."""
    for i, traction in enumerate(scene.tractions):
        with at_key(f"tractions[{i}] ({traction.name!r})"):
            whole.body(traction.body).mesh.side(traction.nodes)
        yield traction.name, loads.Traction(traction.body, traction.nodes, vector(scene.system, traction.value))
    for i, pressure in enumerate(scene.pressures):
        with at_key(f"pressures[{i}] ({pressure.name!r})"):
            whole.body(pressure.body).mesh.side(pressure.nodes)
        yield pressure.name, loads.Pressure(pressure.body, pressure.nodes, number(scene.system, pressure.value))
    for i, point_load in enumerate(scene.point_loads):
        with at_key(f"point_loads[{i}] ({point_load.name!r})"):
            nodes = _nodes(scene, whole, point_load, node_at)
        yield point_load.name, loads.PointLoad(point_load.body, nodes, vector(scene.system, point_load.force))
    if scene.gravity is not None:
        for body in scene.bodies:
            if body.density is not None and body.density.si > 0:
                acceleration = vector(scene.system, scene.gravity)
                if scene.motion is None:
                    yield GRAVITY, loads.Gravity(body.name, acceleration)
                else:
                    yield GRAVITY, loads.Weight(body.name, acceleration, scene.motion.mass == "lumped")


class Surfaces(Protocol):
    """A structure that gives the sides of its bodies, with unknowns numbered in one vector u."""

    @property
    def size(self) -> int:
        """Return the number of unknowns."""

    def surface(self, body: str, side: str) -> Surface:
        """Return a side of a body."""


def sides_of(contact: Contact) -> list[tuple[str, str]]:
    """Return the bodies and sides of an entry of the scene's contacts."""
    return [(side.partition(".")[0], side.partition(".")[2]) for side in contact.touching_sides]


def paired_contact(scene: SceneData, whole: Surfaces, contact: Contact) -> PairedContact:
    """Return the pairing of an entry of the scene's contacts: two sides of bodies, or one side and an obstacle."""
    ends = sides_of(contact)
    surfaces = [whole.surface(*end) for end in ends]
    overlap = None if contact.overlap is None else number(scene.system, contact.overlap)
    if contact.obstacle is not None:
        touched = obstacle(scene, contact.obstacle)
        found = paired(surfaces[0], touched, dimension=whole.size)
        _refuse_overlap(found, surfaces[0], contact.obstacle, overlap)
        doubt = doubt_of_side(surfaces[0], found.gap, found.direction, repr(contact.obstacle), scene.units.length)
        warn_of_start(scene, scene.contacts.index(contact), doubt)
    else:
        method = pair_mortar if contact.pairing == "mortar" else pair_node_to_segment
        reach = None if contact.reach is None else number(scene.system, contact.reach)
        found = method(*surfaces, reach=reach, overlap=overlap, dimension=whole.size)
    if not len(found.gap):
        raise InvalidProblem(
            f"expected sides that may touch, got no node of {surfaces[0].name} with a partner in reach"
        )
    return PairedContact(contact.name, ends[0][0], found, contact.friction or Fraction(0))


def _refuse_overlap(found: Pairing, surface: Surface, name: str, overlap: float | None) -> None:
    """Refuse a side that initially overlaps its obstacle or partner by more than the case states."""
    allowed = OVERLAP * diameters(surface.points[surface.facets]).max() if overlap is None else overlap
    i = int(np.argmin(found.gap))
    if found.gap[i] < -allowed:
        at = ", ".join(f"{x:.6g}" for x in found.points[i])
        raise InvalidProblem(
            f"{surface.name}: node {found.nodes[i]} at ({at}) is {-found.gap[i]:.6g} inside {name!r} at the start: "
            f"expected an overlap of at most {allowed:.6g}, which the key 'overlap' can change"
        )


def _membrane_contact(scene: SceneData, whole: Structure, contact: Contact, name: str) -> PairedContact:
    """Pair all free nodes of a membrane with an obstacle, except where the obstacle has no height."""
    membrane = whole.body(name)
    if not isinstance(membrane, Membrane) or contact.obstacle is None:
        raise InvalidProblem(f"expected a membrane and an obstacle, got {name!r} and {contact.obstacle!r}")
    heights = height_of(obstacle(scene, contact.obstacle), contact.obstacle, membrane.mesh.points)
    if not np.isfinite(heights).any():
        raise InvalidProblem(f"expected an obstacle below the membrane, got {contact.obstacle!r} beside it")
    unknowns = whole.first(name) + np.arange(membrane.size)
    found = pair_scalar(membrane.mesh.points, heights, unknowns=unknowns, dimension=whole.size)
    up = np.tile([0.0, 0.0, 1.0], (len(found.nodes), 1))
    found = replace(
        found,
        points=membrane.points[found.nodes],
        direction=up,
        area=membrane.areas()[found.nodes],
        projection=nodal_pressure(membrane.surface, found.nodes),
    )
    return PairedContact(contact.name, name, found, Fraction(0))
