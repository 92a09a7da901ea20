"""Solutions of one problem, again and again, take no more memory than the first ones."""

from __future__ import annotations

import resource
from pathlib import Path

from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import solve_distributed
from tests.blocks_in_space import on_sphere

ranks = Ranks()


def resident() -> float:
    """MiB of this rank."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


problem = distribute(on_sphere((8, 8, 6)), ranks)
seen = []
for _ in range(3):
    for _ in range(20):
        problem.computed.clear()  # or the preconditioner would be made once
        solve_distributed(problem, solver="mumps")
    seen.append(resident())
# Without a word to PETSc it is 80 MiB and more.
assert ranks.max(seen[-1] - seen[0]) < 5.0, seen
if ranks.rank == 0:
    print("the same")
