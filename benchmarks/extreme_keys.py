"""Every key of every shipped case at an extreme, one at a time: an answer or one line, within seconds.

    python -O -W error -m benchmarks.extreme_keys               # each key once
    python -m benchmarks.extreme_keys --seed 3 --minutes 10     # other values, as far as the time goes

A number becomes 1e12, 1e100, 0, negative or another size, in its own unit where it has one; anything may become a
boolean, a list, a table or no text. Each file goes through `run`, `explain` or `oracle`, as a file or piped; what it
ends with is judged as the adversary judges it (`adversary/files.py`). A body that is made of a million elements takes
its time, and is listed as slow. Exit 1 if anything but an answer or a line of its own came.
"""

from __future__ import annotations

import argparse
import copy
import re
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.adversary.files import CASES, COMMANDS, _judge_command
from benchmarks.adversary.judging import Finding, Judge
from benchmarks.bricks import Generator

SIZES = ("1e12", "1e-12", "-1e12", "1e100", "1e-100", "-1e100", "0", "-1", "1e6", "1e-6", "1e3", "7")
COUNTS = (0, -1, 1, 2, 1000, 10**6, 10**12, -(10**12), 10**100)
OTHERS = (True, False, "", "x", [], [[1, 2], [3]], [[[]]], {}, "1e12 m", "nan", "1 m m")
# Blocks of a case file that state no problem, and keys whose values are only printed.
LEFT_OUT = ("study", "published", "remarks", "report")
TOLD = ("title", "source", "about", "derivation", "why", "where", "statement", "verdict", "erratum", "printed")
EXPECTATIONS = 2  # that a case keeps: all are read alike
NUMBER = re.compile(r"[-+\d./eE*]+")
# Seconds of the processor after which an answer is listed as slow.
PATIENCE = 5.0
PIPED = 0.15

Keys = tuple[Any, ...]


def keys(node: Any, path: Keys = ()) -> Iterator[tuple[Keys, Any]]:
    """Yield every value of a case, lists as a whole and entry by entry, with the keys that lead to it."""
    if isinstance(node, dict):
        for key, value in node.items():
            if key not in TOLD:
                yield from keys(value, (*path, key))
        return
    if isinstance(node, list):
        for i, value in enumerate(node):
            yield from keys(value, (*path, i))
    yield path, node


def extreme(value: Any, rng: Generator) -> Any:
    """Return what takes the place of a value: mostly a number of another size, or else something of another kind."""
    stated = isinstance(value, str) and bool(NUMBER.match(value)) and any(map(str.isdigit, value.split()[0]))
    if rng.random() < 0.25 or isinstance(value, bool) or not (stated or isinstance(value, int | float)):
        return OTHERS[int(rng.integers(len(OTHERS)))]
    if isinstance(value, int):
        return COUNTS[int(rng.integers(len(COUNTS)))]
    size = SIZES[int(rng.integers(len(SIZES)))]
    return size + NUMBER.sub("", value, count=1) if stated else float(size)


def as_toml(value: Any) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        plain = "".join(c if c not in '"\\' and ord(c) > 31 and ord(c) != 127 else f"\\u{ord(c):04x}" for c in value)
        return f'"{plain}"'
    if isinstance(value, list):
        return f"[{', '.join(map(as_toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{as_toml(key)} = {as_toml(one)}' for key, one in value.items())}}}"
    return repr(value)


def changed(case: dict[str, Any], path: Keys, value: Any) -> bytes:
    """Return a case file in which one value is another."""
    case = copy.deepcopy(case)
    at = case
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return "".join(f"{as_toml(key)} = {as_toml(one)}\n" for key, one in case.items()).encode()


def cases(names: list[str]) -> dict[str, dict[str, Any]]:
    """Return the cases of these names, or all, without what states no problem."""
    found = {}
    for file in sorted(CASES.glob("*.toml")):
        if not names or file.stem in names:
            case = {key: one for key, one in tomllib.loads(file.read_text("utf-8")).items() if key not in LEFT_OUT}
            found[file.stem] = case | {"expect": case.get("expect", [])[:EXPECTATIONS]}
    return found


def tried(names: list[str], seed: int, seconds: float) -> tuple[Counter[str], list[Finding], list[str]]:
    """Return how many files came to what, the findings, and the answers that took long."""
    rng, known = np.random.default_rng(seed), cases(names)
    every = [(name, path, value) for name, case in known.items() for path, value in keys(case) if path]
    judge = Judge(None, seed)  # type: ignore[arg-type]  # there is no problem with a truth
    slow, until = list[str](), time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "case.toml")
        for k in rng.permutation(len(every)).tolist():
            if time.monotonic() > until:
                break
            name, path, value = every[k]
            other = extreme(value, rng)
            data = changed(known[name], path, other)
            file.write_bytes(data)
            command = COMMANDS[int(rng.integers(len(COMMANDS)))]
            where = "-" if rng.random() < PIPED else str(file)
            what = f"{name}: {'.'.join(map(str, path))} = {str(other)[:20]}"
            began = time.process_time()
            _judge_command(judge, [command[0], where, *command[1:]], what, data)
            if (took := time.process_time() - began) > PATIENCE:
                slow.append(f"{took:.0f} s: {' '.join(command)}, {what}")
    return Counter(files=judge.judgements, of=len(every)), judge.findings, slow


def main(arguments: list[str] | None = None) -> int:
    """Run what the command line asks for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help="names of shipped cases; all without")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=60.0)
    options = parser.parse_args(arguments)
    count, findings, slow = tried(options.cases, options.seed, 60 * options.minutes)
    for finding in findings:
        print(f"{finding.kind}: {finding.what}: {finding.text}")
    for line in slow:
        print(f"slow: {line}")
    print(f"seed {options.seed}: {count['files']} of {count['of']} keys, {len(findings)} findings, {len(slow)} slow")
    return int(bool(findings))


if __name__ == "__main__":
    sys.exit(main())
