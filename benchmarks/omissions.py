"""What each thing that a scene leaves out saves, in time and memory, against bringing it in all the same.

    python -m benchmarks.omissions                  # a few minutes
    python -m benchmarks.omissions --size 2000 --rounds 3
    python -m benchmarks.omissions --only condensation "mass matrix"

What is solved either way has the same answer, which is checked. Times are the least of rounds in which both take turns
in one process, each on a fresh problem; memory is the most that a process of its own for each way holds beyond what it
held before. What is imported or not is measured in fresh processes altogether, which solve a bar at a wall: processor
time, the least of the rounds, and all memory of the process.
"""

from __future__ import annotations

import argparse
import gc
import importlib.util
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import contactqp as cq
from contactqp.certificate.subset_bounds import take_all
from contactqp.elements.loads import solid_mass
from contactqp.elements.material import Material
from contactqp.elements.pairing import pair_scalar
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body, Membrane
from contactqp.elements.structure import Structure, Support, System
from contactqp.study.footprint_child import peak, resident

CASE = Path(__file__).parents[1] / "cases" / "bar_wall.toml"
STEPS = 10  # of the load path
SAME = 1e-6  # of the largest displacement: answers that differ by less are one
# Ratios nearer to one than this are what the clock scatters by.
SCATTER = 0.05
MEBIBYTE = 2**20
Displacement = np.ndarray[Any, Any]
Way = Callable[[], Displacement]


@dataclass(frozen=True)
class Omission:
    """Two ways to one answer: `ways(size)` are the lean one and that with more, for about so many unknowns."""

    name: str
    brought_in: str  # what the second way has and the first has not
    ways: Callable[[int], tuple[Way, Way]]
    share: float = 1.0  # of the size asked for, where a part of it is enough


@dataclass(frozen=True)
class Saving:
    """What an omission saves: seconds and bytes of the lean way and of the full one."""

    name: str
    brought_in: str
    unknowns: int | None
    lean_seconds: float
    full_seconds: float
    lean_bytes: int | None
    full_bytes: int | None

    @property
    def ratio(self) -> float:
        return self.full_seconds / self.lean_seconds

    @property
    def verdict(self) -> str:
        if abs(self.ratio - 1) <= SCATTER:
            return "no time that can be measured"
        if self.ratio < 1:
            return f"{1 / self.ratio:.3g} times as fast with it"
        return f"{self.ratio:.3g} times as long with it"


@dataclass(frozen=True)
class Block:
    """A plane-strain block, its top moved down onto a tilted plane."""

    structure: Structure
    system: System
    pairing: Any
    plane: cq.Plane

    @classmethod
    def of(cls, unknowns: int) -> Block:
        cells = max(round(np.sqrt(unknowns / 4)), 2)
        mesh, material = rectangle(1.0, 0.5, (2 * cells, cells)), Material(1.0, 0.3, density=1.0)
        body = Body(mesh, material, "plane-strain", name="block")
        structure, plane = Structure([body]), cq.Plane([0.0, -0.01], [0.05, 1.0])
        system = structure.assemble([Support("block", "top", axis, -0.02 * axis) for axis in range(2)])
        return cls(structure, system, cq.pair(structure.surface("block", "bottom"), plane), plane)

    def problem(self, friction: float | None = None) -> cq.ContactProblem:
        return self.system.problem([self.pairing], friction=friction)

    def contact(self) -> cq.ObstacleContact:
        """The same contacts with gaps and normals that follow the nodes."""
        surface = self.structure.surface("block", "bottom")
        nodes = surface.nodes
        places = np.searchsorted(self.system.free, surface.unknowns[nodes])
        return cq.ObstacleContact(surface.points[nodes], self.plane, places, len(self.system.free))


@dataclass(frozen=True)
class LinearBody:
    """A stiffness as `large_deformation` takes bodies."""

    stiffness: Any

    @property
    def dimension(self) -> int:
        return int(self.stiffness.shape[0])

    def energy(self, displacement: Displacement) -> float:
        return float(displacement @ (self.stiffness @ displacement)) / 2

    def internal_force(self, displacement: Displacement) -> Displacement:
        return np.asarray(self.stiffness @ displacement)

    def tangent(self, displacement: Displacement) -> Any:
        del displacement
        return self.stiffness


def fresh(problem: cq.ContactProblem) -> cq.ContactProblem:
    """The same numbers with nothing computed from them."""
    return problem.replace(stiffness=problem.stiffness)


def solved(problem: cq.ContactProblem, **options: Any) -> Displacement:
    return cq.solve(fresh(problem), **options).displacement


