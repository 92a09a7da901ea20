"""Bounds that somebody hands over enter the certificate of a right answer, and its verdict."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.bounds import Bounds
from contactqp.distributed.certificate import certify_distributed
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks
from contactqp.errors import InvalidProblem
from contactqp.model.solution import Answer
from contactqp.scene.building import build

scene = cq.load_scene(Path(__file__).parents[3] / "cases" / "truss_floor.toml")
problem = build(scene).problem
found = cq.solve(problem)
part = distribute(problem, Ranks())
answer = Answer(
    found.displacement[part.dof_number], found.normal_force[part.contact_number], None, found.tie_force[part.tie_number]
)

unbounded = certify_distributed(part, answer)
assert unbounded.passed
assert not unbounded.proven
assert unbounded.energy_error is None
assert unbounded.reasons[0] == "energy_error: no solver was given that could bound it"

near = Bounds(energy_error=1e-8, force_error=1e-8, energy_scale=1.0, force_scale=1.0)
proven = certify_distributed(part, answer, bounds=lambda: near)
assert proven.passed
assert proven.proven
assert proven.energy_error == 1e-8

far = Bounds(energy_error=1e-3, force_error=1e-8, energy_scale=1.0, force_scale=1.0, estimated=True)
refused = certify_distributed(part, answer, bounds=lambda: far)
assert not refused.passed
assert not refused.proven
assert refused.failures == ("energy_error: the displacement may be off by 0.001 of its size (tolerance 1e-06)",), (
    refused.failures
)
assert refused.notes[-1].startswith("nothing was factorised")

# The last contact is known worst: whichever rank has it names it.
bound = 1e-3 * (1.0 + part.contact_number)
loose = Bounds(1e-8, 1e-8, bound, bound, energy_scale=1.0, force_scale=1.0)
named = certify_distributed(part, answer, bounds=lambda: loose)
assert len(named.failures) == 1, named.failures
assert problem.contact_name(problem.contacts - 1) in named.failures[0], named.failures

# One rank's mistake is told by all.
long = Answer(np.append(answer.displacement, 0.0), answer.normal_force, None, answer.tie_force)
with pytest.raises(InvalidProblem, match="displacement: expected shape"):
    certify_distributed(part, long if part.ranks.rank == 0 else answer)
print("judged")
