"""From a scene and its solution to the fields that pictures and VTU files show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from contactqp.analysis.large.deformation import LargeSolution
from contactqp.model.arrays import Array
from contactqp.model.problem import Units
from contactqp.model.solution import Solution
from contactqp.pictures.contact_fields import HELD, ContactFields, contact_fields
from contactqp.pictures.frame_fields import FrameContact, FrameFields, Member
from contactqp.pictures.membrane_drawing import MembraneFields
from contactqp.scene.body_geometry import obstacle
from contactqp.scene.building import exact_problem
from contactqp.scene.schema import SceneData


def fields_of(scene: SceneData, solution: Solution) -> ContactFields | FrameFields:
    """The fields of a scene's solution, in the scene's units.

    The one place that decides what kind of picture a scene gets. Bars, springs, beams, strings and matrices give
    FrameFields. Elastic bodies give the ContactFields of the System and the Pairings that the scene's problem is made
    of; draw, write_vtu and the command line take either.

    Parameters
    ----------
    scene : Scene
    solution : Solution
        Of ``scene.problem()``, by any method.

    Raises
    ------
    Unsupported
        The scene has a membrane.
    """
    if scene.meshed:
        return _fields_of_bodies(scene, solution)
    unknowns = exact_problem(scene).unknowns
    value = dict.fromkeys(unknowns.names, 0.0) | dict(zip(unknowns.free, solution.displacement.tolist(), strict=True))
    return FrameFields(
        axes=scene.axes,
        nodes=tuple(scene.every_node),
        position=np.array([_point(scene, node) for node in scene.every_node]),
        displacement=np.array([[value[name] for name in scene.displacements(node)] for node in scene.every_node]),
        held=np.array([[name in unknowns.fixed for name in scene.displacements(node)] for node in scene.every_node]),
        members=tuple(_members(scene, value)),
        contacts=tuple(_contacts(scene, solution)),
        units=Units(length=scene.units.length, force=scene.units.force),
    )


def fields_of_membranes(scene: SceneData, solution: Solution) -> MembraneFields:
    """The fields of a scene of membranes, which have no stresses; contacts at supported nodes are "held"."""
    from contactqp.scene.body_model import body_model

    model = body_model(scene)
    structure, pairings = model.structure, [contact.pairing for contact in model.contacts]
    w, kept = model.system.expand(solution.displacement), model.system.free_contacts(pairings)
    position = np.concatenate([np.zeros((0, 3)), *(pairing.points for pairing in pairings)])
    force, status = np.full(len(position), np.nan), np.full(len(position), HELD, dtype="<U8")
    force[kept], status[kept] = solution.normal_force, solution.contact_status
    first = [structure.first(body.name) for body in structure.bodies]
    return MembraneFields(
        meshes=tuple(body.mesh for body in structure.bodies),
        deflections=tuple(w[i : i + body.size] for i, body in zip(first, structure.bodies, strict=True)),
        position=position[:, :2],
        force=force,
        status=status,
        units=solution.problem.units,
    )


def _fields_of_bodies(scene: SceneData, solution: Solution) -> ContactFields:
    from contactqp.scene.body_model import body_model

    model = body_model(scene)
    pairings, names = [c.pairing for c in model.contacts], [c.name for c in model.contacts]
    return contact_fields(model.system, pairings, solution, names=names)


def _members(scene: SceneData, value: Mapping[str, float]) -> Iterator[Member]:
    place = _places(scene)
    for _, element in scene.elements:
        line = element.drawn(scene, value)
        if line is not None:
            nodes = tuple(place[name] for name in line.nodes)
            yield Member(element.noun, nodes, line.path, line.displacement)


def _contacts(scene: SceneData, solution: Solution) -> Iterator[FrameContact]:
    place, gaps = _places(scene), solution.gap
    for i, (contact, form) in enumerate(zip(scene.contacts, exact_problem(scene).contacts, strict=True)):
        push = [[-float(form.normal.get(name, 0)) for name in scene.displacements(node)] for node in contact.touched]
        initial_gap = float(form.gap)
        if isinstance(solution, LargeSolution) and solution.position is not None:
            # The plane that touches the obstacle where it is nearest to the node now, seen from where the node was.
            normal = obstacle(scene, str(contact.obstacle)).normals(solution.position[i : i + 1])[0]
            push = [[float(x) for x in normal]]
            moved = solution.position[i] - _point(scene, contact.touched[0])
            initial_gap = float(gaps[i] - normal @ moved)
        yield FrameContact(
            name=contact.name,
            nodes=tuple(place[name] for name in contact.touched),
            push=np.array(push),
            force=float(solution.normal_force[i]),
            gap=float(gaps[i]),
            initial_gap=initial_gap,
            status=str(solution.contact_status[i]),
        )


def _places(scene: SceneData) -> dict[str, int]:
    return {node: i for i, node in enumerate(scene.every_node)}


def _point(scene: SceneData, name: str) -> Array:
    return np.array(scene.point(name), dtype=float)
