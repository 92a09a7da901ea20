"""What contact costs at size: friction, free bodies, mortar, steps and backends, in units of the frictionless problem.

    python -m benchmarks.at_size                                   # the small sizes: tens of minutes
    python -m benchmarks.at_size --sizes 74k 219k 1M --rows frictionless friction
    python -m benchmarks.at_size --sizes plane-500k plane-2M --rows frictionless friction step

A box of hexahedra (a rectangle of quadrilaterals in the plane) twice as wide as high is moved down onto a paraboloid by
supports on its top, or pressed onto it by forces and held by two planes of symmetry (`free along z`) or by nothing at
all (`free`). Two boxes meet by the mortar. Every cell is a process of its own, which poses the problem, solves it once
by `cq.solve` with its certificate, and says seconds, peak memory, the way that was taken and what the certificate
states; posing it is not timed. With `--forge` its largest contact force, or one force in a hundred, is then made
a hundredth larger, and the answer to a load a hundredth larger is taken for its own: the certificate has to refuse all.
A cell that ends with an error says that error. Threads are those of the environment.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.model.summary import verdict_of

# Cells along the width: unknowns are about 3/2 cells^3 in space, cells^2 in the plane.
SIZES = {"20k": 24, "74k": 36, "219k": 52, "1M": 88, "plane-500k": 700, "plane-2M": 1400}
PRESSED, WEIGHT, FRICTION = 0.02, 0.02, 0.3
MATERIAL = Material(1.0, 0.3)
# A thrown body: its wave takes about so many steps from the contact to its top, and so many steps are timed.
STEPS_A_PASSAGE, STEPS = 20, 10
PATIENCE = 900


def _body(cells: int, name: str, plane: bool, low: float = 0.0, curved: float = 0.0) -> Body:
    half = cells // 2
    if plane:
        return Body(rectangle(1.0, 0.5, (cells, half)), MATERIAL, "plane-strain", name=name)
    shape = box((1.0, 1.0, 0.5), (cells, cells, half), corner=(0.0, 0.0, low))

    def raised(x: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        rise = curved * ((x[:, 0] - 0.5) ** 2 + (x[:, 1] - 0.5) ** 2) * (1 - abs(x[:, 2]) / 0.5)
        return x + np.column_stack([0 * rise, 0 * rise, rise])

    return Body(shape.mapped(raised) if curved else shape, MATERIAL, "3d", name=name)


def _paraboloid(plane: bool, centre: float) -> cq.Paraboloid:
    return cq.Paraboloid([centre, 0.0] if plane else [centre, centre, 0.0], [0.0, 1.0] if plane else [0, 0, 1.0], 5.0)


def supported(cells: int, plane: bool, friction: float | None = None) -> cq.ContactProblem:
    """Its top moved down."""
    structure = Structure([_body(cells, "block", plane)])
    axes = range(2 if plane else 3)
    held = [Support("block", "top", axis, -PRESSED if axis == axes[-1] else 0.0) for axis in axes]
    pair = cq.pair(structure.surface("block", "bottom"), _paraboloid(plane, 0.5))
    return structure.assemble(held).problem([pair], friction=friction)


def pressed(cells: int, plane: bool, symmetric: bool, friction: float | None = None) -> cq.ContactProblem:
    """Forces on its top, and two planes of symmetry or no support at all."""
    body = _body(cells, "block", plane)
    structure = Structure([body])
    held = [Support("block", side, axis) for axis, side in enumerate(["left"] if plane else ["left", "front"])]
    assembled = structure.assemble(held if symmetric else [])
    pair = cq.pair(structure.surface("block", "bottom"), _paraboloid(plane, 0.0 if symmetric else 0.5))
    problem = assembled.problem([pair], friction=friction)
    points, force = body.mesh.points, np.zeros(body.size)
    width = points.shape[1]
    top = np.flatnonzero(points[:, -1] == np.max(points[:, -1]))
    share = np.prod(np.where((points[top, :-1] == 0) | (points[top, :-1] == 1), 0.5, 1.0), axis=1)
    force[width * top + width - 1] = -WEIGHT * share / np.sum(share)
    return problem.replace(load=force[assembled.free])


def mortar(cells: int, plane: bool, friction: float | None = None) -> cq.ContactProblem:
    """A curved box on a flat one of other cells, both of the size of half the unknowns."""
    if plane:
        raise cq.Unsupported("two bodies are posed in space only")
    cells = round(cells / 2 ** (1 / 3))
    upper, lower = _body(cells, "upper", plane, curved=0.1), _body(9 * cells // 20 * 2, "lower", plane, low=-0.5)
    structure = Structure([upper, lower])
    held = [Support("upper", "top", axis, -PRESSED if axis == 2 else 0.0) for axis in range(3)]
    held += [Support("lower", "bottom", axis) for axis in range(3)]
    pair = cq.pair_mortar(structure.surface("upper", "bottom"), structure.surface("lower", "top"), reach=0.2)
    return structure.assemble(held).problem([pair], friction=friction)


class Spent(NamedTuple):
    """Seconds by the clock, and of the processor, which other work on the machine does not count in."""

    seconds: float
    processor: float


def _timed(call: Callable[[], Any]) -> tuple[Spent, Any]:
    started = time.perf_counter(), time.process_time()
    found = call()
    return Spent(time.perf_counter() - started[0], time.process_time() - started[1]), found


def _once(problem: cq.ContactProblem, method: str = "active-set", **options: float) -> tuple[Spent, Any]:
    return _timed(lambda: cq.solve(problem, method, **options))


def _next(problem: cq.ContactProblem) -> tuple[Spent, Any]:
    """The step that follows: pressed down by a tenth more, started from the first."""
    first = cq.solve(problem)
    return _timed(lambda: cq.solve(problem.replace(load=1.1 * problem.load), warm_start=first))


def _thrown(problem: cq.ContactProblem, plane: bool) -> tuple[Spent, Any]:
    """A step of an impact: the difference of two motions of the free body, the longer by STEPS."""
    height, cells = 0.5, problem.dimension
    mass = sp.identity(cells, format="csc") * (0.5 / cells * (2 if plane else 3))
    velocity = np.zeros(cells)
    velocity[1 if plane else 2 :: 2 if plane else 3] = -0.02
    step = height / STEPS_A_PASSAGE  # the wave travels by about one a second
    spent, taken = [], []
    for steps in (2, 2 + STEPS):
        twin = problem.replace(stiffness=problem.stiffness)
        motion = partial(cq.impact, twin, mass, np.zeros(cells), velocity, steps * step, step)
        of_motion, history = _timed(motion)
        spent.append(of_motion)
        taken.append(history[-1].work.back_substitutions)  # of the motion so far
    print(f"back-substitutions a step: {(taken[1] - taken[0]) / STEPS}", file=sys.stderr)
    return Spent(*((long - short) / STEPS for short, long in zip(*spent, strict=True))), history[-1]


# An interior point, a first-order method, and two of the classical enforcements.
OTHERS: dict[str, dict[str, float]] = {
    "clarabel": {},
    "osqp": {},
    "penalty": {"penalty": 1e3},
    "lagrange-multiplier": {},
}


def _by(method: str, **options: float) -> Callable[[int, bool], tuple[Spent, Any]]:
    return lambda cells, plane: _once(supported(cells, plane), method, **options)


ROWS: dict[str, Callable[[int, bool], tuple[Spent, Any]]] = {
    "frictionless": lambda cells, plane: _once(supported(cells, plane)),
    "friction": lambda cells, plane: _once(supported(cells, plane, FRICTION)),
    "free along z": lambda cells, plane: _once(pressed(cells, plane, symmetric=True)),
    "free along z, friction": lambda cells, plane: _once(pressed(cells, plane, True, FRICTION)),
    "free": lambda cells, plane: _once(pressed(cells, plane, symmetric=False)),
    "free, friction": lambda cells, plane: _once(pressed(cells, plane, False, FRICTION)),
    "mortar": lambda cells, plane: _once(mortar(cells, plane)),
    "mortar, friction": lambda cells, plane: _once(mortar(cells, plane, FRICTION)),
    "step": lambda cells, plane: _next(supported(cells, plane)),
    "step, friction": lambda cells, plane: _next(supported(cells, plane, FRICTION)),
    "impact": lambda cells, plane: _thrown(pressed(cells, plane, symmetric=False), plane),
    "impact, friction": lambda cells, plane: _thrown(pressed(cells, plane, False, FRICTION), plane),
    **{name: _by(name, **options) for name, options in OTHERS.items()},
}


def _forgeries_refused(solution: Any) -> bool:
    """Whether forces that are a hundredth off are refused, and so is the right answer to a load a hundredth larger.

    Off are the largest force, and those of one closed contact in a hundred.
    """
    problem, force, several = solution.problem, solution.normal_force.copy(), solution.normal_force.copy()
    force[int(np.argmax(force))] *= 1.01
    several[np.flatnonzero(several > 0)[::100]] *= 1.01
    other = cq.solve(problem.replace(load=1.01 * problem.load), warm_start=solution)
    forged = (
        *((solution.displacement, given, solution.friction_force, solution.tie_force) for given in (force, several)),
        (other.displacement, other.normal_force, other.friction_force, other.tie_force),
    )
    return not any(cq.certify(problem, *answer).passed for answer in forged)


def cell(row: str, size: str, forge: bool = False) -> dict[str, Any]:
    """What one cell came to, in this process."""
    cells, plane = SIZES[size], size.startswith("plane")
    try:
        spent, solution = ROWS[row](cells, plane)
    except cq.ContactQPError as error:
        return {"error": f"{type(error).__name__}: {error}"}
    certificate, work = solution.certificate, solution.work
    return {
        "seconds": spent.seconds,
        "processor": spent.processor,
        "unknowns": solution.problem.dimension,
        "contacts": solution.problem.contacts,
        "closed": int(np.sum(solution.normal_force > 0)),
        "solver": work.solver,
        "verdict": verdict_of(certificate),
        "error_bound": certificate.energy_error,
        "back_substitutions": work.back_substitutions,
        "forgeries_refused": _forgeries_refused(solution) if forge else None,
    }


def _in_a_process(row: str, size: str, forge: bool) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.at_size", "--cell", row, size, *(["--forge"] if forge else [])]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return {"error": f"no answer after {PATIENCE} s"}
    if ended.returncode:
        return {"error": f"ended with {ended.returncode}: {(ended.stderr.strip().splitlines() or [''])[-1]}"}
    found: dict[str, Any] = json.loads(ended.stdout.splitlines()[-1])
    return found


FORGED = {None: "", True: ", 1 % off: refused", False: ", 1 % off: PASSED"}


def _line(row: str, size: str, found: dict[str, Any], reference: dict[str, Any] | None) -> str:
    head = f"{size:12}{row:24}"
    if "error" in found:
        return f"{head}{found['error']}"
    prices = [found[of] / reference[of] for of in ("seconds", "processor")] if reference else []
    price = " and ".join(f"{one:.2f}" for one in prices)
    bound = "" if found["error_bound"] is None else f", energy error {found['error_bound']:.1e}"
    return (
        f"{head}{found['seconds']:9.2f} s, {found['processor']:.2f} of the processor, {price} x, "
        f"{found['memory']:.2f} GiB, {found['unknowns']} unknowns, "
        f"{found['closed']} of {found['contacts']} contacts, {found['solver']}, "
        f"{found['back_substitutions']} back-substitutions, {found['verdict']}{bound}"
        f"{FORGED[found['forgeries_refused']]}"
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=["20k", "74k"])
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--forge", action="store_true", help="have wrong answers refused, too; memory is then of both")
    parser.add_argument("--cell", nargs=2, help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.cell:
        found = cell(*chosen.cell, chosen.forge)
        found["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(json.dumps(found))
        return 0
    threads = os.environ.get("OMP_NUM_THREADS", "as many as there are cores")
    print(f"{os.cpu_count()} cores, threads: {threads}; x: seconds, then of the processor, in those of frictionless")
    for size in chosen.sizes:
        reference: dict[str, Any] | None = None
        for row in chosen.rows:
            found = _in_a_process(row, size, chosen.forge)
            reference = found if row == "frictionless" and "error" not in found else reference
            print(_line(row, size, found, reference), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
