"""What a block held by contact alone costs, in units of the same block supported.

    python -m benchmarks.floating_bodies                        # PARDISO if installed
    python -m benchmarks.floating_bodies --solver superlu --sizes 15000

A block of hexahedra is pressed on a paraboloid, contact on one whole face: moved down by supports of its whole top
(`supported`, of one layer more, so that it has as many unknowns), pressed by forces on its top, which springs hold too
(`bedded`), pressed and held by nothing else (`floating`), or the same with two planes of symmetry (`quarter`). `stated`
are problems with their `near_null_space`, `bare` those without. One process; the kinds take turns, each on a fresh
problem, `cq.solve` with its certificate; medians of the ratios of a round to the supported and to the bedded block that
are stated likewise. Exit code 1 if one that floats takes more than 1.5 times as long as the supported. Assembly is left
out. Threads are those of the environment (OMP_NUM_THREADS, MKL_NUM_THREADS), which the first line states; one more
thread lays matrices out while another factorises.

With `--others`, in seconds alone, for comparison between versions: a plane floating block, and the bedded and the
floating block with friction.
"""

from __future__ import annotations

import argparse
import importlib.util
import os

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from benchmarks.price_of_contact import block, fresh, timed
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support

WEIGHT = 0.02  # the whole force on the top: some of the contacts close
BED = 1e-3  # springs at each unknown of the top, Young's modulus and length of the block being one
FRICTION = 0.3
REFERENCES = ("supported", "bedded")
MOST = 1.5  # times the supported block that one held by contact alone may take


def pressed(unknowns: int, supports: list[Support], friction: float | None = None) -> cq.ContactProblem:
    """A block of about that many unknowns, pressed down by forces on its top and held by these supports alone."""
    cells = round((unknowns / 3 / 0.7) ** (1 / 3))
    body = Body(box((1.0, 1.0, 0.7), (cells, cells, round(0.7 * cells))), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    centre = [0.0, 0.0, 0.0] if supports else [0.5, 0.5, 0.0]
    paraboloid = cq.Paraboloid(centre, [0.0, 0.0, 1.0], 5.0)
    assembled = structure.assemble(supports)
    problem = assembled.problem([cq.pair(structure.surface("block", "bottom"), paraboloid)], friction=friction)
    points, force = body.mesh.points, np.zeros(body.size)
    top = np.flatnonzero(points[:, 2] == np.max(points[:, 2]))
    # Half the force within each side that ends a row of nodes: the resultant lies over the middle of the top.
    share = np.prod(np.where((points[top, :2] == 0) | (points[top, :2] == 1), 0.5, 1.0), axis=1)
    force[3 * top + 2] = -WEIGHT * share / np.sum(share)
    return problem.replace(load=force[assembled.free])


def bedded(problem: cq.ContactProblem) -> cq.ContactProblem:
    """The problem of a free block with springs on the three unknowns of every node that is pressed."""
    springs, pressed_down = np.zeros(problem.dimension), np.flatnonzero(problem.load)
    springs[np.concatenate([pressed_down - 2, pressed_down - 1, pressed_down])] = BED
    return problem.replace(stiffness=problem.stiffness + sp.diags(springs, format="csc"))


def plane(unknowns: int) -> cq.ContactProblem:
    """A plane block of about that many unknowns, pressed on a parabola by forces on its top and held by nothing."""
    cells = round(np.sqrt(unknowns / 4))
    body = Body(rectangle(1.0, 0.5, (2 * cells, cells)), Material(1.0, 0.3), "plane-strain", name="block")
    structure = Structure([body])
    assembled = structure.assemble([])
    paraboloid = cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0)
    problem = assembled.problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])
    points, force = body.mesh.points, np.zeros(body.size)
    top = np.flatnonzero(points[:, 1] == np.max(points[:, 1]))
    share = np.where((points[top, 0] == 0) | (points[top, 0] == 1), 0.5, 1.0)
    force[2 * top + 1] = -WEIGHT * share / np.sum(share)
    return problem.replace(load=force[assembled.free])


