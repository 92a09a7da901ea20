"""The resources of a solve: late import of SciPy, cores, free memory, time, and engines outside of this process.

An engine is found by name in a table, and its functions are imported when needed, so that lower layers do not depend on
its module.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property, partial
from importlib import import_module
from typing import Any

import numpy as np

from contactqp.errors import BackendFailed, InvalidProblem, Unsupported, free_memory, shown
from contactqp.model.arrays import refuse_late, renew_in_child, seconds_left


def _renew_cached_properties() -> None:
    """Give the cached properties of the package new locks, each of which serves all instances of a class."""
    modules = [module for name, module in tuple(sys.modules.items()) if name.partition(".")[0] == "contactqp"]
    kinds = {kind for module in modules for kind in vars(module).values() if isinstance(kind, type)}
    for kind in kinds:
        for attribute in vars(kind).values():
            if isinstance(attribute, cached_property) and hasattr(attribute, "lock"):
                attribute.lock = threading.RLock()


if sys.version_info < (3, 12):  # from Python 3.12 on there are no locks
    renew_in_child(_renew_cached_properties)


STANDARD_OUTPUT = 1
# One thread at a time exchanges the standard output, so that each of them finds the original one to restore.
_EXCHANGE = [threading.RLock()]
renew_in_child(lambda: _EXCHANGE.__setitem__(0, threading.RLock()))


@contextlib.contextmanager
def silenced_output() -> Iterator[None]:
    """Discard what compiled libraries print on the standard output of the process, as Python cannot intercept it."""
    with _EXCHANGE[0]:
        yield from _silenced()


def _silenced() -> Iterator[None]:
    try:
        sys.stdout.flush()
        kept = os.dup(STANDARD_OUTPUT)
    except (AttributeError, OSError, ValueError):  # no such file descriptor, so nothing is visible
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, STANDARD_OUTPUT)
        yield
    finally:
        os.dup2(kept, STANDARD_OUTPUT)
        os.close(kept)
        os.close(nowhere)


# The last part of the name of SciPy's modules with copies of NumPy's names.
_COPY = "array_api_compat.numpy"


def import_scipy() -> None:
    """Import SciPy's sparse matrices without unneeded parts of NumPy.

    SciPy copies all names of NumPy, which loads a parser of Fortran, test tools and other lazy parts in 60 ms, a tenth
    of a small command. Here these are copied on first access. It is meant for a process of our own, such as that of a
    command, and does nothing if SciPy has been imported.
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
    """Return SciPy's LAPACK, imported on first use."""
    from scipy.linalg import lapack as found

    return found


# From this part of stored entries on, BLAS is faster than loops over them; the rows of bodies have few.
DENSE_PART = 1 / 8


def dense_product(rows: Any, columns: Any) -> Any:
    """Return rows (m, n), sparse, times columns (n, q), dense, by BLAS where many entries of the rows are stored."""
    return (rows.toarray() if is_nearly_dense(rows) else rows) @ columns


def is_nearly_dense(rows: Any) -> bool:
    """Return whether a sparse matrix stores so many of its entries that BLAS is faster with all of them."""
    return bool(rows.nnz >= DENSE_PART * rows.shape[0] * rows.shape[1])


def cores() -> int:
    """Return the number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# What is predicted to exceed this part of the free memory is refused; fewer bytes fit into any memory.
MOST_OF_MEMORY, LITTLE_MEMORY = 0.95, 2.0**29


def refuse_more_than_memory(what: str, entries: float) -> None:
    """Raise Unsupported where so many doubles would not fit into memory, before the system ends the process."""
    needed = entries * np.dtype(float).itemsize
    free = free_memory() if needed > LITTLE_MEMORY else None
    if free is not None and needed > MOST_OF_MEMORY * free:
        raise Unsupported(
            f"{what} need about {needed / 2**30:.1f} GiB, {free / 2**30:.1f} GiB are free: free memory, leave contacts "
            "that cannot close out, or take a coarser mesh"
        )


# The type of MKL's progress function: thread, step, name of the stage and its length; and what is being factorised.
_PROGRESS = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int)
_RUNNING: list[None] = []


@contextlib.contextmanager
def stoppable(set_progress: Any) -> Iterator[None]:
    """End a factorisation by PARDISO at Ctrl-C, or with NotConverged when the time limit of the call has passed.

    MKL calls its progress function all the while, and ends with an error if that returns one. The function serves the
    whole process, so that a time limit ends no factorisation beside another one.

    Parameters
    ----------
    set_progress : MKL's function that takes the progress function; None if the factorisation is short
    """
    _RUNNING.append(None)
    set_progress = set_progress if len(_RUNNING) == 1 else None
    in_main = threading.current_thread() is threading.main_thread()
    heard = in_main and set_progress and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    left, pressed = seconds_left(), threading.Event()
    end = np.inf if left is None else time.perf_counter() + left

    def progress(_thread: int, _step: int, stage: bytes, _length: int) -> int:
        late = pressed.is_set() or (len(_RUNNING) == 1 and time.perf_counter() > end)
        return int(late and stage.startswith(b"Pardiso"))  # LAPACK reports stages of its own in between

    called = _PROGRESS(progress)
    try:
        if set_progress is not None:
            set_progress(called)
        if heard:
            signal.signal(signal.SIGINT, lambda *_: pressed.set())
        yield
    except BackendFailed:
        if set_progress is not None:
            refuse_late("the factors of the stiffness were complete")
        raise
    finally:
        _RUNNING.pop()
        if set_progress is not None:
            set_progress(None)
        if heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if pressed.is_set():
            raise KeyboardInterrupt


@dataclass(frozen=True)
class Engine:
    """A solver outside of this process; each of its functions is named as ``module:function``."""

    solve: str  # (problem, method, *, warm_start, **options) -> Solution
    build: str  # (scene) -> a model with the methods of `contactqp.scene.body_model.BodyModel`
    run: str  # (model, method, checkpoint, **options) -> History
    answer_at: str  # (model, pseudo-time of a load path, method, **options) -> its solution

    def function(self, name: str) -> Callable[..., Any]:
        """Import the function of this name, one of the fields."""
        module, _, function = str(getattr(self, name)).partition(":")
        found: Callable[..., Any] = getattr(import_module(module), function)
        return found


SERIAL, PETSC = "serial", "petsc"
_ON_RANKS = "contactqp.distributed.running_on_ranks"
_TABLE = {
    PETSC: Engine(
        solve="contactqp.distributed.solving:solve_whole",
        build=f"{_ON_RANKS}:model_on_ranks",
        run=f"{_ON_RANKS}:run_on_ranks",
        answer_at=f"{_ON_RANKS}:answer_at",
    )
}
ENGINES = (SERIAL, *_TABLE)


def refuse_unknown_engine(engine: Any) -> None:
    """Raise InvalidProblem unless there is an engine of this name."""
    if not isinstance(engine, str) or engine not in ENGINES:
        raise InvalidProblem(f"engine: expected {' or '.join(map(repr, ENGINES))}, got {shown(engine)}")


def engine_named(name: str) -> Engine:
    """Return the engine of this name, one of `ENGINES` other than "serial"."""
    return _TABLE[name]
