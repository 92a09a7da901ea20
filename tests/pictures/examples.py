"""Solved contact problems whose fields are known exactly: uniform uniaxial stress."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

import contactqp as cq
from contactqp.elements.loads import Pressure
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body, stress_at_nodes
from contactqp.elements.structure import Structure, Support, System
from contactqp.pictures.contact_fields import BodyFields, ContactFields, contact_fields

MODULUS, POISSON, PRESSURE = 200.0, 0.25, 3.0
MATERIAL = Material(modulus=MODULUS, poisson=POISSON)
UNITS = {"length": "mm", "force": "N"}
FLOOR = cq.Plane(point=[0.0, 0.0], normal=[0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Solved:
    system: System
    pairings: list[Any]
    solution: cq.Solution

    @cached_property
    def fields(self) -> ContactFields:
        return contact_fields(self.system, self.pairings, self.solution)


def solved(system: System, *pairings: Any) -> Solved:
    return Solved(system, list(pairings), cq.solve(system.problem(pairings, units=UNITS)))


@cache
def block(kind: str = "quad4", model: str = "plane-stress", thickness: float = 1.0) -> Solved:
    """A block of 2 by 1, or a cylinder of radius 2 and height 1, under PRESSURE from above, on a floor."""
    body = Body(rectangle(2.0, 1.0, (4, 3), kind), MATERIAL, model, thickness=thickness, name="block")
    structure = Structure([body])
    held = "left" if model == "axisymmetric" else body.mesh.nearest((0.0, 1.0))
    system = structure.assemble([Support("block", held, 0)], [Pressure("block", "top", PRESSURE)])
    return solved(system, cq.pair(structure.surface("block", "bottom"), FLOOR, dimension=structure.size))


@cache
def stack(upper_cells: tuple[int, int] = (3, 2)) -> Solved:
    """A block on a block on a floor under PRESSURE from above, on meshes that match with (4, 2) only."""
    bodies = [
        Body(rectangle(2.0, 1.0, (4, 2)), MATERIAL, "plane-stress", name="lower"),
        Body(rectangle(2.0, 1.0, upper_cells, corner=(0.0, 1.0)), MATERIAL, "plane-stress", name="upper"),
    ]
    structure = Structure(bodies)
    supports = [Support("lower", "left", 0), Support("upper", "left", 0)]
    system = structure.assemble(supports, [Pressure("upper", "top", PRESSURE)])
    on_floor = cq.pair(structure.surface("lower", "bottom"), FLOOR, dimension=structure.size)
    between = cq.pair_mortar(
        structure.surface("upper", "bottom"), structure.surface("lower", "top"), dimension=structure.size
    )
    return solved(system, on_floor, between)


@cache
def cube(kind: str = "hex8") -> Solved:
    """A block of 2 by 1 by 1 under PRESSURE from above, on a floor."""
    body = Body(box((2.0, 1.0, 1.0), (2, 1, 1), kind), MATERIAL, "3d", name="cube")
    structure = Structure([body])
    system = structure.assemble(
        [Support("cube", "left", 0), Support("cube", "front", 1)], [Pressure("cube", "top", PRESSURE)]
    )
    floor = cq.Plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
    return solved(system, cq.pair(structure.surface("cube", "bottom"), floor, dimension=structure.size))


@cache
def unloaded(kind: str) -> ContactFields:
    """The body of `cube` in its uniform state, in no contact at all."""
    body = Body(box((2.0, 1.0, 1.0), (2, 2, 1), kind), MATERIAL, "3d", name="cube")
    u = uniaxial(body.mesh.points)
    fields = BodyFields(body, u, stress_at_nodes(body, u.ravel()), np.zeros_like(u), np.zeros_like(u))
    return ContactFields((fields,), (), cq.Units(**UNITS))


def uniaxial(points: np.ndarray) -> np.ndarray:
    """The displacement under the stress -PRESSURE along the last axis, of a body that stands at the origin."""
    strain = PRESSURE / MODULUS
    u = POISSON * strain * points
    u[:, -1] = -strain * points[:, -1]
    return u


def with_friction(solution: cq.Solution, friction_force: np.ndarray) -> cq.Solution:
    """Return a solution with these friction forces in place of its own."""
    return replace(solution, answer=replace(solution.answer, friction_force=friction_force))
