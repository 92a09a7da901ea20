"""Slots that are the workers of a Dask cluster which is there already."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import Any

from contactqp.errors import BackendMissing, InvalidProblem
from contactqp.study.digest import source_digest
from contactqp.study.running.workers import Slot

INSTALL = "pip install 'contactqp[dask]'"
# Seconds until a scheduler must have answered.
PATIENCE = 10.0


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


def _refuse_others(client: Any, address: str) -> None:
    """Results of one study come from one state of the code."""
    mine = source_digest()
    for worker, theirs in client.run(source_digest, on_error="return").items():
        if theirs != mine:
            what = "another one" if isinstance(theirs, str) else f"{type(theirs).__name__}: {theirs}"
            raise InvalidProblem(f"--dask {address}: expected this contactqp on every worker, got on {worker} {what}")


class Cluster:
    """All threads of a cluster's workers side by side, and one worker for what is timed.

    What others compute on the cluster meanwhile is nothing that a study could know of.
    """

    how = "by the workers of a Dask cluster"

    def __init__(self, client: Any, threads: Mapping[str, int]) -> None:
        self._client = client
        self._threads = sum(threads.values())
        self.notes: tuple[str, ...] = (f"run by {len(threads)} workers of Dask with {self._threads} threads",)

    @contextmanager
    def concurrent(self) -> Iterator[Sequence[Slot]]:
        """On any worker."""
        yield [_Anywhere(self._client) for _ in range(self._threads)]

    @contextmanager
    def alone(self) -> Iterator[Sequence[Slot]]:
        """On one worker, as long as it lives."""
        yield [_OnOne(self._client)]

    def ask(self, function: Callable[[], Any]) -> Any:
        return self._client.submit(function, pure=False, workers=_first(self._client)).result()


class _Anywhere:
    """One task of the cluster at a time."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._task: Any = None

    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
        future: Future[Any] = Future()
        self._task = self._client.submit(function, *arguments, pure=False, **self._where())
        self._task.add_done_callback(lambda task: _hand_over(task, future))
        return future

    def _where(self) -> dict[str, Any]:
        return {}

    def death(self, error: BaseException, /) -> str | None:
        """Dask has tried a task on several workers by then."""
        from distributed import KilledWorker

        return "the Dask workers that ran it died" if isinstance(error, KilledWorker) else None

    def restart(self) -> None:
        """A task cannot be stopped, but its worker can where a nanny looks after it."""
        if self._task is None or self._task.done():
            return
        busy = [worker for worker, keys in self._client.processing().items() if self._task.key in keys]
        self._task.release()
        with suppress(ValueError, TimeoutError):  # no nanny
            self._client.restart_workers(busy, raise_for_error=False)


class _OnOne(_Anywhere):
    """Tasks for one worker; should it die, for one other."""

    def __init__(self, client: Any) -> None:
        super().__init__(client)
        self._worker = _first(client)

    def _where(self) -> dict[str, Any]:
        return dict(workers=self._worker, allow_other_workers=True)

    def restart(self) -> None:
        super().restart()
        self._worker = _first(self._client)


def _first(client: Any) -> list[str]:
    return sorted(client.nthreads())[:1]


def _hand_over(task: Any, future: Future[Any]) -> None:
    """What a task of Dask has become is what becomes of the future."""
    if task.status == "finished":
        future.set_result(task.result())
    elif task.status == "error":
        future.set_exception(task.exception())
    else:
        future.set_exception(InvalidProblem(f"--dask: the scheduler was lost, the task is {task.status}"))
    task.release()
