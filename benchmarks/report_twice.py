"""The brief report twice on one machine: whether methods keep their order by time, and whether the estimate holds.

    python -m benchmarks.report_twice [--runs N] [--output DIR]

Each run is `contactqp report --fresh` in a process of its own. Its lines of progress are held against the time that it
then took: from the first fifth on, what is said to be left must be right within a third, and five seconds more, as it
is told in tens. The order of the methods in the table of the second run must be that of the first, but for methods
whose times lie within their spreads, by the rule of `contactqp report --compare`. Then the membrane on a ball by the
active set is timed in a report, in a script, and there with one thread of OpenBLAS: the three must agree within 30 %.
All needs a machine that does nothing else; its load is printed. Exit 1 where something fails. `--runs 0` is the
membrane alone.
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

from contactqp.scene.shipped import shipped_folder
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


MEMBRANE = "membrane_ball"
AGREE = 1.3
# What somebody would write to time a solve, without its certificate: the median of fifteen problems after one that is
# not counted.
SCRIPT = """
import statistics, sys
import contactqp as cq
scene = cq.load_scene(sys.argv[1])
solutions = [cq.solve(scene.problem()) for _ in range(16)]
print(statistics.median(one.seconds - one.certify_seconds for one in solutions[1:]))
"""


def of_membrane() -> dict[str, float]:
    """Return the seconds of the membrane on a ball by the active set: in a report, in a script, with one thread."""
    folder = shipped_folder()
    assert folder is not None
    case = str(folder / f"{MEMBRANE}.toml")
    with tempfile.TemporaryDirectory() as nowhere:
        command = [sys.executable, "-m", "contactqp", "report", case, "--output", nowhere]
        subprocess.run(
            command, check=False, capture_output=True
        )  # 1: methods that are wrong by themselves are none of ours
        rows = read_report(Path(nowhere) / "results.json")["rows"]
    (reported,) = (row["seconds"] for row in rows if row["method"] == "active-set" and row["variant"] == "")
    script = [sys.executable, "-c", SCRIPT, case]
    plain, single = (
        float(subprocess.run(script, check=True, capture_output=True, text=True, env=os.environ | threads).stdout)
        for threads in ({}, {"OPENBLAS_NUM_THREADS": "1"})
    )
    return {"in a report": reported, "in a script": plain, "in a script with one thread": single}


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
            estimates = sum(seconds_left(line) is not None and at >= BEGINNING * total for at, line in lines)
            print(f"{folder.name}: {total:.0f} s, load {before:.1f} before; {len(wrong)} of {estimates} estimates off")
            print("".join(f"  {line}\n" for line in wrong), end="", flush=True)
            failed |= bool(wrong)
        reports = [read_report(folder / "results.json") for folder in folders]
        for folder, other in zip(folders[1:], reports[1:], strict=True):
            told = changes(reports[0], other).splitlines()
            order = [line for line in told if "order by time" in line or "faster" in line]
            print(f"{folder.name} after {folders[0].name}: {'; '.join(order)}")
            failed |= any("is faster than" in line for line in order)
    load = os.getloadavg()[0]
    times = of_membrane()
    ratio = max(times.values()) / min(times.values())
    each = ", ".join(f"{1e3 * seconds:.1f} ms {where}" for where, seconds in times.items())
    print(f"{MEMBRANE} by active-set: {each}; at most {ratio:.2f} times each other, load {load:.1f} before")
    sys.exit(failed or ratio > AGREE)


if __name__ == "__main__":
    main()
