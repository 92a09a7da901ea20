"""Ctrl-C and polite kills: a study that is stopped says how far it is and can go on."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

# What a shell adds to the number of the signal that ended a program.
OF_SIGNAL = 128


class Stopped(KeyboardInterrupt):
    """A program was asked to stop; `code` is what it then exits with, 130 after Ctrl-C."""

    def __init__(self, message: str, cause: BaseException | None = None, number: int = signal.SIGINT) -> None:
        super().__init__(message)
        self.code: int = cause.code if isinstance(cause, Stopped) else OF_SIGNAL + number


@contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Within this, SIGTERM raises Stopped, as Ctrl-C raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def _stop(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001  the interface of handlers
    raise Stopped(signal.Signals(number).name, number=number)
