"""An answer for the rank that prints it: whole on the first, of no rows on the others."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.problem import Numbers
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solution import DistributedSolution
from contactqp.distributed.whole import certificate_of
from contactqp.model.arrays import Vector
from contactqp.model.solution import Certificate, Work


@dataclass(frozen=True, eq=False)
class CollectedSolution:
    """What is told of an answer in the numbers of one process; arrays have their rows on the first rank alone."""

    displacement: Vector = field(repr=False)  # (n,)
    normal_force: Vector = field(repr=False)  # (m,)
    friction_force: NDArray[np.float64] | None = field(repr=False)  # (m, d-1)
    tie_force: Vector = field(repr=False)  # (k,)
    contact_status: NDArray[np.str_] = field(repr=False)  # (m,)
    certificate: Certificate  # its figures and its verdict are those of all ranks
    method: str
    seconds: float
    work: Work


def collected(solution: DistributedSolution) -> CollectedSolution:
    """An answer of all ranks. Collective."""
    part, answer = solution.problem, solution.answer

    def whole(values: NDArray[Any], numbers: Numbers) -> NDArray[Any]:
        return _on_first(part.ranks, values, numbers)

    friction = answer.friction_force
    return CollectedSolution(
        displacement=whole(answer.displacement, part.dof_number),
        normal_force=whole(answer.normal_force, part.contact_number),
        friction_force=None if friction is None else whole(friction, part.contact_number),
        tie_force=whole(answer.tie_force, part.tie_number),
        contact_status=whole(solution.status, part.contact_number),
        certificate=certificate_of(solution, whole),
        method=solution.method,
        seconds=solution.seconds,
        work=solution.work,
    )


def _on_first(ranks: Ranks, values: NDArray[Any], numbers: Numbers) -> NDArray[Any]:
    """Values of all ranks in the order of their numbers, negative ones left out, on the first rank. Collective."""
    kept = np.flatnonzero(numbers >= 0)
    every, order = ranks.exchanged(np.zeros(len(kept), dtype=np.intp), values[kept], numbers[kept])
    return np.asarray(every[np.argsort(order)])
