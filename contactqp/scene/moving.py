"""Run `impact` and `large_deformation` on a scene, and return histories with its names and units.

For a motion the mass matrix is exact for nodes and integrated by quadrature for bodies.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.impact import OWN_ARGUMENTS, impact
from contactqp.analysis.motion.motion_history import MotionHistory
from contactqp.elements.scalars import Number
from contactqp.errors import InvalidProblem, NotConverged, SceneError, Unsupported
from contactqp.model.arrays import Array, Index, Vector
from contactqp.model.problem import ContactProblem
from contactqp.scene.building import NodeModel, assembled
from contactqp.scene.schema import start_values
from contactqp.solving.methods import find

if TYPE_CHECKING:
    from contactqp.scene.building import Model
    from contactqp.scene.schema import SceneData
import re
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import groupby

from contactqp.analysis.large.deformation import LargeHistory, LargeSolution
from contactqp.analysis.large_deformation import large_deformation
from contactqp.elements.deformable import ContactGeometry, ContactGroup, ObstacleContact, Supported
from contactqp.elements.nonlinear_truss import LAWS, LawOfEachBar, NonlinearTruss
from contactqp.scene.geometry import obstacle
from contactqp.scene.schema import end_time

# The default number of steps of a path.
DEFAULT_STEPS = 10
# Settings that the scene states, so that they cannot be options of a method.
OWN = ("steps", "control", "controlled", "target", "arc_length", "friction", "start", "tie", "tie_values")
_BY_PLACE = re.compile(r"\bunknown (\d+)\b")


@dataclass(frozen=True, eq=False)
class DeformableModel:
    """The bars and obstacles of a scene at large displacements; its unknowns are those of the model."""

    model: NodeModel

    @cached_property
    def truss(self) -> NonlinearTruss:
        """Return the bars on all unknowns."""
        scene = self.model.scene
        nodes = list(scene.every_node)
        place = {node: i for i, node in enumerate(nodes)}
        bars = [(bar, segment) for bar in scene.bars for segment in bar.segments]
        laws = [bar.law or "green" for bar, _ in bars]
        return NonlinearTruss(
            nodes=[[float(x) for x in scene.point(node)] for node in nodes],
            bars=[[place[node] for node in segment] for _, segment in bars],
            modulus=[float(scene.system.value(bar.modulus)) for bar, _ in bars],
            area=[float(scene.system.value(bar.area)) for bar, _ in bars],
            law=laws[0] if len(set(laws)) == 1 else LawOfEachBar(tuple(LAWS[law] for law in laws)),
        )

    @cached_property
    def body(self) -> Supported:
        """Return the bars on the free unknowns."""
        unknowns = self.model.exact.unknowns
        return Supported(self.truss, held={unknowns.place[name]: 0.0 for name in unknowns.fixed})

    @cached_property
    def contact(self) -> ContactGeometry | None:
        """Return all contacts in the order of the scene, over all unknowns; None if there are none."""
        parts = list(self._contacts())
        return ContactGroup(parts) if parts else None

    def _contacts(self) -> Iterator[ContactGeometry]:
        scene, place = self.model.scene, self.model.exact.unknowns.place
        for name, group in groupby(scene.contacts, lambda contact: str(contact.obstacle)):
            nodes = [str(contact.node) for contact in group]
            yield ObstacleContact(
                points=[[float(x) for x in scene.point(node)] for node in nodes],
                obstacle=obstacle(scene, name),
                unknowns=np.array([[place[unknown] for unknown in scene.displacements(node)] for node in nodes]),
                dimension=len(place),
            )

    def bar_force(self, name: str, displacement: Array) -> float:
        """Return the true axial force of a bar in one piece, positive in tension [force]."""
        first = 0
        for bar in self.model.scene.bars:
            if bar.name == name:
                break
            first += bar.divisions
        return float(self.truss.axial_force(self.body.expand(displacement))[first])

    def support_forces(self, solution: LargeSolution) -> Array:
        """Return the forces of the supports on the body, at all unknowns: f_int + E_N' l_N + E_T' l_T - f.

        At free unknowns it is the residual that Newton's method left.
        """
        u = self.body.expand(solution.displacement)
        load = self.model.exact_load_at(Fraction(solution.load_factor))
        force = self.truss.internal_force(u)
        force -= [float(load.get(name, 0)) for name in self.model.exact.unknowns.names]
        if self.contact is not None:
            state = self.contact.state(u)
            force += state.normal.T @ solution.normal_force
            if solution.friction_force is not None and state.tangent is not None:
                force += state.tangent.T @ solution.friction_force.ravel()
        return force


def deform(model: NodeModel, method: str, **options: Any) -> LargeHistory:
    """Follow the path that the scene states, at large deformations.

    Raises SceneError: a setting that `large_deformation` refuses, with its key in ``path``, or an option that belongs
    there; NotConverged: with the history so far.
    """
    scene, deformable = model.scene, DeformableModel(model)
    path = scene.path
    assert path is not None
    for name in OWN:
        if name in options:
            raise SceneError(f"{name}: expected in [path], and not as an option of {method!r}")
    coefficients = [float(contact.friction or 0) for contact in scene.contacts]
    control: dict[str, Any] = {"control": path.control or "load"}
    if path.controlled is not None and path.target is not None:
        control["controlled"] = model.exact.unknowns.free.index(path.controlled)
        control["target"] = float(scene.system.value(path.target))
    if path.arc_length is not None:
        control["arc_length"] = float(scene.system.value(path.arc_length))
    contact = None if deformable.contact is None else deformable.body.contact(deformable.contact)
    try:
        history = large_deformation(
            deformable.body,
            [model.load_at(Fraction(i + 1)) for i in range(int(end_time(scene)))],
            contact,
            steps=path.steps or DEFAULT_STEPS,
            method=method,
            friction=coefficients if any(coefficients) else None,
            **control,
            **options,
        )
    except InvalidProblem as error:
        raise SceneError(f"path: {_named(model, str(error))}") from None
    except NotConverged as error:
        so_far = error.history
        until_then = _of_scene(model, so_far) if isinstance(so_far, LargeHistory) else so_far
        raise NotConverged(_named(model, str(error)), until_then, error.solution) from error
    return _of_scene(model, history)


def _of_scene(model: NodeModel, history: LargeHistory) -> LargeHistory:
    """Return the history with the names and units of the scene."""
    names = [contact.name for contact in model.exact.contacts]
    return LargeHistory(
        [_solution_of_scene(model, solution) for solution in history if isinstance(solution, LargeSolution)],
        [_named(model, note) for note in history.notes],
        history.limit_points,
        [replace(event, name=names[event.contact]) for event in history.events],
        history.snaps,
    )


def _solution_of_scene(model: NodeModel, solution: LargeSolution) -> LargeSolution:
    stated = model.problem
    problem = solution.problem.replace(
        dof_names=stated.dof_names, contact_names=stated.contact_names, units=stated.units
    )
    return replace(solution, problem=problem)


def _named(model: NodeModel, text: str) -> str:
    """Return a message with the names of unknowns in place of their numbers."""
    free = model.exact.unknowns.free
    return _BY_PLACE.sub(lambda found: free[int(found[1])], text)


def exact_mass(scene: SceneData) -> Mapping[tuple[str, str], Number]:
    """Return the nonzero entries of M on all unknowns by their names, in the scene's units."""
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


