"""Cells run: what a journal has is taken from it, the rest runs and is written to it as it comes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any, Protocol

from contactqp.errors import ContactQPError
from contactqp.study.running.cells import Cell, Crash, Result, refuse_twins
from contactqp.study.running.journal import Journal
from contactqp.study.running.progress import Progress, nothing
from contactqp.study.running.workers import Slot, Workers

# Seconds after which a cell is stopped: far more than anything in a report takes, and less than anybody waits.
TIME_LIMIT = 600.0
# Seconds after which a watcher is told that time goes by.
TICK = 0.5


class Watcher(Protocol):
    """Is told how far a study is."""

    def begin(self, cells: Sequence[Cell], found: Mapping[str, Result], /) -> None:
        """These cells are wanted, and of these keys the results were kept."""

    def done(self, cell: Cell, result: Result, /) -> None:
        """One more."""

    def tick(self) -> None:
        """Time goes by."""


def run_cells(
    cells: Sequence[Cell],
    workers: Workers,
    journal: Journal | None = None,
    *,
    alone: bool = False,
    watcher: Watcher | None = None,
    time_limit: float = TIME_LIMIT,
) -> dict[str, Result]:
    """The results of all cells by their keys, in the order of the cells.

    A cell whose process dies is run once more, when all others are done, in a process of its own: what died with it by
    chance, or of a signal that was meant for all, is no crash. A cell that dies again is one, as is one that raises
    what is no error of contactqp, and one that takes too long.

    Parameters
    ----------
    cells : sequence of Cell
    workers : Workers
        Where they run.
    journal : Journal, optional
        Where results are kept, each as soon as there is one.
    alone : bool
        Whether they are timed: one after the other in one process, while nothing else runs.
    watcher : Watcher, optional
    time_limit : float
        Of each cell [s]. What runs in this process cannot be stopped.

    Raises
    ------
    ContactQPError
        Of a cell: the case is wrong.
    """
    refuse_twins(cells)
    watcher = watcher or Progress(nothing)
    found = {cell.key: result for cell in cells if journal and (result := journal.find(cell)) is not None}
    left = [cell for cell in cells if cell.key not in found]
    watcher.begin(cells, found)
    if left:
        with workers.alone() if alone else workers.concurrent() as slots:
            for cell, result in _twice_if_it_dies(left, slots, watcher, time_limit):
                found[cell.key] = journal.write(cell, result) if journal else result
                watcher.done(cell, found[cell.key])
    return {cell.key: found[cell.key] for cell in cells}


@dataclass(frozen=True)
class _Death:
    """Of the process that ran a cell."""

    message: str


@dataclass(frozen=True)
class _Task:
    """A cell that runs."""

    cell: Cell
    slot: Slot
    deadline: float


def _twice_if_it_dies(
    cells: Sequence[Cell], slots: Sequence[Slot], watcher: Watcher, time_limit: float
) -> Iterator[tuple[Cell, Result]]:
    suspects = []
    for cell, result in _side_by_side(cells, slots, watcher, time_limit):
        if isinstance(result, _Death):
            suspects.append(cell)
        else:
            yield cell, result
    for cell in suspects:
        slots[0].restart()
        for _, result in _side_by_side([cell], slots[:1], watcher, time_limit):
            yield cell, Crash(result.message) if isinstance(result, _Death) else result


def _side_by_side(
    cells: Sequence[Cell], slots: Sequence[Slot], watcher: Watcher, time_limit: float
) -> Iterator[tuple[Cell, Result | _Death]]:
    waiting, idle = deque(cells), list(slots)
    running: dict[Future[Any], _Task] = {}
    while waiting or running:
        while waiting and idle:
            cell, slot = waiting.popleft(), idle.pop()
            running[slot.submit(cell.function, cell.arguments)] = _Task(cell, slot, time.monotonic() + time_limit)
        done, _ = wait(running, timeout=TICK, return_when=FIRST_COMPLETED)
        watcher.tick()
        for future in [*done, *_late(running, done)]:
            task = running.pop(future)
            idle.append(task.slot)
            yield task.cell, _outcome(task.slot, future) if future in done else _stopped(task.slot, time_limit)


def _late(running: dict[Future[Any], _Task], done: set[Future[Any]]) -> list[Future[Any]]:
    now = time.monotonic()
    return [future for future, task in running.items() if future not in done and now > task.deadline]


def _stopped(slot: Slot, time_limit: float) -> Crash:
    slot.restart()
    return Crash(f"stopped after {time_limit:g} s without an answer")


def _outcome(slot: Slot, future: Future[Any]) -> Result | _Death:
    error = future.exception()
    if error is None:
        return future.result()
    death = slot.death(error)
    if death is not None:
        slot.restart()
        return _Death(death)
    if isinstance(error, ContactQPError):
        raise error
    return Crash(f"raised {type(error).__name__}: {error}")
