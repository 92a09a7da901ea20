"""A clock on which time passes faster where a test says so; the fixture `clock` puts it in place of the machine's."""

from __future__ import annotations

import time


class Clock:
    def __init__(self) -> None:
        self._clock, self._ahead = time.perf_counter, 0.0

    def __call__(self) -> float:
        return self._clock() + self._ahead

    def passes(self, seconds: float) -> None:
        self._ahead += seconds
