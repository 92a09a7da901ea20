"""A process for one cell at a time: it may die or hang without anybody else.

A pool, be it the standard library's or joblib's, gives up all that it has in hand when one of its processes dies,
cannot stop one that hangs, and cannot be had within a worker of Dask. Here each thread that asks has a process of its
own, and knows how that one ended.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from contactqp.study.running.crashes import died_of
from contactqp.study.running.serving import framed

_STOPPED = "the study was stopped"
_COMMAND = (sys.executable, "-P", "-c", "from contactqp.study.running.serving import serve; serve()")


@dataclass(frozen=True)
class Death:
    """Of the process, before it answered."""

    message: str


@dataclass(frozen=True)
class Late:
    """No answer came in time, and the process was killed."""

    message: str


@dataclass(frozen=True)
class Raised:
    """What the function raised."""

    error: BaseException


class Children:
    """A process for each thread that asks."""

    def __init__(self) -> None:
        self._lock, self._closed = threading.Lock(), False
        self._of_thread: dict[int, Child] = {}

    def ask(
        self,
        function: Callable[..., Any],
        arguments: tuple[Any, ...],
        time_limit: float,
        environment: Mapping[str, str],
    ) -> Any:
        """What a function returns in the process of this thread, or Raised, Death or Late.

        Parameters
        ----------
        function : callable
            Of a module that can be imported.
        arguments : tuple
        time_limit : float
            Seconds until the process is killed.
        environment : mapping
            Environment variables of the process, where it has to be started.
        """
        with self._lock:
            if self._closed:
                return Death(_STOPPED)
            child = self._of_thread.setdefault(threading.get_ident(), Child(environment))
        return child.ask(function, arguments, time_limit)

    def close(self) -> None:
        """Kill all of them; from now on there are none."""
        with self._lock:
            self._closed = True
        for child in self._of_thread.values():
            child.close()


class Child:
    """A process that is started when it is asked something, and started again when it has died."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = os.environ | {"PYTHONPATH": os.pathsep.join(_paths())} | dict(environment)
        self._lock, self._closed = threading.Lock(), False
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, function: Callable[..., Any], arguments: tuple[Any, ...], time_limit: float) -> Any:
        """What the function returns there, or Raised, Death or Late."""
        order = pickle.dumps((function, arguments))
        process = self._started()
        if process is None:
            return Death(_STOPPED)
        timer, started = threading.Timer(time_limit, process.kill), time.monotonic()
        timer.start()
        try:
            answered, answer = _exchange(process, order)
        except (EOFError, OSError):
            self._end(process)
            if time.monotonic() - started >= time_limit:
                return Late(f"stopped after {time_limit:g} s without an answer")
            return Death(died_of(process.returncode))
        finally:
            timer.cancel()
        return answer if answered else Raised(answer)

    def _started(self) -> subprocess.Popen[bytes] | None:
        with self._lock, _interrupts_blocked():
            if self._process is None and not self._closed:
                pipe = subprocess.PIPE
                self._process = subprocess.Popen(_COMMAND, stdin=pipe, stdout=pipe, env=self._environment)
            return self._process

    def close(self) -> None:
        """Kill the process; there will be no other one."""
        with self._lock:
            self._closed = True
        if self._process is not None:
            self._end(self._process)

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        process.kill()
        process.wait()
        with self._lock:
            self._process = None
        for stream in (process.stdin, process.stdout):
            with suppress(OSError):  # what was not sent yet is sent nowhere
                if stream is not None:
                    stream.close()


def _exchange(process: subprocess.Popen[bytes], order: bytes) -> Any:
    """Send an order and receive the answer; EOFError or OSError where nobody is there any more."""
    if process.stdin is None or process.stdout is None:
        raise EOFError
    process.stdin.write(framed(order))
    process.stdin.flush()
    size = process.stdout.read(8)
    answer = process.stdout.read(int.from_bytes(size, "big"))
    if not answer:
        raise EOFError
    return pickle.loads(answer)


def _paths() -> list[str]:
    """Where modules are found here."""
    return [path or os.getcwd() for path in sys.path]


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Ctrl-C goes to all processes of a terminal; one that starts now never sees it, and need not tell of it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
