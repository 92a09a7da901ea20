"""Model a scene of elastic bodies of which each rank has a piece, with the quantities that claims evaluate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, partial
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.analysis.history import Energies, History
from contactqp.distributed.mesh_nodes import ContactSurfaces, gather_surfaces, number_nodes
from contactqp.distributed.mesh_system import PieceSystem, prescribed_displacements
from contactqp.distributed.partition_mesh import FileSource, LatticeSource, MeshPiece, Source, partition_meshes
from contactqp.distributed.problem import DistributedProblem, DistributedSolution
from contactqp.distributed.ranks import Ranks
from contactqp.elements.loads import node_numbers
from contactqp.elements.pairing import Pairing
from contactqp.elements.reference_elements import Block
from contactqp.elements.solid import stress_sums
from contactqp.elements.structure import FreeContacts, Part, Structure, Support, free_contacts
from contactqp.errors import Unsupported
from contactqp.model.arrays import BUILD, Array, Index, Vector, stage
from contactqp.model.problem import Units
from contactqp.scene.body_model import (
    ContactEntries,
    at_key,
    loads_of,
    paired_contact,
    sides_of,
    solid_body,
    sum_of,
    supports_of,
)
from contactqp.scene.geometry import lattice_of_shape, mesh_of_file, near_enough, nearest_to
from contactqp.scene.schema import end_time, factors_at, has_corners

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData
    from contactqp.scene.schema_bodies import Body


@dataclass(frozen=True, eq=False)
class DistributedBodyModel(ContactEntries):
    """The model of a scene of bodies on several ranks; the contacts are the same on all of them.

    Attributes
    ----------
    contacts : tuple of PairedContact, the contacts, with rows over the unknowns of `surfaces`
    scene : Scene, the scene
    ranks : the processes
    system : the pieces of this rank with their supports
    surfaces : the surfaces that may touch
    supports : tuple of Support, the supports of the scene
    load : (k d,) array, the load on own unknowns at full value, or at the end of the load path [force]
    loads : mapping of name to (k d,) array
        Each load separately, if a load path applies them one after another [force].
    """

    scene: SceneData
    ranks: Ranks
    system: PieceSystem
    surfaces: ContactSurfaces
    supports: tuple[Support, ...]
    load: Vector
    loads: Mapping[str, Vector]

    @property
    def structure(self) -> Structure:
        """Return the structure of this rank's pieces."""
        return self.system.structure

    @cached_property
    def problem(self) -> DistributedProblem:
        """Return the contact problem on the free unknowns; the first call is collective."""
        nodes = np.concatenate([np.zeros(0, dtype=np.int64), *[self._slaves(c.body, c.pairing) for c in self.contacts]])
        with stage(BUILD):
            return self.system.problem(
                self.load,
                self.surfaces,
                self.free_contacts,
                nodes[self.kept],
                units=Units(length=self.scene.units.length, force=self.scene.units.force),
            )

    def _slaves(self, body: str, pairing: Pairing) -> Index:
        """Return the indices in `surfaces` of the nodes of a pairing."""
        found = np.searchsorted(self.surfaces.numbers, self.surfaces.first(body) + pairing.nodes)
        return np.asarray(found, dtype=np.int64)

    @cached_property
    def free_contacts(self) -> FreeContacts:
        """Return the contacts that a free unknown moves, the same on all ranks; the first call is collective."""
        pairings = [contact.pairing for contact in self.contacts]
        return free_contacts(pairings, self._prescribed, friction=self.row_friction, names=self.row_names)

    @cached_property
    def _prescribed(self) -> Vector:
        """Return the prescribed displacements of the unknowns of the surfaces, NaN at free ones; the first call is
        collective.
        """
        d = self.system.dimension
        return np.asarray(self.surfaces.gathered(self.system.nodes, self.system.prescribed.reshape(-1, d)).ravel())

    @property
    def given(self) -> Vector:
        """Return the prescribed displacements of the unknowns of the surfaces, 0 at free ones."""
        return np.where(np.isnan(self._prescribed), 0.0, self._prescribed)

    @property
    def kept(self) -> Index:
        """Return the rows of all pairings that are contacts of the problem."""
        return self.free_contacts.kept

    def load_on_all(self, time: Fraction) -> Vector:
        """Return the load (k d,) on own unknowns, including constrained ones, at a pseudo-time of the load path
        [force].
        """
        if not has_corners(self.scene):
            return float(time) * self.load
        return sum_of(self.loads, factors_at(self.scene, time), len(self.load))

    def load_at(self, time: Fraction) -> Vector:
        """Return the right-hand side (n_here,) under that load and full prescribed displacements; the first call is
        collective.
        """
        return self.system.right_side(self.load_on_all(time))

    def displacement(self, solution: DistributedSolution) -> Vector:
        """Return the displacements (k d,) of own unknowns, prescribed ones included [length]."""
        return solution.answer.displacement + self.system.support_displacement

    def velocity(self, _: Vector) -> Vector:
        """Raise Unsupported: motions are computed in one process only."""
        raise Unsupported("motions: expected elastic bodies at rest on many ranks")

    def node_at(self, body: str, point: ArrayLike) -> int:
        """Return the number of the node of a body at a point. Collective."""
        return node_at(self.ranks, self.structure.body(body), point, f"the body {body!r}")

    def displacement_at(self, body: str, node: int, solution: DistributedSolution) -> Vector:
        """Return the displacement (d,) of a node of a body [length]. Collective."""
        d = self.system.dimension
        mine = self.system.own_nodes(body, node)
        return np.asarray(self.ranks.sum(self.displacement(solution).reshape(-1, d)[mine].sum(axis=0)))

    def stress_at(self, body: str, node: int, solution: DistributedSolution) -> Vector:
        """Return the stress (6,) at a node of a body, the mean over its elements on all ranks. Collective."""
        d, part = self.system.dimension, self.structure.solid(body)
        every = self.system.nodes.with_ghosts(self.displacement(solution).reshape(-1, d)).ravel()
        total, count = np.zeros(6), 0.0
        for place in np.flatnonzero(node_numbers_of(part) == node):
            around = [Block(b.kind, b.nodes[(b.nodes == place).any(axis=1)]) for b in part.mesh.blocks]
            sums, counts = stress_sums(
                part, self.structure.displacements(body, every).ravel(), [b for b in around if len(b)]
            )
            total, count = sums[place], float(counts[place, 0])
        return np.asarray(self.ranks.sum(total) / self.ranks.sum(count))

    def resultant(self, name: str, solution: DistributedSolution) -> Vector:
        """Return the sum (d,) of -E_N' lambda of one contact over the nodes of its body, the slave of two [force]."""
        contact = self.contacts[self.place(name)]
        forces = -(contact.pairing.normal.T @ self.normal_forces(name, solution))
        return np.asarray(forces.reshape(self.surfaces.points.shape)[self.surfaces.of_body(contact.body)].sum(axis=0))

    def ranges(self, body: str, field: Vector) -> Vector:
        """Return the lowest and highest values (d, 2) of a field on own unknowns at a body's nodes. Collective."""
        values = field.reshape(-1, self.system.dimension)[self.system.own_nodes(body)]
        low, high = (self.ranks.max(np.max(sign * values, axis=0, initial=-np.inf)) for sign in (-1, 1))
        return np.stack([-low, high], axis=1)

    def free_motions(self, solution: DistributedSolution) -> Array:
        """Return the free motions (q, k d) of the solution on own unknowns, zero at supports."""
        return solution.motions.T.copy()

    def largest(self, rows: Array, i: int) -> tuple[Vector, int]:
        """Return the column (q,) of fields (q, k d) where field i is largest on any rank, and its number."""
        found = (0.0, -1, np.zeros(len(rows)))
        if rows.shape[1]:
            size = np.abs(rows[i])
            at = int(np.argmax(size))
            found = (-float(size[at]), int(self.problem.dof_number[at]), rows[:, at].copy())
        _, place, column = min(self.ranks.comm.allgather(found), key=lambda one: one[:2])
        return column, place

    def energy(self, solution: DistributedSolution, time: Fraction) -> float:
        """Return 1/2 u'Ku - f'u of all unknowns, prescribed ones included [force * length]. Collective."""
        u, supports = solution.answer.displacement, self.system.support_displacement
        force = self.system.parts.support_product
        elastic = u @ self.problem.product(u) / 2 + u @ force + supports @ force / 2
        return float(self.ranks.sum(float(elastic - self.load_on_all(time) @ (u + supports))))

    def support_force(self, support: int, solution: DistributedSolution, time: Fraction) -> float:
        """Return the force of a support of the scene on its body, along its axis [force]. Collective."""
        residual = self.system.constrained_product(self.displacement(solution)) - self.load_on_all(time)
        pressed = np.zeros(self.surfaces.size)
        for contact in self.contacts:
            pressed += contact.pairing.normal.T @ self.normal_forces(contact.name, solution)
            if solution.friction_force is not None:
                pressed += contact.pairing.tangent.T @ self.tangential(contact.name, solution.friction_force).ravel()
        d, mine = self.system.dimension, self.surfaces.owners == self.ranks.rank
        at = self.surfaces.place[mine] - self.system.nodes.first
        residual.reshape(-1, d)[at] += pressed.reshape(-1, d)[mine]
        stated = self.supports[support]
        nodes = node_numbers(self.structure.solid(stated.body), stated.nodes)
        places = self.system.own_places(stated.body, nodes)
        return float(self.ranks.sum(float(residual.reshape(-1, d)[places, int(stated.axis)].sum())))


