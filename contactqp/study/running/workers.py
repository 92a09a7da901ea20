"""Where cells run: the interface of a slot, which runs one cell at a time, and the slot of this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Protocol


class Slot(Protocol):
    """Runs one cell at a time, mostly in a process of its own."""

    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
        """Start a cell; the slot before has finished its last one, or was restarted."""

    def death(self, error: BaseException, /) -> str | None:
        """How the process died, in words, if that is what the error of a future says."""

    def restart(self) -> None:
        """A new process in place of one that is dead, or that takes too long."""


class Workers(Protocol):
    """Where a study runs."""

    notes: tuple[str, ...]  # for the user
    how: str  # cells run, as far as results depend on it

    def concurrent(self) -> AbstractContextManager[Sequence[Slot]]:
        """Slots that run side by side. No process of theirs is left at the end, whatever happens."""

    def alone(self) -> AbstractContextManager[Sequence[Slot]]:
        """One slot for what is timed, while nothing else runs."""

    def ask(self, function: Callable[[], Any]) -> Any:
        """What a function says where cells run."""


class ThisProcess:
    """One cell after the other, here: a crash is everybody's, and nothing can be stopped."""

    how = "in one process"

    def __init__(self, *notes: str) -> None:
        self.notes = notes

    @contextmanager
    def concurrent(self) -> Iterator[Sequence[Slot]]:
        yield (_SlotHere(),)

    @contextmanager
    def alone(self) -> Iterator[Sequence[Slot]]:
        yield (_SlotHere(),)

    def ask(self, function: Callable[[], Any]) -> Any:
        return function()


class _SlotHere:
    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as error:  # noqa: BLE001  it is the future's, as in every executor
            future.set_exception(error)
        return future

    def death(self, _: BaseException) -> str | None:
        return None

    def restart(self) -> None:
        return None
