"""Clocks of an answer's stages and counts of its factorisations, which cost nothing where no clock runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar

READ = "read and check the file"
BUILD = "build the problem"
CONDENSE = "condense"
METHOD = "method"
POLISH = "expand and polish"
CERTIFY = "certify"
STEPS = "between the steps"  # of a path or a motion: tangents, predictions, events
# In the order of the data.
STAGES = (READ, BUILD, CONDENSE, METHOD, POLISH, CERTIFY, STEPS)


class StageClock:
    """Seconds by stage. Each instant belongs to the innermost stage that it is in, so that they sum to the total."""

    def __init__(self) -> None:
        self.factorisations = 0  # of the stiffness
        self.half_substitutions = 0  # forward or backward, with one right-hand side
        self._seconds: dict[str, float] = {}
        self._outer: list[str] = []
        self._stage, self._since = "", time.perf_counter()

    @property
    def seconds(self) -> dict[str, float]:
        """So far, by stage; of what is in none by the name ''."""
        self._charge()
        return dict(self._seconds)

    @property
    def back_substitutions(self) -> int:
        """Right-hand sides solved, forward and backward."""
        return (self.half_substitutions + 1) // 2

    @contextmanager
    def within(self, name: str) -> Iterator[None]:
        """What happens meanwhile belongs to a stage, unless that has stages of its own."""
        self._charge()
        self._outer.append(self._stage)
        self._stage = name
        try:
            yield
        finally:
            self._charge()
            self._stage = self._outer.pop()

    def _charge(self) -> None:
        now = time.perf_counter()
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._since
        self._since = now


# The clock that runs, if one does: whoever factorises or solves adds to its counts.
RUNNING: ContextVar[StageClock | None] = ContextVar("the clock that runs", default=None)
_UNTIMED = nullcontext()


@contextmanager
def timed() -> Iterator[StageClock]:
    """A clock for all that this thread does meanwhile."""
    clock = StageClock()
    token = RUNNING.set(clock)
    try:
        yield clock
    finally:
        RUNNING.reset(token)


def stage(name: str) -> AbstractContextManager[None]:
    """Charge what happens meanwhile to a stage, if a clock runs."""
    clock = RUNNING.get()
    return _UNTIMED if clock is None else clock.within(name)
