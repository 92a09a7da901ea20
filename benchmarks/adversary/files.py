"""Mutated files of every format, and mutated case files through the commands that read them."""

from __future__ import annotations

import contextlib
import io
import tempfile
import warnings
from pathlib import Path

from benchmarks.adversary.judging import Judge
from benchmarks.bricks import Generator
from benchmarks.fuzz_readers import JUDGED, REFUSED, run_format
from benchmarks.mutations import mutate
from benchmarks.valid_files import SLOW, Seed, seeds
from contactqp.cli import main

CASES = Path(__file__).parents[2] / "cases"
# Cases of a few unknowns, and the commands that take them; answers in milliseconds.
SMALL = ("bar_wall.toml", "seed_2_18.toml", "beam_on_stops.toml")
COMMANDS = (("run",), ("explain",), ("oracle",), ("run", "--json"))
# Mutated files of one trial.
FILES = 20
# What commands end with: done, not certified, refused, something is missing.
EXITS = (0, 1, 2, 3)


class Files:
    """Valid files of every format in a folder that is removed with this."""

    def __init__(self) -> None:
        self._root = tempfile.TemporaryDirectory()
        self.folder = Path(self._root.name)
        self.seeds = [seed for seed in seeds(self.folder) if not seed.name.startswith(SLOW)]

    def judge(self, judge: Judge, rng: Generator) -> None:
        """Mutate the files of one format, or one case file, and ask about each."""
        if rng.random() < 0.5:
            self._read(judge, self.seeds[int(rng.integers(0, len(self.seeds)))], rng)
        else:
            self._command(judge, rng)

    def _read(self, judge: Judge, seed: Seed, rng: Generator) -> None:
        numbers = rng.integers(0, 2**31, FILES).tolist()
        for number, what, outcome in run_format(seed, self.folder / seed.name, numbers):
            judge.judgements += 1
            if outcome not in (JUDGED, REFUSED):
                judge.found("crashed", f"{seed.name} {number} ({what})", outcome)

    def _command(self, judge: Judge, rng: Generator) -> None:
        names = [name for name in SMALL if (CASES / name).exists()]
        original = (CASES / str(rng.choice(names))).read_bytes()
        file = self.folder / "case.toml"
        for _ in range(FILES):
            changed, what = mutate(original, rng)
            file.write_bytes(changed)
            command = COMMANDS[int(rng.integers(0, len(COMMANDS)))]
            code, said = _ended([*command[:1], str(file), *command[1:]])
            judge.judgements += 1
            if code not in EXITS or "Traceback" in said:
                judge.found("crashed", f"{' '.join(command)} ({what})", f"exit {code}: {said[-300:]}")


def _ended(arguments: list[str]) -> tuple[object, str]:
    """The exit code of a command in this process, and what it said on standard error."""
    out, err = io.StringIO(), io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        warnings.simplefilter("error")
        try:
            main(arguments)
        except SystemExit as ended:
            return ended.code, err.getvalue()
        except Exception as error:  # noqa: BLE001  whatever leaves is what is looked for
            return type(error).__name__, str(error)
    return None, err.getvalue()