def tangential_rows(unknowns: int) -> tuple[Way, Way]:
    block = Block.of(unknowns)
    return partial(solved, block.problem()), partial(solved, block.problem(friction=0.0))


def mass_matrix(unknowns: int) -> tuple[Way, Way]:
    block = Block.of(unknowns)

    def with_mass() -> Displacement:
        mass = solid_mass(block.structure.bodies[0])
        assert mass.shape[0] == block.structure.size
        return solved(block.problem())

    return lambda: solved(block.problem()), with_mass


def newton_loop(unknowns: int) -> tuple[Way, Way]:
    block = Block.of(unknowns)
    problem, contact = block.problem(), block.contact()

    def with_newton() -> Displacement:
        twin = fresh(problem)
        return cq.large_deformation(LinearBody(twin.stiffness), [twin.load], contact, steps=1)[-1].displacement

    return partial(solved, problem), with_newton


def condensation(unknowns: int, method: str) -> tuple[Way, Way]:
    problem = Block.of(unknowns).problem()
    return partial(solved, problem, method=method), partial(solved, problem, method=method, condense=False)


def one_factorisation(unknowns: int) -> tuple[Way, Way]:
    problem = Block.of(unknowns).problem()
    loads = [problem.load * (k + 1) / STEPS for k in range(STEPS)]

    def along_the_path() -> Displacement:
        history = cq.follow_path(fresh(problem), [problem.load], steps=STEPS)
        return [solution.displacement for solution in history][-1]

    def one_by_one() -> Displacement:
        return [solved(problem.replace(load=load)) for load in [0 * problem.load, *loads]][-1]

    return along_the_path, one_by_one


def contacts_out_of_reach(unknowns: int) -> tuple[Way, Way]:
    """A membrane that hangs over a ball, which each of its nodes may touch and few do."""
    cells = max(round(np.sqrt(unknowns)), 4)
    mesh = rectangle(4.0, 4.0, (cells, cells))
    mesh = replace(mesh, points=mesh.points - 2.0)
    structure = Structure([Membrane(mesh, 1.0)])
    held = [Support("membrane", side, 0) for side in ("left", "right", "bottom", "top")]
    x, y = mesh.points.T
    height = 0.7 - (x**2 + y**2)
    pairing = pair_scalar(mesh.points, height)
    problem = structure.assemble(held).problem([pairing])

    def with_all() -> Displacement:
        twin = fresh(problem)
        take_all(twin)
        return cq.solve(twin).displacement

    return partial(solved, problem), with_all


OMISSIONS = (
    Omission("tangential rows", "rows E_T with a friction of zero", tangential_rows),
    Omission("mass matrix", "the consistent mass matrix, in statics", mass_matrix),
    Omission("Newton loop", "tangents and gaps of large deformations, one step", newton_loop),
    Omission("condensation", "the full problem for active-set", partial(condensation, method="active-set")),
    Omission("condensation, osqp", "the full problem for osqp", partial(condensation, method="osqp"), 0.2),
    Omission("condensation, clarabel", "the full problem for clarabel", partial(condensation, method="clarabel"), 0.2),
    Omission("one factorisation", f"a factorisation for each of {STEPS} load steps", one_factorisation),
    Omission("contacts out of reach", "all contacts condensed onto", contacts_out_of_reach, 0.2),
)
# What else a bar could import, and does not.
IMPORTS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    (
        "finite elements",
        "meshes and elastic bodies of this package",
        ("contactqp.scene.body_model", "contactqp.elements.mortar"),
    ),
    ("finite-element library", "scikit-fem and meshlane", ("skfem", "meshlane")),
    (
        "friction",
        "the algorithms of Coulomb friction",
        ("contactqp.solving.friction_runs", "contactqp.solving.local_solving"),
    ),
    (
        "motions, large deformations",
        "time stepping and path following",
        ("contactqp.scene.moving", "contactqp.scene.moving", "contactqp.analysis.load_path"),
    ),
    ("plotting", "matplotlib and the pictures", ("matplotlib.figure", "contactqp.study.answer_pictures")),
    (
        "optional backends",
        "all QP backends and cvxpy",
        ("qpsolvers", "osqp", "clarabel", "piqp", "proxsuite", "daqp", "highspy", "scs", "qpalm", "cvxpy"),
    ),
    ("exact arithmetic", "python-flint and the oracle", ("flint", "contactqp.oracle.exact.rational_answer")),
    ("files of other codes", "h5py and the readers", ("h5py", "contactqp.exchange.problem_files")),
    ("sparse direct solver", "PARDISO's library (MKL)", ("contactqp.linalg.pardiso", "pypardiso")),
)


