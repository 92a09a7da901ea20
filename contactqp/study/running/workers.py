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
from contactqp.model.arrays import renew_in_child
from contactqp.study.running.child import Children
from contactqp.study.running.journal import source_digest

# Parallel processes use one thread each, as more would only compete with each other.
ONE_THREAD: Mapping[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

# On which threads times are taken, in words.
AS_EVER = "as many as linear algebra takes by itself"

# Maps a function, its arguments and a time limit [s] to what the function returns, or to Raised, Death or Late.
Ask = Callable[[Callable[..., Any], tuple[Any, ...], float], Any]


@dataclass(frozen=True)
class Pool:
    """An executor, how many cells it runs at a time, and the function that runs a cell on it."""

    executor: Executor
    size: int
    ask: Ask
    deaths: tuple[type[BaseException], ...] = ()  # errors that mean that a worker died

    def start(self, function: Callable[..., Any], arguments: tuple[Any, ...], time_limit: float) -> Future[Any]:
        """Submit a cell."""
        return self.executor.submit(self.ask, function, arguments, time_limit)


class Workers(Protocol):
    """The workers that a study runs on."""

    notes: tuple[str, ...]  # for the user
    how: str  # in words, as far as results depend on it
    threads: str  # of linear algebra, on which times are taken, in words

    def side_by_side(self) -> AbstractContextManager[Pool]:
        """Yield the pool for answers; it leaves no process behind."""

    def alone(self) -> AbstractContextManager[Pool]:
        """Yield a pool that runs one cell at a time in one process, for timings."""

    def ask(self, function: Callable[[], Any]) -> Any:
        """Return what a function returns where cells run."""


class ThisProcess:
    """Runs one cell after the other in this process, which a crash ends and a time limit does not stop."""

    notes: tuple[str, ...] = ()
    how = "in one process"
    threads = AS_EVER

    @contextmanager
    def side_by_side(self) -> Iterator[Pool]:
        """Yield a pool that runs a cell while it is submitted."""
        yield Pool(_AtOnce(), 1, lambda function, arguments, _: function(*arguments))

    alone = side_by_side

    def ask(self, function: Callable[[], Any]) -> Any:
        return function()


class _AtOnce(Executor):
    """Runs a function while it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001  it is the future's, as in every executor
            future.set_exception(error)
        return future


class Processes:
    """Runs cells in `jobs` processes of this machine side by side, and in one for timings.

    That one has the threads that the environment gives it, or one: beside other work two threads wait for each other
    most of the time, and times come out several times too long.
    """

    notes: tuple[str, ...] = ()
    how = "in processes of one thread each"

    def __init__(self, jobs: int, one_thread: bool = False) -> None:
        self.jobs, self._timing = jobs, ONE_THREAD if one_thread else {}
        self.threads = "one, as the machine is busy" if one_thread else AS_EVER

    @contextmanager
    def side_by_side(self) -> Iterator[Pool]:
        """Yield a pool of processes with one thread each."""
        with _process_pool(self.jobs, ONE_THREAD) as pool:
            yield pool

    @contextmanager
    def alone(self) -> Iterator[Pool]:
        """Yield a pool of one process for timings."""
        with _process_pool(1, self._timing) as pool:
            yield pool

    def ask(self, function: Callable[[], Any]) -> Any:
        return function()


@contextmanager
def _process_pool(size: int, environment: Mapping[str, str]) -> Iterator[Pool]:
    """Yield a pool of threads that have a process each."""
    executor, children = ThreadPoolExecutor(size), Children()
    try:
        yield Pool(executor, size, partial(children.ask, environment=environment))
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        children.close()
        executor.shutdown(wait=True)


INSTALL = "pip install distributed"
# Seconds until a scheduler must have answered.
PATIENCE = 10.0
# Schemes of addresses; none stands for tcp.
SCHEMES = ("", "tcp", "tls", "ws", "wss", "ucx")


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Connect to the Dask cluster of the scheduler at an address, until the end of the context.

    Its workers must have this very version of contactqp, and see the mesh files of the cases under the same names.

    Raises BackendMissing: distributed is not installed; InvalidProblem: no scheduler answers, it has no workers, or
    they have another contactqp.
    """
    if importlib.util.find_spec("distributed") is None:
        raise BackendMissing(f"--dask needs distributed: {INSTALL}")
    client_of: Any = importlib.import_module("distributed").Client
    _refuse_malformed(address)
    try:
        client = client_of(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InvalidProblem(f"--dask {address}: expected the address of a Dask scheduler, got: {reason}") from None
    with client:
        threads = dict(client.nthreads())
        if not threads:
            raise InvalidProblem(f"--dask {address}: expected a cluster with workers, got one without")
        _refuse_others(client, address)
        yield Cluster(client, threads)


def _refuse_malformed(address: str) -> None:
    """Raise where this is not an address: a client of it would print to stderr long after it was refused."""
    scheme, _, place = address.rpartition("://")
    host, _, port = place.rpartition(":")
    if scheme in SCHEMES and host and port.isdecimal():
        return
    raise InvalidProblem(f"--dask: expected the address of a Dask scheduler such as tcp://host:8786, got {address!r}")


def _refuse_others(client: Any, address: str) -> None:
    """Raise where a worker has another state of the code: the results of one study come from one."""
    here = source_digest()
    for worker, there in client.run(source_digest, on_error="return").items():
        if there != here:
            what = "another one" if isinstance(there, str) else f"{type(there).__name__}: {there}"
            raise InvalidProblem(f"--dask {address}: expected this contactqp on every worker, got on {worker} {what}")


def in_child(
    function: Callable[..., Any], arguments: tuple[Any, ...], time_limit: float, environment: Mapping[str, str]
) -> Any:
    """Run a function in a child process of a worker: the task that is submitted to Dask.

    Parameters
    ----------
    function : callable
    arguments : tuple
    time_limit : seconds until the process is killed
    environment : mapping, environment variables of the process, where it has to be started
    """
    with _LOCK:
        children = _CHILDREN[-1]
    return children.ask(function, arguments, time_limit, environment)


def stop_children() -> None:
    """End all processes that this worker has started; the next study starts others."""
    with _LOCK:
        _CHILDREN.append(Children())
        children = _CHILDREN.pop(0)
    children.close()


# The processes of a worker, shared by all of its threads.
_LOCK = threading.Lock()
_CHILDREN = [Children()]


def _renew() -> None:
    """Start without children in a process that was forked: those of its parent answer the parent."""
    global _LOCK
    _LOCK = threading.Lock()
    _CHILDREN[:] = [Children()]


renew_in_child(_renew)


class Cluster:
    """Runs cells on all threads of a cluster's workers side by side, and on one worker for timings.

    Cells run in processes that the workers start, so that no worker dies of them. Timings include what others compute
    on the cluster meanwhile.
    """

    how = "by the workers of a Dask cluster, in processes of one thread each"
    threads = AS_EVER

    def __init__(self, client: Any, threads: Mapping[str, int]) -> None:
        self._client = client
        self._threads = sum(threads.values())
        self._first = min(threads)
        self.notes: tuple[str, ...] = (f"run by {len(threads)} workers of Dask with {self._threads} threads",)

    @contextmanager
    def side_by_side(self) -> Iterator[Pool]:
        """Yield a pool of all workers."""
        with self._pool(self._threads, ONE_THREAD) as pool:
            yield pool

    @contextmanager
    def alone(self) -> Iterator[Pool]:
        """Yield a pool of one worker, and of any other one should that be lost."""
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
