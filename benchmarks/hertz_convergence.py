"""Hertz's ball under refinement: the contact force at given approaches, and the peak pressure against his relation.

Every number is a mean over several approaches, because the edge of contact falls somewhere within an element, and both
errors swing with where. Hertz (Johnson 1985, section 4.2(a)): p0 = (6 P E*^2 / (pi^3 R^2))^(1/3). The force at an
approach has no closed form on a half ball, which is no half-space; its order is that of the differences between meshes.

    python -m benchmarks.hertz_convergence --finest 48

Exit code 1 where an order is below 0.9, or the peak pressure on the finest mesh off by more than 1 %.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.scene.building import build
from contactqp.scene.scene import Scene
from contactqp.solving.solve import solve

RADIUS, MODULUS, POISSON = 10.0, 21e3, 0.3  # mm, MPa
LEAST_ORDER, LARGEST_ERROR = 0.9, 0.01
APPROACHES = (30, 35, 40, 45, 50, 55, 60)  # um


@dataclass(frozen=True)
class Level:
    """One mesh: its unknowns, forces at the approaches [N], and mean |p / p0 - 1|."""

    divisions: int
    unknowns: int
    forces: NDArray[np.float64]
    pressure_error: float


def ball(divisions: int, approach: float, element: str = "quad4") -> Scene:
    """The lower half of a ball, its flat side pushed down by `approach` [um] on a rigid plane."""
    shape = dict(kind="quarter-disc", element=element, radius="10 mm", divisions=[divisions, divisions], grading=20)
    return Scene(
        title="A ball on a plane",
        units={"length": "mm", "force": "N"},
        axes=["x", "y"],
        obstacles=[{"name": "plane", "point": ["0 mm", "-10 mm"], "normal": [0, 1]}],
        contacts=[{"name": "foot", "side": "ball.arc", "obstacle": "plane"}],
        supports=[
            {"name": "axis", "on": "ball.left", "axis": "x"},
            {"name": "lid", "on": "ball.top", "axis": "y", "value": f"-{approach} um"},
        ],
        bodies=[{"name": "ball", "shape": shape, "model": "axisymmetric", "modulus": "21 GPa", "poisson": POISSON}],
    )


def level(divisions: int, approaches: Iterable[float] = APPROACHES) -> Level:
    """Solve all approaches on one mesh."""
    forces, errors, unknowns = [], [], 0
    effective = MODULUS / (1 - POISSON**2)
    for approach in approaches:
        model = build(ball(divisions, approach))
        solution = solve(model.problem)
        force = float(model.normal_forces("foot", solution).sum())
        peak = (6 * force * effective**2 / (np.pi**3 * RADIUS**2)) ** (1 / 3)
        forces.append(force)
        errors.append(abs(float(np.nanmax(model.pressures("foot", solution))) / peak - 1))
        unknowns = model.problem.dimension
    return Level(divisions, unknowns, np.array(forces), float(np.mean(errors)))


def orders(levels: list[Level]) -> tuple[float, float]:
    """Fitted orders in the element size of the force's differences and of the peak pressure's error."""
    sizes = 1 / np.array([found.divisions for found in levels], dtype=float)
    steps = [np.mean(abs(a.forces - b.forces) / b.forces) for a, b in itertools.pairwise(levels)]
    force = np.polyfit(np.log(sizes[:-1]), np.log(steps), 1)[0]
    pressure = np.polyfit(np.log(sizes), np.log([found.pressure_error for found in levels]), 1)[0]
    return float(force), float(pressure)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Hertz's ball under refinement")
    parser.add_argument(
        "--finest", type=int, default=48, help="divisions of the finest mesh, 6 times a power of 2, at least 24"
    )
    finest = parser.parse_args(arguments).finest
    levels = []
    while 6 * 2 ** len(levels) <= finest:
        levels.append(level(6 * 2 ** len(levels)))
        found = levels[-1]
        middle = found.forces[len(found.forces) // 2]
        print(f"{found.divisions:3d} divisions {found.unknowns:6d} unknowns  force at 45 um {middle:8.2f} N", end="")
        print(f"  peak pressure off by {found.pressure_error:.4f}")
    force, pressure = orders(levels)
    print(f"order of the force {force:.2f}, of the peak pressure {pressure:.2f}")
    return int(min(force, pressure) < LEAST_ORDER or levels[-1].pressure_error > LARGEST_ERROR)


if __name__ == "__main__":
    raise SystemExit(main())
