"""What a study consists of: functions with their arguments, and what became of each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class Cell:
    """One piece of a study that succeeds, fails or crashes by itself.

    Parameters
    ----------
    key : str
        What it is, the same in every run and different from all others: "bar_wall/osqp/raw/tolerance=1e-06".
    function : callable
        Of a module, so that another process finds it by its name.
    arguments : tuple
        Its arguments; they are pickled.
    result : type
        What it returns: a dataclass of plain data, see `contactqp.study.running.codec`.
    digest : str
        Of what the arguments stand for; a result that was kept under another one is not used.
    cost : float
        How long it is expected to take, relative to the others.
    """

    key: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    result: type
    digest: str = ""
    cost: float = 1.0


@dataclass(frozen=True)
class Crash:
    """What became of a cell that returned nothing."""

    message: str  # died of a segmentation fault (SIGSEGV); stopped after 600 s; raised RuntimeError: ...


# Of a cell: what its function returned, or a Crash.
Result = Any


def refuse_twins(cells: Iterable[Cell]) -> None:
    """Raise ValueError where two cells have one key: one of them would get the other's result."""
    seen: set[str] = set()
    for cell in cells:
        if cell.key in seen:
            raise ValueError(f"two cells are called {cell.key!r}")
        seen.add(cell.key)
