"""Displacements and forces of problems that are dealt out, against those of one process: to 1e-9, with their status.

Arguments: a solver, and names of cases; of the gallery ``gallery:KIND``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import contactqp as cq
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import solve_distributed
from contactqp.scene.building import build
from contactqp.testing import problems

CASES = Path(__file__).parents[3] / "cases"
SAME = 1e-9
# Of the answer of one process, which is rounded to doubles.
ROUNDING = 1e-12
ranks, solver = Ranks(), sys.argv[1]


def asked() -> Iterator[tuple[str, cq.ContactProblem]]:
    for name in sys.argv[2:]:
        if name.startswith("gallery:"):
            yield from ((known.name, known.problem) for known in problems(name.removeprefix("gallery:"), count=3))
        else:
            yield name, build(cq.load_scene(CASES / f"{name}.toml")).problem


def off(values: np.ndarray, truth: np.ndarray) -> float:
    """The largest difference, of the largest value."""
    size = np.max(abs(truth), initial=0.0)
    return float(np.max(abs(values - truth), initial=0.0) / (size or 1.0))


def energy_norm(problem: cq.ContactProblem, u: np.ndarray) -> float:
    return float(np.sqrt(max(u @ (problem.stiffness @ u), 0.0)))


for name, problem in asked():
    many = solve_distributed(distribute(problem, ranks), solver=solver)
    one = ranks.comm.bcast(cq.solve(problem) if ranks.rank == 0 else None)
    assert many.certificate.passed, name
    # Only what is factorised has bounds that are no estimates.
    assert many.certificate.proven == (many.work.solver == "mumps"), name
    u = off(many.displacement, one.displacement)
    if size := energy_norm(problem, one.displacement):
        true = energy_norm(problem, many.displacement - one.displacement) / size
        assert many.certificate.energy_error >= true - ROUNDING, (name, true)
    # Contacts that depend on each other share their forces as they like: what they do to the bodies is the same.
    force = off(problem.normal.T @ many.normal_force, problem.normal.T @ one.normal_force)
    assert u <= SAME, (name, u)
    assert force <= SAME, (name, force)
    if not name.startswith("redundant"):
        assert off(many.normal_force, one.normal_force) <= SAME, name
        assert list(many.contact_status) == list(one.contact_status), name
    assert len(many.free_motions) == len(one.free_motions), name
    assert abs(many.energy - one.energy) <= SAME * max(abs(one.energy), 1e-300), name
    if ranks.rank == 0:
        print(f"{name}: displacement {u:.1e}, forces {force:.1e}")
