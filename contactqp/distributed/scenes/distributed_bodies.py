"""A scene of elastic bodies of which each rank has a piece, and what its claims ask of an answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.distributed.pieces.mesh_piece import MeshPiece
from contactqp.distributed.pieces.system import PieceSystem
from contactqp.distributed.pieces.touching import Touching
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks
from contactqp.elements.geometry import Block
from contactqp.elements.loads import node_numbers
from contactqp.elements.pairing import Pairing
from contactqp.elements.solid import stress_sums
from contactqp.elements.structure import FreeContacts, Part, Structure, free_contacts
from contactqp.elements.structure import Support as Held
from contactqp.errors import Unsupported
from contactqp.linalg.stages import BUILD, stage
from contactqp.model.arrays import Vector
from contactqp.model.problem import Units
from contactqp.scene.bodies import sum_of
from contactqp.scene.contact_entries import ContactEntries
from contactqp.scene.corners import factors_at, has_corners
from contactqp.scene.meshing import near_enough, nearest_to

if TYPE_CHECKING:
    from contactqp.distributed.solution import DistributedSolution
    from contactqp.scene.schema import SceneData


@dataclass(frozen=True, eq=False)
class DistributedBodyModel(ContactEntries):
    """What a scene of bodies is made into on many ranks; the contacts are the same on all of them.

    Attributes
    ----------
    contacts : tuple of PairedContact
        Their rows are over the unknowns of `touching`.
    scene : Scene
    ranks : Ranks
    system : PieceSystem
    touching : Touching
    supports : tuple of Support
    load : (k d,) array
        On own unknowns at full value, or at the end of the load path [force].
    loads : mapping of name to (k d,) array
        Each by itself, where they come one by one.
    """

    scene: SceneData
    ranks: Ranks
    system: PieceSystem
    touching: Touching
    supports: tuple[Held, ...]
    load: Vector
    loads: Mapping[str, Vector]

    @property
    def structure(self) -> Structure:
        """The pieces of this rank."""
        return self.system.structure

    @cached_property
    def problem(self) -> DistributedProblem:
        """On the free unknowns, first asked collectively."""
        nodes = np.concatenate([np.zeros(0, dtype=np.int64), *[self._slaves(c.body, c.pairing) for c in self.contacts]])
        with stage(BUILD):
            return self.system.problem(
                self.load,
                self.touching,
                self.free_contacts,
                nodes[self.kept],
                units=Units(length=self.scene.units.length, force=self.scene.units.force),
            )

    def _slaves(self, body: str, pairing: Pairing) -> NDArray[np.int64]:
        """The places in `touching` of the nodes of a pairing."""
        found = np.searchsorted(self.touching.numbers, self.touching.first(body) + pairing.nodes)
        return np.asarray(found, dtype=np.int64)

    @cached_property
    def free_contacts(self) -> FreeContacts:
        """The contacts that a free unknown moves, the same on all ranks; first asked collectively."""
        d = self.system.dimension
        prescribed = self.touching.gathered(self.system.nodes, self.system.prescribed.reshape(-1, d)).ravel()
        pairings = [contact.pairing for contact in self.contacts]
        return free_contacts(pairings, prescribed, friction=self.row_friction, names=self.row_names)

    @property
    def kept(self) -> NDArray[np.int64]:
        """Which rows of all pairings are contacts of the problem."""
        return self.free_contacts.kept

    def load_on_all(self, time: Fraction) -> Vector:
        """The load on own unknowns, held ones too, at a pseudo-time of the load path."""
        if not has_corners(self.scene):
            return float(time) * self.load
        return sum_of(self.loads, factors_at(self.scene, time), len(self.load))

    def load_at(self, time: Fraction) -> Vector:
        """The right-hand side (n_here,) under that load; prescribed displacements stay. First asked collectively."""
        return self.system.right_side(self.load_on_all(time))

    def displacement(self, solution: DistributedSolution) -> Vector:
        """(k d,) u of own unknowns, prescribed ones included."""
        return solution.answer.displacement + self.system.given

    def velocity(self, _: Vector) -> Vector:
        """Motions are followed by one process."""
        raise Unsupported("motions: expected elastic bodies at rest on many ranks")

    def node_at(self, body: str, point: ArrayLike) -> int:
        """The number of the node of a body at a point. Collective."""
        return node_at(self.ranks, self.structure.body(body), point, f"the body {body!r}")

    def displacement_at(self, body: str, node: int, solution: DistributedSolution) -> Vector:
        """(d,) of a node of a body. Collective."""
        d = self.system.dimension
        mine = self.system.own_nodes(body, node)
        return np.asarray(self.ranks.sum(self.displacement(solution).reshape(-1, d)[mine].sum(axis=0)))

    def stress_at(self, body: str, node: int, solution: DistributedSolution) -> Vector:
        """(6,) at a node of a body, the mean over the elements of all ranks that have it. Collective."""
        d, part = self.system.dimension, self.structure.solid(body)
        every = self.system.nodes.spread(self.displacement(solution).reshape(-1, d)).ravel()
        total, count = np.zeros(6), 0.0
        for place in np.flatnonzero(node_numbers_of(part) == node):
            around = [Block(b.kind, b.nodes[(b.nodes == place).any(axis=1)]) for b in part.mesh.blocks]
            sums, counts = stress_sums(
                part, self.structure.displacements(body, every).ravel(), [b for b in around if len(b)]
            )
            total, count = sums[place], float(counts[place, 0])
        return np.asarray(self.ranks.sum(total) / self.ranks.sum(count))

    def resultant(self, name: str, solution: DistributedSolution) -> Vector:
        """(d,) the sum of -E_N' lambda of one entry over the nodes of its body, of two bodies the slave."""
        contact = self.contacts[self.place(name)]
        forces = -(contact.pairing.normal.T @ self.normal_forces(name, solution))
        return np.asarray(forces.reshape(self.touching.points.shape)[self.touching.of_body(contact.body)].sum(axis=0))

    def ranges(self, body: str, field: Vector) -> Vector:
        """(d, 2) the lowest and the highest value of a field on own unknowns, at the nodes of a body. Collective."""
        values = field.reshape(-1, self.system.dimension)[self.system.own_nodes(body)]
        low, high = (self.ranks.max(np.max(sign * values, axis=0, initial=-np.inf)) for sign in (-1, 1))
        return np.stack([-low, high], axis=1)

    def free_motions(self, solution: DistributedSolution) -> NDArray[np.float64]:
        """(q, k d) the directions of the solution's free motions on own unknowns; supports stand still."""
        return solution.motions.T.copy()

    def largest(self, rows: NDArray[np.float64], i: int) -> tuple[Vector, int]:
        """The column of some fields (q, k d) where field i is largest on any rank, and its place. Collective."""
        found = (0.0, -1, np.zeros(len(rows)))
        if rows.shape[1]:
            size = np.abs(rows[i])
            at = int(np.argmax(size))
            found = (-float(size[at]), int(self.problem.dof_number[at]), rows[:, at].copy())
        _, place, column = min(self.ranks.comm.allgather(found), key=lambda one: one[:2])
        return column, place

    def energy(self, solution: DistributedSolution, time: Fraction) -> float:
        """1/2 u'Ku - f'u of all unknowns, prescribed ones included. Collective."""
        u, given, of_given = solution.answer.displacement, self.system.given, self.system.parts.of_given
        elastic = u @ self.problem.product(u) / 2 + u @ of_given + given @ of_given / 2
        return float(self.ranks.sum(float(elastic - self.load_on_all(time) @ (u + given))))

    def support_force(self, support: int, solution: DistributedSolution, time: Fraction) -> float:
        """What an entry of the scene's supports does to its body, along its axis. Collective."""
        residual = self.system.at_held(self.displacement(solution)) - self.load_on_all(time)
        pressed = np.zeros(self.touching.size)
        for contact in self.contacts:
            pressed += contact.pairing.normal.T @ self.normal_forces(contact.name, solution)
            if solution.friction_force is not None:
                pressed += contact.pairing.tangent.T @ self.tangential(contact.name, solution.friction_force).ravel()
        d, mine = self.system.dimension, self.touching.owners == self.ranks.rank
        at = self.touching.place[mine] - self.system.nodes.first
        residual.reshape(-1, d)[at] += pressed.reshape(-1, d)[mine]
        held = self.supports[support]
        nodes = node_numbers(self.structure.solid(held.body), held.nodes)
        places = self.system.own_places(held.body, nodes)
        return float(self.ranks.sum(float(residual.reshape(-1, d)[places, held.axis].sum())))


def node_at(ranks: Ranks, body: Part, point: ArrayLike, what: str) -> int:
    """The number of the node of a body at a point, whatever rank has it; as `nearest_node`. Collective."""
    numbers, found = node_numbers_of(body), None
    if body.mesh.elements:
        here = nearest_to(body, point)
        found = replace(here, node=int(numbers[here.node]))
    every = [one for one in ranks.comm.allgather(found) if one is not None]
    best = min(every, key=lambda one: (one.apart, one.node))
    smallest = min(one.smallest for one in every if one.node == best.node)
    return near_enough(replace(best, smallest=smallest), what)


def node_numbers_of(body: Part) -> NDArray[np.int64]:
    """The number in the whole mesh of each node of a piece."""
    assert isinstance(body.mesh, MeshPiece)  # what has ranks is made of pieces
    return body.mesh.numbers
