"""Child processes that run one cell at a time, and whose crash or hang does not affect others.

A pool of the standard library or of joblib gives up all of its tasks when one of its processes dies, cannot stop one
that hangs, and cannot run within a worker of Dask. Here each thread has a process of its own and finds out how that
process ended.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, BinaryIO

# How a process died, in words.
SIGNALS: Mapping[str, str] = {
    "SIGSEGV": "died of a segmentation fault",
    "SIGBUS": "died of a bus error",
    "SIGABRT": "aborted",
    "SIGFPE": "died of an arithmetic exception",
    "SIGILL": "died of an illegal instruction",
    "SIGKILL": "was killed, mostly for want of memory",
}
# What Windows calls a segmentation fault.
ACCESS_VIOLATION = 0xC0000005


def died_of(code: int | None) -> str:
    """Return the death of a process in words.

    Parameters
    ----------
    code : its exit code: the negative number of a signal on POSIX

    Examples
    --------
    >>> died_of(-11)
    'the process died of a segmentation fault (SIGSEGV)'
    >>> died_of(3)
    'the process left with exit code 3'
    """
    if code == ACCESS_VIOLATION:
        return f"the process {SIGNALS['SIGSEGV']}"
    if code is None or code >= 0:
        return f"the process left with exit code {code}"
    name = _name(-code)
    return f"the process {SIGNALS.get(name, 'was ended')} ({name})"


def _name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a signal without a name, as those for real time
        return f"signal {number}"


def serve() -> None:
    """Run the functions that come on stdin one after the other: the main loop of the process of a `Child`.

    Results are sent to the original stdout, and what libraries print goes to stderr. Ctrl-C is left to the parent. When
    the parent is gone its pipe closes, and this process exits at once.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    orders: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_receive, args=(sys.stdin.buffer, orders), daemon=True).start()
    while True:
        replies.write(_reply(orders.get()))
        replies.flush()


def _receive(stream: BinaryIO, orders: queue.Queue[bytes]) -> None:
    while size := stream.read(8):
        orders.put(stream.read(int.from_bytes(size, "big")))
    os._exit(0)


def framed(data: bytes) -> bytes:
    """Return a message as it is sent: its size first, in 8 bytes."""
    return len(data).to_bytes(8, "big") + data


def _reply(order: bytes) -> bytes:
    try:
        function, arguments = pickle.loads(order)
        return framed(pickle.dumps((True, function(*arguments))))
    except Exception as error:  # noqa: BLE001  it is raised in the parent
        return framed(pickle.dumps((False, _portable(error))))


def _portable(error: Exception) -> Any:
    """Return the error if it survives pickling, else a RuntimeError with its message."""
    try:
        return pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001  whatever it is that does not travel
        return RuntimeError(f"{type(error).__name__}: {error}")


_STOPPED = "the study was stopped"
_COMMAND = (sys.executable, "-P", "-c", "from contactqp.study.running.child import serve; serve()")


@dataclass(frozen=True)
class Death:
    """The death of a process before it answered."""

    message: str


@dataclass(frozen=True)
class Late:
    """The process did not answer in time and was killed."""

    message: str


@dataclass(frozen=True)
class Raised:
    """The exception that the function raised."""

    error: BaseException


class Children:
    """Child processes, one for each thread that asks."""

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
        """Run a function in the process of this thread; return its result, or Raised, Death or Late.

        Parameters
        ----------
        function : callable, of a module that can be imported
        arguments : tuple
        time_limit : seconds until the process is killed
        environment : mapping, environment variables of the process, where it has to be started
        """
        with self._lock:
            if self._closed:
                return Death(_STOPPED)
            child = self._of_thread.setdefault(threading.get_ident(), Child(environment))
        return child.ask(function, arguments, time_limit)

    def close(self) -> None:
        """Kill all processes; no other is started."""
        with self._lock:
            self._closed = True
        for child in self._of_thread.values():
            child.close()


def environment_of_children() -> dict[str, str]:
    """Return the environment variables with which a new Python process finds the modules that this one finds."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}


class Child:
    """A process that is started when it is first asked, and again when it has died."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = environment_of_children() | dict(environment)
        self._lock, self._closed = threading.Lock(), False
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, function: Callable[..., Any], arguments: tuple[Any, ...], time_limit: float) -> Any:
        """Run a function in the process; return its result, or Raised, Death or Late."""
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
        """Kill the process; no other is started."""
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
            with suppress(OSError):  # pending data is discarded
                if stream is not None:
                    stream.close()


def _exchange(process: subprocess.Popen[bytes], order: bytes) -> Any:
    """Send an order and return the answer; raises EOFError or OSError where the process has ended."""
    if process.stdin is None or process.stdout is None:
        raise EOFError
    process.stdin.write(framed(order))
    process.stdin.flush()
    size = process.stdout.read(8)
    answer = process.stdout.read(int.from_bytes(size, "big"))
    if not answer:
        raise EOFError
    return pickle.loads(answer)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C, which goes to all processes of a terminal, so that one that starts now never sees it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
