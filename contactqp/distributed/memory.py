"""Memory that was freed and that the C library keeps for itself."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


def give_back() -> None:
    """Return to the system what is free between what is in use: glibc does so at the end of its heap alone.

    What lasts, a stiffness, is made after what does not, a mesh, and would come on top of it. Nothing happens where the
    C library is another.
    """
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


@cache
def _malloc_trim() -> Any:
    return getattr(ctypes.CDLL(None), "malloc_trim", None)  # of what this process has loaded: nothing is searched for
