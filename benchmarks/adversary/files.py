"""Mutated files of every format, and mutated files and words through the commands that take them."""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
import tempfile
import warnings
from pathlib import Path
from unittest.mock import patch

import numpy as np
import scipy.io
import scipy.sparse as sp

import contactqp as cq
from benchmarks.adversary.judging import Judge
from benchmarks.bricks import Generator
from benchmarks.decks import write_decks
from benchmarks.fuzz_readers import JUDGED, LONGEST_MESSAGE, REFUSED, run_format
from benchmarks.mutations import mutate
from benchmarks.valid_files import SLOW, Seed, problem, seeds
from contactqp.cli import main

CASES = Path(__file__).parents[2] / "cases"
# Cases of a few unknowns, and the commands that take them; answers in milliseconds.
SMALL = ("bar_wall.toml", "klarbring_push_first.toml", "von_mises_truss.toml", "bar_impact.toml", "stacked_blocks.toml")
COMMANDS = (("run",), ("explain",), ("oracle",), ("run", "--json"), ("oracle", "--json"))
# Numerals in a case file, and what one of them becomes: any size that a double has, and sizes that none has.
NUMERAL = re.compile(rb"(?<![\w.-])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")
SIZES = (b"0", b"-1", b"5e-324", b"1e-308", b"1e-200", b"1e-30", b"1e30", b"1e200", b"1.7e308", b"1e400", b"9" * 400)
# Mutated files of one trial, and of formats that are read in a process of their own; the slowest of these take seconds
# a file, and come one at a time in so many of all trials.
FILES, OWN_PROCESS = 20, 4
IN_OWN_PROCESS = ("quadratic-program.mat", "quadratic-program.qps")
SLOW_TRIALS = 0.02
# Formats of quadratic programs that are run and checked as they come.
PROGRAMS = ("mat", "npz", "qps")
ENTRIES = (np.nan, np.inf, -1e20, 1e20, 1e308, 5e-324, 1e-200, -1.0)
# What commands end with: done, not certified, refused, something is missing.
EXITS = (0, 1, 2, 3)
REFUSED_BY = (2, 3)
# Names and numbers that somebody may type, and commands that take them; FOLDER/WORD is a file that may be written.
WORDS = (
    "",
    "-",
    "x",
    "bar_wall",
    "all",
    "named",
    "hard",
    "truss-over-floor",
    "a" * 300,
    "1" * 5000,
    "..",
    "a\nb",
    "nan",
    "1e400",
    "-1",
    "0",
    "2",
    "\u0663",
    "\0",
    "\udcff",
    "[bold]",
    "%s",
    "x.toml",
    "*.toml",
    "/dev/null",
)
SPOKEN = (
    "init FOLDER/WORD", "init FOLDER/WORD.toml --like WORD", "cases WORD", "cases WORD --json", "schema WORD",
    "gallery --list --count 1 --kind WORD", "gallery --list --name WORD --json", "methods WORD", "oracle WORD",
    "gallery --list --count 1 --difficulty WORD", "gallery FOLDER/WORD --name truss-over-floor --as WORD",
    "run CASE --time-limit WORD --json", "run CASE --method WORD", "run CASE --units WORD", "run CASE --csv WORD",
    "explain WORD --no-solve", "export WORD --inp FOLDER/deck", "crosscheck WORD", "check --verify WORD --json",
)  # fmt: skip


