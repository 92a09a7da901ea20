"""A membrane over the unit ball: its free boundary is the circle r = a (PETSc SNES tutorial ex9; Bueler 2021, ch. 12).

    w = sqrt(1 - r^2) for r <= a,   w = -A log(r) + B beyond,   A = a^2 / sqrt(1 - a^2),   B = A log 2

with w and its slope continuous at a and w = 0 at r = 2. PETSc's example takes the square (-2, 2)^2 with this w on its
outline; the disc r < 2 has w = 0 there. The ball pushes the membrane with 2 pi A T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import contactqp as cq
from benchmarks.h1_error import Vector, h1_error
from contactqp.elements.mesh import Mesh
from contactqp.elements.pairing import pair_scalar
from contactqp.elements.shapes import disc, rectangle
from contactqp.elements.solid import Membrane
from contactqp.elements.structure import Structure, Support

RIM = 2.0
RADIUS = 0.697965148223374  # a: the root of a^2 (log(RIM) - log(a)) = 1 - a^2, to the last digit
SLOPE = RADIUS**2 / np.sqrt(1 - RADIUS**2)  # A


@dataclass(frozen=True)
class MembraneLevel:
    """One mesh.

    Attributes
    ----------
    size : float
        Of the largest element along an axis.
    h1, force : float
        Relative errors.
    boundary : float
        |largest radius of a node that presses - a|, in elements.
    radius : float
        |a of the pushing force - a| / a, the force being 2 pi a^2 / sqrt(1 - a^2).
    """

    size: float
    unknowns: int
    h1: float
    force: float
    boundary: float
    radius: float


def deflection(x: Vector) -> Vector:
    """w at (p, 2) points, (p,)."""
    r = np.linalg.norm(x, axis=1)
    return np.where(r <= RADIUS, height(x), -SLOPE * np.log(np.maximum(r, RADIUS) / RIM))


def gradient(x: Vector) -> Vector:
    """grad w at (p, 2) points, (p, 1, 2)."""
    r = np.linalg.norm(x, axis=1, keepdims=True)
    on_ball = -x / np.sqrt(1 - np.minimum(r, RADIUS) ** 2)
    return np.where(r <= RADIUS, on_ball, -SLOPE * x / np.maximum(r, RADIUS) ** 2)[:, None]


def height(x: Vector) -> Vector:
    """Of the ball over (p, 2) points, -inf beside it."""
    below = 1 - (x**2).sum(axis=1)
    return np.where(below >= 0, np.sqrt(np.maximum(below, 0)), -np.inf)


def on_square(kind: str, cells: int) -> Mesh:
    """(-2, 2)^2 in `cells` times `cells` elements."""
    return rectangle(2 * RIM, 2 * RIM, (cells, cells), kind, corner=(-RIM, -RIM))


def on_disc(kind: str, cells: int) -> Mesh:
    """r < 2, about `cells` elements across."""
    return disc(RIM, (cells // 4, cells // 4), kind)


def membrane_level(mesh: Mesh) -> MembraneLevel:
    """Solve on one mesh, w prescribed on its outline."""
    membrane = Membrane(mesh, 1.0, name="sheet")
    structure = Structure([membrane])
    system = structure.assemble([Support("sheet", side, 0, deflection) for side in mesh.sides])
    pairing = pair_scalar(mesh.points, height)
    problem = system.problem([pairing])
    solution = cq.solve(problem)
    presses = system.free_contacts([pairing])[solution.normal_force > 0]
    reached = np.linalg.norm(pairing.points[presses], axis=1).max()
    size = max(float(np.ptp(mesh.points[block.nodes], axis=1).max()) for block in mesh.blocks)
    pushing = float(solution.normal_force.sum()) / (2 * np.pi)
    # a^2 / sqrt(1 - a^2) = q has the root a^2 = q (sqrt(q^2 + 4) - q) / 2.
    radius = np.sqrt(pushing * (np.sqrt(pushing**2 + 4) - pushing) / 2)
    return MembraneLevel(
        size,
        problem.dimension,
        h1_error(mesh, system.expand(solution.displacement)[:, None], gradient),
        abs(pushing / SLOPE - 1),
        float(abs(reached - RADIUS)) / size,
        abs(float(radius) / RADIUS - 1),
    )
