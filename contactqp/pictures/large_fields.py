"""The fields of a solid at large deformation: displacements and contact forces in the current configuration."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.analysis.large.deformation import LargeSolution, LoadedBody
from contactqp.elements.deformable import ContactGeometry, ContactGroup, ObstacleContact, Supported, SupportedContact
from contactqp.elements.nonlinear_solid import NonlinearSolid
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.solid import Body
from contactqp.model.arrays import Vector
from contactqp.model.solution import Solution
from contactqp.pictures.contact_fields import BodyFields, ContactFields, PairingFields


def fields_of_solid(solution: Solution) -> ContactFields | None:
    """Return the fields of a solid at a large deformation, None for other bodies and contacts of other kinds.

    Contacts stand where they are now, so that the obstacle is x - gap n; stresses are not looked at and are NaN.
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
    """Yield the contact geometries of a group, in the order of their contacts, whatever supports are around them."""
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
