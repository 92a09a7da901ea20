"""Count how often a wrong answer is returned whose certificate passes: never, over thousands of hard problems.

    python -m benchmarks.silently_wrong --problems 2000

Every problem has its exact rational solution (`exact_truth`) and meets all methods. An answer is wrong if its error, in
the energy norm of the displacement or of the contact forces, exceeds 1e-6 + 100 eps kappa(K). Counted besides: what
the methods' own flags said of their raw answers, how far the certificate's bounds are from the true errors, and whether
they are ever below them, also for answers that are spoiled on purpose. Exit code 1 if anything wrong passed, a bound
was below the truth, or too much was refused.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import asdict
from pathlib import Path

from benchmarks.counting import failures, text
from benchmarks.judging import Report, available, judge
from benchmarks.problem_families import FAMILIES
from benchmarks.processes import reports_of


def _task(task: tuple[str, int, tuple[str, ...]]) -> Report:
    return judge(*task)


def run(names: list[str], problems: int, methods: tuple[str, ...], jobs: int) -> list[Report]:
    """`problems` problems spread evenly over the families, in a fixed order."""
    each = -(-problems // len(names))
    tasks = [(name, seed, methods) for seed in range(each) for name in names]
    return reports_of(_task, tasks, jobs)


def write(reports: list[Report], path: Path) -> None:
    """Everything as JSON: one object a problem."""
    path.write_text(json.dumps([asdict(report) for report in reports], indent=0, default=float) + "\n")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=2000, help="in all, spread evenly over the families")
    parser.add_argument("--family", action="append", choices=list(FAMILIES), help="only this one; may be repeated")
    parser.add_argument("--methods", nargs="+", choices=available(), metavar="METHOD", default=list(available()))
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--output", type=Path, default=Path("silently_wrong.json"))
    chosen = parser.parse_args(arguments)
    started = time.perf_counter()
    reports = run(chosen.family or list(FAMILIES), chosen.problems, tuple(chosen.methods), chosen.jobs)
    print("\n".join(text(reports, chosen.methods, time.perf_counter() - started)))
    write(reports, chosen.output)
    found = failures(reports, chosen.methods)
    print("\n" + ("\n".join(f"FAILED: {line}" for line in found) or "all met"))
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
