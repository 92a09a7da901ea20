"""What a solver over the ranks may not pass on: answers it has not found, and answers that are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.distributed import solving
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import certified_solution, solve_distributed
from contactqp.errors import NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.model.solution import Candidate
from contactqp.scene.building import build

CASES = Path(__file__).parents[3] / "cases"
ranks = Ranks()
problem = build(cq.load_scene(CASES / "hertz_line.toml")).problem
part = distribute(problem, ranks)
found = solve_distributed(part)

# A contact set that one change does not find, and a limit that is over before the first step.
with pytest.raises(NotConverged, match="no contact set was found") as stopped:
    solve_distributed(part, max_iter=1)
assert stopped.value.solution is not None
assert not stopped.value.solution.certificate.passed
with pytest.raises(NotConverged, match="the time limit is reached"):
    solve_distributed(part, time_limit=1e-9)

# Bounds see what figures of equilibrium do not: a force that is off by a little where it is carried on.
off = replace(found.answer, normal_force=found.answer.normal_force * (1 + 1e-4))
refused = certified_solution(part, off, "active-set").certificate
assert not refused.passed
assert any(failure.startswith("equilibrium") for failure in refused.failures), refused.failures
soft = np.ones(part.contacts)
moved = replace(found.answer, displacement=found.answer.displacement + 1e-4 * abs(found.answer.displacement).max())
assert not certified_solution(part, moved, "active-set").certificate.passed

# A method that hands over the answer of the bodies without contact is refused, whatever it claims.
right = solving.solve_by_iteration
try:
    solving.solve_by_iteration = lambda *arguments, **options: Candidate(
        replace(right(*arguments, **options).answer, normal_force=np.zeros(part.contacts))
    )
    with pytest.raises(NotCertified, match="the certificate refuses"):
        solve_distributed(part)
finally:
    solving.solve_by_iteration = right

# A load that pulls the body off its only contacts.
with pytest.raises(NoEquilibrium, match="a rigid motion that no contact and no tie holds back"):
    solve_distributed(replace(part, load=-part.load))
with pytest.raises(Unsupported, match="solver: expected auto, gamg, hypre, mumps, got 'lu'"):
    solve_distributed(part, solver="lu")
if ranks.rank == 0:
    print("refused")