def alternated(ways: Sequence[Way], rounds: int) -> list[float]:
    """The least seconds of each way; both take turns, after a round to warm up, in which their answers are compared."""
    lean, full = (way() for way in ways)
    size = float(np.max(abs(lean)))
    if not np.max(abs(full - lean)) <= SAME * size:
        raise AssertionError(f"two answers: they differ by {np.max(abs(full - lean)):.3g} of {size:.3g}")
    times: list[list[float]] = [[] for _ in ways]
    for _ in range(rounds):
        for way, seconds in zip(ways, times, strict=True):
            gc.collect()
            started = time.perf_counter()
            way()
            seconds.append(time.perf_counter() - started)
    return [min(seconds) for seconds in times]


def memory_of(name: str, way: int, size: int) -> int | None:
    """Bytes that one way takes beyond what its process held before, in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.omissions", "--memory-of", name, str(way), "--size", str(size)]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return json.loads(said.splitlines()[-1])


def own_memory(omission: Omission, way: int, size: int) -> int | None:
    """In this process: a small problem first brings in what is imported on the way."""
    omission.ways(200)[way]()
    chosen = omission.ways(max(round(omission.share * size), 200))[way]
    gc.collect()
    before = resident()
    chosen()
    after = peak()
    return None if before is None or after is None else max(after - before, 0)


def of_ways(omission: Omission, size: int, rounds: int) -> Saving:
    ways = omission.ways(max(round(omission.share * size), 200))
    unknowns = len(ways[0]())
    lean, full = alternated(ways, rounds)
    taken = [memory_of(omission.name, way, size) for way in range(2)]
    return Saving(omission.name, omission.brought_in, unknowns, lean, full, *taken)


_BAR = """
import importlib, json, sys, time
from contactqp.study.footprint_child import peak
for name in sys.argv[2:]:
    importlib.import_module(name)
import contactqp as cq
assert cq.run(cq.load_scene(sys.argv[1]))[-1].certificate.passed
print(json.dumps([time.process_time(), peak()]))
"""


def bar_with(modules: Sequence[str]) -> tuple[float, int | None]:
    """Processor seconds and peak bytes of a fresh process that imports these and solves a bar at a wall."""
    command = [sys.executable, "-c", _BAR, str(CASE), *modules]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    seconds, most = json.loads(said.splitlines()[-1])
    return seconds, most


def of_imports(name: str, brought_in: str, modules: Sequence[str], rounds: int) -> Saving:
    runs = [(bar_with(()), bar_with(modules)) for _ in range(rounds)]
    lean, full = (min(run[k][0] for run in runs) for k in range(2))
    most = [runs[-1][k][1] for k in range(2)]
    return Saving(name, brought_in, None, lean, full, *most)


def installed(modules: Sequence[str]) -> list[str]:
    return [name for name in modules if importlib.util.find_spec(name.partition(".")[0]) is not None]


def header() -> str:
    return (
        f"{'left out':28s}{'unknowns':>9s}{'lean ms':>10s}{'with it ms':>12s}{'ratio':>8s}"
        f"{'lean MiB':>10s}{'with it MiB':>13s}  brought in"
    )


def line(saving: Saving) -> str:
    size = "" if saving.unknowns is None else str(saving.unknowns)
    memory = ["" if taken is None else f"{taken / MEBIBYTE:.1f}" for taken in (saving.lean_bytes, saving.full_bytes)]
    return (
        f"{saving.name:28s}{size:>9s}{1e3 * saving.lean_seconds:>10.1f}{1e3 * saving.full_seconds:>12.1f}"
        f"{saving.ratio:>8.2f}{memory[0]:>10s}{memory[1]:>13s}  {saving.brought_in}: {saving.verdict}"
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=20_000, help="unknowns of the block")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="*", metavar="NAME", help="by name")
    parser.add_argument("--memory-of", nargs=2, help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.memory_of:
        name, way = chosen.memory_of
        (omission,) = (one for one in OMISSIONS if one.name == name)
        print(json.dumps(own_memory(omission, int(way), chosen.size)))
        return 0
    wanted = chosen.only or [*(one.name for one in OMISSIONS), *(name for name, *_ in IMPORTS)]
    print(header())
    for omission in (one for one in OMISSIONS if one.name in wanted):
        print(line(of_ways(omission, chosen.size, chosen.rounds)), flush=True)
    for name, brought_in, modules in IMPORTS:
        if name in wanted:
            print(line(of_imports(name, brought_in, installed(modules), chosen.rounds)), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
