"""Where and how a study runs, as a user says it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from contactqp.errors import InvalidProblem
from contactqp.study.running.runner import TIME_LIMIT
from contactqp.study.running.workers import Processes, ThisProcess, Workers

# Seconds of a year: no cell takes longer, and every clock counts so far.
LONGEST = 365 * 24 * 3600.0


@dataclass(frozen=True)
class Running:
    """How a study runs.

    Parameters
    ----------
    jobs : int, optional
        Processes side by side; all cores by default, 0 for none but this process.
    dask : str, optional
        Address of a Dask scheduler, whose workers take the place of processes here.
    fresh : bool
        Forget what an interrupted study left.
    time_limit : float
        Seconds after which one cell is stopped.
    shown : bool
        Show progress on stderr.
    """

    jobs: int | None = None
    dask: str | None = None
    fresh: bool = False
    time_limit: float = TIME_LIMIT
    shown: bool = False

    def __post_init__(self) -> None:
        if self.jobs is not None and self.dask is not None:
            raise InvalidProblem(f"expected jobs here or a Dask cluster, got both: {self.jobs} and {self.dask}")
        if not 0 < self.time_limit <= LONGEST:
            raise InvalidProblem(
                f"time limit: expected seconds, more than 0 and at most {LONGEST:g}, got {self.time_limit}"
            )


@contextmanager
def workers_of(running: Running) -> Iterator[Workers]:
    """The workers that a user asks for."""
    if running.dask is None:
        yield ThisProcess() if running.jobs == 0 else Processes(running.jobs or _cores())
        return
    from contactqp.study.running.cluster import cluster

    with cluster(running.dask) as workers:
        yield workers


def _cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
