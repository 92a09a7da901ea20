"""A scene at large deformations: from its model to `large_deformation`, with the names and units of the scene."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from contactqp.analysis.large.deformation import LargeHistory, LargeSolution
from contactqp.analysis.large_deformation import large_deformation
from contactqp.elements.deformable import ContactGeometry, ContactGroup, ObstacleContact, Supported
from contactqp.elements.nonlinear_truss import LAWS, LawOfEachBar, NonlinearTruss
from contactqp.errors import InvalidProblem, NotConverged, SceneError
from contactqp.model.arrays import Array
from contactqp.scene.building import NodeModel
from contactqp.scene.geometry import obstacle
from contactqp.scene.unknowns import end_time

# Steps of a path that states none.
DEFAULT_STEPS = 10
# What the scene says itself, and no option of a method does.
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

        At free unknowns it is what Newton's method left out of balance.
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

    Raises
    ------
    SceneError
        What `large_deformation` refuses, with its key in ``path``; an option that belongs there.
    NotConverged
        With the history so far.
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
    """Return a text with unknowns by their names in place of their numbers."""
    free = model.exact.unknowns.free
    return _BY_PLACE.sub(lambda found: free[int(found[1])], text)
