"""The brief report twice on one machine: whether methods keep their order by time, and whether the estimate holds.

    python -m benchmarks.report_twice [--runs N] [--output DIR]

Each run is `contactqp report --fresh` in a process of its own. Its lines of progress are held against the time that it
then took: from the first fifth on, what is said to be left must be right within a third, and five seconds more, as it
is told in tens. The order of the methods in the table of the second run must be that of the first, but for methods
whose times lie within their spreads, by the rule of `contactqp report --compare`. Both need a machine that does nothing
else; its load is printed. Exit 1 where one of them fails.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from contactqp.study.report_data import changes, read_report

# From this part of a run on the estimate must be right within a third, and half of the ten seconds that it is told in.
BEGINNING, WITHIN, ROUNDING = 0.2, 1 / 3, 5.0
LEFT = re.compile(r"about (?:(\d+) h )?(?:(\d+) min ?)?(?:(\d+) s )?left")


def seconds_left(line: str) -> float | None:
    """Return the seconds that a line of progress says are left; None where it has no estimate.

    >>> seconds_left("contactqp: answers: 7 of 447, about 1 min 20 s left"), seconds_left("contactqp: truths: 7 of 8")
    (80.0, None)
    >>> seconds_left("contactqp: times: 1 of 9, about 30 s left"), seconds_left("x: 1 of 9, about 1 h 6 min left")
    (30.0, 3960.0)
    """
    found = LEFT.search(line)
    if found is None:
        return None
    hours, minutes, seconds = (int(part or 0) for part in found.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


def misses(lines: Sequence[tuple[float, str]], total: float) -> Iterator[str]:
    """Yield each line of progress, with the second it came at, whose estimate is off by more than it may be."""
    for at, line in lines:
        said, left = seconds_left(line), total - at
        if said is not None and at >= BEGINNING * total and abs(said - left) > WITHIN * left + ROUNDING:
            yield f"after {at:.0f} s of {total:.0f}: {left:.0f} s were left: {line.strip()}"


def run(folder: Path) -> tuple[list[tuple[float, str]], float]:
    """Write one report and return its lines of progress with the seconds they came at, and how long it took."""
    command = [sys.executable, "-m", "contactqp", "report", "--fresh", "--output", str(folder)]
    began = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        lines = [(time.monotonic() - began, line) for line in process.stderr]
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: exit {process.returncode}")
    return lines, time.monotonic() - began


def main() -> None:
    """Run the reports and say what differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--output", type=Path, help="where the reports go; by default nowhere that lasts")
    chosen = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory() as nowhere:
        folders = [(chosen.output or Path(nowhere)) / f"report {i}" for i in range(chosen.runs)]
        for folder in folders:
            before = os.getloadavg()[0]
            lines, total = run(folder)
            wrong = list(misses(lines, total))
            told = sum(seconds_left(line) is not None and at >= BEGINNING * total for at, line in lines)
            print(f"{folder.name}: {total:.0f} s, load {before:.1f} before; {len(wrong)} of {told} estimates off")
            print("".join(f"  {line}\n" for line in wrong), end="", flush=True)
            failed |= bool(wrong)
        first, *others = (read_report(folder / "results.json") for folder in folders)
        for folder, other in zip(folders[1:], others, strict=True):
            order = [line for line in changes(first, other).splitlines() if "order by time" in line or "faster" in line]
            print(f"{folder.name} after {folders[0].name}: {'; '.join(order)}")
            failed |= any("is faster than" in line for line in order)
    sys.exit(failed)


if __name__ == "__main__":
    main()
