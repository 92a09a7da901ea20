"""From a scene of elastic bodies to its contact problem, in floats: meshes, structure, supports, loads, pairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.elements import loads, solid
from contactqp.elements.facet import Surface, diameters
from contactqp.elements.material import Material
from contactqp.elements.membrane import Membrane as MembranePart
from contactqp.elements.mesh import Mesh
from contactqp.elements.mortar import OVERLAP, pair_mortar
from contactqp.elements.nodal_pressure import nodal_pressure
from contactqp.elements.node_to_segment import pair_node_to_segment
from contactqp.elements.pairing import Pairing, pair, pair_scalar
from contactqp.elements.solid import stress_at_nodes
from contactqp.elements.structure import Part, Structure, System
from contactqp.elements.structure import Support as Held
from contactqp.errors import InvalidProblem
from contactqp.linalg.stages import BUILD, stage
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem, Units
from contactqp.model.solution import Solution
from contactqp.scene.body_loads import at_key, loads_of, supports_of
from contactqp.scene.contact_entries import ContactEntries, PairedContact
from contactqp.scene.corners import Factors, end_time, factors_at, has_corners
from contactqp.scene.meshing import body_mesh, nearest_node
from contactqp.scene.obstacles import height_of, obstacle
from contactqp.scene.units import number

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData
    from contactqp.scene.schema_bodies import Body
    from contactqp.scene.schema_contacts import Contact


class Surfaces(Protocol):
    """Sides of bodies, numbered in one u."""

    @property
    def size(self) -> int: ...

    def surface(self, body: str, side: str) -> Surface: ...


@dataclass(frozen=True, eq=False)
class BodyModel(ContactEntries):
    """What a scene of bodies is made into, all numbers in the scene's units."""

    scene: SceneData
    structure: Structure
    system: System
    supports: tuple[Held, ...]
    loads: Mapping[str, Vector]  # on all unknowns at their full values, by their names

    @cached_property
    def problem(self) -> ContactProblem:
        """On the free unknowns."""
        with stage(BUILD):
            return self.system.problem(
                [contact.pairing for contact in self.contacts],
                friction=self.row_friction,
                units=Units(length=self.scene.units.length, force=self.scene.units.force),
                names=self.row_names,
            )

    @property
    def kept(self) -> NDArray[np.int64]:
        """Which rows of all pairings are contacts of the problem."""
        return self.system.free_contacts([contact.pairing for contact in self.contacts])

    def load_on_all(self, time: Fraction) -> Vector:
        """The load on all unknowns at a pseudo-time of the load path; without corners, a factor on all loads."""
        if not has_corners(self.scene):
            return float(time) * self.system.load
        return sum_of(self.loads, factors_at(self.scene, time), self.structure.size)

    def load_at(self, time: Fraction) -> Vector:
        """The right-hand side under that load; prescribed displacements stay."""
        return np.asarray((self.load_on_all(time) - self.structure.stiffness @ self.system.given)[self.system.free])

    def displacement(self, solution: Solution) -> Vector:
        """u of all unknowns, prescribed ones included."""
        return self.system.expand(solution.displacement)

    def node_at(self, body: str, point: ArrayLike) -> int:
        """The node of a body at a point."""
        return nearest_node(self.structure.body(body), point, f"the body {body!r}")

    def displacement_at(self, body: str, node: int, solution: Solution) -> Vector:
        """(d,) of a node of a body."""
        return np.asarray(self.structure.displacements(body, self.displacement(solution))[node])

    def stress_at(self, body: str, node: int, solution: Solution) -> Vector:
        """(6,) at a node of a body, the mean over its elements."""
        u = self.structure.displacements(body, self.displacement(solution))
        return np.asarray(stress_at_nodes(self.structure.solid(body), u.ravel())[node])

    def resultant(self, name: str, solution: Solution) -> Vector:
        """(d,) the sum of -E_N' lambda of one entry over the nodes of its body, of two bodies the slave."""
        contact = self.contacts[self.place(name)]
        forces = -(contact.pairing.normal.T @ self.normal_forces(name, solution))
        return np.asarray(self.structure.displacements(contact.body, forces).sum(axis=0))

    def ranges(self, body: str, field: Vector) -> Vector:
        """(d, 2) the lowest and the highest value of a field on all unknowns, at the nodes of a body."""
        values = self.structure.displacements(body, field)
        return np.stack([values.min(axis=0), values.max(axis=0)], axis=1)

    def free_motions(self, solution: Solution) -> NDArray[np.float64]:
        """(q, all unknowns) the directions of the solution's free motions; supports stand still."""
        return np.array([self.velocity(motion.direction) for motion in solution.free_motions])

    def largest(self, rows: NDArray[np.float64], i: int) -> tuple[Vector, int]:
        """The column of some fields (q, all unknowns) where field i is largest, and its place."""
        at = int(np.argmax(np.abs(rows[i])))
        return rows[:, at].copy(), at

    def energy(self, solution: Solution, time: Fraction) -> float:
        """1/2 u'Ku - f'u of all unknowns, prescribed ones included."""
        u = self.displacement(solution)
        return float(u @ (self.structure.stiffness @ u) / 2 - self.load_on_all(time) @ u)

    def support_force(self, support: int, solution: Solution, time: Fraction) -> float:
        """What an entry of the scene's supports does to its body, along its axis."""
        return float(self.support_forces(solution, time)[self.held_by(support)].sum())

    def velocity(self, free: Vector) -> Vector:
        """v of all unknowns from that of the free ones; supports stand still."""
        every = np.zeros(self.structure.size)
        every[self.system.free] = free
        return every

    def support_forces(self, solution: Solution, time: Fraction) -> Vector:
        """What the supports do to the bodies at each of all unknowns; 0 at free ones [force]."""
        pressed = self.system.load - self.load_on_all(time)
        for contact in self.contacts:
            pressed = pressed + contact.pairing.normal.T @ self.normal_forces(contact.name, solution)
            if solution.friction_force is not None:
                along = self.tangential(contact.name, solution.friction_force)
                pressed = pressed + contact.pairing.tangent.T @ along.ravel()
        return self.system.support_forces(self.displacement(solution), pressed)

    def held_by(self, support: int) -> NDArray[np.int64]:
        """The places in u of the unknowns that an entry of the scene's supports holds."""
        held = self.supports[support]
        body = self.structure.body(held.body)
        return self.structure.first(body.name) + len(body.axes) * loads.node_numbers(body, held.nodes) + held.axis


