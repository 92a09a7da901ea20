"""What holds and loads the bodies of a scene: its supports and loads, made from their keys."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from contactqp.elements import loads
from contactqp.elements.structure import Part, Structure
from contactqp.elements.structure import Support as Held
from contactqp.errors import InvalidProblem, SceneError
from contactqp.scene.corners import GRAVITY
from contactqp.scene.meshing import nearest_node
from contactqp.scene.units import number, vector

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData
    from contactqp.scene.schema_bodies import PointLoad, Support

# From a body, a point and what a message calls the body to the number of the node there.
NodeAt = Callable[[Part, ArrayLike, str], int]


@contextmanager
def at_key(where: str) -> Iterator[None]:
    """What the elements refuse is refused with the key that they were made from."""
    try:
        yield
    except InvalidProblem as error:
        raise SceneError(f"{where}: {error}") from None


def _nodes(scene: SceneData, whole: Structure, place: Support | PointLoad, node_at: NodeAt) -> str | int:
    if place.near is None:
        whole.body(place.body).mesh.nodes(place.nodes)
        return place.nodes
    return node_at(whole.body(place.body), vector(scene.system, place.near), f"the body {place.body!r}")


def supports_of(scene: SceneData, whole: Structure, node_at: NodeAt = nearest_node) -> Iterator[Held]:
    for i, support in enumerate(scene.supports):
        with at_key(f"supports[{i}] ({support.name!r})"):
            nodes = _nodes(scene, whole, support, node_at)
        value = 0.0 if support.value is None else number(scene.system, support.value)
        yield Held(support.body, nodes, whole.body(support.body).axes.index(support.axis), value)


def loads_of(scene: SceneData, whole: Structure, node_at: NodeAt = nearest_node) -> Iterator[tuple[str, loads.Load]]:
    """Every load with its name; what bodies weigh is called gravity."""
    for i, traction in enumerate(scene.tractions):
        with at_key(f"tractions[{i}] ({traction.name!r})"):
            whole.body(traction.body).mesh.side(traction.nodes)
        yield traction.name, loads.Traction(traction.body, traction.nodes, vector(scene.system, traction.value))
    for i, pressure in enumerate(scene.pressures):
        with at_key(f"pressures[{i}] ({pressure.name!r})"):
            whole.body(pressure.body).mesh.side(pressure.nodes)
        yield pressure.name, loads.Pressure(pressure.body, pressure.nodes, number(scene.system, pressure.value))
    for i, point_load in enumerate(scene.point_loads):
        with at_key(f"point_loads[{i}] ({point_load.name!r})"):
            nodes = _nodes(scene, whole, point_load, node_at)
        yield point_load.name, loads.PointLoad(point_load.body, nodes, vector(scene.system, point_load.force))
    if scene.gravity is not None:
        for body in scene.bodies:
            if body.density is not None and body.density.si > 0:
                acceleration = vector(scene.system, scene.gravity)
                if scene.motion is None:
                    yield GRAVITY, loads.Gravity(body.name, acceleration)
                else:
                    yield GRAVITY, loads.Weight(body.name, acceleration, scene.motion.mass == "lumped")
