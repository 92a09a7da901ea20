"""Nodal pressures against closed forms at every node, for every kind of element: Hertz, flat punch, Lame's fit.

    Hertz      A rigid parabola or paraboloid on a half-space, touching to r = 1 (Johnson 1985, section 4.2). The value
               of a node is made of the forces of the facets at it and of their neighbours, and may be off by what the
               exact pressure varies over them; with linear elements by what sigma_x varies over one of them,
               2 p0 h / a, as well.
    punch      A rigid flat punch on a half-space, p = P / (pi sqrt(1 - x^2)) or P / (2 pi sqrt(1 - r^2)) (sections 2.8,
               3.7), up to r = 0.5: the pole at the edge makes all errors of first order, whatever the element.
    Lame       Rings of radii 0.5, 1 and 2 with the interference 1e-3, node to segment on facets that match and that do
               not: the second do not converge, since node to segment fails the patch test; linear ones are told.
    patch      A uniform pressure between two bodies, facets that match and that do not.

    python -m benchmarks.nodal_pressures

prints the largest errors over the nodes, relative to p0, to the exact pressure, or to the mean, mesh after mesh. Exit
code 1 where Hertz is off by more than that at a node, or the punch converges with an order below 0.9, beside what a
block of 21 radii is off a half-space.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import contactqp as cq
from contactqp.elements.loads import Pressure
from contactqp.elements.material import Material
from contactqp.elements.pairing import Pairing
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.elements.surface import Surface, diameters, kind_of

Array = NDArray[np.float64]
MODULUS, POISSON = 1000.0, 0.3
MATERIAL = Material(MODULUS, POISSON)
PLANE_KINDS = ("tri3", "quad4", "tri6", "quad8", "quad9")
SOLID_KINDS = ("hex8", "tet4", "hex20", "tet10", "hex27")
LINEAR = ("tri3", "quad4", "hex8", "tet4")
MODELS = ("plane-strain", "plane-stress", "axisymmetric")
CASES = [(model, kind) for model in MODELS for kind in PLANE_KINDS] + [("3d", kind) for kind in SOLID_KINDS]
LEAST_ORDER, BLOCK = 0.9, 1 / 21**2
# What an interference of 1e-3 makes of Lame's pressure on facets that match, whatever the mesh.
FACETS = 1e-3


def forces(pairing: Pairing, system: Any, solution: Any) -> Array:
    """The force of each row of the pairing, 0 where only supported nodes meet."""
    every = np.zeros(len(pairing.gap))
    every[system.free_contacts([pairing])] = solution.normal_force
    return every


def hertz(model: str, kind: str, finer: float = 1.0) -> tuple[Surface, Array, Array]:
    """A half-space under a rigid parabola or paraboloid that touches to r = 1: surface, r, pressures over p0."""
    radius, size, count = 200.0, 20.0, round(24 * finer)
    stiff = MODULUS if model == "plane-stress" else MODULUS / (1 - POISSON**2)
    if model == "3d":
        size, count = 12.0, round((14 if kind in LINEAR else 9) * finer)
        mesh = box((size,) * 3, (count, count, count // 2), kind, grading=12.0, towards=("left", "front", "bottom"))
    else:
        mesh = rectangle(size, size, (count, count), kind, grading=40.0, towards=("left", "bottom"))
    body = Body(mesh, MATERIAL, model, name="body")
    structure = Structure([body])
    if model.startswith("plane"):
        force, spread = np.pi * stiff / (4 * radius), 2 * size
        peak = 2 * force / np.pi
    else:
        force, spread = 4 * stiff / (3 * radius), 4 * size**2 if model == "3d" else np.pi * size**2
        peak = 3 * force / (2 * np.pi)
    held = [Support("body", name, axis) for axis, name in enumerate(("left", "front")[: body.dimension - 1])]
    system = structure.assemble(held, [Pressure("body", "top", force / spread)])
    axis = np.eye(body.dimension)[-1]
    surface = structure.surface("body", "bottom")
    pairing = cq.pair(surface, cq.Paraboloid(0 * axis, axis, radius), dimension=structure.size)
    force = forces(pairing, system, cq.solve(system.problem([pairing])))
    return surface, np.linalg.norm(pairing.points[:, :-1], axis=1), pairing.pressure(force) / peak


def over_two_rings(surface: Surface, pressure: Callable[[Array], Array]) -> tuple[Array, Array]:
    """The least and the largest value of a function of the position on the facets at each node and their neighbours."""
    kind = kind_of(surface)
    shape = kind.shape(np.vstack([kind.quadrature(6)[0], kind.nodes]))
    value = pressure(np.einsum("qk,fkd->fqd", shape, surface.points[surface.facets]))
    least, largest = value.min(axis=1), value.max(axis=1)
    for _ in range(2):
        low, high = np.full(len(surface.points), np.inf), np.full(len(surface.points), -np.inf)
        np.minimum.at(low, surface.facets, least[:, np.newaxis])
        np.maximum.at(high, surface.facets, largest[:, np.newaxis])
        least, largest = low[surface.facets].min(axis=1), high[surface.facets].max(axis=1)
    return low[surface.nodes], high[surface.nodes]


def hertz_errors(surface: Surface, pressure: Array, *, linear: bool) -> tuple[Array, Array]:
    """At each node the error of a pressure over p0, and what is allowed."""

    def exact(x: Array) -> Array:
        return np.asarray(np.sqrt(np.maximum(0, 1 - (x[..., :-1] ** 2).sum(axis=-1))))

    least, largest = over_two_rings(surface, exact)
    here = exact(surface.points[surface.nodes])
    size = np.zeros(len(surface.points))
    np.maximum.at(size, surface.facets, diameters(surface.points[surface.facets])[:, np.newaxis])
    element = 2 * size[surface.nodes] * (here > 0) if linear else 0.0
    return np.abs(pressure - here), np.maximum(largest - here, here - least) + element


def rigid_punch(model: str, kind: str, cells: int) -> tuple[Surface, Array, Array]:
    """A half-space under a rigid flat punch of half-width or radius 1: surface, r, p pi a / P or p 2 pi a^2 / P."""

    def away(s: Array) -> Array:
        return np.where(s < 1, s, 1 + np.expm1(1.8 * np.maximum(s - 1, 0)) / 1.8)

    if model == "3d":
        mesh = box((3.0, 0.5, 3.0), (3 * cells, 2, 3 * cells), kind)
    else:
        mesh = rectangle(3.0, 3.0, (3 * cells, 3 * cells), kind)
    mesh = mesh.mapped(lambda x: np.column_stack([away(x[:, 0]), x[:, 1:-1], away(x[:, -1])]))
    under = np.flatnonzero((mesh.points[:, -1] == 0) & (mesh.points[:, 0] < 1 + 1e-9))
    body = Body(mesh.with_node_sets({"under": under}), MATERIAL, model, name="body")
    structure = Structure([body])
    held = [Support("body", "left", 0)] + [Support("body", name, 1) for name in ("front", "back") if model == "3d"]
    system = structure.assemble(held, [Pressure("body", "top", 1.0)])
    up = np.eye(body.dimension)[-1]
    surface = structure.surface("body", "under")
    pairing = cq.pair(surface, cq.Plane(point=0 * up, normal=up), dimension=structure.size)
    force = forces(pairing, system, cq.solve(system.problem([pairing])))
    length = {"axisymmetric": 0.5, "3d": 2 / 0.5}.get(model, 2.0)
    return surface, pairing.points[:, 0], pairing.pressure(force) / (force.sum() * length / np.pi)


def punch_error(model: str, kind: str, cells: int) -> float:
    """The largest error up to r = 0.5, of the exact pressure there."""
    _, r, pressure = rigid_punch(model, kind, cells)
    return float(np.abs(pressure * np.sqrt(1 - np.minimum(r, 0.5) ** 2) - 1)[r <= 0.5].max())


def quarter(name: str, inner: float, outer: float, kind: str, cells: int, model: str = "plane-stress") -> Body:
    """A quarter of a ring, its sides bottom and top on the axes, left and right inside and outside.

    `cells` are around it; there are four fifths as many from inside to outside, two fifths as many of bricks.
    """

    def bent(x: Array) -> Array:
        r, angle = inner + (outer - inner) * x[:, 0], np.pi / 2 * x[:, 1]
        return np.column_stack([r * np.cos(angle), r * np.sin(angle), *x[:, 2:].T])

    if model == "3d":
        mesh = box((1.0, 1.0, 0.5), (max(2, round(0.4 * cells)), cells, 2), kind)
    else:
        mesh = rectangle(1.0, 1.0, (max(4, round(0.8 * cells)), cells), kind)
    return Body(mesh.mapped(bent), MATERIAL, model, name=name)


def press_fit(
    kind: str, cells: tuple[int, int], interference: float, *, mortar: bool = False, model: str = "plane-stress"
) -> tuple[Pairing, Array]:
    """Lame's fit of rings of radii 0.5, 1 and 2: the pairing, its pressures over the exact one (plane stress)."""
    shaft = quarter("shaft", 0.5, 1.0 + interference, kind, cells[0], model)
    hub = quarter("hub", 1.0, 2.0, kind, cells[1], model)
    structure = Structure([shaft, hub])
    sides = ("front", "back") if model == "3d" else ("bottom", "top")
    held = [Support(name, sides[0], 1) for name in ("shaft", "hub")]
    held += [Support(name, sides[1], 0) for name in ("shaft", "hub")]
    if model == "3d":
        held += [Support(name, "bottom", 2) for name in ("shaft", "hub")]
    system = structure.assemble(held)
    method = cq.pair_mortar if mortar else cq.pair_node_to_segment
    found = method(structure.surface("shaft", "right"), structure.surface("hub", "left"), overlap=0.1)
    exact = interference * MODULUS / (5 / 3 + 5 / 3)  # both rings are twice as wide as they are narrow
    return found, found.pressure(forces(found, system, cq.solve(system.problem([found])))) / exact


