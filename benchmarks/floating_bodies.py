"""What a block held by contact alone costs, in units of the same block held at its top.

    python -m benchmarks.floating_bodies                        # PARDISO if installed
    python -m benchmarks.floating_bodies --solver superlu --sizes 15000

A block of hexahedra is pressed on a paraboloid, contact on one whole face: moved down by supports (`supported`),
pressed by forces on its top and held by nothing else (`floating`), or the same with two planes of symmetry
(`quarter`). One process; the kinds take turns, each on a fresh problem, `cq.solve` with its certificate. Assembly is
left out. Threads are those of the environment (OMP_NUM_THREADS, MKL_NUM_THREADS), which the first line states.
"""

from __future__ import annotations

import argparse
import importlib.util
import os

import numpy as np

import contactqp as cq
from benchmarks.price_of_contact import block, fresh, timed
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support

WEIGHT = 0.02  # the whole force on the top: some of the contacts close


def pressed(unknowns: int, supports: list[Support]) -> cq.ContactProblem:
    """A block of about that many unknowns, pressed down by forces on its top and held by these supports alone."""
    cells = round((unknowns / 3 / 0.7) ** (1 / 3))
    body = Body(box((1.0, 1.0, 0.7), (cells, cells, round(0.7 * cells))), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    centre = [0.0, 0.0, 0.0] if supports else [0.5, 0.5, 0.0]
    paraboloid = cq.Paraboloid(centre, [0.0, 0.0, 1.0], 5.0)
    assembled = structure.assemble(supports)
    problem = assembled.problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])
    points, force = body.mesh.points, np.zeros(body.size)
    top = np.flatnonzero(points[:, 2] == np.max(points[:, 2]))
    # Half the force within each side that ends a row of nodes: the resultant lies over the middle of the top.
    share = np.prod(np.where((points[top, :2] == 0) | (points[top, :2] == 1), 0.5, 1.0), axis=1)
    force[3 * top + 2] = -WEIGHT * share / np.sum(share)
    return problem.replace(load=force[assembled.free])


def kinds(unknowns: int) -> dict[str, cq.ContactProblem]:
    """The problems that are compared, the supported one first."""
    symmetric = [Support("block", "left", 0), Support("block", "front", 1)]
    return {
        "supported": block(unknowns, 3),
        "floating": pressed(unknowns, []),
        "quarter": pressed(unknowns, symmetric),
    }


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="*", default=[15_000, 47_000], help="unknowns")
    parser.add_argument("--solver", choices=("pardiso", "superlu"), help="by default the fastest installed")
    parser.add_argument("--repeats", type=int, default=5)
    chosen = parser.parse_args(arguments)
    solver = chosen.solver or ("pardiso" if importlib.util.find_spec("pypardiso") else "superlu")
    os.environ["CONTACTQP_SPARSE_SOLVER"] = solver
    threads = ", ".join(f"{name}={os.environ.get(name, 'unset')}" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS"))
    print(f"sparse solver: {solver}; {threads}")
    for unknowns in chosen.sizes:
        problems = kinds(unknowns)
        seconds: dict[str, list[float]] = {name: [] for name in problems}
        solutions = {}
        for round_ in range(chosen.repeats + 1):
            for name, problem in problems.items():
                solutions.pop(name, None)
                twin = fresh(problem)
                taken, solutions[name] = timed(lambda twin=twin: cq.solve(twin))
                if round_:  # the first round warms up
                    seconds[name].append(taken)
        for name, problem in problems.items():
            ratio = np.median(np.array(seconds[name]) / seconds["supported"])
            work, certificate = solutions[name].work, solutions[name].certificate
            print(
                f"{problem.dimension:>8d} unknowns  {name:10s}{np.median(seconds[name]):>8.2f} s  x {ratio:.2f}  "
                f"{work.factorisations} factorisation, {work.back_substitutions} back-substitutions, "
                f"{'passed' if certificate.passed else 'REFUSED'}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
