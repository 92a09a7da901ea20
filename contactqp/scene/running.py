"""A scene's answer: its motion or load path if it has one, its one solution otherwise."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contactqp.analysis.history import History
from contactqp.errors import Unsupported
from contactqp.linalg.stages import STEPS, stage
from contactqp.model.arrays import own_floating_point
from contactqp.model.engines import SERIAL, engine_named, refuse_unknown_engine
from contactqp.model.problem import ContactProblem
from contactqp.scene.corners import end_time
from contactqp.scene.models import build
from contactqp.scene.scene import Scene
from contactqp.scene.schema import SceneData
from contactqp.solving.solve import solve

if TYPE_CHECKING:
    from contactqp.scene.models import Model


@own_floating_point
def run(
    scene: Scene,
    method: str = "active-set",
    *,
    engine: str = SERIAL,
    checkpoint: str | Path | None = None,
    **options: Any,
) -> History:
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
    engine : str
        "serial": in this process. "petsc": on all ranks of MPI, each of which calls this and gets the same; what a
        solution of bodies is asked for is gathered then, so that all ranks have to ask or all of them wait; `method` is
        "active-set", and load paths are without friction and take steps. Each rank makes its own piece of elastic
        bodies; what is asked of their solutions is gathered, so that all ranks ask it together.
    checkpoint : str or Path, optional
        With "petsc", a folder where every step is kept. Steps that are there already are not solved again, whatever
        number of ranks has solved them.
    **options
        Of `contactqp.solve`; numbers are in the scene's units.

    Raises
    ------
    Unsupported
        With "petsc", a motion, large deformations, exact events, a load path with friction, or a method or an option of
        one process.
    InvalidProblem
        A `checkpoint` of another scene; and as `contactqp.solve`.
    """
    return run_model(built(scene, engine), method, engine, checkpoint, **options)


def built(scene: SceneData, engine: str = SERIAL) -> Any:
    """The scene's model, for an engine."""
    refuse_unknown_engine(engine)
    if engine == SERIAL:
        return build(scene)
    return engine_named(engine).function("build")(scene)


def run_model(
    model: Model, method: str, engine: str = SERIAL, checkpoint: str | Path | None = None, **options: Any
) -> History:
    """As `run`, of a scene that is built already."""
    if engine != SERIAL:
        found: History = engine_named(engine).function("run")(model, method, checkpoint, **options)
        return found
    if checkpoint is not None:
        raise Unsupported("checkpoint: only engine='petsc' keeps the steps of a load path")
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