def kinds(unknowns: int) -> dict[str, cq.ContactProblem]:
    """The problems that are compared, the references first, each stated and bare."""
    symmetric = [Support("block", "left", 0), Support("block", "front", 1)]
    floating = pressed(unknowns, [])
    stated = {
        "supported": block(unknowns, 3, more_layers=1),
        "bedded": bedded(floating),
        "floating": floating,
        "quarter": pressed(unknowns, symmetric),
    }
    bare = {f"{name}, bare": problem.replace(near_null_space=None) for name, problem in stated.items()}
    return stated | bare


def others(unknowns: int) -> dict[str, cq.ContactProblem]:
    """A plane floating block, twice as many unknowns, and blocks with friction, each stated and bare."""
    free = pressed(unknowns, [], FRICTION)
    supported, flat = bedded(free), plane(2 * unknowns)
    return {
        "plane": flat,
        "plane, bare": flat.replace(near_null_space=None),
        "friction, bedded": supported,
        "friction, bedded, bare": supported.replace(near_null_space=None),
        "friction, floating": free,
        "friction, floating, bare": free.replace(near_null_space=None),
    }


def rounds(
    problems: dict[str, cq.ContactProblem], repeats: int
) -> tuple[dict[str, list[float]], dict[str, cq.Solution]]:
    """The seconds of every problem in every round after the first, which warms up, and the last solutions."""
    seconds: dict[str, list[float]] = {name: [] for name in problems}
    solutions: dict[str, cq.Solution] = {}
    for round_ in range(repeats + 1):
        for name, problem in problems.items():
            solutions.pop(name, None)
            twin = fresh(problem)
            taken, solutions[name] = timed(lambda twin=twin: cq.solve(twin))
            if round_:
                seconds[name].append(taken)
    return seconds, solutions


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="*", default=[15_000, 47_000], help="unknowns")
    parser.add_argument("--solver", choices=("pardiso", "superlu"), help="by default the fastest installed")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--others", action="store_true", help="plane blocks and friction, in seconds")
    chosen = parser.parse_args(arguments)
    solver = chosen.solver or ("pardiso" if importlib.util.find_spec("pypardiso") else "superlu")
    os.environ["CONTACTQP_SPARSE_SOLVER"] = solver
    threads = ", ".join(f"{name}={os.environ.get(name, 'unset')}" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS"))
    print(f"sparse solver: {solver}; {threads}; median of {chosen.repeats} rounds")
    slow = []
    for unknowns in chosen.sizes:
        problems = others(unknowns) if chosen.others else kinds(unknowns)
        seconds, solutions = rounds(problems, chosen.repeats)
        for name, problem in problems.items():
            stated = name.split(",")[1:]
            references = {} if chosen.others else {of: ",".join([of, *stated]) for of in REFERENCES}
            ratios = "".join(
                f"  x {_ratio(seconds[name], seconds[reference]):.2f} of {of}" for of, reference in references.items()
            )
            if not chosen.others and _ratio(seconds[name], seconds[",".join(["supported", *stated])]) > MOST:
                slow.append(f"{problem.dimension} unknowns, {name}")
            work, certificate = solutions[name].work, solutions[name].certificate
            print(
                f"{problem.dimension:>8d} unknowns  {name:26s}{np.median(seconds[name]):>8.2f} s{ratios}  "
                f"{work.factorisations} factorisation, {work.back_substitutions} back-substitutions, "
                f"{'passed' if certificate.passed else 'REFUSED'}",
                flush=True,
            )
    for name in slow:
        print(f"not met: {name}: more than {MOST} times the supported block")
    return int(bool(slow))


def _ratio(seconds: list[float], reference: list[float]) -> float:
    """The median of the ratios of the rounds."""
    return float(np.median(np.array(seconds) / reference))


if __name__ == "__main__":
    raise SystemExit(main())
