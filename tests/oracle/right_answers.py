"""Generated problems with their right answers: without friction, with friction, and with redundant contacts."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from benchmarks.problem_families import family
from contactqp.model.problem import ContactProblem
from tests.examples import block_between, cantilever, seeded_problem
from tests.solving.friction.problems import known_answer
from tests.solving.friction.space import several

Given = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Base:
    """A problem and its right answer."""

    name: str
    problem: ContactProblem
    right: Given

    def __getitem__(self, part: str) -> np.ndarray:
        return self.right[part]


def _solved(name: str, problem: ContactProblem) -> Base | None:
    with suppress(cq.ContactQPError):
        found = cq.solve(problem)
        if not any("redundant" in reason for reason in found.certificate.reasons):
            right = {"displacement": found.displacement, "normal_force": found.normal_force}
            if problem.ties:
                right["tie_force"] = found.tie_force
            return Base(name, problem, right)
    return None


FAMILIES = (
    "lattice_on_floor",  # an elastic body
    "tied_chains",
    "chain_walls",
    "beam_stops",  # stiff: condition to 1e10
    "lattice_in_corner",  # floats
    "held_by_ties",
    "nearly_grazing",
    "overlap",
    "soft_support",
    "random_truss",
    "exactly_grazing",
    "beam_supports_as_rows",
    "badly_scaled",
)


TIED = ("tied_chains", "held_by_ties", "beam_supports_as_rows")


@cache
def frictionless() -> tuple[Base, ...]:
    """Problems without friction, of all families in turn: elastic, tied, stiff, floating, grazing."""
    found = []
    for seed in range(10):
        made = [(f"{name} {seed}", family(name, seed)) for name in FAMILIES if seed < 6 or name in TIED]
        if seed < 6:
            made += [
                (f"seeded {seed}", seeded_problem(seed, 12, 8)),
                (f"block {seed}", block_between(6, 3, 10.0, seed)),
            ]
        if seed == 0:
            made.append(("cantilever", cantilever(100)))
        found += [one for one in (_solved(*pair) for pair in made) if one is not None]
    return tuple(found)


@cache
def frictional() -> tuple[Base, ...]:
    """Problems with friction, in the plane and in space, some tied, made around their answers."""
    found = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        for name, known in (
            (f"space {seed}", several(seed, ties=seed % 2)),
            (f"plane {seed}", known_answer(rng, 2, m=3)),
        ):
            problem, right = known.problem, known.answer()
            if problem.contacts * (1 + known.friction_force.shape[1]) + problem.ties > problem.dimension:
                continue
            with suppress(cq.ContactQPError):
                solution = cq.solve(problem)
                same = np.max(abs(solution.displacement - known.displacement)) < 1e-6
                if same and not solution.certificate.uniqueness:
                    right = right if problem.ties else {part: right[part] for part in list(right)[:3]}
                    found.append(Base(name, problem, right))
    return tuple(found)


@cache
def redundant() -> tuple[Base, ...]:
    """Problems in which a pushing contact stands twice: only the sum of its two forces is known."""
    found = []
    for seed in range(12):
        problem = seeded_problem(seed, 12, 8)
        twice = int(np.argmax(cq.solve(problem).normal_force))
        rows = sp.vstack([problem.normal, problem.normal[[twice]]])
        double = problem.replace(normal=rows, gap=np.append(problem.gap, problem.gap[twice]))
        solution = cq.solve(double)
        found.append(Base(f"twice {seed}", double, {p: getattr(solution, p) for p in ("displacement", "normal_force")}))
    return tuple(found)
