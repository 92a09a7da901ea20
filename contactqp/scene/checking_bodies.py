"""Whether the parts of a scene of elastic bodies fit each other; meshes are not read before the scene is built."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from contactqp.errors import SceneError
from contactqp.scene.blocks import BLOCKS
from contactqp.scene.fields import refuse_unknown

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData

# What only scenes of nodes have beside their elements, and what takes its place.
_OF_NODES = {
    "ties": "ties between bodies are not offered yet",
    "fixed": "'supports' hold bodies",
    "line_loads": "they act on strings",
    "loads": "'tractions', 'pressures' and 'point_loads' act on bodies",
}
# The dimensions that an obstacle exists in.
_DIMENSIONS = {"plane": (2, 3), "circle": (2,), "sphere": (3,), "cylinder": (3,), "paraboloid": (2, 3)}


def check_bodies(scene: SceneData) -> None:
    """Raise SceneError at the first part that does not fit the others."""
    beside = {key: kind.beside_bodies for key, kind in BLOCKS.items()}
    for key, instead in {"nodes": "", **beside, **_OF_NODES}.items():
        if getattr(scene, key):
            instead = instead or f"bodies and {key} in one scene are not offered yet"
            raise SceneError(f"{key}: expected none in a scene of bodies: {instead}")
    if scene.axes not in (("x", "y"), ("x", "y", "z")):
        raise SceneError(f"axes: expected ['x', 'y'] or ['x', 'y', 'z'] in a scene of bodies, got {list(scene.axes)}")
    if scene.membranes:
        _membranes_fit(scene)
    _models_fit(scene)
    _bodies_exist(scene)
    _obstacles_exist(scene)
    for i, support in enumerate(scene.supports):
        refuse_unknown(f"supports[{i}].axis ({support.name!r})", support.axis, scene.axes, "axis")
        if scene.path is not None and support.value is not None and support.value.si:
            raise SceneError(
                f"supports[{i}].value ({support.name!r}): expected 0 with a load path, which makes loads grow and "
                f"prescribed displacements not, got {support.value}"
            )
    loaded = scene.tractions or scene.pressures or scene.point_loads or scene.gravity
    if scene.path is not None and not loaded:
        raise SceneError("path: expected loads that grow along it, got none")


def _membranes_fit(scene: SceneData) -> None:
    """Refuse membranes outside of the plane z = 0 of a scene in space, and beside bodies."""
    if scene.bodies:
        raise SceneError("membranes: expected none beside bodies, which are not offered together")
    if len(scene.axes) != 3:
        raise SceneError(
            f"axes: expected ['x', 'y', 'z'] with membranes, which deflect along z, got {list(scene.axes)}"
        )
    for i, membrane in enumerate(scene.membranes):
        if membrane.shape is not None and membrane.shape.dimension != 2:
            raise SceneError(
                f"membranes[{i}].shape ({membrane.name!r}): expected a plane shape, got {membrane.shape.kind!r}"
            )
    for i, support in enumerate(scene.supports):
        if support.axis != "z":
            raise SceneError(
                f"supports[{i}].axis ({support.name!r}): expected 'z' for a membrane, got {support.axis!r}"
            )
    if scene.gravity is not None:
        raise SceneError("gravity: expected none, membranes have no mass")


def _models_fit(scene: SceneData) -> None:
    round_ones = [body.model == "axisymmetric" for body in scene.bodies]
    for i, body in enumerate(scene.bodies):
        where = f"bodies[{i}].model ({body.name!r})"
        if (body.model == "3d") != (len(scene.axes) == 3):
            raise SceneError(f"{where}: expected a model for the axes {list(scene.axes)}, got {body.model!r}")
        if round_ones[i] != round_ones[0]:
            raise SceneError(f"{where}: expected axisymmetric bodies only, or none, got {body.model!r}")
        if scene.gravity is not None and body.density is None:
            raise SceneError(f"bodies[{i}].density ({body.name!r}): expected, since there is gravity, and missing")


def _places(scene: SceneData) -> Iterator[tuple[str, str]]:
    """Yield every key that names an elastic body, and the body."""
    for key, name in (("point_loads", "on"), ("tractions", "side"), ("pressures", "side")):
        for i, item in enumerate(getattr(scene, key)):
            yield f"{key}[{i}].{name} ({item.name!r})", item.body
    for i, contact in enumerate(scene.contacts):
        for j, side in enumerate(contact.touching_sides):
            key = f"contacts[{i}].sides[{j}]" if contact.sides else f"contacts[{i}].side"
            yield f"{key} ({contact.name!r})", side.partition(".")[0]


def _bodies_exist(scene: SceneData) -> None:
    known = [body.name for body in scene.bodies]
    for key, name in _places(scene):
        refuse_unknown(key, name, known, "body")
    meshed = [body.name for body in scene.meshed]
    for i, support in enumerate(scene.supports):
        refuse_unknown(f"supports[{i}].on ({support.name!r})", support.body, meshed, "body")
    for i, contact in enumerate(scene.contacts):
        if contact.membrane is not None:
            membranes = [membrane.name for membrane in scene.membranes]
            refuse_unknown(f"contacts[{i}].membrane ({contact.name!r})", contact.membrane, membranes, "membrane")


def obstacles_exist_in(scene: SceneData) -> None:
    """Refuse obstacles that the scene has not enough dimensions for, or too many."""
    d = len(scene.axes)
    for i, obstacle in enumerate(scene.obstacles):
        if d not in _DIMENSIONS[obstacle.kind]:
            raise SceneError(
                f"obstacles[{i}].kind ({obstacle.name!r}): a {obstacle.kind} does not exist in {d} dimensions"
            )


def _obstacles_exist(scene: SceneData) -> None:
    known = [obstacle.name for obstacle in scene.obstacles]
    obstacles_exist_in(scene)
    for i, contact in enumerate(scene.contacts):
        where = f"contacts[{i}]"
        if contact.touched:
            raise SceneError(f"{where} ({contact.name!r}): expected 'side' or 'sides' in a scene of bodies")
        if contact.obstacle is not None:
            refuse_unknown(f"{where}.obstacle ({contact.name!r})", contact.obstacle, known, "obstacle")
        if contact.sides is not None:
            _pairs_fit(scene, f"{where}.sides ({contact.name!r})", contact.sides, contact.pairing)


def _pairs_fit(scene: SceneData, where: str, sides: tuple[str, ...], pairing: str | None) -> None:
    first, second = (scene.body(side.partition(".")[0]) for side in sides)
    thicknesses = [None if body.thickness is None else body.thickness.si for body in (first, second)]
    if thicknesses[0] != thicknesses[1]:
        raise SceneError(f"{where}: expected bodies of one thickness, got {first.thickness} and {second.thickness}")
    if first.model == "axisymmetric" and pairing == "mortar":
        raise SceneError(f"{where}: expected the pairing 'node-to-segment' between axisymmetric bodies, got 'mortar'")
