"""A problem that every rank was given whole, solved by all of them, and its answer given whole to each."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.distributed.answer import DistributedAnswer
from contactqp.distributed.distributing import distribute
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solution import DistributedSolution
from contactqp.distributed.solving import solve_distributed
from contactqp.errors import Unsupported
from contactqp.existence import describe_motion
from contactqp.problem import ContactProblem
from contactqp.solution import FreeMotion, Solution

# What `solve` takes for a problem in one process and has no meaning on several, with what leaves it out.
_OF_ONE_PROCESS = {"condense": "auto", "polish": True, "time_limit": None, "max_iter": None}


def solve_whole(problem: ContactProblem, method: str, *, warm_start: Any = None, **options: Any) -> Solution:
    """As `contactqp.solve`, on the ranks of MPI. Collective: all ranks give the same and get the same.

    Raises
    ------
    Unsupported
        A method or an option that is of one process only.
    """
    chosen = options_on_ranks(options)
    part = distribute(problem, Ranks())
    start = None if warm_start is None else dealt(part, warm_start)
    return gathered(problem, solve_distributed(part, method, warm_start=start, **chosen))


def options_on_ranks(options: dict[str, Any]) -> dict[str, Any]:
    """The options of `solve` that mean something on several ranks.

    Raises
    ------
    Unsupported
        Another one is given.
    """
    stated = [name for name, usual in _OF_ONE_PROCESS.items() if name in options and options[name] != usual]
    if stated:
        raise Unsupported(f"engine 'petsc': {stated[0]} is an option of one process, leave it out")
    left_out = {*_OF_ONE_PROCESS, *(["algorithm"] if options.get("algorithm") is None else [])}
    return {name: value for name, value in options.items() if name not in left_out}


def dealt(part: DistributedProblem, solution: Solution) -> DistributedAnswer:
    """This rank's part of a solution that all ranks have."""
    friction, there = solution.friction_force, part.dof_number >= 0
    displacement = np.zeros(len(part.dof_number))
    displacement[there] = solution.displacement[part.dof_number[there]]
    return DistributedAnswer(
        displacement=displacement,
        normal_force=solution.normal_force[part.contact_number],
        friction_force=None if friction is None else friction[part.contact_number],
        tie_force=solution.tie_force[part.tie_number],
    )


def gathered(problem: ContactProblem, solution: DistributedSolution) -> Solution:
    """A distributed solution as one process would have it, on every rank. Collective."""
    certificate = solution.certificate
    return Solution(
        problem=problem,
        displacement=solution.displacement,
        normal_force=solution.normal_force,
        friction_force=solution.friction_force,
        tie_force=solution.tie_force,
        contact_status=solution.contact_status,
        free_motions=tuple(FreeMotion(motion, describe_motion(problem, motion)) for motion in solution.free_motions),
        certificate=certificate,
        method=solution.method,
        seconds=solution.seconds,
        certify_seconds=solution.certify_seconds,
        work=solution.work,
    )