def node_at(ranks: Ranks, body: Part, point: ArrayLike, what: str) -> int:
    """Return the number of the node of a body at a point on any rank, like `nearest_node`. Collective.

    Parameters
    ----------
    ranks : the processes
    body : this rank's piece of the body
    point : (d,) array, the point [length]
    what : the name of the body in messages
    """
    numbers, found = node_numbers_of(body), None
    if body.mesh.elements:
        here = nearest_to(body, point)
        found = replace(here, node=int(numbers[here.node]))
    every = [one for one in ranks.comm.allgather(found) if one is not None]
    best = min(every, key=lambda one: (one.apart, one.node))
    smallest = min(one.smallest for one in every if one.node == best.node)
    return near_enough(replace(best, smallest=smallest), what)


def node_numbers_of(body: Part) -> Index:
    """Return the number in the whole mesh of each node of a piece."""
    assert isinstance(body.mesh, MeshPiece)  # the bodies of a DistributedBodyModel are pieces
    return body.mesh.numbers


def distributed_model(scene: SceneData, ranks: Ranks) -> DistributedBodyModel:
    """Make the model of a scene of bodies: pieces of meshes, supports, loads and contacts. Collective.

    Shapes are made slab by slab. A mesh file is read by rank 0, which holds the whole mesh temporarily.

    Raises SceneError: the scene is invalid; the message begins with the key and is the same on all ranks; Unsupported:
    membranes, motions, large deformations, a scene without bodies.
    """
    features = {
        "membranes": scene.membranes,
        "motions": scene.motion,
        "large motions": scene.large,
        "a scene without bodies": not scene.bodies,
    }
    if found := [name for name, present in features.items() if present]:
        raise Unsupported(
            f"{found[0]}: expected elastic bodies at rest for pieces on many ranks; engine='serial' takes them"
        )
    with stage(BUILD):
        return _model(scene, ranks)


