"""A scene's answer: its load path if it has one, its one solution otherwise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from contactqp.analysis.history import History
from contactqp.analysis.load_path import follow_path
from contactqp.scene.models import build
from contactqp.scene.schema import Scene
from contactqp.solving import solve

if TYPE_CHECKING:
    from contactqp.scene.models import Model


def run(scene: Scene, method: str = "active-set", **options: Any) -> History:
    """Solve a scene; ``history[-1]`` is the solution under the full load.

    Parameters
    ----------
    scene : Scene
        From `load_scene`, or built in Python. With `path`, all loads grow together from nothing, and the history has
        ``steps + 1`` solutions and the events; without, it has one.
    method : str
        A name of `contactqp.methods()`.
    **options
        Of `contactqp.solve`; numbers are in the scene's units.
    """
    return run_model(build(scene), method, **options)


def run_model(model: Model, method: str, **options: Any) -> History:
    """As `run`, of a scene that is built already."""
    problem, path = model.problem, model.scene.path
    if path is None:
        solution = solve(problem, method, **options)
        return History([solution], [1.0])
    return follow_path(problem, loads=[problem.load], steps=path.steps, events=path.events, method=method, **options)
