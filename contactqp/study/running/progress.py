"""How far a study is, and how much time is left: a bar on a terminal, lines of text elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from contactqp.study.running.cells import Cell, Result

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

# Seconds between lines where there is no terminal.
LINES = 10.0
# A bar that is drawn more often takes time from what is timed.
REDRAWS = 2.0


# Shows what is done, how much of it, of how much, and the time left in words.
Display = Callable[[str, int, int, str], None]


class Progress:
    """Watches a study of several parts.

    Time left is what a cell of this part took so far, times the costs of those that are left, and what later parts are
    expected to take.
    """

    def __init__(self, display: Display) -> None:
        self._display = display
        self._what = ""
        self._later: Callable[[], float] | None = None

    def part(self, what: str, later: Callable[[], float] | None = None) -> None:
        """Name the part that begins, and what the parts after it are expected to take [s], where that is known."""
        self._what, self._later = what, later

    def begin(self, cells: Sequence[Cell], found: Mapping[str, Result]) -> None:
        self._total, self._done = len(cells), len(found)
        self._left = sum(cell.cost for cell in cells if cell.key not in found)
        self._spent, self._started = 0.0, time.monotonic()
        self.tick()

    def done(self, cell: Cell, _: Result) -> None:
        self._done += 1
        self._spent += cell.cost
        self._left -= cell.cost
        self.tick()

    def tick(self) -> None:
        self._display(self._what, self._done, self._total, self._time_left())

    def _time_left(self) -> str:
        elapsed = time.monotonic() - self._started
        if self._later is None or (self._left > 0 and not self._spent):
            return ""
        here = elapsed / self._spent * max(self._left, 0.0) if self._spent else 0.0
        return f"about {in_words(here + self._later())} left"


def in_words(seconds: float) -> str:
    """A time to wait, no more exact than it can be known.

    Examples
    --------
    >>> in_words(4.2), in_words(95), in_words(3980)
    ('10 s', '1 min 40 s', '1 h 6 min')
    """
    tens = max(10 * round(seconds / 10), 10)
    if tens < 60:
        return f"{tens} s"
    if tens < 3600:
        return f"{tens // 60} min {tens % 60} s"
    return f"{tens // 3600} h {tens % 3600 // 60} min"


def nothing(*_: object) -> None:
    """Shows nothing."""


class Lines:
    """A line every few seconds, for logs."""

    def __init__(self) -> None:
        self._last = time.monotonic()

    def __call__(self, what: str, done: int, total: int, left: str) -> None:
        if time.monotonic() - self._last < LINES:
            return
        self._last = time.monotonic()
        print(f"contactqp: {what}: {done} of {total}{', ' if left else ''}{left}", file=sys.stderr, flush=True)


class _Drawn:
    """A bar of rich."""

    def __init__(self, bar: Bar) -> None:
        self._bar, self._task = bar, bar.add_task("", left="")

    def __call__(self, what: str, done: int, total: int, left: str) -> None:
        self._bar.update(self._task, description=what, completed=done, total=total, left=left)


@contextmanager
def progress(shown: bool) -> Iterator[Progress]:
    """Progress on stderr, if it is to be shown."""
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
