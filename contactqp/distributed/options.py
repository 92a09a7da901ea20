"""Options of PETSc's, which users set with a prefix of ours."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from contactqp.distributed.environment import petsc

# Of the preconditioners, as in PETSC_OPTIONS="-contactqp_pc_gamg_threshold 0.02".
PREFIX = "contactqp_"


@contextmanager
def given(prefix: str, ours: dict[str, Any]) -> Iterator[None]:
    """Options that the user has not set, for the while."""
    options = petsc().Options(prefix)
    added = {name: value for name, value in ours.items() if not options.hasName(name)}
    for name, value in added.items():
        options[name] = value
    try:
        yield
    finally:
        for name in added:
            options.delValue(name)
