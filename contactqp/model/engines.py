"""Where a problem is solved: in this process, or by PETSc on all ranks of MPI."""

from __future__ import annotations

from typing import Any

from contactqp.errors import InvalidProblem

SERIAL, PETSC = "serial", "petsc"
ENGINES = (SERIAL, PETSC)


def refuse_unknown_engine(engine: Any) -> None:
    """Raise InvalidProblem unless there is an engine of this name."""
    if engine not in ENGINES:
        raise InvalidProblem(f"engine: expected {' or '.join(map(repr, ENGINES))}, got {engine!r}")