def body_model(scene: SceneData) -> BodyModel:
    """Meshes, structure, supports, loads and pairs of a scene.

    Raises
    ------
    SceneError
        What is no good, its key first.
    """
    bodies: list[Part] = []
    for i, body in enumerate(scene.bodies):
        with at_key(f"bodies[{i}] ({body.name!r})"):
            bodies.append(solid_body(scene, body, body_mesh(scene, body)))
    for i, membrane in enumerate(scene.membranes):
        with at_key(f"membranes[{i}] ({membrane.name!r})"):
            tension = number(scene.system, membrane.tension)
            bodies.append(MembranePart(body_mesh(scene, membrane), tension, name=membrane.name))
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


def sum_of(loads: Mapping[str, Vector], factors: Factors, size: int) -> Vector:
    """The loads times their factors."""
    return sum((float(factors.of(name)) * load for name, load in loads.items()), np.zeros(size))


def solid_body(scene: SceneData, body: Body, mesh: Mesh) -> solid.Body:
    """An elastic body of the scene on its mesh."""
    density = 0.0 if body.density is None else number(scene.system, body.density)
    material = Material(number(scene.system, body.modulus), float(body.poisson), density, name="material")
    thickness = 1.0 if body.thickness is None else number(scene.system, body.thickness)
    return solid.Body(mesh, material, body.model, thickness=thickness, name=body.name)


def sides_of(contact: Contact) -> list[tuple[str, str]]:
    """The bodies and sides of an entry of the scene's contacts."""
    return [(side.partition(".")[0], side.partition(".")[2]) for side in contact.touching_sides]


def paired_contact(scene: SceneData, whole: Surfaces, contact: Contact) -> PairedContact:
    """An entry of the scene's contacts between sides of bodies, or one side and an obstacle."""
    ends = sides_of(contact)
    surfaces = [whole.surface(*end) for end in ends]
    overlap = None if contact.overlap is None else number(scene.system, contact.overlap)
    if contact.obstacle is not None:
        found = pair(surfaces[0], obstacle(scene, contact.obstacle), dimension=whole.size)
        _refuse_overlap(found, surfaces[0], contact.obstacle, overlap)
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
    """A side may start inside an obstacle as little as inside another body, unless the case says how much."""
    allowed = OVERLAP * diameters(surface.points[surface.facets]).max() if overlap is None else overlap
    i = int(np.argmin(found.gap))
    if found.gap[i] < -allowed:
        at = ", ".join(f"{x:.6g}" for x in found.points[i])
        raise InvalidProblem(
            f"{surface.name}: node {found.nodes[i]} at ({at}) is {-found.gap[i]:.6g} inside {name!r} at the start: "
            f"expected an overlap of at most {allowed:.6g}, which the key 'overlap' can change"
        )


def _membrane_contact(scene: SceneData, whole: Structure, contact: Contact, name: str) -> PairedContact:
    """All free nodes of a membrane over an obstacle; where the obstacle has no height there is no contact."""
    membrane = whole.body(name)
    if not isinstance(membrane, MembranePart) or contact.obstacle is None:
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
