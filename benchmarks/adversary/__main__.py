"""Problems, candidates and files by a grammar, for so many minutes; everything that is wrong is a finding.

    python -m benchmarks.adversary --minutes 2
    python -m benchmarks.adversary --seed 17 --trial 4231      # one trial again
    python -m benchmarks.adversary --minutes 2 --plant tension # with a fault planted, which must be found

The seed is printed; trials are the same for the same seed. Each is judged by exact rational solutions or enumeration,
or by the law written out once more; forged answers must be refused; whatever leaves a function must be an answer or an
error of this package, without a warning and within five seconds. Findings are shrunk and written below --output with
the command that shows them. Exit code 1 if there are any.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import resource
import secrets
import subprocess
import sys
import threading
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.adversary import judging
from benchmarks.adversary.faults import FAULTS, SEEN_AS
from benchmarks.adversary.judging import Finding
from benchmarks.adversary.trials import KINDS, Trial, trial, write_smallest

# Seconds without a word from a process after which it hangs: of the processor, and by the clock where it only waits.
SILENCE, WAITING = 60, 600
MEMORY = 4 * 2**30
LARGEST = 2**30  # bytes that a process may hold
SHOWN = 40


@dataclass
class Tally:
    """What all trials add up to."""

    trials: Counter[str] = field(default_factory=Counter)
    judgements: Counter[str] = field(default_factory=Counter)
    exact: int = 0
    findings: list[tuple[int, str, tuple[str, ...], Finding]] = field(default_factory=list)

    def add(self, number: int, done: Trial) -> None:
        self.trials[done.kind] += 1
        self.judgements[done.kind] += done.judgements
        self.exact += done.exact
        self.findings += [(number, done.kind, done.words, finding) for finding in done.findings]


def child(options: argparse.Namespace, first: int) -> None:
    """Every so many-th trial from `first` on, until the time is over: a line before and a line after each."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    out, until = sys.stdout, time.monotonic() + 60 * options.minutes
    number = first
    with FAULTS[options.plant]():
        while time.monotonic() < until and (options.trials is None or number < options.trials):
            print(json.dumps({"begun": number}), file=out, flush=True)
            done = trial(options.seed, number, tuple(options.kind or KINDS))
            largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
            print(json.dumps({"number": number, "memory": largest} | asdict(done)), file=out, flush=True)
            number += options.jobs


class Processes:
    """The trials of all processes; one that is silent or ends is a finding, and another goes on behind it."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.tally = Tally()
        self._options = options
        self._until = time.monotonic() + 60 * options.minutes
        self._lines: queue.Queue[tuple[int, str | None]] = queue.Queue()
        self._processes: dict[int, subprocess.Popen[str]] = {}
        self._begun: dict[int, int] = {}
        self._heard: dict[int, tuple[float, float]] = {}
        self._large: set[int] = set()
        for job in range(options.jobs):
            self._start(job, job)
        self._running = set(self._processes)

    def run(self) -> Tally:
        """A fault that is planted need be found once, by a finding that is due to it."""
        while self._running and not self._found_what_is_planted():
            try:
                job, line = self._lines.get(timeout=1.0)
            except queue.Empty:
                self._end_silent()
                continue
            self._heard[job] = self._clocks(job)
            if line is None:
                self._ended(job, self._processes[job].wait())
            elif not line.startswith("{"):  # a library's own words, past Python's streams
                self._find(self._begun[job], "printed", f"on standard output: {line.strip()[:200]}")
            else:
                self._said(job, json.loads(line))
        for one in self._processes.values():
            one.kill()
        return self.tally

    def _found_what_is_planted(self) -> bool:
        due = SEEN_AS.get(self._options.plant, set())
        return any(finding.kind in due for *_, finding in self.tally.findings)

    def _start(self, job: int, first: int) -> None:
        options, left = self._options, max(self._until - time.monotonic(), 0.0) / 60
        command = [sys.executable, "-m", "benchmarks.adversary", "--child", str(first), "--minutes", f"{left:.4f}",
                   "--seed", str(options.seed), "--jobs", str(options.jobs), "--plant", options.plant,
                   "--patience", str(options.patience)]  # fmt: skip
        command += [part for kind in options.kind or () for part in ("--kind", kind)]
        command += [] if options.trials is None else ["--trials", str(options.trials)]
        one = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self._processes[job], self._begun[job] = one, -1
        self._heard[job] = self._clocks(job)
        self._large.discard(job)
        threading.Thread(target=self._read, args=(job, one), daemon=True).start()

    def _read(self, job: int, one: subprocess.Popen[str]) -> None:
        assert one.stdout is not None
        with one.stdout:
            for line in one.stdout:
                self._lines.put((job, line))
        self._lines.put((job, None))

    def _end_silent(self) -> None:
        for job in tuple(self._running):
            waited, worked = (now - then for now, then in zip(self._clocks(job), self._heard[job], strict=True))
            if worked > SILENCE or waited > WAITING:
                self._processes[job].kill()
                self._processes[job].wait()

    def _clocks(self, job: int) -> tuple[float, float]:
        """The time, and the processor's seconds of a process: other work on the machine is no silence of it."""
        try:
            spent = Path(f"/proc/{self._processes[job].pid}/stat").read_text().rpartition(")")[2].split()
            worked = (int(spent[11]) + int(spent[12])) / os.sysconf("SC_CLK_TCK")
        except (OSError, IndexError):  # it has ended, or this is no Linux
            worked = time.monotonic()
        return time.monotonic(), worked

    def _ended(self, job: int, code: int) -> None:
        number = self._begun[job]
        if code != 0:
            where = "" if number >= 0 else " before its first trial"
            self._find(number, "hang", f"the process ended with {code}{where}")
        if code == 0 or number < 0 or time.monotonic() > self._until:
            self._running.discard(job)
        else:
            self._start(job, number + self._options.jobs)

    def _said(self, job: int, said: dict[str, Any]) -> None:
        if "begun" in said:
            self._begun[job] = said["begun"]
            return
        number, memory = said.pop("number"), said.pop("memory")
        if memory > LARGEST and job not in self._large:
            self._large.add(job)
            self._find(number, "memory", f"the process holds {memory:.3g} bytes from here on")
        findings = tuple(Finding(**one) for one in said.pop("findings"))
        self.tally.add(number, Trial(**said | {"findings": findings, "words": tuple(said["words"])}))

    def _find(self, number: int, kind: str, text: str) -> None:
        self.tally.findings.append((number, "process", (), Finding(kind, f"trial {number}", text)))


