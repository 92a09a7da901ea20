"""Clocks of an answer's stages and counts of its factorisations, threads of BLAS, and free memory.

A clock costs nothing where none runs. OpenBLAS keeps to one thread around the small dense systems of the contacts
(`contactqp.model.arrays`). MKL, which PARDISO runs on, keeps its threads.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache, cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.errors import NotConverged
from contactqp.model.arrays import WORTHWHILE, on_one_thread, renew_in_child

if TYPE_CHECKING:
    from contactqp.model.problem import ContactProblem

READ = "read and check the file"
BUILD = "build the problem"
CONDENSE = "condense"
METHOD = "method"
POLISH = "expand and polish"
CERTIFY = "certify"
STEPS = "between the steps"  # of a path or a motion: tangents, predictions, events
# In the order of the data.
STAGES = (READ, BUILD, CONDENSE, METHOD, POLISH, CERTIFY, STEPS)


class StageClock:
    """Seconds by stage. Each instant belongs to the innermost stage that it is in, so that they sum to the total."""

    def __init__(self) -> None:
        self.factorisations = 0  # of the stiffness
        self.half_substitutions = 0  # forward or backward, with one right-hand side
        self._seconds: dict[str, float] = {}
        self._outer: list[str] = []
        self._stage, self._since = "", time.perf_counter()

    @property
    def seconds(self) -> dict[str, float]:
        """The seconds so far by stage; those outside of any have the name ''."""
        self._charge()
        return dict(self._seconds)

    @property
    def back_substitutions(self) -> int:
        """The number of right-hand sides solved, forward and backward."""
        return (self.half_substitutions + 1) // 2

    @contextmanager
    def within(self, name: str) -> Iterator[None]:
        """Count the time inside the block as that of a stage, apart from stages inside it."""
        self._charge()
        self._outer.append(self._stage)
        self._stage = name
        try:
            yield
        finally:
            self._charge()
            self._stage = self._outer.pop()

    def _charge(self) -> None:
        now = time.perf_counter()
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._since
        self._since = now


# The clock that runs, if one does: whoever factorises or solves adds to its counts.
RUNNING: ContextVar[StageClock | None] = ContextVar("the clock that runs", default=None)
_UNTIMED = nullcontext()


@contextmanager
def timed() -> Iterator[StageClock]:
    """Run a clock for all that this thread does inside the block."""
    clock = StageClock()
    token = RUNNING.set(clock)
    try:
        yield clock
    finally:
        RUNNING.reset(token)


# Who is told where the call that runs is, if anybody.
_LISTENER: ContextVar[Callable[[str], object] | None] = ContextVar("who is told where the call is", default=None)


@contextmanager
def telling(progress: Callable[[str], object] | None) -> Iterator[None]:
    """Have `tell` call a function while this lasts; None leaves the one that there is."""
    token = _LISTENER.set(_LISTENER.get() if progress is None else progress)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def tell(where: str) -> None:
    """Say in a few words what is done now."""
    listener = _LISTENER.get()
    if listener is not None:
        listener(where)


def stage(name: str) -> AbstractContextManager[None]:
    """Say that a stage begins, and charge what happens meanwhile to it if a clock runs."""
    tell(name)
    clock = RUNNING.get()
    return _UNTIMED if clock is None else clock.within(name)


# When the call that runs has to end, if it has to, and the seconds that it was given.
_END: ContextVar[tuple[float, float] | None] = ContextVar("when the call that runs has to end", default=None)


def within_time(seconds: float | None) -> AbstractContextManager[None]:
    """Have `refuse_late` raise so many seconds from now; an earlier end that is already set stays."""
    earlier = _END.get()
    end = earlier if seconds is None else (time.perf_counter() + seconds, seconds)
    return _ending(end if earlier is None or (end is not None and end[0] < earlier[0]) else earlier)


def in_any_time() -> AbstractContextManager[None]:
    """Suspend the time limit inside the block, so that what has been found is certified."""
    return nullcontext() if _END.get() is None else _ending(None)


@contextmanager
def _ending(end: tuple[float, float] | None) -> Iterator[None]:
    token = _END.set(end)
    try:
        yield
    finally:
        _END.reset(token)


def seconds_left() -> float | None:
    """Return the seconds until the running call has to end, at least a microsecond; None without a limit."""
    end = _END.get()
    return None if end is None else max(end[0] - time.perf_counter(), 1e-6)


def time_is_up() -> bool:
    """Return whether the call that runs should have ended."""
    end = _END.get()
    return end is not None and time.perf_counter() > end[0]


def stated_limit(seconds: float | None) -> str:
    """Return in words the time limit of the call; outside of a call, of a step that was given these seconds."""
    end = _END.get()
    return f"{seconds if end is None else end[1]:g} s"


def refuse_late(what: str) -> None:
    """Raise NotConverged where the call that runs should have ended; `what` was to be done next."""
    end = _END.get()
    if end is not None and time.perf_counter() > end[0]:
        raise NotConverged(f"stopped at the time limit of {stated_limit(None)}, before {what}")


def _renew_cached_properties() -> None:
    """Give the cached properties of the package new locks: one lock serves all instances of a class."""
    modules = [module for name, module in tuple(sys.modules.items()) if name.partition(".")[0] == "contactqp"]
    kinds = {kind for module in modules for kind in vars(module).values() if isinstance(kind, type)}
    for kind in kinds:
        for attribute in vars(kind).values():
            if isinstance(attribute, cached_property) and hasattr(attribute, "lock"):
                attribute.lock = threading.RLock()


if sys.version_info < (3, 12):  # from 3.12 on they have no lock
    renew_in_child(_renew_cached_properties)


# Contacts from which a second thread pays.
THREADS_PAY = 1500


def one_blas_thread(problem: ContactProblem) -> AbstractContextManager[None]:
    """Keep OpenBLAS on one thread while a problem is worked on, unless its dense systems are large enough for two.

    What counts is the size of the dense systems, whatever the number of unknowns: a membrane of 737 unknowns has 217
    contacts, and two threads made its Cholesky factors up to a hundred times slower beside other work.
    """
    tangents = 0 if problem.tangent is None else problem.tangent.shape[0]
    rows = max(problem.contacts + tangents + problem.ties, problem.dimension)
    return on_one_thread() if rows >= WORTHWHILE and problem.contacts < THREADS_PAY else nullcontext()


# How the name ends of the modules where SciPy keeps copies of NumPy's names.
_COPY = "array_api_compat.numpy"


def import_scipy() -> None:
    """Import SciPy's sparse matrices without the parts of NumPy that are loaded for nothing beside them.

    SciPy copies all names of NumPy, and by asking for each it loads a parser of Fortran, tools of tests and others that
    NumPy leaves until they are used: 60 ms, a tenth of a small command. Here the copy gets those later, when it is
    asked for them. It is meant for a process of our own, such as that of a command, and does nothing where SciPy has
    been imported already.
    """
    if any(name.endswith(_COPY) for name in sys.modules) or not hasattr(np, "__getattr__"):
        return
    own = vars(np)
    stated: dict[str, Any] = {name: own[name] for name in ("__all__", "__dir__") if name in own}
    loaded = [name for name in np.__all__ if name in own]
    own.update(__all__=loaded, __dir__=lambda: loaded)
    try:
        import_module("scipy.sparse")
    finally:
        own.pop("__dir__")
        own.update(stated)
    for copy in [module for name, module in sys.modules.items() if name.endswith(_COPY)]:
        vars(copy)["__getattr__"] = partial(getattr, np)


@cache
def lapack() -> Any:
    """Return SciPy's LAPACK, which is imported when the first system is solved."""
    from scipy.linalg import lapack as found

    return found


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# Where a control group limits memory: the folder, the limit, what is held, and the name of what of it are cached files,
# which are given back when asked for; versions 2 and 1.
_GROUPS = (
    ("/sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    ("/sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)


def free_memory() -> int | None:
    """Return the bytes of memory that may still be taken without swapping, within the limits of process and group.

    None where the system does not say.
    """
    limits = (_available(), *(_left_of(*group) for group in _GROUPS), _left_of_address_space())
    return min((left for left in limits if left is not None), default=None)


def _available() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next((1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), None)
    except (OSError, ValueError):
        return None


def _left_of(folder: str, limit: str, used: str, cached: str) -> int | None:
    def read(name: str) -> str:
        return Path(folder, name).read_text(encoding="ascii").strip()

    try:
        most = read(limit)
        if most == "max":
            return None
        parts = dict(line.split() for line in read("memory.stat").splitlines())
        return max(int(most) - int(read(used)) + int(parts.get(cached, 0)), 1)
    except (OSError, ValueError):
        return None


def _left_of_address_space() -> int | None:
    """Return the address space that `ulimit -v` leaves [bytes]."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        return None if limit == resource.RLIM_INFINITY else max(limit - pages * resource.getpagesize(), 1)
    except (ImportError, OSError, ValueError):
        return None
