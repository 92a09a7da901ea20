"""What a further step of a load path costs, in units of the first solution of the same body.

    python -m benchmarks.load_path                         # 30 000 unknowns in 2D, 15 000 in 3D
    python -m benchmarks.load_path --two 30000 100000 --three --steps 50

The block of price_of_contact.py is pressed on a paraboloid in 100 steps by `follow_path`. One process; fresh problems;
medians of several rounds. `first` is one certified solution with its factorisation; a further step is what the path
takes more than that, divided by its steps; a look polishes, expands and certifies one step. Exit code 1 where a further
step costs more than 0.05 of the first.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks.price_of_contact import block, fresh

TARGET = 0.05
STEPS = 100


@dataclass(frozen=True)
class Price:
    """Medians in seconds."""

    unknowns: int
    contacts: int
    first: float
    step: float
    look: float
    factorisations: int

    @property
    def met(self) -> bool:
        """Whether a further step costs at most TARGET of the first solution."""
        return self.step <= TARGET * self.first


def price(problem: cq.ContactProblem, steps: int = STEPS, rounds: int = 3) -> Price:
    """The path from no load to the problem's, after one solution to warm up."""
    cq.solve(fresh(problem))
    times = []
    factorisations = 0
    for _ in range(rounds):
        first, _ = _timed(lambda: cq.solve(fresh(problem)))
        path, history = _timed(lambda: cq.follow_path(fresh(problem), [problem.load], steps=steps))
        look, looked = _timed(lambda history=history: history[-1])
        times.append((first, (path - first) / steps, look))
        factorisations = history[0].work.factorisations + looked.work.factorisations
    first, step, look = (float(value) for value in np.median(times, axis=0))
    return Price(problem.dimension, problem.contacts, first, step, look, factorisations)


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    gc.collect()
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--two", type=int, nargs="*", default=[30_000], help="unknowns in 2D")
    parser.add_argument("--three", type=int, nargs="*", default=[15_000], help="unknowns in 3D")
    parser.add_argument("--steps", type=int, default=STEPS)
    chosen = parser.parse_args(arguments)
    met = True
    for dimension, sizes in ((2, chosen.two), (3, chosen.three)):
        for unknowns in sizes:
            found = price(block(unknowns, dimension), chosen.steps)
            met &= found.met
            print(
                f"{dimension}D {found.unknowns} unknowns, {found.contacts} contacts: first {found.first:.3f} s, "
                f"a further step {found.step / found.first:.4f} of it, a look at one {found.look / found.first:.3f}; "
                f"{found.factorisations} factorisation(s): {'met' if found.met else 'MISSED'}",
                flush=True,
            )
    return int(not met)


if __name__ == "__main__":
    raise SystemExit(main())
