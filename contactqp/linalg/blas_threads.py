"""OpenBLAS on one thread around the small dense systems of the contacts.

Two threads make a Cholesky factorisation of a few hundred rows no faster, and a hundred times slower where another
process has the second core: they wait for each other by spinning. MKL, which PARDISO runs on, keeps its threads.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import cache
from typing import Any

from contactqp.linalg.forking import renew_in_child
from contactqp.model.problem import ContactProblem

# Contacts from which a second thread pays.
THREADS_PAY = 1500
# Problems smaller than this are done before the libraries are found.
WORTHWHILE = 2000


def one_blas_thread(problem: ContactProblem) -> AbstractContextManager[None]:
    """While a problem is worked on, where that pays."""
    return on_one_thread(problem.dimension >= WORTHWHILE and problem.contacts < THREADS_PAY)


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
