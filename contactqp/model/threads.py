"""Threads of BLAS, and locks after a fork.

OpenBLAS keeps to one thread around small dense systems: two threads make a Cholesky factorisation of a few hundred rows
no faster, and a hundred times slower where another process has the second core: they wait for each other by spinning.

A lock that another thread holds while the process is forked would never be released in the child, which therefore makes
its own.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from typing import Any

# Rows of contacts, tangents and ties, or unknowns that are eliminated by dense factors, from which OpenBLAS would start
# a second thread; smaller problems are done before its libraries are found.
WORTHWHILE = 32


def renew_in_child(renew: Callable[[], None]) -> None:
    """Call this in every process that is forked from this one, where the platform forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=renew)


@contextmanager
def on_one_thread() -> Iterator[None]:
    """Keep OpenBLAS on one thread."""
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
