"""Slots that are processes of this machine, by joblib's executor.

One executor for each process, not one for all: where a process dies, joblib gives up all that its executor has in
hand, and that is then one cell; and a process that hangs can be stopped without the others.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Future
from contextlib import ExitStack, contextmanager
from typing import Any

from contactqp.study.running.crashes import died_of
from contactqp.study.running.workers import Slot, ThisProcess, Workers

INSTALL = "pip install 'contactqp[report]'"
# Side by side: more threads than one each only wait for each other.
ONE_THREAD: Mapping[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# joblib has the dead print where they died; the row says it.
_QUIET: Mapping[str, str] = {"PYTHONFAULTHANDLER": ""}
# Seconds after which an orphan notices it.
ORPHANED = 0.5


def local_workers(jobs: int | None = None) -> Workers:
    """Processes of this machine.

    Parameters
    ----------
    jobs : int, optional
        How many run side by side; all cores by default. 0: none but this process.
    """
    if jobs == 0:
        return ThisProcess()
    if importlib.util.find_spec("joblib") is None:
        return ThisProcess(f"one case after the other in this process, as joblib is not installed: {INSTALL}")
    from joblib import cpu_count

    return Processes(jobs or cpu_count())


class Processes:
    """So many processes of this machine side by side, and one for what is timed."""

    how = "in processes of one thread each"

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self.notes: tuple[str, ...] = ()

    @contextmanager
    def concurrent(self) -> Iterator[Sequence[Slot]]:
        """With one thread each."""
        with ExitStack() as stack:
            yield [stack.enter_context(_process(ONE_THREAD)) for _ in range(self.jobs)]

    @contextmanager
    def alone(self) -> Iterator[Sequence[Slot]]:
        """With as many threads as everybody gets here."""
        with _process({}) as slot:
            yield [slot]

    def ask(self, function: Callable[[], Any]) -> Any:
        return function()


@contextmanager
def _process(environment: Mapping[str, str]) -> Iterator[Slot]:
    slot = _Process(environment)
    try:
        yield slot
    finally:
        slot.stop()


class _Process:
    """A process that is started when the first cell comes."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = dict(environment) | dict(_QUIET)
        self._executor: Any = None

    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
        if self._executor is None:
            self._executor = self._started()
        try:
            future: Future[Any] = self._executor.submit(function, *arguments)
        except BrokenExecutor:  # it died while it had nothing to do
            self.restart()
            return self.submit(function, arguments)
        return future

    def _started(self) -> Any:
        from joblib.externals.loky import ProcessPoolExecutor

        executor = ProcessPoolExecutor(
            max_workers=1, env=self._environment, initializer=_serve, initargs=(os.getpid(),)
        )
        with _interrupts_ignored():  # the process that starts here inherits it
            executor.submit(os.getpid)
        return executor

    def death(self, error: BaseException) -> str | None:
        return died_of(str(error)) if isinstance(error, BrokenExecutor) else None

    def restart(self) -> None:
        self.stop()

    def stop(self) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=True)
            self._executor = None


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ctrl-C goes to all processes of a terminal: the first one stops the others, and they need not tell of it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)


def _serve(parent: int) -> None:
    """What a process does before its first cell: a study that is killed leaves nobody behind who computes on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(ORPHANED)
    os._exit(1)