def _model(scene: SceneData, ranks: Ranks) -> DistributedBodyModel:
    sources: list[Source] = []
    for i, body in enumerate(scene.bodies):
        with at_key(f"bodies[{i}] ({body.name!r})"):
            sources.append(_source(scene, ranks, body))
    with at_key("bodies"):
        meshes = partition_meshes(ranks, sources)
        nodes = number_nodes(ranks, meshes)
    pieces: list[Part] = []
    for i, (body, mesh) in enumerate(zip(scene.bodies, meshes, strict=True)):
        with at_key(f"bodies[{i}] ({body.name!r})"), ranks.raising_together():
            pieces.append(solid_body(scene, body, mesh))
    with at_key("bodies"):
        structure = Structure(pieces)
    at = partial(node_at, ranks)
    acting = list(loads_of(scene, structure, at))
    supports = tuple(supports_of(scene, structure, at))
    with at_key("supports"):
        system = PieceSystem(structure, nodes, prescribed_displacements(structure, nodes, supports))
    names = dict.fromkeys(name for name, _ in acting)
    by_name = {name: system.forces([load for other, load in acting if other == name]) for name in names}
    load = sum((part for part in by_name.values()), np.zeros(len(system.prescribed)))
    if has_corners(scene):
        load = sum_of(by_name, factors_at(scene, end_time(scene)), len(load))
    sides = []
    for i, contact in enumerate(scene.contacts):
        with at_key(f"contacts[{i}] ({contact.name!r})"):
            for body_name, side in sides_of(contact):
                structure.solid(body_name).mesh.side(side)
                sides.append((body_name, side))
    with at_key("contacts"):
        surfaces = gather_surfaces(structure, nodes, sides)
    contacts = []
    for i, contact in enumerate(scene.contacts):
        with at_key(f"contacts[{i}] ({contact.name!r})"):
            found = paired_contact(scene, surfaces, contact)
            contacts.append(replace(found, pairing=surfaces.named(found.body, found.pairing)))
    return DistributedBodyModel(
        tuple(contacts), scene, ranks, system, surfaces, supports, load, by_name if has_corners(scene) else {}
    )


