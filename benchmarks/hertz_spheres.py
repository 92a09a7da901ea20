"""Hertz's contact of two elastic spheres by the mortar on meshes that do not match, against his closed form.

    python -m benchmarks.hertz_spheres                # 485 to 34 976 unknowns, 6 s

With 1/R = 1/R1 + 1/R2, 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2 and a contact of radius a (Johnson 1985, section 4.2(a)):

    p = p0 sqrt(1 - r^2/a^2),  p0 = 2 E* a / (pi R),  P = 2 pi a^2 p0 / 3,  approach a^2 / R

A quarter of each sphere near the contact, |x|, |y| <= 2 a and 2 a deep, carries on its outer sides the displacement of
the half-space under p: Boussinesq's point loads (Johnson 1985, eq. 3.19) summed over the contact. So nothing stands
for infinity, the approach is given, and the force is the mesh's own. Exit code 1 if a target is missed: the fitted
order of the force and of the pressure in L1 at least 0.9, peak pressure off by at most 2 % at last, and the edge of
contact never off by an element.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial

import numpy as np

import contactqp as cq
from benchmarks.h1_error import Vector, order
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support

CONTACT = 1.0  # a
DEPTH = 2 * CONTACT
RADII = (2e4, 3e4)  # of the upper and of the lower sphere; a / R is small, as Hertz has it
MATERIALS = (Material(1000.0, 0.3), Material(2000.0, 0.25))
LEAST_ORDER, LARGEST_PEAK_ERROR = 0.9, 0.02


@dataclass(frozen=True)
class Level:
    """One pair of meshes: relative errors of the force, the peak pressure and, in L1 over P, the pressure.

    `radius` is that of the last node that presses, less a, in elements of the slave.
    """

    size: float
    unknowns: int
    force: float
    peak: float
    l1: float
    radius: float


@dataclass(frozen=True)
class Hertz:
    """The closed form for one pair of materials and radii."""

    curvature: float = 1 / RADII[0] + 1 / RADII[1]

    @property
    def effective(self) -> float:
        """E*."""
        return 1 / sum((1 - material.poisson**2) / material.modulus for material in MATERIALS)

    @property
    def peak(self) -> float:
        """p0 [force / length^2]."""
        return 2 * self.effective * CONTACT * self.curvature / np.pi

    @property
    def force(self) -> float:
        """P [force]."""
        return 2 * np.pi * CONTACT**2 * self.peak / 3

    @property
    def approach(self) -> float:
        """Of points far away from the contact [length]."""
        return CONTACT**2 * self.curvature

    def pressure(self, r: Vector) -> Vector:
        """p(r)."""
        return self.peak * np.sqrt(np.maximum(0.0, 1 - (r / CONTACT) ** 2))


def half_space(x: Vector, material: Material, hertz: Hertz) -> Vector:
    """u at (p, 3) points beside or beneath the contact, z the depth: point loads summed over the disc r < a, (p, 3).

    With t = sqrt(1 - r^2 / a^2) the force on a ring is p0 a^2 t^2 dt dphi: Gauss in t, equal angles in phi.
    """
    t, weight = np.polynomial.legendre.leggauss(24)
    t, weight = (t + 1) / 2, weight / 2
    angles = 64
    phi = 2 * np.pi * (np.arange(angles) + 0.5) / angles
    radius = CONTACT * np.sqrt(1 - t**2)
    where = np.stack([np.outer(radius, np.cos(phi)).ravel(), np.outer(radius, np.sin(phi)).ravel()], axis=1)
    load = np.repeat(hertz.peak * CONTACT**2 * t**2 * weight * 2 * np.pi / angles, angles)
    apart = x[:, None, :2] - where
    z = np.broadcast_to(x[:, None, 2], apart.shape[:2])
    rho = np.sqrt((apart**2).sum(axis=2) + z**2)
    nu = material.poisson
    sideways = z / rho**3 - (1 - 2 * nu) / (rho * (rho + z))
    down = z**2 / rho**3 + 2 * (1 - nu) / rho
    shear = material.modulus / (2 * (1 + nu))
    u = [np.einsum("pq,pq,q->p", apart[:, :, axis], sideways, load) for axis in (0, 1)]
    return np.stack([*u, down @ load], axis=1) / (4 * np.pi * shear)


def level(cells: int, radii: tuple[float, float] = RADII) -> Level:
    """The lower sphere in `cells`^3 hexahedra, the upper one, the slave, in (5/4 `cells`)^3; `cells` a multiple of 4.

    `radii` are what the meshes are given: others than RADII must miss the closed form.
    """
    hertz = Hertz()
    upper = _sphere("upper", 5 * cells // 4, radii[0], MATERIALS[0], up=True)
    lower = _sphere("lower", cells, radii[1], MATERIALS[1], up=False)
    structure = Structure([upper, lower])
    held = [Support(body, side, axis) for body in ("upper", "lower") for axis, side in enumerate(("left", "front"))]
    held += _surroundings("upper", MATERIALS[0], hertz, up=True) + _surroundings("lower", MATERIALS[1], hertz, up=False)
    system = structure.assemble(held)
    pairing = cq.pair_mortar(
        structure.surface("upper", "bottom"), structure.surface("lower", "top"), reach=DEPTH, overlap=hertz.approach
    )
    problem = system.problem([pairing])
    solution = cq.solve(problem)
    force = np.zeros(len(pairing.gap))
    force[system.free_contacts([pairing])] = solution.normal_force
    pressure, r = pairing.pressure(force), np.linalg.norm(pairing.points[:, :2], axis=1)
    size = DEPTH / upper.mesh.blocks[0].nodes.shape[0] ** (1 / 3)
    return Level(
        size,
        problem.dimension,
        abs(4 * float(force.sum()) / hertz.force - 1),
        abs(float(pressure.max()) / hertz.peak - 1),
        4 * float(abs(pressure - hertz.pressure(r)) @ pairing.area) / hertz.force,
        abs(float(r[force > 0].max()) - CONTACT) / size,
    )


def _sphere(name: str, cells: int, radius: float, material: Material, *, up: bool) -> Body:
    """A cube of the sphere's material; the side towards the other sphere has its curvature, the opposite one none."""
    low = 0.0 if up else -DEPTH
    cube = box((DEPTH, DEPTH, DEPTH), (cells, cells, cells), corner=(0.0, 0.0, low))

    def curved(x: Vector) -> Vector:
        rise = (1 if up else -1) * (x[:, 0] ** 2 + x[:, 1] ** 2) / (2 * radius)
        return x + np.column_stack([0 * rise, 0 * rise, rise * (1 - abs(x[:, 2]) / DEPTH)])

    return Body(cube.mapped(curved), material, "3d", name=name)


