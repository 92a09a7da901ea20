"""What Coulomb friction costs along a load path, in units of the same path without friction.

    python -m benchmarks.friction_path
    python -m benchmarks.friction_path --steps 100 --rounds 5

A plane block with 200 contacts along its lower side is pressed and then pushed sideways, on a flat floor (all contacts
touch from the start) and on a paraboloid (they close one by one, each anchored where it does), in 200 steps by
`follow_path`. One process; fresh problems; with and without friction in turn, medians of several rounds; the
condensation belongs to the path, `a step` is without it. `looked at` adds the refinement and the certificate of every
tenth solution. Exit code 1 where friction costs five times the path without, or takes a second factorisation.
"""

from __future__ import annotations

import argparse
import gc
import time
from dataclasses import dataclass

import numpy as np

import contactqp as cq
from benchmarks.price_of_contact import fresh
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg.condensation import condense

TARGET = 5.0
FRICTION = 0.3
OBSTACLES = {
    "flat floor": cq.Plane([0.5, 0.0], [0.0, 1.0]),
    "paraboloid": cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0),
}


@dataclass(frozen=True)
class Price:
    """Medians in seconds."""

    unknowns: int
    contacts: int
    smooth: float
    rough: float
    smooth_step: float  # one, without the condensation
    rough_step: float
    smooth_looked: float
    rough_looked: float
    events: int
    factorisations: int

    @property
    def met(self) -> bool:
        """Whether friction costs less than TARGET times the path without, on one factorisation."""
        return self.rough < TARGET * self.smooth and self.factorisations == 1


def block(
    obstacle: object, friction: float | None, contacts: int = 200, rows: int = 80
) -> tuple[cq.ContactProblem, list[np.ndarray]]:
    """A block held at its top, which moves down and then to the side: the problem, and the two loads."""
    body = Body(rectangle(1.0, 0.5, (contacts - 1, rows)), Material(1.0, 0.3), "plane-strain", name="block")
    structure = Structure([body])
    surface = cq.pair(structure.surface("block", "bottom"), obstacle)
    loads = []
    for sideways in (0.0, 0.008):
        held = [Support("block", "top", 0, sideways), Support("block", "top", 1, -0.02)]
        problem = structure.assemble(held).problem([surface], friction=friction)
        loads.append(problem.load)
    return problem, loads


def price(name: str, steps: int, rounds: int) -> Price:
    """The path on one obstacle, with and without friction."""
    rough, loads = block(OBSTACLES[name], FRICTION)
    smooth, _ = block(OBSTACLES[name], None)
    times = []
    history = _walked(smooth, loads, 2)[0]
    for _ in range(rounds):
        first = [_condensed(problem) for problem in (smooth, rough)]
        history, *plain = _walked(smooth, loads, steps)
        history, *with_friction = _walked(rough, loads, steps)
        times.append((*plain, *with_friction, *first))
    work = sum(solution.work.factorisations for solution in history[::10])
    one, one_looked, other, other_looked, first_one, first_other = (float(value) for value in np.median(times, axis=0))
    return Price(
        unknowns=rough.dimension,
        contacts=rough.contacts,
        smooth=one,
        rough=other,
        smooth_step=(one - first_one) / steps,
        rough_step=(other - first_other) / steps,
        smooth_looked=one_looked,
        rough_looked=other_looked,
        events=len(history.events),
        factorisations=work,
    )


def _condensed(problem: cq.ContactProblem) -> float:
    """Seconds of a fresh condensation."""
    problem = fresh(problem)
    gc.collect()
    started = time.perf_counter()
    condense(problem)
    return time.perf_counter() - started


def _walked(problem: cq.ContactProblem, loads: list[np.ndarray], steps: int) -> tuple[cq.History, float, float]:
    """A history, the seconds it took, and those with every tenth solution looked at."""
    problem = fresh(problem)
    gc.collect()
    started = time.perf_counter()
    history = cq.follow_path(problem, loads, steps=steps // 2)
    walked = time.perf_counter() - started
    for solution in history[::10]:
        assert solution.certificate.passed
    return history, walked, time.perf_counter() - started


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200, help="on both legs together")
    parser.add_argument("--rounds", type=int, default=3)
    chosen = parser.parse_args(arguments)
    met = True
    for name in OBSTACLES:
        found = price(name, chosen.steps, chosen.rounds)
        met &= found.met
        print(
            f"{name}: {found.unknowns} unknowns, {found.contacts} contacts, {chosen.steps} steps, {found.events} "
            f"events: without friction {found.smooth:.2f} s, with {found.rough / found.smooth:.2f} of it, looked at "
            f"{found.rough_looked / found.smooth_looked:.2f}; a step {1e3 * found.smooth_step:.2f} and "
            f"{1e3 * found.rough_step:.2f} ms; {found.factorisations} factorisation(s): "
            f"{'met' if found.met else 'MISSED'}",
            flush=True,
        )
    return int(not met)


if __name__ == "__main__":
    raise SystemExit(main())
