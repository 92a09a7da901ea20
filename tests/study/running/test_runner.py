"""Cells that die, hang or raise cost themselves and nobody else; what a journal has is not run again."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from contactqp.errors import SceneError
from contactqp.study.running import runner
from contactqp.study.running.child import Child
from contactqp.study.running.journal import Cell, Crash, Journal
from contactqp.study.running.runner import Progress, Running, workers_of
from contactqp.study.running.workers import Processes, ThisProcess, Workers
from tests.study.running import cell_functions as do
from tests.study.running.cell_functions import Number

CONDITIONS = {"version": 1}


def _cell(key: str, function: Callable[..., Number], *arguments: Any, digest: str = "") -> Cell:
    return Cell(key, function, arguments, Number, digest)


def run_cells(cells: list[Cell], workers: Workers, *rest: Any, alone: bool = False, **options: Any) -> dict[str, Any]:
    with workers.alone() if alone else workers.side_by_side() as pool:
        return runner.run_cells(cells, pool, *rest, **options)


def _halves(count: int) -> list[Cell]:
    return [_cell(f"half of {i}", do.half, i) for i in range(count)]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("workers", [ThisProcess(), Processes(1), Processes(3)])
@pytest.mark.parametrize("alone", [False, True])
def test_results_are_the_same_however_cells_run(workers: Workers, alone: bool) -> None:
    found = run_cells(_halves(20), workers, alone=alone)
    assert list(found.items()) == [(f"half of {i}", Number(i / 2)) for i in range(20)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "message"),
    [
        (do.segfault, "the process died of a segmentation fault (SIGSEGV)"),
        (do.killed, "the process was killed, mostly for want of memory (SIGKILL)"),
        (do.leaves, "the process left with exit code 3"),
        (do.buggy, "raised ZeroDivisionError: nobody thought of this"),
        (do.unportable, "raised RuntimeError: Unportable: this and that"),
    ],
)
@pytest.mark.parametrize("alone", [False, True])
def test_a_crash_costs_its_own_cell(function: Callable[..., Number], message: str, alone: bool) -> None:
    cells = _halves(10)
    cells.insert(3, _cell("bad", function))
    found = run_cells(cells, Processes(2), alone=alone)
    assert found.pop("bad") == Crash(message)
    assert list(found.values()) == [Number(i / 2) for i in range(10)]


def test_what_dies_once_is_run_again(tmp_path: Path) -> None:
    cells = [*_halves(3), _cell("unlucky", do.unlucky, tmp_path / "seen")]
    assert run_cells(cells, Processes(2))["unlucky"] == Number(1.0)


def test_what_hangs_is_stopped_and_the_others_are_not() -> None:
    started = time.monotonic()
    found = run_cells([_cell("hangs", do.hangs), *_halves(5)], Processes(2), time_limit=2.0)
    assert found.pop("hangs") == Crash("stopped after 2 s without an answer")
    assert list(found.values()) == [Number(i / 2) for i in range(5)]
    assert time.monotonic() - started < 30


def test_an_error_of_a_case_ends_the_study() -> None:
    for workers in (ThisProcess(), Processes(2)):
        with pytest.raises(SceneError, match="got 'much'"):
            run_cells([_cell("wrong", do.wrong_case), *_halves(3)], workers)


def test_what_libraries_print_is_no_answer(capfd: pytest.CaptureFixture[str]) -> None:
    assert run_cells([_cell("chatter", do.chatter)], Processes(1)) == {"chatter": Number(1.0)}
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "without Python" in printed.err


def test_what_is_timed_runs_alone_in_one_process(tmp_path: Path) -> None:
    together = [_cell(str(i), do.overlap, tmp_path) for i in range(8)]
    assert max(result.value for result in run_cells(together, Processes(2)).values()) == 2
    assert {result.value for result in run_cells(together, Processes(2), alone=True).values()} == {1}
    places = [_cell(str(i), do.where) for i in range(4)]
    assert len({result.value for result in run_cells(places, Processes(2), alone=True).values()}) == 1


@pytest.mark.slow
def test_side_by_side_each_has_one_thread_and_alone_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    cell = _cell("threads", do.threads)
    assert run_cells([cell], Processes(2))["threads"].value == 1
    assert math.isnan(run_cells([cell], Processes(2), alone=True)["threads"].value)


def test_on_a_busy_machine_what_is_timed_has_one_thread_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside two busy processes two threads took 340 ms where one takes 67: Hertz's contact with 8 000 unknowns."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with workers_of(Running(jobs=2), one_thread=True) as workers:
        assert run_cells([_cell("threads", do.threads)], workers, alone=True)["threads"].value == 1
        assert workers.threads == "one, as the machine is busy"


def test_two_cells_of_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="'half of 0'"):
        run_cells([*_halves(1), *_halves(1)], ThisProcess())


@pytest.mark.slow
def test_what_the_journal_has_is_not_run_again(tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    cells = [_cell(f"cell {i}", do.noted, calls, float(i)) for i in range(6)]
    for count in (4, 6):
        journal = Journal(tmp_path / "journal", CONDITIONS)
        found = run_cells(cells[:count], Processes(1), journal)
        journal.close()
    assert list(found.values()) == [Number(i / 2) for i in range(6)]
    assert calls.read_text().split() == ["0.0", "1.0", "2.0", "3.0", "4.0", "5.0"]


def test_a_changed_case_is_run_again_and_the_others_are_not(tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    for digests in ("ab", "aB"):
        journal = Journal(tmp_path / "journal", CONDITIONS)
        cells = [_cell(name.lower(), do.noted, calls, 1.0, digest=name) for name in digests]
        changed = [cell.key for cell in journal.changed(cells)]
        run_cells(cells, ThisProcess(), journal)
        journal.close()
    assert changed == ["b"]
    assert len(calls.read_text().split()) == 3


def test_a_crash_is_kept_too(tmp_path: Path) -> None:
    file = tmp_path / "journal"
    for _ in range(2):
        journal = Journal(file, CONDITIONS)
        assert isinstance(run_cells([_cell("bad", do.buggy)], ThisProcess(), journal)["bad"], Crash)
        journal.close()
    assert len(file.read_text().splitlines()) == 2  # what is run under, and the crash once


@pytest.mark.slow
def test_no_process_stays_behind() -> None:
    places = run_cells([_cell(str(i), do.where) for i in range(4)], Processes(2))
    assert len(places) == 4
    assert not any(_alive(int(result.value)) for result in places.values())


def test_processes_leave_when_their_parent_is_killed() -> None:
    """Even those that are in the middle of something."""
    code = (
        "import os, threading, time\n"
        "from contactqp.study.running.child import Child\n"
        "from tests.study.running import cell_functions as do\n"
        "child = Child({})\n"
        "print(int(child.ask(do.where, (), 60.0).value), flush=True)\n"
        "child.ask(do.hangs, (), 600.0)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=_environment())
    with parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        time.sleep(0.2)
        assert _alive(child)
        parent.send_signal(signal.SIGKILL)
    _wait_for(lambda: not _alive(child))


@pytest.mark.slow
def test_a_child_starts_again_after_its_death() -> None:
    child = Child({})
    first = child.ask(do.where, (), 60.0)
    child.ask(do.segfault, (), 60.0)
    second = child.ask(do.where, (), 60.0)
    child.close()
    assert isinstance(first, Number)
    assert isinstance(second, Number)
    assert first != second


class _Clock:
    """Ten seconds a look."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_progress_tells_the_time_that_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = _Clock()
    monkeypatch.setattr("contactqp.study.running.runner.time.monotonic", clock)
    shown: list[str] = []
    progress = Progress(lambda what, done, total, left: shown.append(f"{what} {done}/{total} {left}"))
    cells = [Cell(str(i), do.half, (1.0,), Number, cost=cost) for i, cost in enumerate((1.0, 1.0, 2.0))]
    progress.part("answers", later=lambda: 100.0)
    progress.begin(cells, {})
    clock.now = 20.0
    progress.done(cells[0], Number(1.0))
    assert shown == ["answers 0/3 ", "answers 1/3 about 2 min 40 s left"]  # 3 more at 20 s each, and 100 s
    progress.part("times", later=lambda: 0.0)
    progress.begin(cells, {"0": Number(1.0), "1": Number(1.0)})
    clock.now = 60.0
    progress.done(cells[2], Number(1.0))
    assert shown[2:] == ["times 2/3 ", "times 3/3 about 5 s left"]


def test_the_least_cells_do_not_tell_the_time_of_the_large_ones_after_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred cells take a fifth of what was expected, as calls do; the last one is expected to take a minute."""
    clock = _Clock()
    monkeypatch.setattr("contactqp.study.running.runner.time.monotonic", clock)
    shown: list[str] = []
    progress = Progress(lambda *told: shown.append(told[3]))
    least = [Cell(str(i), do.half, (1.0,), Number, cost=0.02) for i in range(100)]
    progress.part("times", later=lambda: 0.0, side_by_side=1)
    progress.begin([*least, Cell("large", do.half, (1.0,), Number, cost=60.0)], {})
    assert shown == ["about 1 min 0 s left"]
    for cell in least:
        clock.now += 0.004
        progress.done(cell, Number(1.0))
    assert shown[-1] == "about 50 s left"
    progress.part("answers", later=lambda: 0.0, side_by_side=2)
    progress.begin([Cell(str(i), do.half, (1.0,), Number, cost=10.0) for i in range(4)], {})
    assert shown[-1] == "about 20 s left"


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{process}/stat")
    return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")


def _wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)