class Files:
    """Valid files of every format in a folder that is removed with this."""

    def __init__(self) -> None:
        self._root = tempfile.TemporaryDirectory()
        self.folder = Path(self._root.name)
        found = seeds(self.folder)
        self.seeds = [seed for seed in found if not seed.name.startswith(SLOW)]
        self.slow = [seed for seed in found if seed.name.startswith(SLOW)]
        self.problem = cq.write_problem(self.folder / "checked", problem(), cq.solve(problem()))
        self.asked = self._asked()

    def _asked(self) -> list[tuple[Path, list[str]]]:
        """Return files beside cases and answers, each with a command that reads it."""
        answer, receipt, loads = (self.folder / name for name in ("judged.json", "receipt.json", "loads.csv"))
        answer.write_bytes((self.problem / "answer.json").read_bytes())
        loads.write_text("case,1.x,2.x\none,1e5,2e5\ntwo,-3e4,\nthree,,1e5\n")
        exported = self.folder / "exported.toml"
        exported.write_bytes((CASES / "patch_two_blocks.toml").read_bytes())
        decks = self.folder / "decks"
        decks.mkdir()
        write_decks(decks)
        check = ["check", str(self.problem), str(answer), "--receipt"]
        assert _ended([*check, str(receipt)], b"")[0] == 0
        asked = [
            (receipt, ["check", "--verify", str(receipt)]),
            (answer, [*check, str(self.folder / "another.json")]),
            (loads, ["run", str(CASES / "two_bars.toml"), "--loads", str(loads)]),
            (exported, ["export", str(exported), "--inp", str(self.folder / "deck")]),
        ]
        for suffix in PROGRAMS:
            asked += self._of_program(suffix)
        for name in ("plane", "space", "assembled"):
            files = [decks / f"{name}.inp", decks / f"{name}.dat"]
            asked += [(file, ["crosscheck", *map(str, files)]) for file in files]
        return asked

    def _of_program(self, suffix: str) -> list[tuple[Path, list[str]]]:
        """Return a quadratic program of one format, solved and beside its answer, and the answer."""
        folder = self.folder / f"program-{suffix}"
        folder.mkdir()
        file, answer = folder / f"program.{suffix}", folder / "answer.json"
        file.write_bytes((self.folder / f"quadratic-program.{suffix}" / file.name).read_bytes())
        stated = cq.read_problem(file)
        cq.write_problem(folder / "solved", stated, cq.solve(stated))
        answer.write_bytes((folder / "solved" / "answer.json").read_bytes())
        check = ["check", str(file), str(answer)]
        return [(file, ["run", str(file)]), (file, check), (answer, check)]

    def judge(self, judge: Judge, rng: Generator) -> None:
        """Mutate the files of one format, one case file or one answer, and ask about each."""
        drawn = rng.random()
        if self.slow and drawn < SLOW_TRIALS:
            self._read(judge, self.slow[int(rng.integers(0, len(self.slow)))], rng, 1)
        elif drawn < 0.5:
            seed = self.seeds[int(rng.integers(0, len(self.seeds)))]
            self._read(judge, seed, rng, OWN_PROCESS if seed.name in IN_OWN_PROCESS else FILES)
        elif drawn < 0.7:
            self._command(judge, rng)
        elif drawn < 0.82:
            self._check(judge, rng)
        elif drawn < 0.95:
            self._ask(judge, rng)
        else:
            self._speak(judge, rng)

    def _read(self, judge: Judge, seed: Seed, rng: Generator, files: int) -> None:
        numbers = rng.integers(0, 2**31, files).tolist()
        for number, what, outcome in run_format(seed, self.folder / seed.name, numbers):
            judge.judgements += 1
            if outcome not in (JUDGED, REFUSED):
                judge.found("crashed", f"{seed.name} {number} ({what})", outcome)

    def _command(self, judge: Judge, rng: Generator) -> None:
        names = [name for name in SMALL if (CASES / name).exists()]
        original = (CASES / str(rng.choice(names))).read_bytes()
        file = self.folder / "case.toml"
        for _ in range(FILES):
            changed, what = mutate(original, rng) if rng.random() < 0.5 else _of_any_size(original, rng)
            file.write_bytes(changed)
            command = COMMANDS[int(rng.integers(0, len(COMMANDS)))]
            piped = rng.random() < 0.3
            _judge_command(judge, [command[0], "-" if piped else str(file), *command[1:]], what, changed)

    def _check(self, judge: Judge, rng: Generator) -> None:
        original = (self.problem / "answer.json").read_bytes()
        file = self.folder / "answer.json"
        for _ in range(FILES):
            changed, what = mutate(original, rng)
            file.write_bytes(changed)
            piped = rng.random() < 0.5
            command = ["check", str(self.problem), "-" if piped else str(file), *["--json"] * int(rng.integers(0, 2))]
            _judge_command(judge, command, what, changed)

    def _ask(self, judge: Judge, rng: Generator) -> None:
        file, command = self.asked[int(rng.integers(0, len(self.asked)))]
        original = file.read_bytes()
        for _ in range(FILES):
            changed, what = _mutated(file, original, rng)
            file.write_bytes(changed)
            as_json = ["--json"] * int(command[0] != "export" and rng.random() < 0.4)
            _judge_command(judge, [*command, *as_json], what, b"")
        file.write_bytes(original)

    def _speak(self, judge: Judge, rng: Generator) -> None:
        for _ in range(FILES):
            command = str(rng.choice(SPOKEN)).split()
            word = WORDS[int(rng.integers(0, len(WORDS)))]
            with tempfile.TemporaryDirectory() as folder:
                places = {"WORD": word, "FOLDER": folder, "CASE": str(CASES / "bar_wall.toml")}
                _judge_command(judge, [_filled(part, places) for part in command], repr(word[:20]), b"")


