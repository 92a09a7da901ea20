"""OpenBLAS on one thread around the small dense systems of the contacts, and locks that survive a fork.

Two threads make a Cholesky factorisation of a few hundred rows no faster, and a hundred times slower where another
process has the second core: they wait for each other by spinning. MKL, which PARDISO runs on, keeps its threads.

A lock that another thread holds while the process is forked would never be released in the child, which therefore makes
its own.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import cache, cached_property
from typing import Any

from contactqp.model.problem import ContactProblem


def renew_in_child(renew: Callable[[], None]) -> None:
    """Call this in every process that is forked from this one, where the platform forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=renew)


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
# Problems smaller than this are done before the libraries are found.
WORTHWHILE = 2000


def one_blas_thread(problem: ContactProblem) -> AbstractContextManager[None]:
    """While a problem is worked on, where that pays."""
    pays = problem.dimension >= WORTHWHILE and problem.contacts < THREADS_PAY
    return on_one_thread() if pays else nullcontext()


@contextmanager
def on_one_thread(pays: bool = True) -> Iterator[None]:
    """Keep OpenBLAS on one thread, if that pays."""
    if not pays:
        yield
        return
    _LIMIT.enter(_openblas())
    try:
        yield
    finally:
        _LIMIT.leave()


class _Limit:
    """One limit for all who want it at a time: entered by the first, left by the last."""

    def __init__(self) -> None:
        self._lock, self._count, self._limited = threading.Lock(), 0, ExitStack()

    def renew(self) -> None:
        """Take a new lock in a process that was forked; it keeps the limit of the process that it comes from."""
        self._lock = threading.Lock()

    def enter(self, pools: Any) -> None:
        with self._lock:
            if not self._count:
                self._limited.enter_context(pools.limit(limits=1))
            self._count += 1

    def leave(self) -> None:
        with self._lock:
            self._count -= 1
            if not self._count:
                self._limited.close()


_LIMIT = _Limit()
renew_in_child(_LIMIT.renew)


@cache
def _openblas() -> Any:
    """The OpenBLAS libraries of NumPy and SciPy."""
    import scipy.linalg  # noqa: F401  brings a library of its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(internal_api="openblas")