def _surroundings(body: str, material: Material, hertz: Hertz, *, up: bool) -> list[Support]:
    """What the rest of the half-space does to the outer sides, the upper one brought down by the approach."""
    turn = np.array([1.0, 1.0, 1.0 if up else -1.0])
    shift = np.array([0.0, 0.0, -hertz.approach if up else 0.0])

    def field(x: Vector, axis: int) -> Vector:
        depth = np.column_stack([x[:, :2], abs(x[:, 2])])
        u = half_space(depth, material, hertz) * turn + shift
        return np.where(x[:, axis] == 0, 0.0, u[:, axis]) if axis < 2 else u[:, axis]  # symmetry to the last digit

    outer = ("right", "back", "top" if up else "bottom")
    return [Support(body, side, axis, partial(field, axis=axis)) for side in outer for axis in range(3)]


def orders(levels: list[Level]) -> tuple[float, float]:
    """Fitted orders of the force and of the pressure in L1."""
    sizes = [found.size for found in levels]
    return order(sizes, [found.force for found in levels]), order(sizes, [found.l1 for found in levels])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--finest", type=int, default=16, help="cells of the lower sphere, 8 times a power of 2")
    finest = parser.parse_args(arguments).finest
    levels = []
    while 4 * 2 ** len(levels) <= finest:
        levels.append(level(4 * 2 ** len(levels)))
        found = levels[-1]
        print(
            f"{found.unknowns:6d} unknowns, size {found.size:.3f} a: force off by {found.force:.4f}, peak pressure "
            f"{found.peak:.4f}, pressure in L1 {found.l1:.4f}, edge {found.radius:.2f} elements",
            flush=True,
        )
    force, l1 = orders(levels)
    print(f"order of the force {force:.2f}, of the pressure in L1 {l1:.2f}")
    sharp = levels[-1].peak <= LARGEST_PEAK_ERROR and all(found.radius < 1 for found in levels)
    return int(min(force, l1) < LEAST_ORDER or not sharp)


if __name__ == "__main__":
    raise SystemExit(main())