def table(tally: Tally, minutes: float) -> list[str]:
    found = Counter(kind for _, kind, _, _ in tally.findings)
    judged = sum(tally.judgements.values())
    rows = [(kind, tally.trials[kind], tally.judgements[kind], found[kind]) for kind in (*KINDS, "process")]
    rows.append(("all", sum(tally.trials.values()), judged, len(tally.findings)))
    return [
        f"{'':14}{'trials':>9}{'judgements':>12}{'findings':>10}",
        *(f"{kind:14}{trials:9}{judgements:12}{findings:10}" for kind, trials, judgements, findings in rows),
        f"{tally.exact} problems with a known truth; {judged / minutes:.0f} judgements a minute",
    ]


def show_trial(options: argparse.Namespace) -> int:
    with FAULTS[options.plant]():
        done = trial(options.seed, options.trial, tuple(options.kind or KINDS))
    print(f"{done.kind}: {' '.join(word for word in done.words if word)}; {done.judgements} judgements")
    for finding in done.findings:
        print(f"{finding.kind}: {finding.what}: {finding.text}")
    return 1 if done.findings else 0


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=None, help="printed, and new each time, where none is given")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--kind", action="append", choices=list(KINDS), help="only this; may be repeated")
    parser.add_argument("--trial", type=int, help="this one alone, in this process")
    parser.add_argument("--trials", type=int, help="no more than these")
    parser.add_argument("--plant", choices=list(FAULTS), default="none", help="a fault that must be found")
    parser.add_argument("--output", type=Path, default=Path("findings"), help="where findings are written")
    parser.add_argument("--patience", type=float, default=judging.PATIENCE, help="seconds that an answer may take")
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    options.seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # of the processes that are started
    judging.PATIENCE = options.patience
    if options.child is not None:
        child(options, options.child)
        return 0
    if options.trial is not None:
        return show_trial(options)
    print(f"seed {options.seed}, {options.minutes:g} minutes, {options.jobs} processes", flush=True)
    started = time.monotonic()
    tally = Processes(options).run()
    print("\n".join(table(tally, (time.monotonic() - started) / 60)))
    for number, kind, words, finding in tally.findings[:SHOWN]:
        said = " ".join(word for word in words if word)
        print(f"{finding.kind}: trial {number} ({kind} {said}): {finding.what}: {finding.text}")
    if options.plant == "none":
        seen: set[tuple[str, str]] = set()
        kinds = tuple(options.kind or KINDS)
        for number, _, _, finding in tally.findings:
            if number >= 0 and (finding.kind, finding.what) not in seen and len(seen) < 10:
                seen.add((finding.kind, finding.what))
                print(f"written: {write_smallest(options.seed, number, kinds, finding, options.output)}")
    return 1 if tally.findings else 0


if __name__ == "__main__":
    sys.exit(main())