def _of_any_size(original: bytes, rng: Generator) -> tuple[bytes, str]:
    """A case file in which one or two numbers are of another size."""
    found, what = list(NUMERAL.finditer(original)), []
    for at in sorted(rng.choice(len(found), int(rng.integers(1, 3)), replace=False), reverse=True):
        size = SIZES[int(rng.integers(0, len(SIZES)))]
        original = original[: found[at].start()] + size + original[found[at].end() :]
        what.append(f"number {at} is {size[:9].decode()}")
    return original, ", ".join(what)


def _mutated(file: Path, original: bytes, rng: Generator) -> tuple[bytes, str]:
    """A file with its bytes mutated, or, of a quadratic program as often, with other numbers or arrays."""
    if file.suffix not in (".mat", ".npz", ".qps") or rng.random() < 0.5:
        return mutate(original, rng)
    return _of_any_size(original, rng) if file.suffix == ".qps" else _of_other_arrays(file.suffix, original, rng)


def _of_other_arrays(suffix: str, original: bytes, rng: Generator) -> tuple[bytes, str]:
    """An archive of arrays in which one is left out, of another shape or kind, or holds a number of any size."""
    stored, out = io.BytesIO(original), io.BytesIO()
    if suffix == ".npz":
        with np.load(stored) as archive:
            arrays = dict(archive)
    else:
        read = scipy.io.loadmat(stored)
        arrays = {name: value for name, value in read.items() if not name.startswith("__")}
    name = str(rng.choice(sorted(arrays)))
    changes = ("left out", "number", "transposed", "empty", "complex", "words", "a cube", "whole", "twice", "one")
    what = str(rng.choice(changes))
    value = arrays.pop(name)
    dense = np.array(value.toarray() if sp.issparse(value) else value)
    if what == "number":
        dense = dense.astype(float)
        dense.flat[int(rng.integers(0, dense.size))] = rng.choice(ENTRIES)
    changed = {
        "left out": None, "number": dense, "transposed": dense.T, "empty": dense[:0], "complex": dense.astype(complex),
        "words": dense.astype(str), "a cube": dense[None, None], "whole": (dense > 0).astype(np.int8),
        "twice": np.concatenate([dense, dense]) if dense.ndim else dense, "one": dense.ravel()[:1],
    }[what]  # fmt: skip
    if changed is not None:
        arrays[name] = sp.csc_array(changed) if sp.issparse(value) and what in ("number", "transposed") else changed
    np.savez(out, **arrays) if suffix == ".npz" else scipy.io.savemat(out, arrays)
    return out.getvalue(), f"{name}: {what}"


def _filled(part: str, places: dict[str, str]) -> str:
    for name, value in places.items():
        part = part.replace(name, value)
    return part


def _judge_command(judge: Judge, command: list[str], what: str, piped: bytes) -> None:
    """A command ends with an exit code that it promises; an error is one line, and JSON where that was asked for."""
    code, out, err = _ended(command, piped)
    judge.judgements += 1
    words = " ".join(word for word in command if "/" not in word)
    if code not in EXITS or "Traceback" in err:
        judge.found("crashed", f"{words} ({what})", f"exit {code}: {err[-300:]}")
    elif code in REFUSED_BY and "--json" in command and not _is_json(out):
        judge.found("printed", f"{words} ({what})", f"no JSON: {out[-300:]}")
    elif code in REFUSED_BY and not _in_one_line(err):
        judge.found("printed", f"{words} ({what})", f"no line of its own: {err[-300:]}")


def _in_one_line(text: str) -> bool:
    """Return whether an error is one line that can be read; how a command is used takes lines, and warnings do."""
    lines = [line for line in text.splitlines() if not line.startswith("contactqp: warning:")]
    return text.startswith("Usage: ") or (len(lines) == 1 and len(lines[0]) <= LONGEST_MESSAGE)


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


def _ended(arguments: list[str], piped: bytes) -> tuple[object, str, str]:
    """The exit code of a command in this process, and what it said on standard output and standard error."""
    out, err = io.StringIO(), io.StringIO()
    stdin = io.TextIOWrapper(io.BytesIO(piped), encoding="utf-8", errors="surrogateescape")
    streams = contextlib.redirect_stdout(out), contextlib.redirect_stderr(err)
    with warnings.catch_warnings(), patch.object(sys, "stdin", stdin), streams[0], streams[1]:
        warnings.simplefilter("error")
        try:
            main(arguments)
        except SystemExit as ended:
            return ended.code, out.getvalue(), err.getvalue()
        except Exception as error:  # noqa: BLE001  whatever leaves is what is looked for
            return type(error).__name__, out.getvalue(), str(error)
    return None, out.getvalue(), err.getvalue()
