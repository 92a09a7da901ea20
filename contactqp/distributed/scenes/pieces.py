"""From a scene of elastic bodies to a contact problem of which each rank has its part."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from contactqp.distributed.pieces.dealing import deal
from contactqp.distributed.pieces.nodes import number_nodes
from contactqp.distributed.pieces.sources import FileSource, LatticeSource, Source
from contactqp.distributed.pieces.system import PieceSystem, prescribed_of
from contactqp.distributed.pieces.touching import touching
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.scenes.distributed_bodies import DistributedBodyModel, node_at
from contactqp.elements.structure import Part, Structure
from contactqp.errors import Unsupported
from contactqp.linalg.stages import BUILD, stage
from contactqp.scene.body_geometry import lattice_of_shape, mesh_of_file
from contactqp.scene.body_model import at_key, loads_of, paired_contact, sides_of, solid_body, sum_of, supports_of
from contactqp.scene.unknowns import end_time, factors_at, has_corners

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData
    from contactqp.scene.schema_bodies import Body


def distributed_model(scene: SceneData, ranks: Ranks) -> DistributedBodyModel:
    """Pieces of meshes, supports, loads and pairs of a scene of bodies. Collective.

    Shapes are made slab by slab. A mesh file is read by rank 0, which for that time has all of it.

    Raises
    ------
    SceneError
        What is no good, its key first; the same on all ranks.
    Unsupported
        Membranes, motions, large deformations, a scene without bodies.
    """
    others = ("membranes", scene.membranes), ("motions", scene.motion), ("large motions", scene.large)
    for what, there in (*others, ("a scene without bodies", not scene.bodies)):
        if there:
            raise Unsupported(
                f"{what}: expected elastic bodies at rest for pieces on many ranks; engine='serial' takes them"
            )
    with stage(BUILD):
        return _model(scene, ranks)


def _model(scene: SceneData, ranks: Ranks) -> DistributedBodyModel:
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
    at = partial(node_at, ranks)
    acting = list(loads_of(scene, structure, at))
    supports = tuple(supports_of(scene, structure, at))
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


def _source(scene: SceneData, ranks: Ranks, body: Body) -> Source:
    if body.shape is not None:
        return LatticeSource(ranks, lattice_of_shape(scene, body.shape))
    assert body.mesh is not None  # a body has one of both
    return FileSource(ranks, partial(mesh_of_file, scene, body.mesh))
