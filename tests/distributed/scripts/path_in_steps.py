"""A case with a path, and what solving it took: path_in_steps.py CASE FOLDER [KILLED_AT]

The first rank prints JSON: how many steps were solved, and displacements and events as one process has them. With
KILLED_AT the last rank is killed while it solves that step, counted from 0.
"""

from __future__ import annotations

import json
import os
import signal
import sys

import contactqp as cq
from contactqp.distributed import running_on_ranks
from contactqp.distributed.ranks import Ranks

case, folder, *killed_at = sys.argv[1:]
ranks, solve, solved = Ranks(), running_on_ranks.solve_distributed, []


def counted(*arguments, **options):
    """As `solve_distributed`, unless it is time to be killed."""
    if killed_at and len(solved) == int(killed_at[0]) and ranks.rank == ranks.size - 1:
        os.kill(os.getpid(), signal.SIGKILL)
    solved.append(arguments)
    return solve(*arguments, **options)


running_on_ranks.solve_distributed = counted
history = cq.run(cq.load_scene(case), engine="petsc", checkpoint=folder)
assert all(solution.certificate.passed for solution in history)
if ranks.rank == 0:
    events = [(event.kind, event.name, event.time) for event in history.events]
    print(json.dumps({"solved": len(solved), "displacements": history.displacements.tolist(), "events": events}))
