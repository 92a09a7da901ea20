"""Memory that is free and that the C library, or PETSc, keeps for itself."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

from contactqp.distributed.environment import petsc


def give_back() -> None:
    """Return to the system what is free between what is in use: glibc does so at the end of its heap alone.

    What lasts, a stiffness, is made after what does not, a mesh, and would come on top of it. Nothing happens where the
    C library is another.
    """
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


def destroy_dropped(comm: Any) -> None:
    """Destroy what of PETSc's Python has dropped on all ranks: PETSc waits to be told. Collective.

    Until then it keeps every vector and scatter that was made for a while: some of them in each solution.
    """
    cleanup = getattr(petsc(), "garbage_cleanup", None)  # PETSc before 3.18 destroys at once
    if cleanup is not None:
        cleanup(comm)


@cache
def _malloc_trim() -> Any:
    return getattr(ctypes.CDLL(None), "malloc_trim", None)  # of what this process has loaded: nothing is searched for
