"""A scene in motion: its mass, exact for nodes and by quadrature for bodies, its starts, the momentum of its parts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.analysis.impact import OWN_ARGUMENTS, impact
from contactqp.analysis.motion.motion_history import MotionHistory
from contactqp.elements.scalars import Number
from contactqp.errors import InvalidProblem, NotConverged, SceneError, Unsupported
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.scene.building import NodeModel, assembled
from contactqp.scene.unknowns import start_values
from contactqp.solving.methods import find

if TYPE_CHECKING:
    from contactqp.scene.building import Model
    from contactqp.scene.schema import SceneData


def exact_mass(scene: SceneData) -> Mapping[tuple[str, str], Number]:
    """Return M on all unknowns by their names, in the scene's units; what is zero is left out."""
    lumped = scene.motion is not None and scene.motion.mass == "lumped"
    return assembled(part for _, element in scene.elements for part in element.masses(scene, lumped))


def mass_on_all(model: Model) -> Any:
    """Return M on all unknowns, free or not, CSR."""
    if not isinstance(model, NodeModel):
        motion = model.scene.motion
        lumped = motion is not None and motion.mass == "lumped"
        return model.structure.mass(lumped)
    place = model.exact.unknowns.place
    matrix = sp.lil_array((len(place), len(place)))
    for (i, j), entry in exact_mass(model.scene).items():
        matrix[place[i], place[j]] = float(entry)
    return matrix.tocsr()


def free_places(model: Model) -> NDArray[np.int64]:
    """Return the places of the free unknowns among all."""
    if not isinstance(model, NodeModel):
        return model.system.free
    unknowns = model.exact.unknowns
    return np.array([unknowns.place[name] for name in unknowns.free], dtype=np.int64)


# Times of scenes are in seconds.
TIME_LABEL = "time [s]"


def move(model: Model, problem: ContactProblem, method: str, **options: Any) -> MotionHistory:
    """Follow the motion that the scene states, of the model's own problem or a copy of it.

    Raises
    ------
    SceneError
        What `impact` refuses, with its key in ``motion``; an option that belongs there.
    Unsupported
        A method that is approximate by design.
    """
    motion, value = model.scene.motion, model.scene.system.value
    assert motion is not None
    if not find(method).exact:
        raise Unsupported(f"{method}: approximate by design; in a motion contact springs are the scheme 'penalty'")
    for name in OWN_ARGUMENTS:
        if name in options:
            raise SceneError(f"{name}: expected in [motion], and not as an option of {method!r}")
    knobs: dict[str, Any] = {}
    for name in ("theta", "restitution"):
        if getattr(motion, name) is not None:
            knobs[name] = float(getattr(motion, name))
    if motion.penalty is not None:
        knobs["penalty"] = float(value(motion.penalty))
    free = free_places(model)
    mass = mass_on_all(model)[free][:, free]
    displacement, velocity = start_of(model, "displacements"), start_of(model, "velocities")
    try:
        history = impact(
            problem,
            mass,
            displacement[free],
            velocity[free],
            float(motion.duration.si),
            float(motion.time_step.si),
            motion.scheme,
            start_time=float(motion.start.si),
            method=method,
            **knobs,
            **options,
        )
    except InvalidProblem as error:
        raise SceneError(f"motion.{error}") from None
    except NotConverged as error:
        if isinstance(error.history, MotionHistory):
            error.history.time_label = TIME_LABEL
        raise
    history.time_label = TIME_LABEL
    return history


def start_of(model: Model, key: str) -> Vector:
    """Return the ``displacements`` or ``velocities`` that all unknowns start with, in the scene's units.

    Raises
    ------
    SceneError
        A body that is set going along an axis that a support holds.
    """
    places = dict(_places(model))
    start = np.zeros(sum(len(at) for at in places.values()))
    supported = np.ones(len(start), dtype=bool)
    supported[free_places(model)] = False
    for i, item in enumerate(getattr(model.scene.motion, key)):
        for name, number in start_values(model.scene, item):
            if number and supported[places[name]].any():
                raise SceneError(f"motion.{key}[{i}] ({item.of!r}): expected 0 for {name!r}, which supports hold")
            start[places[name]] = float(number)
    return start


def momentum(model: Model, history: MotionHistory, velocity: Vector, axis: str, part: str | None = None) -> float:
    """Return the sum of M v over the unknowns along an axis [force time]; M is what the scheme steps with.

    Parameters
    ----------
    model : NodeModel or BodyModel
    history : MotionHistory
    velocity : (n,) array
        Of the free unknowns [length / time].
    axis : str
    part : str, optional
        One bar, point mass or body; by default the whole scene. At nodes that parts share, the mass of all counts.
    """
    free = free_places(model)
    sums = mass_on_all(model)[:, free] @ velocity  # fixed unknowns too: a consistent mass spreads to them
    sums[free] = history.motion.scheme.body.mass @ velocity
    places = dict(_places(model))
    return float(sum(sums[places[name]].sum() for name in _along(model, axis, part)))


def _along(model: Model, axis: str, part: str | None) -> list[str]:
    scene = model.scene
    if part is None:
        return [name for name, _ in _places(model) if name.rpartition(".")[2] == axis]
    if not isinstance(model, NodeModel):
        return [f"{part}.{axis}"]
    nodes = next(element.chain for _, element in scene.elements if element.inertial and element.name == part)
    return [f"{node}.{axis}" for node in nodes]


def _places(model: Model) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Yield the names of starts, unknowns or ``body.axis``, and their places among all unknowns."""
    if isinstance(model, NodeModel):
        for name, place in model.exact.unknowns.place.items():
            yield name, np.array([place])
        return
    for body in model.structure.bodies:
        first, d = model.structure.first(body.name), len(body.axes)
        for i, axis in enumerate(body.axes):
            yield f"{body.name}.{axis}", np.arange(first + i, first + body.size, d)
