"""Where cells run: executors as those of the standard library, side by side or alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from contactqp.study.running.child import Children

# Side by side: more threads than one each only wait for each other.
ONE_THREAD: Mapping[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


# From a function, its arguments and a time limit to what it returns, or Raised, Death or Late.
Ask = Callable[[Callable[..., Any], tuple[Any, ...], float], Any]


@dataclass(frozen=True)
class Crew:
    """An executor, how many cells it runs at a time, and what it runs for each."""

    executor: Executor
    size: int
    ask: Ask
    deaths: tuple[type[BaseException], ...] = ()  # errors that say that a worker died, with all it had

    def start(self, function: Callable[..., Any], arguments: tuple[Any, ...], time_limit: float) -> Future[Any]:
        """A cell begins."""
        return self.executor.submit(self.ask, function, arguments, time_limit)


class Workers(Protocol):
    """Where a study runs."""

    notes: tuple[str, ...]  # for the user
    how: str  # cells run, as far as results depend on it

    def side_by_side(self) -> AbstractContextManager[Crew]:
        """For answers. No process is left at the end, whatever happens."""

    def alone(self) -> AbstractContextManager[Crew]:
        """One cell at a time in one process, for what is timed."""

    def ask(self, function: Callable[[], Any]) -> Any:
        """What a function says where cells run."""


class ThisProcess:
    """One cell after the other, here: a crash is everybody's, and nothing can be stopped."""

    notes: tuple[str, ...] = ()
    how = "in one process"

    @contextmanager
    def side_by_side(self) -> Iterator[Crew]:
        yield Crew(_AtOnce(), 1, _here)

    alone = side_by_side

    def ask(self, function: Callable[[], Any]) -> Any:
        return function()


def _here(function: Callable[..., Any], arguments: tuple[Any, ...], _: float) -> Any:
    return function(*arguments)


class _AtOnce(Executor):
    """Runs what is submitted while it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001  it is the future's, as in every executor
            future.set_exception(error)
        return future


class Processes:
    """So many processes of this machine side by side, and one for what is timed."""

    notes: tuple[str, ...] = ()
    how = "in processes of one thread each"

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    @contextmanager
    def side_by_side(self) -> Iterator[Crew]:
        """With one thread each."""
        with _crew(self.jobs, ONE_THREAD) as crew:
            yield crew

    @contextmanager
    def alone(self) -> Iterator[Crew]:
        """With as many threads as everybody gets here."""
        with _crew(1, {}) as crew:
            yield crew

    def ask(self, function: Callable[[], Any]) -> Any:
        return function()


@contextmanager
def _crew(size: int, environment: Mapping[str, str]) -> Iterator[Crew]:
    """Threads that have a process each."""
    executor, children = ThreadPoolExecutor(size), Children()
    try:
        yield Crew(executor, size, partial(children.ask, environment=environment))
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        children.close()
        executor.shutdown(wait=True)
