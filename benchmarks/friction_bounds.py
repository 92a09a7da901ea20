"""What a proven bound with friction costs: blocks with 200 rough contacts in the plane and in space, and beyond.

    python -m benchmarks.friction_bounds
    python -m benchmarks.friction_bounds --rounds 9

Supported on top, or held there by ties alone; judged are the answer of the solve, and the one that somebody else prints
with nine digits. "After" is the judgement of the answer of a solve whose factors are there, "alone" that of one whose
stiffness nothing has been computed of. Exit code 1 if a problem within the stated size has no bound, if a bound after
the solve takes more than half of it with up to 300 contacts, or if one is below the distance of the printed answer to
the refined one.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.shapes import box, rectangle
from contactqp.linalg.iteration import Systems, systems_of

# A bound after a solve may take this part of it.
MOST = 0.5
# Digits of the printed answer, and what it is judged at.
DIGITS, TOLERANCE, ERROR_TOLERANCE = 9, 1e-6, 1e-4
HEAD = f"{'block':<24}{'unknowns':>9}{'contacts':>9}{'ties':>6}  {'systems':<10}{'solve':>8}{'after':>8}{'alone':>8}"
HEAD += f"{'after/solve':>12}  {'scope':<8}{'error':>8}{'printed':>9}"


def block(mesh: Any, model: str, friction: float, tied: bool) -> cq.ContactProblem:
    """Return a block whose top is pressed onto a rough plane and pushed sideways, by supports or by ties alone."""
    body = cq.Body(mesh, cq.Material(modulus=1.0, poisson=0.3), model, name="block")
    structure = cq.Structure([body])
    up = 2 if model == "3d" else 1
    moved = {axis: 0.0 for axis in range(up + 1)} | {0: 0.002, up: -0.01}
    supports = [cq.Support("block", "top", axis, value) for axis, value in moved.items()]
    floor = cq.Plane([0.0] * (up + 1), [0.0] * up + [1.0])
    system = structure.assemble([] if tied else supports)
    problem = system.problem([cq.pair(structure.surface("block", "bottom"), floor)], friction=friction)
    return with_ties(problem, structure.surface("block", "top"), moved) if tied else problem


def with_ties(problem: cq.ContactProblem, top: Any, moved: dict[int, float]) -> cq.ContactProblem:
    """Return the problem of a block that nothing supports with a tie on every unknown of its top."""
    places = (len(moved) * np.asarray(top.nodes)[:, None] + np.arange(len(moved))).ravel()
    values = np.tile(list(moved.values()), len(top.nodes))
    rows = sp.csr_matrix((np.ones(len(places)), (np.arange(len(places)), places)), (len(places), problem.dimension))
    return cq.ContactProblem(
        problem.stiffness,
        problem.load,
        problem.normal,
        problem.gap,
        tangent=problem.tangent,
        friction=problem.friction,
        slip_origin=problem.slip_origin,
        tie=rows,
        tie_value=values,
        near_null_space=problem.near_null_space,
    )


def problems() -> dict[str, Callable[[], cq.ContactProblem]]:
    """Return what makes each problem of the table, by its name."""
    strip, cube = rectangle(2.0, 0.5, (199, 8)), box((1.0, 1.0, 0.3), (13, 13, 3))
    longer, wider = rectangle(4.0, 0.5, (399, 8)), box((1.0, 1.0, 0.3), (18, 18, 3))
    longest, widest = rectangle(7.0, 0.5, (699, 8)), box((1.0, 1.0, 0.3), (25, 25, 3))
    return {
        "plane, supported": lambda: block(strip, "plane-strain", 0.2, tied=False),
        "plane, tied": lambda: block(strip, "plane-strain", 0.2, tied=True),
        "space, supported": lambda: block(cube, "3d", 0.2, tied=False),
        "space, tied": lambda: block(cube, "3d", 0.2, tied=True),
        "plane, nearby alone": lambda: block(longer, "plane-strain", 0.2, tied=False),
        "space, nearby alone": lambda: block(wider, "3d", 0.2, tied=False),
        "plane, beyond the size": lambda: block(longest, "plane-strain", 0.2, tied=False),
        "space, beyond the size": lambda: block(widest, "3d", 0.2, tied=False),
    }


def fresh(problem: cq.ContactProblem) -> cq.ContactProblem:
    """Return the problem with a stiffness for which nothing has been computed."""
    return problem.replace(stiffness=problem.stiffness.copy())


def judged(problem: cq.ContactProblem, solution: Any, round_to: int | None = None) -> Any:
    """Return the certificate of the parts of a solution, printed with so many digits where these are stated."""

    def part(values: Any) -> Any:
        return values if round_to is None else np.vectorize(lambda x: float(f"{x:.{round_to - 1}e}"))(values)

    tie = part(solution.tie_force) if problem.ties else None
    limits = {} if round_to is None else {"tolerance": TOLERANCE, "error_tolerance": ERROR_TOLERANCE}
    parts = (solution.displacement, solution.normal_force, solution.friction_force)
    return cq.certify(problem, *(part(one) for one in parts), tie_force=tie, **limits)


def seconds(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the seconds of the processor that a call takes, and what it returns."""
    began = time.process_time()
    found = call()
    return time.process_time() - began, found


