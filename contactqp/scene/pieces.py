"""From a scene of elastic bodies to a contact problem of which each rank has its part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks
from contactqp.elements.free_contacts import FreeContacts, free_contacts
from contactqp.elements.pairing import Pairing
from contactqp.elements.pieces.dealing import deal
from contactqp.elements.pieces.mesh_piece import MeshPiece
from contactqp.elements.pieces.nodes import number_nodes
from contactqp.elements.pieces.sources import FileSource, LatticeSource, Source
from contactqp.elements.pieces.system import PieceSystem, prescribed_of
from contactqp.elements.pieces.touching import Touching, touching
from contactqp.elements.structure import Part, Structure
from contactqp.elements.structure import Support as Held
from contactqp.errors import Unsupported
from contactqp.problem import Units
from contactqp.scene.bodies import paired_contact, sides_of, solid_body, sum_of
from contactqp.scene.body_loads import at_key, loads_of, supports_of
from contactqp.scene.contact_entries import ContactEntries
from contactqp.scene.corners import end_time, factors_at, has_corners
from contactqp.scene.meshing import Nearest, lattice_of_shape, mesh_of_file, near_enough, nearest_to
from contactqp.stages import BUILD, stage

if TYPE_CHECKING:
    from contactqp.scene.schema import Scene
    from contactqp.scene.schema_bodies import Body

Vector = NDArray[np.float64]


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

    scene: Scene
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


def distributed_model(scene: Scene, ranks: Ranks) -> DistributedBodyModel:
    """Pieces of meshes, supports, loads and pairs of a scene of bodies. Collective.

    Shapes are made slab by slab. A mesh file is read by rank 0, which for that time has all of it.

    Raises
    ------
    SceneError
        What is no good, its key first; the same on all ranks.
    Unsupported
        Membranes, motions, large deformations.
    """
    for what, there in (("membranes", scene.membranes), ("motions", scene.motion), ("large motions", scene.large)):
        if there:
            raise Unsupported(f"{what}: expected elastic bodies at rest for the engine 'petsc'; use the engine 'scipy'")
    with stage(BUILD):
        return _model(scene, ranks)


def _model(scene: Scene, ranks: Ranks) -> DistributedBodyModel:
    sources: list[Source] = []
    for i, body in enumerate(scene.bodies):
        with at_key(f"bodies[{i}] ({body.name!r})"):
            sources.append(_source(scene, ranks, body))
    with at_key("bodies"):
        dealt = deal(ranks, sources)
        nodes = number_nodes(ranks, dealt)
    pieces: list[Part] = []
    for i, (body, part) in enumerate(zip(scene.bodies, dealt, strict=True)):
        with at_key(f"bodies[{i}] ({body.name!r})"), ranks.together():
            pieces.append(solid_body(scene, body, part.mesh))
    with at_key("bodies"):
        structure = Structure(pieces)
    node_at = partial(_node_at, ranks)
    acting = list(loads_of(scene, structure, node_at))
    supports = tuple(supports_of(scene, structure, node_at))
    with at_key("supports"):
        system = PieceSystem(structure, nodes, prescribed_of(structure, nodes, supports))
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
        surfaces = touching(structure, nodes, sides)
    contacts = []
    for i, contact in enumerate(scene.contacts):
        with at_key(f"contacts[{i}] ({contact.name!r})"):
            found = paired_contact(scene, surfaces, contact)
            contacts.append(replace(found, pairing=surfaces.named(found.body, found.pairing)))
    return DistributedBodyModel(
        tuple(contacts), scene, ranks, system, surfaces, supports, load, by_name if has_corners(scene) else {}
    )


def _source(scene: Scene, ranks: Ranks, body: Body) -> Source:
    if body.shape is not None:
        return LatticeSource(ranks, lattice_of_shape(scene, body.shape))
    assert body.mesh is not None  # a body has one of both
    return FileSource(ranks, partial(mesh_of_file, scene, body.mesh))


def _node_at(ranks: Ranks, body: Part, point: ArrayLike, what: str) -> int:
    """The number of the node of a body at a point, whatever rank has it; as `nearest_node`. Collective."""
    mesh = body.mesh
    found: Nearest | None = None
    if mesh.elements and isinstance(mesh, MeshPiece):
        here = nearest_to(body, point)
        found = Nearest(here.apart, int(mesh.numbers[here.node]), here.at, here.smallest)
    every = [one for one in ranks.comm.allgather(found) if one is not None]
    best = min(every, key=lambda one: (one.apart, one.node))
    smallest = min(one.smallest for one in every if one.node == best.node)
    return near_enough(Nearest(best.apart, best.node, best.at, smallest), what)