def patch_error(kind: str, model: str, cells: tuple[int, int], *, mortar: bool = False) -> float:
    """What is off at the worst node where a block of so many facets presses uniformly on another."""
    if model == "3d":
        upper, lower = (box((1.0,) * 3, (n, n, 2), kind, corner=(0, 0, z)) for n, z in zip(cells, (0, -1), strict=True))
    else:
        upper, lower = (rectangle(1.0, 1.0, (n, 2), kind, corner=(0, y)) for n, y in zip(cells, (0, -1), strict=True))
    structure = Structure([Body(upper, MATERIAL, model, name="upper"), Body(lower, MATERIAL, model, name="lower")])
    across = ("left", "front") if model == "3d" else ("left",)
    held = [Support(name, side, axis) for name in ("upper", "lower") for axis, side in enumerate(across)]
    system = structure.assemble([*held, Support("lower", "bottom", len(across))], [Pressure("upper", "top", 1.0)])
    method = cq.pair_mortar if mortar else cq.pair_node_to_segment
    pairing = method(structure.surface("upper", "bottom"), structure.surface("lower", "top"))
    return float(np.abs(pairing.pressure(forces(pairing, system, cq.solve(system.problem([pairing])))) - 1).max())


def _row(*cells: str) -> None:
    print("| " + " | ".join(cells) + " |")