def free_places(model: Model) -> Index:
    """Return the indices of the free unknowns among all."""
    if not isinstance(model, NodeModel):
        return model.system.free
    unknowns = model.exact.unknowns
    return np.array([unknowns.place[name] for name in unknowns.free], dtype=np.int64)


# Times of scenes are in seconds.
TIME_LABEL = "time [s]"


def move(model: Model, problem: ContactProblem, method: str, **options: Any) -> MotionHistory:
    """Follow the motion that the scene states, for the model's problem or a modified copy.

    Raises
    ------
    SceneError
        A setting that `impact` refuses, with its key in ``motion``, or an option that belongs there.
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
    """Return the initial ``displacements`` or ``velocities`` of all unknowns, in the scene's units.

    Raises SceneError: an initial velocity along an axis that a support fixes.
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
    """Return the sum of M v over the unknowns along an axis [force * time], with the mass matrix of the scheme.

    Parameters
    ----------
    model : NodeModel or BodyModel
    history : MotionHistory
    velocity : (n,) array
        The velocities of the free unknowns [length / time].
    axis : str
    part : str, optional
        One bar, point mass or body; by default the whole scene. At nodes that parts share, the mass of all counts.
    """
    free = free_places(model)
    sums = mass_on_all(model)[:, free] @ velocity  # fixed ones too: a consistent mass couples them
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


def _places(model: Model) -> Iterator[tuple[str, Index]]:
    """Yield the names of unknowns or ``body.axis`` with initial values, and their indices among all unknowns."""
    if isinstance(model, NodeModel):
        for name, place in model.exact.unknowns.place.items():
            yield name, np.array([place])
        return
    for body in model.structure.bodies:
        first, d = model.structure.first(body.name), len(body.axes)
        for i, axis in enumerate(body.axes):
            yield f"{body.name}.{axis}", np.arange(first + i, first + body.size, d)
