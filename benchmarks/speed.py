"""Where people wait: small problems, threads of BLAS, steps of paths and motions, each beside what it should cost.

    python -m benchmarks.speed                       # some minutes; exit 1 where a target is missed
    python -m benchmarks.speed --only small threads

One process; what is compared takes turns, and medians of the ratios are shown. Milliseconds are those of the processor
with one thread of BLAS, so that other work on the machine counts little; threads are compared by the clock, as
installed but where the row says one. `before` is what the same row measured on 2026-11-20, by the clock, where it was.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support

ROUNDS = 15
# Contacts of the rows on threads, and the ratio that two threads may cost beside one.
CONTACTS, SPINNING = (20, 100, 220, 500, 1500), 1.3


@dataclass(frozen=True)
class Row:
    """One line of the table; `unit` is "ms" or "x", a ratio."""

    what: str
    measured: float
    unit: str
    target: float | None
    before: float | None

    @property
    def missed(self) -> bool:
        return self.target is not None and self.measured > self.target

    def __str__(self) -> str:
        before = "" if self.before is None else f"{self.before:g}"
        target = "" if self.target is None else f"{self.target:g}"
        return f"{self.what:58}{self.measured:10.3g} {self.unit:3}{target:>8}{before:>8}{'  missed' * self.missed}"


def seconds(function: Callable[[], Any]) -> float:
    """Return the seconds of one call."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def processor_ms(function: Callable[[], Any]) -> float:
    """Return the milliseconds of the processor that one call takes with one thread of BLAS."""
    with threadpool_limits(1):
        began = time.process_time()
        function()
        return 1e3 * (time.process_time() - began)


def median_ms(function: Callable[[], Any], rounds: int) -> float:
    """Return the median of some calls [ms]; the first one is left out."""
    with threadpool_limits(1):
        function()
        times = []
        for _ in range(rounds):
            began = time.process_time()
            function()
            times.append(time.process_time() - began)
    return 1e3 * statistics.median(times)


def truss(friction: bool = False) -> cq.ContactProblem:
    """Two bars, a floor beneath their node (Example 2.10 of the course chapter)."""
    rubs = dict(tangent=[[1.0, 0.0]], friction=0.3) if friction else {}
    return cq.ContactProblem(
        stiffness=[[59803.0, 6883.1], [6883.1, 77443.0]], load=[60.0, -100.0], normal=[[0.0, -1.0]], gap=[1e-3], **rubs
    )


def small() -> Iterator[Row]:
    """Problems of two unknowns, each built anew."""
    answer = cq.solve(truss())

    def certify() -> object:
        return cq.certify(truss(), displacement=answer.displacement, normal_force=answer.normal_force)

    yield Row("truss of two unknowns: solve", median_ms(lambda: cq.solve(truss()), 200), "ms", 1.0, 4.5)
    yield Row("truss of two unknowns: certify", median_ms(certify, 200), "ms", 0.5, 1.1)
    yield Row("truss of two unknowns, mu = 0.3: solve", median_ms(lambda: cq.solve(truss(True)), 100), "ms", 2.5, 8.9)
    yield Row("truss of two unknowns: compare", median_ms(lambda: cq.compare(truss()), 3), "ms", 300.0, None)


def bed(m: int) -> cq.ContactProblem:
    """A dense stiffness with a contact at every unknown, half of which close."""
    place = np.linspace(0.0, 1.0, m)
    K = np.exp(-abs(place[:, None] - place) * 20) + np.eye(m)
    return cq.ContactProblem(stiffness=K, load=np.sin(7 * place), normal=np.eye(m), gap=np.full(m, 0.05))


@contextlib.contextmanager
def another_process(runs: bool) -> Iterator[None]:
    """A second process that keeps a core busy meanwhile."""
    if not runs:
        yield
        return
    process = multiprocessing.get_context("spawn").Process(target=_spin, daemon=True)
    process.start()
    time.sleep(2.0)  # for its imports
    try:
        yield
    finally:
        process.kill()
        process.join()


def _spin() -> None:
    while True:
        np.linalg.norm(np.ones(1000))


def threads() -> Iterator[Row]:
    """Solves with the threads of BLAS as installed, in units of the same with one thread, taking turns."""
    for beside in (False, True):
        with another_process(beside):
            for m in CONTACTS:
                ratios = []
                for _ in range(ROUNDS if m < 500 else 5):
                    free = seconds(lambda m=m: cq.solve(bed(m)))
                    with threadpool_limits(1):
                        one = seconds(lambda m=m: cq.solve(bed(m)))
                    ratios.append(free / one)
                where = "beside another process" if beside else "alone"
                yield Row(f"{m} dense contacts, free threads over one, {where}", statistics.median(ratios), "x",
                          SPINNING, 40.0 if beside and m == 220 else None)  # fmt: skip


def block(cells: int) -> cq.ContactProblem:
    """A block in space on a plane with friction, contact on its lower face, pressed and pulled sideways."""
    body = Body(box((1.0, 1.0, 1.0), (cells,) * 3), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    held = [Support("block", "top", axis, (0.01, 0.0, -0.02)[axis]) for axis in range(3)]
    pairs = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, 0.0, -0.005], [0.0, 0.0, 1.0]))
    return structure.assemble(held).problem([pairs], friction=0.3)


def steps() -> Iterator[Row]:
    """Certified steps of load paths with friction in space, in milliseconds."""
    for cells, contacts, target in ((2, 9, 1.0), (9, 100, 5.0)):
        problem = block(cells)

        def path(problem: cq.ContactProblem = problem, steps: int = 20) -> object:
            return cq.follow_path(problem, [problem.load], steps=steps).normal_forces

        path()
        a_step = statistics.median(
            (processor_ms(lambda path=path: path(steps=40)) - processor_ms(lambda path=path: path(steps=20))) / 20
            for _ in range(5)
        )
        yield Row(f"a step of a path with friction, {contacts} contacts in space", a_step, "ms", target, 10.0)


PARTS: dict[str, Callable[[], Iterator[Row]]] = {"small": small, "threads": threads, "steps": steps}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(PARTS), default=list(PARTS))
    options = parser.parse_args(arguments)
    blas = ", ".join(f"{one['internal_api']} {one['num_threads']} threads" for one in threadpool_info())
    print(f"{blas}\n{'':58}{'measured':>10}    {'target':>8}{'before':>8}", flush=True)
    missed = False
    for part in options.only:
        for row in PARTS[part]():
            missed |= row.missed
            print(row, flush=True)
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
