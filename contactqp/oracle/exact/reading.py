"""What an exact answer is asked of on the command line: a case file, or a problem of another code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from contactqp.exchange.problem_files import read_problem
from contactqp.scene.scene import Scene, load_scene


def read_case(path: str) -> Any:
    """A Scene of a TOML file; whatever `contactqp.read_problem` reads of anything else."""
    return load_scene(path) if Path(path).suffix.lower() == ".toml" else read_problem(path)


def tie_names(case: Any, ties: int) -> tuple[str, ...]:
    """The names of a scene's ties, or their numbers."""
    named = tuple(str(tie.name) for tie in case.ties) if isinstance(case, Scene) else ()
    return named if len(named) == ties else tuple(f"tie {i}" for i in range(ties))
