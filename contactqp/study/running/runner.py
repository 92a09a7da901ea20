"""Run the cells of a study: take finished ones from the journal, run the others, show progress, stop in order."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from contactqp.errors import ContactQPError, InvalidProblem
from contactqp.linalg.runtime import cores
from contactqp.study.running.child import Death, Late, Raised
from contactqp.study.running.journal import Cell, Crash, Journal, Result, refuse_twins
from contactqp.study.running.workers import Pool, Processes, ThisProcess, Workers

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

# Seconds between lines of text, which show progress where there is no terminal.
LINES = 10.0
# Redraws of a bar per second; more would disturb timings.
REDRAWS = 2.0
# Predicted times count as much as this many seconds of measured ones: the first cells of a part may be the smallest,
# most of whose time is that of calling a process, which says nothing of the large ones after them.
BELIEVED = 5.0


# Shows the name of a part, the number of finished cells, the number of all, and the time left in words.
Display = Callable[[str, int, int, str], None]


class Progress:
    """Watches a study of several parts and estimates the time left.

    It is the time per cost of this part so far, times the cost of its remaining cells, and what later parts are
    expected to take. Where costs are seconds, they are believed before anything is known, and less and less then.
    """

    def __init__(self, display: Display) -> None:
        self._display = display
        self._what = ""
        self._later: Callable[[], float] | None = None
        self._side_by_side = 0
        self._done = self._total = 0
        self._left = self._spent = 0.0
        self._started = time.monotonic()

    def part(self, what: str, later: Callable[[], float] | None = None, side_by_side: int = 0) -> None:
        """Name the part that begins.

        Parameters
        ----------
        what : str
        later : callable, optional
            Returns what the parts after it are expected to take [s], where that is known.
        side_by_side : int
            How many cells of it run at a time, where their costs are seconds; 0 where these are relative.
        """
        self._what, self._later, self._side_by_side = what, later, side_by_side

    def begin(self, cells: Sequence[Cell], found: Mapping[str, Result]) -> None:
        """Start a part: `found` holds the results of the cells that are finished already."""
        self._total, self._done = len(cells), len(found)
        self._left = sum(cell.cost for cell in cells if cell.key not in found)
        self._spent, self._started = 0.0, time.monotonic()
        self.tick()

    def done(self, cell: Cell, _: Result) -> None:
        """Count a finished cell."""
        self._done += 1
        self._spent += cell.cost
        self._left -= cell.cost
        self.tick()

    def tick(self) -> None:
        """Show the progress."""
        self._display(self._what, self._done, self._total, self._time_left())

    def __str__(self) -> str:
        left = self._time_left()
        if not self._what:
            return "it has begun"
        return f"{self._what}: {self._done} of {self._total}{', ' if left else ''}{left}"

    def _time_left(self) -> str:
        elapsed, left = time.monotonic() - self._started, max(self._left, 0.0)
        believed = BELIEVED if self._side_by_side else 0.0
        width = self._side_by_side or 1
        known = believed + self._spent / width  # of these seconds, as the costs have it
        if self._later is None or (left > 0 and not known):
            return ""
        here = (believed + elapsed) / known * left / width if left else 0.0
        return f"about {in_words(here + self._later())} left"


def in_words(seconds: float) -> str:
    """Return a waiting time in words, rounded.

    Examples
    --------
    >>> in_words(4.2), in_words(95), in_words(3980)
    ('5 s', '1 min 40 s', '1 h 6 min')
    """
    if seconds < 7.5:
        return "5 s"
    tens = max(10 * round(seconds / 10), 10)
    if tens < 60:
        return f"{tens} s"
    if tens < 3600:
        return f"{tens // 60} min {tens % 60} s"
    return f"{tens // 3600} h {tens % 3600 // 60} min"


def nothing(*_: object) -> None:
    """Show nothing."""


class Lines:
    """Shows progress as a line of text every few seconds, for logs."""

    def __init__(self) -> None:
        self._last = time.monotonic()

    def __call__(self, what: str, done: int, total: int, left: str) -> None:
        """Print how far something is, at most once in so many seconds.

        Parameters
        ----------
        what : what is being done
        done, total : how many of how many
        left : how long the rest may take, in words; may be empty
        """
        if time.monotonic() - self._last < LINES:
            return
        self._last = time.monotonic()
        print(f"contactqp: {what}: {done} of {total}{', ' if left else ''}{left}", file=sys.stderr, flush=True)


class _Drawn:
    """Shows progress as a bar of rich."""

    def __init__(self, bar: Bar) -> None:
        self._bar, self._task = bar, bar.add_task("", left="")

    def __call__(self, what: str, done: int, total: int, left: str) -> None:
        self._bar.update(self._task, description=what, completed=done, total=total, left=left)


@contextmanager
def progress(shown: bool) -> Iterator[Progress]:
    """Yield a Progress that writes to stderr if `shown`."""
    if not shown:
        yield Progress(nothing)
    elif not sys.stderr.isatty():
        yield Progress(Lines())
    else:
        with _bar() as bar:
            yield Progress(_Drawn(bar))


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    texts = (TextColumn("{task.description}", markup=False), TextColumn("{task.fields[left]}", markup=False))
    columns = (texts[0], BarColumn(), MofNCompleteColumn(), texts[1])
    return Progress(*columns, console=Console(stderr=True), transient=True, refresh_per_second=REDRAWS)


# What a shell adds to the number of the signal that ended a program.
OF_SIGNAL = 128


class Stopped(KeyboardInterrupt):
    """A program was asked to stop; `code` is what it then exits with, 130 after Ctrl-C."""

    def __init__(self, message: str, cause: BaseException | None = None, number: int = signal.SIGINT) -> None:
        super().__init__(message)
        self.code: int = cause.code if isinstance(cause, Stopped) else OF_SIGNAL + number


@contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Have SIGTERM raise Stopped within this, as Ctrl-C raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


@contextmanager
def stopped_after(progress: Callable[[], str]) -> Iterator[None]:
    """Have an interruption within this raise Stopped with the progress and how to go on."""
    try:
        yield
    except KeyboardInterrupt as stop:
        raise Stopped(f"{progress()}; the same command goes on from there", stop) from None


def _stop(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001  the interface of handlers
    raise Stopped(signal.Signals(number).name, number=number)


# Seconds after which a cell is stopped: far more than anything in a report takes, and less than anybody waits.
TIME_LIMIT = 600.0
# Seconds between two calls of `Watcher.tick`.
TICK = 0.5


class Watcher(Protocol):
    """Follows the progress of a study."""

    def begin(self, cells: Sequence[Cell], found: Mapping[str, Result], /) -> None:
        """Take note that these cells are to be run; `found` holds the results that the journal has already."""

    def done(self, cell: Cell, result: Result, /) -> None:
        """Take note that a cell has been run."""

    def tick(self) -> None:
        """Time has passed: called every `TICK` seconds at least."""


def run_cells(
    cells: Sequence[Cell],
    pool: Pool,
    journal: Journal | None = None,
    *,
    watcher: Watcher | None = None,
    time_limit: float = TIME_LIMIT,
) -> dict[str, Result]:
    """Run cells and return the results of all by their keys, in the order of the cells.

    A cell whose process dies is run once more, when all others are done, in a process of its own: the process may have
    died of another cell, or of a signal that was sent to all. A cell that dies again has crashed, as has one that
    raises an exception other than an error of contactqp, and one that takes too long.

    Raises ContactQPError: a cell raised it: the case is wrong.

    Parameters
    ----------
    cells : sequence of Cell
    pool : Pool
        The executor: ``with Processes(2).side_by_side() as pool``, or ``alone()`` for timings.
    journal : keeps each result as soon as it is there
    watcher : follows the progress
    time_limit : limit for each cell [s]; cells that run in this process cannot be stopped
    """
    refuse_twins(cells)
    watcher = watcher or Progress(nothing)
    found = {cell.key: result for cell in cells if journal and (result := journal.find(cell)) is not None}
    remaining = [cell for cell in cells if cell.key not in found]
    watcher.begin(cells, found)
    for cell, result in _Run(pool, watcher, time_limit).results(remaining):
        found[cell.key] = journal.write(cell, result) if journal else result
        watcher.done(cell, found[cell.key])
    return {cell.key: found[cell.key] for cell in cells}


class _Run:
    """One run of cells by a pool."""

    def __init__(self, pool: Pool, watcher: Watcher, limit: float) -> None:
        self._pool, self._watcher, self._limit = pool, watcher, limit

    def results(self, cells: Sequence[Cell]) -> Iterator[tuple[Cell, Result]]:
        """Yield the results of all cells as they come; those whose process died are run again at the end."""
        suspects = []
        for cell, result in self._once(cells, self._pool.size):
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
                running[self._pool.start(cell.function, cell.arguments, self._limit)] = cell
            done, _ = wait(running, timeout=TICK, return_when=FIRST_COMPLETED)
            self._watcher.tick()
            for future in done:
                yield running.pop(future), self._outcome(future)

    def _outcome(self, future: Future[Any]) -> Result | Death:
        if future.cancelled():
            raise InvalidProblem("the cluster was lost; the same command goes on from there")
        error = future.exception()
        if isinstance(error, self._pool.deaths):
            return Death(str(error))
        result = future.result() if error is None else Raised(error)
        if isinstance(result, Raised):
            if isinstance(result.error, ContactQPError):
                raise result.error
            return Crash(f"raised {type(result.error).__name__}: {result.error}")
        return Crash(result.message) if isinstance(result, Late) else result


# The largest time limit: the seconds of a year.
LONGEST = 365 * 24 * 3600.0


@dataclass(frozen=True)
class Running:
    """Settings that say where and how a study runs.

    Parameters
    ----------
    jobs : processes side by side; all cores by default, 0 for none but this process
    dask : address of a Dask scheduler, whose workers take the place of processes here
    fresh : bool, discard the results of an interrupted study
    time_limit : float, seconds after which one cell is stopped
    shown : bool, show progress on stderr
    """

    jobs: int | None = None
    dask: str | None = None
    fresh: bool = False
    time_limit: float = TIME_LIMIT
    shown: bool = False

    def __post_init__(self) -> None:
        if self.jobs is not None and self.dask is not None:
            raise InvalidProblem(f"expected jobs here or a Dask cluster, got both: {self.jobs} and {self.dask}")
        if not 0 < self.time_limit <= LONGEST:
            raise InvalidProblem(
                f"time limit: expected seconds, more than 0 and at most {LONGEST:g}, got {self.time_limit}"
            )


@contextmanager
def workers_of(running: Running, one_thread: bool = False) -> Iterator[Workers]:
    """Yield the workers that `running` asks for; with `one_thread` processes on this machine measure on one."""
    if running.dask is None:
        yield ThisProcess() if running.jobs == 0 else Processes(running.jobs or cores(), one_thread)
        return
    from contactqp.study.running.workers import cluster

    with cluster(running.dask) as workers:
        yield workers
