"""Cells run: what a journal has is taken from it, the rest runs and is written to it as it comes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any, Protocol

from contactqp.errors import ContactQPError, InvalidProblem
from contactqp.study.running.cells import Cell, Crash, Result, refuse_twins
from contactqp.study.running.child import Death, Late, Raised
from contactqp.study.running.journal import Journal
from contactqp.study.running.progress import Progress, nothing
from contactqp.study.running.workers import Crew

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
    crew: Crew,
    journal: Journal | None = None,
    *,
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
    crew : Crew
        Who runs them: ``with Processes(2).side_by_side() as crew``, or ``alone()`` for what is timed.
    journal : Journal, optional
        Where results are kept, each as soon as there is one.
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
    for cell, result in _Run(crew, watcher, time_limit).results(left):
        found[cell.key] = journal.write(cell, result) if journal else result
        watcher.done(cell, found[cell.key])
    return {cell.key: found[cell.key] for cell in cells}


class _Run:
    """Cells run by one crew."""

    def __init__(self, crew: Crew, watcher: Watcher, limit: float) -> None:
        self._crew, self._watcher, self._limit = crew, watcher, limit

    def results(self, cells: Sequence[Cell]) -> Iterator[tuple[Cell, Result]]:
        """Of all cells as they come; those whose process died are run again at the end, one by one."""
        suspects = []
        for cell, result in self._once(cells, self._crew.size):
            if isinstance(result, Death):
                suspects.append(cell)
            else:
                yield cell, result
        for cell, result in self._once(suspects, 1):
            yield cell, Crash(result.message) if isinstance(result, Death) else result

    def _once(self, cells: Sequence[Cell], size: int) -> Iterator[tuple[Cell, Result | Death]]:
        waiting = deque(cells)
        running: dict[Future[Any], Cell] = {}
        while waiting or running:
            while waiting and len(running) < size:
                cell = waiting.popleft()
                running[self._crew.start(cell.function, cell.arguments, self._limit)] = cell
            done, _ = wait(running, timeout=TICK, return_when=FIRST_COMPLETED)
            self._watcher.tick()
            for future in done:
                yield running.pop(future), self._outcome(future)

    def _outcome(self, future: Future[Any]) -> Result | Death:
        if future.cancelled():
            raise InvalidProblem("the cluster was lost; the same command goes on from there")
        error = future.exception()
        if isinstance(error, self._crew.deaths):
            return Death(str(error))
        result = future.result() if error is None else Raised(error)
        if isinstance(result, Raised):
            if isinstance(result.error, ContactQPError):
                raise result.error
            return Crash(f"raised {type(result.error).__name__}: {result.error}")
        return Crash(result.message) if isinstance(result, Late) else result
