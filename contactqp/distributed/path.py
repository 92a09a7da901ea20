"""One load after another on the ranks of MPI, each solved for from the answer before."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from contactqp.distributed.checkpoint import Checkpoint
from contactqp.distributed.preconditioner import AUTO
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.solution import DistributedSolution
from contactqp.distributed.solving import judged, solve_distributed
from contactqp.model.arrays import Vector


def follow_distributed(
    problem: DistributedProblem,
    loads: Iterable[Vector],
    method: str,
    checkpoint: Checkpoint | None = None,
    **options: Any,
) -> Iterator[DistributedSolution]:
    """The solution under each load, started from the one before. Collective.

    Parameters
    ----------
    problem : DistributedProblem
        Its load is not used.
    loads : iterable of (n_here,) arrays [force]
    checkpoint : Checkpoint, optional
        Answers that it has are judged again and not solved for; every other one is kept there.
    method, **options
        Of `solve_distributed`.
    """
    before: DistributedSolution | None = None
    for step, load in enumerate(loads):
        at = replace(problem, load=load)
        if checkpoint is not None and step < checkpoint.steps:
            before = judged(at, checkpoint.read(step, at), method, options.get("solver", AUTO))
        else:
            start = None if before is None else before.answer
            before = solve_distributed(at, method, warm_start=start, **options)
            if checkpoint is not None:
                checkpoint.write(step, at, before.answer)
        yield before


def instants(corners: Sequence[Vector], steps: int) -> Iterator[tuple[float, Vector]]:
    """Pseudo-time and load of the start, without a load, and of so many equal steps from corner to corner."""
    rest = np.zeros_like(corners[0])
    yield 0.0, rest
    for leg, (start, end) in enumerate(pairwise([rest, *corners])):
        for i in range(1, steps + 1):
            yield leg + i / steps, end if i == steps else start + i / steps * (end - start)
