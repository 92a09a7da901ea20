"""A scene's answer: its motion or load path if it has one, its one solution otherwise."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

from contactqp.analysis.history import History
from contactqp.problem import ContactProblem
from contactqp.scene.corners import end_time
from contactqp.scene.models import build
from contactqp.scene.schema import Scene
from contactqp.solving import solve
from contactqp.stages import STEPS, stage

if TYPE_CHECKING:
    from contactqp.scene.models import Model


def run(scene: Scene, method: str = "active-set", **options: Any) -> History:
    """Solve a scene; ``history[-1]`` is the solution under the full load, or at the end of the motion.

    Parameters
    ----------
    scene : Scene
        From `load_scene`, or built in Python. With `path`, loads grow from nothing, together or from corner to corner,
        and the history has the start, every step and the events; with `motion` it is the `MotionHistory` of `impact`;
        without both it has one solution. With ``deformation = "large"`` it is the `LargeHistory` of
        `large_deformation`.
    method : str
        A name of `contactqp.methods()`.
    **options
        Of `contactqp.solve`; numbers are in the scene's units.
    """
    return run_model(build(scene), method, **options)


def run_model(model: Model, method: str, **options: Any) -> History:
    """As `run`, of a scene that is built already."""
    return walk(model, model.problem, method, **options)


def walk(model: Model, problem: ContactProblem, method: str, **options: Any) -> History:
    """As `run_model`, of the model's own problem or a copy of it."""
    if model.scene.path is None and model.scene.motion is None:
        return History([solve(problem, method, **options)], [1.0])
    with stage(STEPS):
        return _steps(model, problem, method, **options)


def _steps(model: Model, problem: ContactProblem, method: str, **options: Any) -> History:
    if model.scene.large:
        from contactqp.scene.building import NodeModel
        from contactqp.scene.deforming import deform

        assert isinstance(model, NodeModel)  # large deformations are offered of nodes only
        return deform(model, method, **options)
    if model.scene.motion is not None:
        from contactqp.scene.moving import move

        return move(model, problem, method, **options)
    from contactqp.analysis.load_path import follow_path

    path = model.scene.path
    assert path is not None  # what has none is one instant
    corners = [model.load_at(Fraction(i + 1)) for i in range(int(end_time(model.scene)))]
    return follow_path(problem, loads=corners, steps=path.steps, events=path.events, method=method, **options)
