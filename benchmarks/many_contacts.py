"""Contacts wherever bodies have nodes: seconds of a certified answer, in linear solves.

    python -m benchmarks.many_contacts                          # all but the largest membrane, some minutes
    python -m benchmarks.many_contacts membranes --sides 100 400 1000
    python -m benchmarks.many_contacts strips plates --method clarabel
    python -m benchmarks.many_contacts --processor              # beside other work, with one thread

    membranes   a square grid under a pressure that pushes it against a plate at three heights, so that 5, 40 and 90 %
                of its nodes are in contact
    strips      a thousand contacts along a strip of quadrilaterals, pressed onto a parabola until 28 % or all are
                closed, without friction and with mu = 0.05, 0.3 and 1
    plates      a plate of hexahedra, 10 201 contacts beneath it, pressed onto a paraboloid
    stacks      two plates, one half of their interface tied (15 150 ties), the other half in contact (5 151)
    ties        two plates tied to each other all over, no contact

Each is a fresh problem, solved once by `cq.solve` with its certificate, after a small one that loads what is needed. A
linear solve is one factorisation of K by PARDISO, or SuperLU where that is not installed, and one back-substitution;
with ties it is that of K and the ties together, which is what the bodies would cost without contact. It is taken twice,
and the faster counts. Threads are those of the environment, which the first line states.

Membranes are solved in processes of their own, and the memory of each is that by which its largest exceeds what it had
before the problem was made, over that of a process with the linear solve alone. At the end of them the exponents x of
seconds ~ unknowns^x are fitted, of all from 10 000 nodes on.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg import pardiso
from contactqp.linalg.equilibration import equilibrated
from contactqp.linalg.factorization import factorise
from contactqp.linalg.sparse_saddle import REGULARISATIONS, SparseSaddle

HEIGHTS = (0.0585, 0.0165, 0.0005)
SIDES = (100, 200, 400)
FITTED = 10_000  # nodes of the smallest whose seconds are fitted
MATERIAL = Material(1.0, 0.3)
# How far a strip is pressed down until 28 % of its contacts, and all of them, are closed.
PRESSED = (0.002, 0.05)
FRICTION = (None, 0.05, 0.3, 1.0)

Clock = Callable[[], float]  # seconds


def membrane(side: int, height: float) -> cq.ContactProblem:
    """A membrane of side * side nodes under a unit pressure, a plate at a height over all of them."""
    h = 1.0 / (side + 1)
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side))
    one, nodes = sp.identity(side), side * side
    K = sp.csr_matrix(sp.kron(one, chain) + sp.kron(chain, one))
    return cq.ContactProblem(K, np.full(nodes, h * h), sp.identity(nodes, format="csr"), np.full(nodes, height))


def strip(pressed: float, friction: float | None = None, cells: int = 1000) -> cq.ContactProblem:
    """A strip of quadrilaterals, eight high, its top moved down onto a parabola."""
    structure = Structure([Body(rectangle(1.0, 8 / cells, (cells, 8)), MATERIAL, "plane-strain", name="strip")])
    held = [Support("strip", "top", 1, -pressed), Support("strip", "top", 0, 0.0)]
    parabola = cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0)
    pair = cq.pair(structure.surface("strip", "bottom"), parabola)
    coulomb = {} if friction is None else {"friction": friction}
    return structure.assemble(held).problem([pair], **coulomb)


def plate(cells: int, layers: int, pressed: float = 0.02) -> cq.ContactProblem:
    """A plate of hexahedra, its top moved down onto a paraboloid."""
    structure = Structure([Body(box((1.0, 1.0, 0.03 * layers), (cells, cells, layers)), MATERIAL, "3d", name="plate")])
    held = [Support("plate", "top", axis, -pressed if axis == 2 else 0.0) for axis in range(3)]
    paraboloid = cq.Paraboloid([0.5, 0.5, 0.0], [0.0, 0.0, 1.0], 5.0)
    return structure.assemble(held).problem([cq.pair(structure.surface("plate", "bottom"), paraboloid)])


def stack(cells: int, layers: int, tied: float) -> cq.ContactProblem:
    """Two plates on each other, tied where x < `tied`, with a wavy gap beyond."""
    structure = Structure([Body(box((1.0, 1.0, 0.03 * layers), (cells, cells, layers)), MATERIAL, "3d", name="plate")])
    ends = [("bottom", "top", 0.0), ("top", "bottom", -0.004)]
    parts, loads, faces = [], [], []
    for end, face, moved in ends:
        held = structure.assemble([Support("plate", end, axis, moved if axis == 2 else 0.0) for axis in range(3)])
        toward = 1.0 if face == "bottom" else -1.0
        height = 0.0 if face == "bottom" else 0.03 * layers
        touched = cq.Paraboloid([0.5, 0.5, height], [0.0, 0.0, toward], 5.0)
        half = held.problem([cq.pair(structure.surface("plate", face), touched)])
        parts.append(half.stiffness), loads.append(half.load), faces.append(half.normal.indices)
    lower, upper, count = faces[0], parts[0].shape[0] + faces[1], len(faces[0])
    at, size = np.arange(count), sum(part.shape[0] for part in parts)
    apart = [
        sp.csr_matrix(
            (np.r_[np.ones(count), -np.ones(count)], (np.r_[at, at], np.r_[lower - 2 + axis, upper - 2 + axis])),
            shape=(count, size),
        )
        for axis in range(3)
    ]
    x = np.tile(np.linspace(0.0, 1.0, cells + 1), cells + 1)
    held = x < tied
    ties = sp.vstack([rows[held] for rows in apart], format="csr")
    gap = 0.01 * (1 + np.sin(7 * x[~held]))
    K = sp.block_diag(parts, format="csr")
    return cq.ContactProblem(
        K, np.concatenate(loads), apart[2][~held], gap, tie=ties, tie_value=np.zeros(ties.shape[0])
    )


def linear_solve(problem: cq.ContactProblem, clock: Clock = time.perf_counter) -> float:
    """Seconds of one factorisation, of K or of K and the ties, and one back-substitution."""
    twin = equilibrated(problem)[0] if problem.ties else problem
    started = clock()
    if problem.ties:
        saddle = SparseSaddle(twin, np.zeros(0, dtype=np.intp), REGULARISATIONS[0])
        saddle.solve(twin.load, np.zeros(0), twin.tie_value)
    elif pardiso.available():
        pardiso.Pardiso(problem.stiffness_rows, np.zeros(0, dtype=np.intp)).solve_all(problem.load)
    else:
        factorise(problem.stiffness).solve(problem.load)
    return clock() - started


def measure(problem: cq.ContactProblem, method: str, clock: Clock) -> tuple[str, float]:
    """Solve it, and say what that took, in words and in seconds."""
    # Of fresh problems: an order of elimination that one of them finds is not known to the others.
    linear = min(linear_solve(problem.replace(stiffness=problem.stiffness), clock) for _ in range(2))
    started = clock()
    solution = cq.solve(problem, method)
    seconds = clock() - started
    certificate, work = solution.certificate, solution.work
    verdict = "proven" if certificate.proven else f"passed by {certificate.basis}"
    closed = np.mean(solution.normal_force > 0) if problem.contacts else 0.0
    sizes = f"{problem.dimension:8d} unknowns, {problem.contacts:6d} contacts, {closed:4.0%} closed"
    cost = f"{seconds:7.2f} s, {seconds / linear:5.1f} linear solves of {linear:.3f} s"
    return f"{sizes}: {cost}, {verdict}, {work.factorisations} factorisations", seconds


def largest_memory(forget: bool = False) -> float:
    """The largest memory that this process has had [GiB], since it was forgotten where the system can forget it."""
    status = Path("/proc/self/status")  # what a process inherits from the one that began it is not in there
    if forget and status.exists():
        status.with_name("clear_refs").write_text("5")
    lines = status.read_text().splitlines() if status.exists() else []
    kibibytes = [int(line.split()[1]) for line in lines if line.startswith("VmHWM:")]
    return (kibibytes or [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss])[0] / 2**20


def of_membrane(side: int, height: float, method: str, processor: bool) -> tuple[str, float, float]:
    """What a membrane, or as "linear" its linear solve alone, takes in words, in seconds and of memory [GiB]."""
    clock = time.process_time if processor else time.perf_counter
    small = membrane(50, HEIGHTS[1])
    linear_solve(small)
    if method != "linear":
        cq.solve(small)
    before = largest_memory(forget=True)
    problem = membrane(side, height)
    said, seconds = ("", linear_solve(problem, clock)) if method == "linear" else measure(problem, method, clock)
    return said, seconds, largest_memory() - before


def membranes(sides: list[int], method: str, processor: bool) -> None:
    """A row for each membrane, with its memory over that of the linear problem, and the exponents of the seconds."""
    context = multiprocessing.get_context("spawn")

    def apart(side: int, height: float, method: str) -> tuple[str, float, float]:
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            return pool.submit(of_membrane, side, height, method, processor).result()

    seconds: dict[float, list[tuple[int, float]]] = {height: [] for height in HEIGHTS}
    for side in sides:
        linear = apart(side, HEIGHTS[0], "linear")[2]
        for height in HEIGHTS:
            said, taken, memory = apart(side, height, method)
            seconds[height].append((side * side, taken))
            name = f"membrane {side} x {side}"
            print(f"{name:24s}{said}, {memory:.2f} GiB, {memory / linear:.1f} of the linear problem's", flush=True)
    for height, taken in seconds.items():
        points = [(np.log(nodes), np.log(second)) for nodes, second in taken if nodes >= FITTED]
        if len(points) > 1:
            exponent = np.polyfit(*np.array(points).T, 1)[0]
            print(f"membranes, plate at {height:g}: seconds as unknowns to the power of {exponent:.2f}")


def warm_up() -> None:
    """Solve small problems, so that what is needed is loaded."""
    for small in (membrane(50, HEIGHTS[1]), strip(PRESSED[0], 0.3, 400)):
        linear_solve(small)
        cq.solve(small)


Named = tuple[str, Callable[[], cq.ContactProblem]]


def chosen(kind: str) -> Iterator[Named]:
    """The problems of one kind, each made when it is asked for."""
    if kind == "strips":
        for pressed in PRESSED:
            for friction in FRICTION:
                name = "strip" if friction is None else f"strip, mu = {friction:g}"
                yield name, lambda pressed=pressed, friction=friction: strip(pressed, friction)
    elif kind == "plates":
        yield "plate", lambda: plate(100, 3)
        yield "plate, pressed flat", lambda: plate(100, 3, 0.1)
    elif kind == "stacks":
        yield "stack", lambda: stack(100, 2, 0.5)
    else:
        yield "plates tied all over", lambda: stack(70, 3, 2.0)


KINDS = ("membranes", "strips", "plates", "stacks", "ties")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)}; all by default")
    parser.add_argument("--sides", type=int, nargs="*", default=list(SIDES))
    parser.add_argument("--method", default="active-set")
    parser.add_argument(
        "--processor", action="store_true", help="seconds of the processor, for one thread beside others"
    )
    asked = parser.parse_args(arguments)
    if unknown := set(asked.kinds) - set(KINDS):
        parser.error(f"no kind is called {unknown.pop()!r}; expected {', '.join(KINDS)}")
    clock = time.process_time if asked.processor else time.perf_counter
    print(f"# {asked.method}; {os.environ.get('OMP_NUM_THREADS', 'all')} threads{'; processor' * asked.processor}")
    for kind in asked.kinds or KINDS:
        if kind == "membranes":
            membranes(asked.sides, asked.method, asked.processor)
            continue
        warm_up()
        for name, make in chosen(kind):
            print(f"{name:24s}{measure(make(), asked.method, clock)[0]}, {largest_memory():.2f} GiB so far", flush=True)


if __name__ == "__main__":
    main()