def row(name: str, problem: cq.ContactProblem, rounds: int) -> list[str]:
    """Print one line of the table and return what is wrong with it."""
    times = []
    for _ in range(rounds):
        again = fresh(problem)
        solve, solution = seconds(lambda again=again: cq.solve(again))
        after, found = seconds(lambda again=again, solution=solution: judged(again, solution))
        again = fresh(problem)
        alone, _ = seconds(lambda again=again, solution=solution: judged(again, solution))
        times.append((solve, after, alone, after / solve))
    printed = judged(problem, solution, DIGITS)
    solve, after, alone, part = (statistics.median(column) for column in zip(*times, strict=True))
    systems = {Systems.SPARSE: "sparse", Systems.CONDENSED: "condensed", Systems.SUBSET: "subset"}[systems_of(problem)]
    errors = "".join(
        f"{'none' if one is None else f'{one:.0e}':>9}" for one in (found.force_error, printed.force_error)
    )
    print(
        f"{name:<24}{problem.dimension:>9}{problem.contacts:>9}{problem.ties:>6}  {systems:<10}"
        f"{solve:>8.3f}{after:>8.3f}{alone:>8.3f}{part:>12.2f}  {found.scope or 'none':<8}{errors[1:]}",
        flush=True,
    )
    if "beyond" in name:
        print(f"    {found.reasons[0]}" if found.reasons else "    no reason is given")
        return [] if found.reasons else [f"{name}: no reason is given"]
    wrong = [f"{name}: the {of} has no bound" for of, one in (("answer", found), ("print", printed)) if not one.proven]
    if part > MOST and "nearby" not in name:
        wrong.append(f"{name}: the bound takes {part:.2f} of the solve")
    if printed.proven and (below := below_the_distance(solution, printed)):
        wrong.append(f"{name}: {below} of the printed forces are bounded by less than their distance")
    return wrong


def below_the_distance(solution: Any, printed: Any) -> int:
    """Return how many printed forces are further from the refined ones than their bounds say."""
    forces = np.column_stack([solution.normal_force, solution.friction_force])
    off = np.array([[float(f"{x:.{DIGITS - 1}e}") - x for x in force] for force in forces])
    size = np.max(abs(forces))
    return int(np.sum(np.linalg.norm(off, axis=1) > printed.force_bound + 1e-15 * size))


def main() -> int:
    """Print the table and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="medians of so many")
    rounds = parser.parse_args().rounds
    print(HEAD)
    wrong = [text for name, made in problems().items() for text in row(name, made(), rounds)]
    print("\n".join(wrong) or "every problem within the size has a bound, of no more than half of a solve")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
