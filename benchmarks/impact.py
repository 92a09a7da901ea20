"""What a time step costs beyond its back-substitution.

    python -m benchmarks.impact                   # 10 000 steps of a rod of 1000 elements
    python -m benchmarks.impact --elements 4000 --steps 5000

A rod is thrown at a wall; the motion is timed in free flight and in contact by the difference of two lengths, so that
what is done once does not count, every step certified. `back-substitution` is what reduces a load and expands the
answer, timed beside it in the same process. Times are of the processor, of every length the least of several rounds:
what else a machine does only adds. Exit code 1 where the rest of a step costs more than 100 microseconds times one plus
the contacts in touch, or more than one factorisation is made.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg.condensation import condense

SPEED, LENGTH, WAVE = 10.0, 10.0, 30.0
BUDGET = 100e-6
ROUNDS = 5


def rod(elements: int) -> tuple[cq.ContactProblem, sp.csc_matrix]:
    """A rod of unit area and density, c = 30, whose first node is at a wall."""
    h, ones = LENGTH / elements, np.ones(elements)
    middle = np.r_[1.0, 2 * np.ones(elements - 1), 1.0]
    K = sp.diags([middle, -ones, -ones], [0, 1, -1]) * WAVE**2 / h
    wall = sp.csr_matrix(([-1.0], ([0], [0])), shape=(1, elements + 1))
    problem = cq.ContactProblem(sp.csc_matrix(K), np.zeros(elements + 1), wall, [0.0])
    return problem, sp.csc_matrix(sp.diags(middle / 2 * h))


def _seconds(run: Callable[[], object]) -> float:
    started = time.process_time()
    run()
    return time.process_time() - started


def price(elements: int, steps: int, scheme: str) -> tuple[float, float, float, int]:
    """Seconds of a free step, a step in contact, a back-substitution; factorisations of the longest run."""
    problem, mass = rod(elements)
    step = LENGTH / elements / WAVE
    count = min(steps, int(1.9 * elements))  # the rod leaves the wall after two passages of its wave
    made = 0

    def run(gap: float, many: int) -> None:
        nonlocal made
        at = problem.replace(stiffness=problem.stiffness, gap=[gap])
        still, velocity = np.zeros(elements + 1), np.full(elements + 1, -SPEED)
        history = cq.impact(at, mass, still, velocity, many * step, step, scheme)
        made = history[-1].work.factorisations

    def step_of(gap: float, many: int) -> float:
        few = many // 10
        long = min(_seconds(lambda: run(gap, many)) for _ in range(ROUNDS))
        short = min(_seconds(lambda: run(gap, few)) for _ in range(ROUNDS))
        return (long - short) / (many - few)

    back = min(_back_substitution(problem, mass, step) for _ in range(ROUNDS))
    return step_of(1e9, steps), step_of(0.0, count), back, made


def _back_substitution(problem: cq.ContactProblem, mass: sp.csc_matrix, step: float, times: int = 2000) -> float:
    way = condense(problem.replace(stiffness=mass + (step / 2) ** 2 * problem.stiffness))._elimination
    load = np.random.default_rng(0).standard_normal(problem.dimension)

    def run() -> None:
        for _ in range(times):
            way.expand(*way.reduce(load))

    return _seconds(run) / times


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--elements", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=10000)
    parser.add_argument("--schemes", nargs="+", default=["moreau-jean", "modified-mass"])
    arguments = parser.parse_args()
    met = True
    print(f"{'scheme':20} {'free step':>12} {'in contact':>12} {'back-subst.':>12} {'rest':>8} {'rest':>8}  [us]")
    for scheme in arguments.schemes:
        free, touching, back, made = price(arguments.elements, arguments.steps, scheme)
        within = free - back <= BUDGET and touching - back <= 2 * BUDGET and made == 1
        met &= within
        numbers = "".join(f"{1e6 * value:13.1f}" for value in (free, touching, back))
        rest = f"{1e6 * (free - back):9.1f}{1e6 * (touching - back):9.1f}"
        print(f"{scheme:20}{numbers}{rest}  {made} factorisation, {'met' if within else 'NOT MET'}")
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
