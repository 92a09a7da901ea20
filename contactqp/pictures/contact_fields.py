"""The fields of a solution on elastic bodies: displacement, stress; contact force, pressure, gap and status.

A force is a force [force]; a pressure is a force per area [force / length^2]. They are never one array.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.pairing import Pairing
from contactqp.elements.solid import Body, stress_at_nodes, von_mises
from contactqp.elements.structure import System
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.model.arrays import Index, Vector
from contactqp.model.problem import Units
from contactqp.model.solution import Solution
from contactqp.pictures.contact_nodes import contact_nodes

# Of a contact that is not in the problem because all its nodes are supported: nobody knows its force.
HELD = "held"


@dataclass(frozen=True, eq=False)
class BodyFields:
    """One body and what it does; N nodes in d dimensions.

    Attributes
    ----------
    body : Body
    displacement : (N, d) array [length]
    stress : (N, 6) array
        (xx, yy, zz, xy, yz, zx), tension positive, averaged at nodes [force / length^2].
    contact_force : (N, d) array
        What contact does to the body at each node, -(E_N' l_N + E_T' l_T) [force]; zero away from contact.
    """

    body: Body
    displacement: NDArray[np.float64]
    stress: NDArray[np.float64]
    contact_force: NDArray[np.float64]

    @property
    def points(self) -> NDArray[np.float64]:
        """(N, d): where the nodes were [length]."""
        return self.body.mesh.points

    @cached_property
    def von_mises(self) -> Vector:
        """(N,): von Mises' equivalent of `stress` [force / length^2]."""
        return von_mises(self.stress)


@dataclass(frozen=True, eq=False)
class PairingFields:
    """The p contacts of one pairing.

    Attributes
    ----------
    name : str
    body, node : (p,) arrays of int
        The body, as its place in ContactFields.bodies, and the node of each contact.
    position : (p, d) array
        Where the node was [length].
    displacement : (p, d) array [length]
    direction : (p, d) array
        The unit normal out of the obstacle or the master surface: along it the contact pushes the body.
    force : (p,) array
        lambda_N, positive in compression [force]: in 2D for the body's thickness, in axial symmetry for the full
        circle. NaN where `status` is "held".
    pressure : (p,) array or None
        `Pairing.pressure` of the forces [force / length^2]; None for a pairing of bare points, which have no area. NaN
        where `status` is "held".
    gap : (p,) array
        Under the load, positive when open [length].
    initial_gap : (p,) array
        Before any displacement [length].
    status : (p,) array of str
        "open", "closed", "grazing", "stick" or "slip"; "held" where every node of the contact is supported, so that
        the contact is not in the problem.
    on_obstacle : bool
        Whether the partner is a rigid obstacle and no other body.
    """

    name: str
    body: Index
    node: Index
    position: NDArray[np.float64]
    displacement: NDArray[np.float64]
    direction: NDArray[np.float64]
    force: Vector
    pressure: Vector | None
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
        """d, 2 or 3."""
        return self.bodies[0].body.dimension


def contact_fields(
    system: System, pairings: Sequence[Pairing], solution: Solution, *, names: Sequence[str] | None = None
) -> ContactFields:
    """The fields of a solution of ``system.problem(pairings)``.

    Parameters
    ----------
    system : System
        ``structure.assemble(supports, loads)``.
    pairings : sequence of Pairing
        Those that the problem was made of, in the same order.
    solution : Solution
    names : sequence of str, optional
        Of the pairings, for legends; by default "contact", numbered if there are several.

    Raises
    ------
    InvalidProblem
        The solution is not one of this system and these pairings; not one name for each pairing.
    """
    kept = system.free_contacts(pairings)
    expected, got = (len(system.free), len(kept)), (len(solution.displacement), len(solution.normal_force))
    if expected != got:
        raise InvalidProblem(
            f"solution: expected {expected[0]} unknowns and {expected[1]} contacts, as the system and the pairings "
            f"have, got {got[0]} and {got[1]}"
        )
    names = _default_names(len(pairings)) if names is None else names
    if len(names) != len(pairings):
        raise InvalidProblem(f"names: expected one for each of {len(pairings)} pairings, got {len(names)}")
    structure, u = system.structure, system.expand(solution.displacement)
    sizes = [len(pairing.gap) for pairing in pairings]
    force, status = np.full(sum(sizes), np.nan), np.full(sum(sizes), HELD, dtype="<U8")
    force[kept], status[kept] = solution.normal_force, solution.contact_status
    on_nodes = _contact_forces(pairings, kept, solution, structure.size)
    bodies = []
    for body in structure.bodies:
        if not isinstance(body, Body):
            raise Unsupported(f"{body.name}: a membrane has no stresses to draw or to write")
        mine = slice(structure.first(body.name), structure.first(body.name) + body.size)
        own, pushed = (v[mine].reshape(body.mesh.points.shape) for v in (u, on_nodes))
        bodies.append(BodyFields(body, own, stress_at_nodes(body, u[mine]), pushed))
    ends = np.cumsum(sizes)
    fields = [
        _pairing_fields(system, bodies, pairing, name, u, force[end - size : end], status[end - size : end])
        for pairing, name, size, end in zip(pairings, names, sizes, ends, strict=True)
    ]
    return ContactFields(tuple(bodies), tuple(fields), solution.problem.units)


def _default_names(count: int) -> list[str]:
    return ["contact"] if count == 1 else [f"contact {i + 1}" for i in range(count)]


def _contact_forces(pairings: Sequence[Pairing], kept: Index, solution: Solution, size: int) -> Vector:
    """-(E_N' l_N + E_T' l_T) on all unknowns, (n,) [force]; held contacts bring nothing."""
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
    system: System,
    bodies: Sequence[BodyFields],
    pairing: Pairing,
    name: str,
    u: Vector,
    force: Vector,
    status: NDArray[np.str_],
) -> PairingFields:
    owner, node, on_obstacle = contact_nodes(system.structure, pairing, name)
    displacement = np.empty(pairing.points.shape)
    for number in np.unique(owner):
        mine = owner == number
        displacement[mine] = bodies[number].displacement[node[mine]]
    return PairingFields(
        name=name,
        body=owner,
        node=node,
        position=pairing.points,
        displacement=displacement,
        direction=pairing.direction,
        force=force,
        pressure=None if pairing.projection is None else pairing.pressure(force),
        gap=np.asarray(pairing.gap - pairing.normal @ u),
        initial_gap=pairing.gap,
        status=status,
        on_obstacle=on_obstacle,
    )