def _numbers(values: list[float]) -> str:
    return ", ".join(f"{value:.4f}" if value > 1e-9 else "0" for value in values)


def main(arguments: list[str] | None = None) -> int:
    argparse.ArgumentParser(description="nodal pressures against closed forms").parse_args(arguments)
    bad = []
    _row("Hertz", "element", "r < 0.7", "axis", "any node", "of what is allowed")
    _row(*["---"] * 6)
    for model, kind in CASES:
        levels = []
        for finer in (1.0, 1.5) if model == "3d" else (0.5, 1.0, 2.0):
            surface, r, pressure = hertz(model, kind, finer)
            error, allowed = hertz_errors(surface, pressure, linear=kind in LINEAR)
            part = float((error / np.where(allowed > 0, allowed, 1e-12)).max())
            levels.append([float(e) for e in (error[r < 0.7].max(), error[np.argmin(r)], error.max(), part)])
        _row(model, kind, *[_numbers(list(column)) for column in zip(*levels, strict=True)])
        bad += [f"Hertz {model} {kind}"] * any(level[-1] > 1 for level in levels)
    print()
    _row("flat punch", "element", "r <= 0.5", "order")
    _row(*["---"] * 4)
    for model, kind in CASES:
        cells = (3, 6) if model == "3d" else (5, 10, 20)
        errors = [punch_error(model, kind, n) for n in cells]
        finer = cells[-1] / cells[0]
        _row(model, kind, _numbers(errors), f"{np.log(errors[0] / errors[-1]) / np.log(finer):.2f}")
        bad += [f"punch {model} {kind}"] * (errors[-1] > errors[0] / finer**LEAST_ORDER + BLOCK)
    print()
    _row("Lame", "5, 10, 20 facets that match", "11 on 8, 22 on 16, 44 on 32")
    _row(*["---"] * 3)
    for kind in PLANE_KINDS:
        each = [[(n, n) for n in (5, 10, 20)], [(11 * n, 8 * n) for n in (1, 2, 4)]]
        found = [[press_fit(kind, cells, 1e-3) for cells in level] for level in each]
        errors = [[float(np.abs(pressure - 1).max()) for _, pressure in level] for level in found]
        told = ", told" * any(pairing.notes for pairing, _ in found[1])
        _row(kind, _numbers(errors[0]), _numbers(errors[1]) + told)
        bad += [f"Lame {kind}"] * (errors[0][-1] > max(FACETS, errors[0][0] / 2))
    print()
    _row("patch", "element", "4 on 4", "8 on 5, 5 on 8, 24 on 17 (3D: 4 on 3, 3 on 4)", "mortar")
    _row(*["---"] * 5)
    for model, kind in CASES:
        unlike = [(4, 3), (3, 4)] if model == "3d" else [(8, 5), (5, 8), (24, 17)]
        weighed = kind in LINEAR and model != "axisymmetric"
        mortar = [patch_error(kind, model, cells, mortar=True) for cells in unlike] if weighed else []
        uneven = [patch_error(kind, model, cells) for cells in unlike]
        _row(model, kind, _numbers([patch_error(kind, model, (4, 4))]), _numbers(uneven), _numbers(mortar) or "-")
    for name in bad:
        print(f"not met: {name}")
    return int(bool(bad))


if __name__ == "__main__":
    raise SystemExit(main())