def _source(scene: SceneData, ranks: Ranks, body: Body) -> Source:
    if body.shape is not None:
        return LatticeSource(ranks, lattice_of_shape(scene, body.shape))
    assert body.mesh is not None  # exactly one of both is given
    return FileSource(ranks, partial(mesh_of_file, scene, body.mesh))


@dataclass(frozen=True, eq=False)
class ProblemInPieces:
    """The problem of a distributed solution for tables and claims, with unknowns and contacts numbered as in one
    process.

    Properties that are gathered are collective at the first call.
    """

    part: DistributedProblem = field(repr=False)
    contact_names: tuple[str, ...] = field(repr=False)
    frictional: bool

    def contact_name(self, i: int) -> str:
        """Return the name of a contact by its number in one process."""
        return self.contact_names[i]

    def dof_name(self, j: int) -> str:
        """Return the name of an unknown by its number in one process."""
        return self.dof_names[j]

    @property
    def units(self) -> Units:
        """Return the units of the scene."""
        return self.part.units

    @property
    def contacts(self) -> int:
        """Return the number m of contacts on all ranks."""
        return len(self.contact_names)

    @property
    def tangent(self) -> None:
        """Return None, since these paths have no friction; pictures of paths need the property."""
        return None

    @cached_property
    def normal(self) -> Any:
        """Return E_N (m, n) in the numbers of one process, gathered on every rank."""
        part, rows = self.part, self.part.normal.entries.tocoo()
        column = part.normal.at_touched(part.dof_number.astype(float)).astype(np.int64)[rows.col]
        free, gathered = column >= 0, part.ranks.gathered
        places = gathered(part.contact_number[rows.row][free]), gathered(column[free])
        return sp.csr_matrix((gathered(rows.data[free]), places), shape=(self.contacts, part.dimension))

    @cached_property
    def load(self) -> Array:
        """Return the load (n,), gathered on every rank [force]."""
        return self.part.gathered(self.part.load, self.part.dof_number)

    @cached_property
    def dof_names(self) -> tuple[str, ...]:
        """Return the names (n,) of all unknowns, gathered on every rank."""
        here = np.array([self.part.dof_name(i) for i in range(len(self.part.dof_number))], dtype=np.str_)
        return tuple(map(str, self.part.gathered(here, self.part.dof_number)))


@dataclass(frozen=True, eq=False)
class SolutionInPieces:
    """A distributed solution with the interface of `contactqp.Solution`, whose arrays are gathered when they are
    used.
    """

    found: DistributedSolution
    problem: ProblemInPieces

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the distributed solution."""
        return getattr(self.found, name)


def in_pieces(model: DistributedBodyModel, solutions: Sequence[DistributedSolution]) -> list[SolutionInPieces]:
    """Return the solutions with the names of the scene."""
    names, frictional = np.array(model.row_names, dtype=np.str_)[model.kept], model.problem.frictional
    contact_names = tuple(map(str, names))
    return [SolutionInPieces(one, ProblemInPieces(one.problem, contact_names, frictional)) for one in solutions]


def energies(solutions: Sequence[DistributedSolution]) -> Iterator[Energies]:
    """Yield the elastic energy and the loads' work along a path without friction, as `History.energies` does."""
    work = 0.0
    for before, now in pairwise(chain(solutions[:1], solutions)):
        u, dot = now.answer.displacement, now.problem.ranks.dot
        work += dot(before.problem.load + now.problem.load, u - before.answer.displacement) / 2
        yield Energies(dot(u, now.problem.product(u)) / 2, kinetic=0.0, work=work, dissipated=0.0)


def gather(history: History) -> None:
    """Gather the fields of a history that pictures and files use on every rank, so that one rank can write them."""
    for solution in history:
        for name in ("displacement", "normal_force", "friction_force", "tie_force", "gap", "contact_status", "energy"):
            getattr(solution, name)
        for name in ("load", "dof_names", "normal"):
            getattr(solution.problem, name)
    for name in ("events", "energies"):
        getattr(history, name)
