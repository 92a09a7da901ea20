"""Hertz's line contact and the flat punch on one mesh, against the half-plane's closed forms (`half_plane`).

A piece of the half-plane carries the exact displacement on its left, right and bottom: the punch has an approach, and
nothing stands for infinity. What the mesh makes of the force, the pressure and the displacement is its error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import contactqp as cq
from benchmarks.h1_error import Vector, h1_error
from benchmarks.half_plane import HalfPlane, Parabola, Punch
from contactqp.elements.material import Material
from contactqp.elements.mesh import Mesh
from contactqp.elements.pairing import Pairing
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support

# Means over these: the edge of contact falls somewhere within an element, and errors swing with where.
HALF_WIDTHS = (0.47, 0.48, 0.49, 0.5, 0.51, 0.52, 0.53)


@dataclass(frozen=True)
class HertzLevel:
    """One mesh, means over HALF_WIDTHS: relative errors, and that of the half-width in elements."""

    size: float
    unknowns: int
    h1: float
    force: float
    peak: float
    half_width: float


@dataclass(frozen=True)
class PunchLevel:
    """One mesh: relative errors of the force and, in L1 over P, of the pressure."""

    size: float
    unknowns: int
    force: float
    l1: float


@dataclass(frozen=True, eq=False)
class _Pressed:
    mesh: Mesh
    displacement: Vector  # (N, 2)
    pairing: Pairing
    force: Vector  # of each contact
    unknowns: int


def hertz_level(kind: str, cells: int) -> HertzLevel:
    """(-1, 1) x (-1, 0) in 2 `cells` times `cells` elements."""
    each = [_hertz(kind, cells, half_width) for half_width in HALF_WIDTHS]
    h1, force, peak, half_width = np.mean([errors for errors, _ in each], axis=0)
    return HertzLevel(1 / cells, each[0][1], float(h1), float(force), float(peak), float(half_width))


def punch_level(kind: str, cells: int) -> PunchLevel:
    """(-2, 2) x (-2, 0) in 2 `cells` times `cells` elements, the punch over the middle half; `cells` even."""
    exact = Punch()
    mesh = rectangle(4.0, 2.0, (2 * cells, cells), kind, corner=(-2.0, -2.0))
    under = (mesh.points[:, 1] == 0) & (abs(mesh.points[:, 0]) < exact.half_width + 1 / cells**2)
    found = _pressed(mesh.with_node_sets({"under": np.flatnonzero(under)}), "under", exact, cq.Plane([0, 0], [0, -1]))
    x = found.pairing.points[:, 0]
    along = np.argsort(x)
    pressure = found.pairing.pressure(found.force)[along]
    # With x = a sin t the integral of |p_h - p| dx is that of |a p_h cos t - P / pi| dt, which is nowhere singular.
    t = (np.arange(20_000) + 0.5) / 20_000 * np.pi - np.pi / 2
    nodal = np.interp(exact.half_width * np.sin(t), x[along], pressure)
    l1 = np.pi * np.mean(abs(exact.half_width * nodal * np.cos(t) - exact.force / np.pi)) / exact.force
    return PunchLevel(2 / cells, found.unknowns, abs(float(found.force.sum()) / exact.force - 1), float(l1))


def _hertz(kind: str, cells: int, half_width: float) -> tuple[list[float], int]:
    exact = Parabola(half_width)
    mesh = rectangle(2.0, 1.0, (2 * cells, cells), kind, corner=(-1.0, -1.0))
    found = _pressed(mesh, "top", exact, cq.Paraboloid([0, 0], [0, -1], exact.radius))
    x = abs(found.pairing.points[:, 0])
    errors = [
        h1_error(mesh, found.displacement, exact.gradient),
        abs(float(found.force.sum()) / exact.force - 1),
        abs(float(found.pairing.pressure(found.force).max()) / exact.peak - 1),
        abs(float(x[found.force > 0].max()) - half_width) * cells,
    ]
    return errors, found.unknowns


def _pressed(mesh: Mesh, side: str, exact: HalfPlane, obstacle: object) -> _Pressed:
    material = Material(exact.elastic.modulus, exact.elastic.poisson)
    structure = Structure([Body(mesh, material, "plane-strain", name="body")])
    held = [
        Support("body", edge, axis, lambda x, axis=axis: exact.displacement(x)[:, axis])
        for edge in ("left", "right", "bottom")
        for axis in (0, 1)
    ]
    system = structure.assemble(held)
    pairing = cq.pair(structure.surface("body", side), obstacle)
    problem = system.problem([pairing])
    solution = cq.solve(problem)
    force = np.zeros(len(pairing.gap))
    force[system.free_contacts([pairing])] = solution.normal_force
    displacement = structure.displacements("body", system.expand(solution.displacement))
    return _Pressed(mesh, displacement, pairing, force, problem.dimension)
