"""OpenBLAS on one thread around the small dense systems of the contacts.

Two threads make a Cholesky factorisation of a few hundred rows no faster, and a hundred times slower where another
process has the second core: they wait for each other by spinning. MKL, which PARDISO runs on, keeps its threads.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from contactqp.problem import ContactProblem

# Contacts from which a second thread pays.
THREADS_PAY = 1500
# Problems smaller than this are done before the libraries are found.
WORTHWHILE = 2000


@contextmanager
def one_blas_thread(problem: ContactProblem) -> Iterator[None]:
    """While a problem is worked on, where that pays; without threadpoolctl (extra `fast`) nothing changes."""
    if problem.dimension < WORTHWHILE or problem.contacts >= THREADS_PAY or (pools := _openblas()) is None:
        yield
        return
    with pools.limit(limits=1):
        yield


@cache
def _openblas() -> Any:
    """The OpenBLAS libraries of NumPy and SciPy."""
    if importlib.util.find_spec("threadpoolctl") is None:
        return None
    import scipy.linalg  # noqa: F401  brings a library of its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(internal_api="openblas")
