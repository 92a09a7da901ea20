"""Contacts wherever bodies have nodes: seconds of a certified answer, in linear solves.

    python -m benchmarks.many_contacts                          # all but the largest membrane, some minutes
    python -m benchmarks.many_contacts membranes --sides 100 400 1000
    python -m benchmarks.many_contacts strips plates --method clarabel
    python -m benchmarks.many_contacts --processor              # beside other work, with one thread

    membranes   a square grid under a pressure that pushes it against a plate at three heights, so that 2, a quarter
                and three quarters of its nodes are in contact
    strips      a thousand contacts along a strip of quadrilaterals, pressed onto a parabola until 28 % or all are
                closed, without friction and with mu = 0.05, 0.3 and 1
    plates      a plate of hexahedra, 10 201 contacts beneath it, pressed onto a paraboloid
    stacks      two plates, one half of their interface tied (15 150 ties), the other half in contact (5 151)
    ties        two plates tied to each other all over, no contact

Each is a fresh problem, solved once by `cq.solve` with its certificate, after a small one that loads what is needed. A
linear solve is one factorisation of K by PARDISO, or SuperLU where that is not installed, and one back-substitution;
with ties it is that of K and the ties together, which is what the bodies would cost without contact. It is taken twice,
and the faster counts. Threads are those of the environment, which the first line states.
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from collections.abc import Callable, Iterator

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

HEIGHTS = (0.068, 0.03, 0.0025)
SIDES = (40, 70, 100, 200, 400)
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


def measure(problem: cq.ContactProblem, method: str, clock: Clock) -> str:
    """Solve it, and say what that took."""
    # Of fresh problems: an order of elimination that one of them finds is not known to the others.
    linear = min(linear_solve(problem.replace(stiffness=problem.stiffness), clock) for _ in range(2))
    started = clock()
    solution = cq.solve(problem, method)
    seconds = clock() - started
    certificate, work = solution.certificate, solution.work
    verdict = "proven" if certificate.proven else f"passed by {certificate.basis}"
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    closed = np.mean(solution.normal_force > 0) if problem.contacts else 0.0
    sizes = f"{problem.dimension:8d} unknowns, {problem.contacts:6d} contacts, {closed:4.0%} closed"
    cost = f"{seconds:7.2f} s, {seconds / linear:5.1f} linear solves of {linear:.3f} s"
    return f"{sizes}: {cost}, {verdict}, {work.factorisations} factorisations, {memory:.2f} GiB so far"


Named = tuple[str, Callable[[], cq.ContactProblem]]


def chosen(kind: str, sides: list[int]) -> Iterator[Named]:
    """The problems of one kind, each made when it is asked for."""
    if kind == "membranes":
        for side in sides:
            for height in HEIGHTS:
                yield f"membrane {side} x {side}", lambda side=side, height=height: membrane(side, height)
    elif kind == "strips":
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
    for small in (membrane(50, HEIGHTS[1]), strip(PRESSED[0], 0.3, 400)):
        linear_solve(small)
        cq.solve(small)
    for kind in asked.kinds or KINDS:
        for name, make in chosen(kind, asked.sides):
            print(f"{name:24s}{measure(make(), asked.method, clock)}", flush=True)


if __name__ == "__main__":
    main()
