"""What a further step of a load path costs, in units of the first solution of the same body.

    python -m benchmarks.load_path                         # 30 000 unknowns in 2D, 15 000 in 3D
    python -m benchmarks.load_path --two 30000 100000 --three --steps 50

The block of price_of_contact.py is pressed on a paraboloid in 100 steps by `follow_path`. One process. The first
solution is that of a fresh problem, with its factorisation; the further steps share theirs. Medians, as ratios to the
first solution, with and without its certificate; then what a step consists of:

    back-substitution   one pair of forward and backward substitution: a load reduced, a displacement expanded
    condensed step      `solve` of the condensed problem alone, certified there, from a load that is already reduced:
                        what a step would cost if only what is looked at were expanded

The target is a further step of at most 0.05 of the first, plus the expansion of what is looked at (one
back-substitution where all of it is). Exit code 1 where the step as it is, certificate included, costs more.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks.price_of_contact import block, fresh
from contactqp.condensation import condense

TARGET = 0.05
STEPS = 100


@dataclass(frozen=True)
class Price:
    """Medians in seconds, and what the whole path counted."""

    unknowns: int
    contacts: int
    first: float  # fresh problem, certificate included
    first_bare: float  # without its certificate
    step: float
    step_bare: float
    substitution: float
    condensed: float
    factorisations: int
    substitutions: float  # pairs a step

    @property
    def ratio(self) -> float:
        """A further step over the first solution, both certified."""
        return self.step / self.first

    @property
    def met(self) -> bool:
        """Whether a step, less the expansion of its displacement, costs at most TARGET of the first solution."""
        return self.step - self.substitution <= TARGET * self.first


def price(problem: cq.ContactProblem, steps: int = STEPS, firsts: int = 3) -> Price:
    """The path from no load to the problem's, after one solution to warm up."""
    cq.solve(fresh(problem))
    first = [cq.solve(fresh(problem)) for _ in range(firsts)]
    twin = fresh(problem)
    history = cq.follow_path(twin, [problem.load], steps=steps)
    further = history[1:]
    way = condense(twin)
    load, inner = way.reduce_load(problem.load)

    def condensed(fraction: float) -> Any:
        return cq.solve(way.reduced_problem(twin, fraction * load, fraction * inner))

    return Price(
        unknowns=problem.dimension,
        contacts=problem.contacts,
        first=_median(solution.seconds for solution in first),
        first_bare=_median(solution.seconds - solution.certify_seconds for solution in first),
        step=_median(solution.seconds for solution in further),
        step_bare=_median(solution.seconds - solution.certify_seconds for solution in further),
        substitution=_timed(lambda _: way.expand(way.reduce_load(problem.load)[0], inner), 20),
        condensed=_timed(condensed, 20),
        factorisations=sum(solution.work.factorisations for solution in history),
        substitutions=float(np.mean([solution.work.back_substitutions for solution in further])),
    )


def _median(values: Any) -> float:
    return float(np.median(list(values)))


def _timed(work: Callable[[float], Any], repeats: int) -> float:
    """The median of a work done at the fractions 1/repeats to 1 of the load."""
    seconds = []
    for fraction in np.arange(1, repeats + 1) / repeats:
        started = time.perf_counter()
        work(float(fraction))
        seconds.append(time.perf_counter() - started)
    return _median(seconds)


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
                f"{dimension}D {found.unknowns} unknowns, {found.contacts} contacts, {chosen.steps} further steps: "
                f"{found.factorisations} factorisation(s), {found.substitutions:.1f} back-substitutions a step\n"
                f"    first solution {found.first:.3f} s, without its certificate {found.first_bare:.3f} s\n"
                f"    further step   {found.step:.3f} s, ratio {found.ratio:.3f}; "
                f"without certificates {found.step_bare:.3f} s, ratio {found.step_bare / found.first_bare:.3f}\n"
                f"    a back-substitution {found.substitution:.4f} s = {found.substitution / found.first:.3f}, "
                f"a condensed step {found.condensed:.4f} s = {found.condensed / found.first:.3f}\n"
                f"    at most {TARGET} beside the expansion: {'met' if found.met else 'MISSED'}",
                flush=True,
            )
    return int(not met)


if __name__ == "__main__":
    raise SystemExit(main())
