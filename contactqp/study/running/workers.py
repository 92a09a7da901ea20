"""Executors that run cells side by side: threads with child processes, or the workers of a Dask cluster."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from contactqp.errors import BackendMissing, InvalidProblem
from contactqp.linalg.runtime import renew_in_child
from contactqp.study.running.child import Children
from contactqp.study.running.journal import source_digest

# Side by side: more threads than one each only wait for each other.
ONE_THREAD: Mapping[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


# From a function, its arguments and a time limit to what it returns, or Raised, Death or Late.
Ask = Callable[[Callable[..., Any], tuple[Any, ...], float], Any]


@dataclass(frozen=True)
class Pool:
    """An executor, how many cells it runs at a time, and what it runs for each."""

    executor: Executor
    size: int
    ask: Ask
    deaths: tuple[type[BaseException], ...] = ()  # errors that say that a worker died, with all it had

    def start(self, function: Callable[..., Any], arguments: tuple[Any, ...], time_limit: float) -> Future[Any]:
        """A cell begins."""
        return self.executor.submit(self.ask, function, arguments, time_limit)


class Workers(Protocol):
    """The workers that a study runs on."""

    notes: tuple[str, ...]  # for the user
    how: str  # cells run, as far as results depend on it

    def side_by_side(self) -> AbstractContextManager[Pool]:
        """For answers. No process is left at the end, whatever happens."""

    def alone(self) -> AbstractContextManager[Pool]:
        """One cell at a time in one process, for what is timed."""

    def ask(self, function: Callable[[], Any]) -> Any:
        """What a function says where cells run."""


class ThisProcess:
    """One cell after the other, here: a crash is everybody's, and nothing can be stopped."""

    notes: tuple[str, ...] = ()
    how = "in one process"

    @contextmanager
    def side_by_side(self) -> Iterator[Pool]:
        yield Pool(_AtOnce(), 1, _here)

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
    def side_by_side(self) -> Iterator[Pool]:
        """With one thread each."""
        with _process_pool(self.jobs, ONE_THREAD) as pool:
            yield pool

    @contextmanager
    def alone(self) -> Iterator[Pool]:
        """With as many threads as everybody gets here."""
        with _process_pool(1, {}) as pool:
            yield pool

    def ask(self, function: Callable[[], Any]) -> Any:
        return function()


@contextmanager
def _process_pool(size: int, environment: Mapping[str, str]) -> Iterator[Pool]:
    """Threads that have a process each."""
    executor, children = ThreadPoolExecutor(size), Children()
    try:
        yield Pool(executor, size, partial(children.ask, environment=environment))
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        children.close()
        executor.shutdown(wait=True)


# Slots that are the workers of a Dask cluster which is there already.

INSTALL = "pip install 'contactqp[dask]'"
# Seconds until a scheduler must have answered.
PATIENCE = 10.0
# Of addresses; none stands for tcp.
SCHEMES = ("", "tcp", "tls", "ws", "wss", "ucx")


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """The cluster of the scheduler at an address, until the end of the context.

    Its workers must have this very version of contactqp, and see the mesh files of the cases under the same names.

    Raises
    ------
    BackendMissing
        distributed is not installed.
    InvalidProblem
        No scheduler answers, it has no workers, or they have another contactqp.
    """
    if importlib.util.find_spec("distributed") is None:
        raise BackendMissing(f"--dask needs distributed: {INSTALL}")
    client_of: Any = importlib.import_module("distributed").Client
    _refuse_malformed(address)
    try:
        client = client_of(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        told = " ".join(str(error).split())
        raise InvalidProblem(f"--dask {address}: expected the address of a Dask scheduler, got: {told}") from None
    with client:
        threads = dict(client.nthreads())
        if not threads:
            raise InvalidProblem(f"--dask {address}: expected a cluster with workers, got one without")
        _refuse_others(client, address)
        yield Cluster(client, threads)


def _refuse_malformed(address: str) -> None:
    """What is no address: a client of it would talk of its end on stderr long after it was refused."""
    scheme, _, place = address.rpartition("://")
    host, _, port = place.rpartition(":")
    if scheme in SCHEMES and host and port.isdecimal():
        return
    raise InvalidProblem(f"--dask: expected the address of a Dask scheduler such as tcp://host:8786, got {address!r}")


def _refuse_others(client: Any, address: str) -> None:
    """Results of one study come from one state of the code."""
    mine = source_digest()
    for worker, theirs in client.run(source_digest, on_error="return").items():
        if theirs != mine:
            what = "another one" if isinstance(theirs, str) else f"{type(theirs).__name__}: {theirs}"
            raise InvalidProblem(f"--dask {address}: expected this contactqp on every worker, got on {worker} {what}")


def in_child(
    function: Callable[..., Any], arguments: tuple[Any, ...], time_limit: float, environment: Mapping[str, str]
) -> Any:
    """What a task does on a worker; see `contactqp.study.running.child.Children.ask`."""
    with _LOCK:
        children = _CHILDREN[-1]
    return children.ask(function, arguments, time_limit, environment)


def stop_children() -> None:
    """End all that this worker has started; the next study starts others."""
    with _LOCK:
        _CHILDREN.append(Children())
        children = _CHILDREN.pop(0)
    children.close()


# Of a worker, one for all of its threads.
_LOCK = threading.Lock()
_CHILDREN = [Children()]


def _renew() -> None:
    """Start anew in a process that was forked: the processes that its parent has started answer the parent."""
    global _LOCK
    _LOCK = threading.Lock()
    _CHILDREN[:] = [Children()]


renew_in_child(_renew)


class Cluster:
    """All threads of a cluster's workers side by side, and one worker for what is timed.

    Cells run in processes that the workers start, so that no worker dies of them. What others compute on the cluster
    meanwhile is nothing that a study could know of.
    """

    how = "by the workers of a Dask cluster, in processes of one thread each"

    def __init__(self, client: Any, threads: Mapping[str, int]) -> None:
        self._client = client
        self._threads = sum(threads.values())
        self._first = min(threads)
        self.notes: tuple[str, ...] = (f"run by {len(threads)} workers of Dask with {self._threads} threads",)

    @contextmanager
    def side_by_side(self) -> Iterator[Pool]:
        """On any worker."""
        with self._pool(self._threads, ONE_THREAD) as pool:
            yield pool

    @contextmanager
    def alone(self) -> Iterator[Pool]:
        """On one worker; on any other one should that be lost."""
        with self._pool(1, {}, workers=[self._first], allow_other_workers=True) as pool:
            yield pool

    @contextmanager
    def _pool(self, size: int, environment: Mapping[str, str], **where: Any) -> Iterator[Pool]:
        from distributed import KilledWorker

        executor = self._client.get_executor(pure=False, **where)
        try:
            yield Pool(executor, size, partial(in_child, environment=environment), (KilledWorker,))
        finally:
            executor.shutdown(wait=False)  # and cancelled, what has not begun
            self._client.run(stop_children, on_error="ignore")

    def ask(self, function: Callable[[], Any]) -> Any:
        return self._client.submit(function, pure=False, workers=[self._first]).result()
