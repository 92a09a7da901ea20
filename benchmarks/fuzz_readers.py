"""Mutated files of every format: each is judged, or refused in one line; no other exception, no crash, no blow-up.

    python -m benchmarks.fuzz_readers                # 12 000 files
    python -m benchmarks.fuzz_readers --files 500 --only answer

Every format runs in a process of its own with a limit on its memory, and every file has a limit of time. Exit 1 if any
file did anything else than being judged or refused.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.mutations import mutate
from benchmarks.valid_files import SLOW, Seed, seeds
from contactqp.errors import ContactQPError, StartWarning

JUDGED, REFUSED = "judged", "refused"
# Bytes of address space of a process that has NumPy, SciPy, h5py and meshlane; seconds for a file.
MEMORY, SECONDS = 3 * 2**30, 20
SECONDS_SLOW = 150  # of formats that take a process of their own, with a graphics library in it
LONGEST_MESSAGE = 1000
SPARED = 10  # of the slow formats a tenth as many


class TooSlow(BaseException):
    """No ContactQPError and no Exception: nothing catches it on its way."""


def outcome(seed: Seed, folder: Path) -> str:
    """What becomes of the question in a folder: judged, refused, or what went wrong with asking."""
    said = io.StringIO()
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", StartWarning)  # meant for whoever wrote the case
            seed.ask(folder)
    except ContactQPError as error:
        message = str(error)
        if not message or len(message) > LONGEST_MESSAGE:
            return f"message: {message[:200]!r}"
        return REFUSED if not said.getvalue() else f"printed: {said.getvalue()[:200]!r}"
    except (TooSlow, Exception) as error:  # noqa: BLE001
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {str(error)[:150]!r} at {Path(last.filename).name}:{last.lineno}"
    return JUDGED if not said.getvalue() else f"printed: {said.getvalue()[:200]!r}"


def run_format(seed: Seed, folder: Path, numbers: Sequence[int]) -> Iterator[tuple[int, str, str]]:
    """Number, mutation and outcome of every mutated file; number k is the same file whenever it is asked for."""
    file = folder / seed.mutated
    data = file.read_bytes()
    for number in numbers:
        random = np.random.default_rng([number, *seed.name.encode()])
        changed, what = mutate(data, random)
        file.write_bytes(changed)
        yield number, what, outcome(seed, folder)
    file.write_bytes(data)


def child(name: str, first: int, count: int) -> None:
    """One format, in this process: a line of JSON for every file, the number of the next one before it is tried."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))

    def late(*_: object) -> None:
        raise TooSlow

    signal.signal(signal.SIGALRM, late)
    out = sys.stdout
    with tempfile.TemporaryDirectory() as root:
        (seed,) = (one for one in seeds(Path(root)) if one.name == name)
        for number in range(first, first + count):
            print(json.dumps({"next": number}), file=out, flush=True)
            signal.alarm(SECONDS_SLOW if name.startswith(SLOW) else SECONDS)
            for _, what, said in run_format(seed, Path(root, name), [number]):
                signal.alarm(0)
                print(json.dumps({"number": number, "what": what, "outcome": said}), file=out, flush=True)


def parent(name: str, count: int) -> tuple[Counter[str], list[str]]:
    """Counts of outcomes of one format, and what was neither judged nor refused; goes on after a crash."""
    counts: Counter[str] = Counter()
    odd: list[str] = []
    first = 0
    while first < count:
        command = [sys.executable, "-m", "benchmarks.fuzz_readers", "--child", name, str(first), str(count - first)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        lines = [json.loads(line) for line in ended.stdout.splitlines() if line.startswith("{")]
        for line in lines:
            if "outcome" in line:
                known = line["outcome"] in (JUDGED, REFUSED)
                counts[line["outcome"] if known else "odd"] += 1
                if not known:
                    odd.append(f"{name} {line['number']} ({line['what']}): {line['outcome']}")
        begun = [line["next"] for line in lines if "next" in line]
        if ended.returncode == 0:
            return counts, odd
        if not begun:
            return counts, [*odd, f"{name}: no process: {ended.stderr[-300:]!r}"]
        counts["odd"] += 1
        odd.append(f"{name} {begun[-1]}: the process ended with {ended.returncode}: {ended.stderr[-300:]!r}")
        first = begun[-1] + 1
    return counts, odd


def main() -> int:
    if "--child" in sys.argv:
        name, first, count = sys.argv[2:]
        child(name, int(first), int(count))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=12000, help="mutated files in all")
    parser.add_argument("--only", default="", help="formats whose names contain this")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as root:
        names = [seed.name for seed in seeds(Path(root)) if options.only in seed.name]
    each, failed = -(-options.files // len(names)), []
    print(f"{'format':32} {'judged':>8} {'refused':>8} {'other':>8}")
    total: Counter[str] = Counter()
    for name in names:
        counts, odd = parent(name, -(-each // SPARED) if name.startswith(SLOW) else each)
        print(f"{name:32} {counts[JUDGED]:8} {counts[REFUSED]:8} {counts['odd']:8}", flush=True)
        for line in odd:
            print(f"    {line}", flush=True)
        total += counts
        failed += odd
    print(f"{'all':32} {total[JUDGED]:8} {total[REFUSED]:8} {total['odd']:8}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
