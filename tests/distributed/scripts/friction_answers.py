"""Answers with friction over the ranks are those of one process: friction_answers.py SOLVER NAME...

A name is that of a shipped case, or of a body of friction_bodies.py with its coefficient, ``two blocks/0.3``. With
``--steps`` the fixed point goes alone, without Newton's method on combinations.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from friction_bodies import BODIES

import contactqp as cq
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import solve_distributed
from contactqp.scene.building import build
from contactqp.solving.friction.by_iteration import FrictionNewton

CASES = Path(__file__).parents[3] / "cases"
SAME = 1e-9


def problem_of(name: str) -> cq.ContactProblem:
    body, _, mu = name.partition("/")
    return BODIES[body](float(mu)) if mu else build(cq.load_scene(CASES / f"{name}.toml")).problem


def compare(name: str, solver: str, ranks: Ranks) -> None:
    problem = problem_of(name)
    one = ranks.comm.bcast(cq.solve(problem) if ranks.rank == 0 else None)
    many = solve_distributed(distribute(problem, ranks), solver=solver)
    assert many.certificate.passed
    assert many.certificate.natural_map is not None
    for part in ("displacement", "normal_force", "friction_force", "tie_force"):
        ours, theirs = getattr(many, part), getattr(one, part)
        assert ours.shape == theirs.shape
        off, size = np.max(abs(ours - theirs), initial=0.0), np.max(abs(theirs), initial=0.0)
        assert off <= SAME * size, f"{name}: {part} is off by {off} of {size}"
    words = list(one.contact_status)
    assert list(many.contact_status) == words, f"{name}: {many.contact_status}, not {words}"
    if ranks.rank == 0:
        steps = many.work.iterations
        print(f"{name}: {words.count('stick')} stick, {words.count('slip')} slip, {steps} steps", flush=True)


if __name__ == "__main__":
    if "--steps" in sys.argv:
        FrictionNewton.run = lambda *_: None
    solver, *names = [word for word in sys.argv[1:] if word != "--steps"]
    for name in names:
        compare(name, solver, Ranks())
