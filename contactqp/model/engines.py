"""Engines that solve a problem elsewhere than in this process, found by their names in a table.

An engine's functions are imported when they are asked for; nothing below it knows the module that they are in.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from contactqp.errors import InvalidProblem, shown


@dataclass(frozen=True)
class Engine:
    """A solver outside of this process; each of its functions is named as ``module:function``."""

    solve: str  # (problem, method, *, warm_start, **options) -> Solution
    build: str  # (scene) -> a model that answers what `contactqp.scene.body_model.BodyModel` does
    run: str  # (model, method, checkpoint, **options) -> History
    answer_at: str  # (model, pseudo-time of a load path, method, **options) -> its solution

    def function(self, name: str) -> Callable[..., Any]:
        """Import the function of this name, one of the fields."""
        module, _, function = str(getattr(self, name)).partition(":")
        found: Callable[..., Any] = getattr(importlib.import_module(module), function)
        return found


SERIAL, PETSC = "serial", "petsc"
_ON_RANKS = "contactqp.distributed.running_on_ranks"
_TABLE = {
    PETSC: Engine(
        solve="contactqp.distributed.solving:solve_whole",
        build=f"{_ON_RANKS}:model_on_ranks",
        run=f"{_ON_RANKS}:run_on_ranks",
        answer_at=f"{_ON_RANKS}:answer_at",
    )
}
ENGINES = (SERIAL, *_TABLE)


def refuse_unknown_engine(engine: Any) -> None:
    """Raise InvalidProblem unless there is an engine of this name."""
    if not isinstance(engine, str) or engine not in ENGINES:
        raise InvalidProblem(f"engine: expected {' or '.join(map(repr, ENGINES))}, got {shown(engine)}")


def engine_named(name: str) -> Engine:
    """Return the engine of this name, one of `ENGINES` other than "serial"."""
    return _TABLE[name]
