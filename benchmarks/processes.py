"""The tasks of a benchmark in processes of their own."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable
from typing import Any


def reports_of(task: Callable[[Any], Any], tasks: list[Any], jobs: int) -> list[Any]:
    """What `task` says of every one of `tasks`, in their order; progress goes to stderr. One job: in this process."""
    if jobs < 2:
        return [task(one) for one in tasks]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the processes that are about to start
    reports = []
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for report in pool.imap(task, tasks, chunksize=4):
            reports.append(report)
            if len(reports) % 100 == 0:
                print(f"{len(reports)} of {len(tasks)} problems", file=sys.stderr)
    return reports
