"""Locks that another thread holds while the process is forked: in the child nobody would ever release them."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from functools import cached_property


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
