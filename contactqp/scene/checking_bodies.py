"""Check that the parts of a scene of bodies, of large deformations, motions and load paths fit each other."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import TYPE_CHECKING

from contactqp.errors import SceneError
from contactqp.scene.claims import Claim
from contactqp.scene.fields import unknown
from contactqp.scene.units import Quantity
from contactqp.scene.unknowns import Unknowns, end_time, has_corners, load_names, started

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData

# What only scenes of nodes have, and what takes its place.
_OF_NODES = {
    "nodes": "bodies and nodes in one scene are not offered yet",
    "bars": "bodies and bars in one scene are not offered yet",
    "springs": "bodies and springs in one scene are not offered yet",
    "beams": "bodies and beams in one scene are not offered yet",
    "strings": "bodies and strings in one scene are not offered yet",
    "masses": "a body weighs by its density",
    "matrices": "a body has its own stiffness",
    "ties": "ties between bodies are not offered yet",
    "fixed": "'supports' hold bodies",
    "line_loads": "they act on strings",
    "loads": "'tractions', 'pressures' and 'point_loads' act on bodies",
}
_OF_BODIES = ("supports", "tractions", "pressures", "point_loads")
# The dimensions that an obstacle exists in.
_DIMENSIONS = {"plane": (2, 3), "circle": (2,), "sphere": (3,), "cylinder": (3,), "paraboloid": (2, 3)}


def check_no_bodies(scene: SceneData) -> None:
    """Refuse what only bodies can have in a scene without them, and a scene of nothing."""
    for key in _OF_BODIES:
        if getattr(scene, key):
            raise SceneError(f"{key}: expected none in a scene without bodies")
    if not scene.nodes:
        raise SceneError("nodes: expected 'nodes', 'bodies' or 'membranes', got none")
    for i, obstacle in enumerate(scene.obstacles):
        if obstacle.kind != "plane" and not scene.large:
            raise SceneError(
                f"obstacles[{i}].kind ({obstacle.name!r}): expected a plane for nodes, got {obstacle.kind!r}"
            )
    for i, contact in enumerate(scene.contacts):
        if not contact.touched:
            raise SceneError(f"contacts[{i}] ({contact.name!r}): expected 'node' or 'nodes' in a scene without bodies")


def check_bodies(scene: SceneData) -> None:
    """Raise SceneError at the first part that does not fit the others."""
    for key, instead in _OF_NODES.items():
        if getattr(scene, key):
            raise SceneError(f"{key}: expected none in a scene of bodies: {instead}")
    if scene.axes not in (("x", "y"), ("x", "y", "z")):
        raise SceneError(f"axes: expected ['x', 'y'] or ['x', 'y', 'z'] in a scene of bodies, got {list(scene.axes)}")
    if scene.membranes:
        _membranes_fit(scene)
    _models_fit(scene)
    _bodies_exist(scene)
    _obstacles_exist(scene)
    for i, support in enumerate(scene.supports):
        if support.axis not in scene.axes:
            raise SceneError(f"supports[{i}].axis ({support.name!r}): {unknown(support.axis, scene.axes, 'axis')}")
        if scene.path is not None and support.value is not None and support.value.si:
            raise SceneError(
                f"supports[{i}].value ({support.name!r}): expected 0 with a load path, which makes loads grow and "
                f"prescribed displacements not, got {support.value}"
            )
    loaded = scene.tractions or scene.pressures or scene.point_loads or scene.gravity
    if scene.path is not None and not loaded:
        raise SceneError("path: expected loads that grow along it, got none")


def _membranes_fit(scene: SceneData) -> None:
    """A membrane lies in the plane z = 0 of a scene in space, alone or with other membranes."""
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
    """Every place that names an elastic body, and the body."""
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
        if name not in known:
            raise SceneError(f"{key}: {unknown(name, known, 'body')}")
    meshed = [body.name for body in scene.meshed]
    for i, support in enumerate(scene.supports):
        if support.body not in meshed:
            raise SceneError(f"supports[{i}].on ({support.name!r}): {unknown(support.body, meshed, 'body')}")
    for i, contact in enumerate(scene.contacts):
        if contact.membrane is not None:
            membranes = [membrane.name for membrane in scene.membranes]
            if contact.membrane not in membranes:
                raise SceneError(
                    f"contacts[{i}].membrane ({contact.name!r}): {unknown(contact.membrane, membranes, 'membrane')}"
                )


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
        if contact.obstacle is not None and contact.obstacle not in known:
            raise SceneError(f"{where}.obstacle ({contact.name!r}): {unknown(contact.obstacle, known, 'obstacle')}")
        if contact.sides is not None:
            _pairs_fit(scene, f"{where}.sides ({contact.name!r})", contact.sides, contact.pairing)


def _pairs_fit(scene: SceneData, where: str, sides: tuple[str, ...], pairing: str | None) -> None:
    first, second = (scene.body(side.partition(".")[0]) for side in sides)
    thicknesses = [None if body.thickness is None else body.thickness.si for body in (first, second)]
    if thicknesses[0] != thicknesses[1]:
        raise SceneError(f"{where}: expected bodies of one thickness, got {first.thickness} and {second.thickness}")
    if first.model == "axisymmetric" and pairing == "mortar":
        raise SceneError(f"{where}: expected the pairing 'node-to-segment' between axisymmetric bodies, got 'mortar'")


# Whether a scene fits large deformations: bars between nodes, obstacles, and a load path with its control.

# What has no form at large displacements here.
_SMALL_ONLY = ("bodies", "membranes", "springs", "beams", "strings", "matrices", "ties")


def large_fits(scene: SceneData) -> None:
    """Raise SceneError at the first part that does not fit large deformations, or that only they have."""
    if not scene.large:
        _no_large_keys(scene)
        return
    for key in _SMALL_ONLY:
        if getattr(scene, key):
            raise SceneError(f"{key}: expected none with deformation = 'large', which is offered of bars")
    if scene.motion is not None:
        raise SceneError("motion: expected none with deformation = 'large', which is of statics")
    if scene.path is None:
        raise SceneError("path: expected with deformation = 'large', the path on which the loads grow, and missing")
    if len(scene.axes) == 1:
        raise SceneError("axes: expected two or three with deformation = 'large', got one")
    if not scene.bars:
        raise SceneError("bars: expected with deformation = 'large', got none")
    if scene.path.events is not None:
        raise SceneError(
            f"path.events: expected none with deformation = 'large', where nothing is linear between events, got "
            f"{scene.path.events!r}"
        )
    _obstacles_are_surfaces(scene)


def _no_large_keys(scene: SceneData) -> None:
    for i, bar in enumerate(scene.bars):
        if bar.law is not None:
            raise SceneError(f"bars[{i}].law ({bar.name!r}): expected with deformation = 'large' only, got {bar.law!r}")
    if scene.path is not None and scene.path.control is not None:
        raise SceneError(f"path.control: expected with deformation = 'large' only, got {scene.path.control!r}")


def _obstacles_are_surfaces(scene: SceneData) -> None:
    obstacles_exist_in(scene)
    for i, obstacle in enumerate(scene.obstacles):
        if obstacle.kind == "paraboloid" and obstacle.measure != "normal":
            raise SceneError(
                f"obstacles[{i}].measure ({obstacle.name!r}): expected 'normal' with deformation = 'large': a gap "
                "along the axis has no normal that follows large displacements"
            )
    for i, contact in enumerate(scene.contacts):
        if contact.node is None:
            raise SceneError(
                f"contacts[{i}] ({contact.name!r}): expected 'node' and 'obstacle' with deformation = 'large'"
            )


def control_fits(scene: SceneData, unknowns: Unknowns) -> None:
    """Raise SceneError if the path's control does not fit the scene."""
    path = scene.path
    if path is None or path.control in (None, "load"):
        return
    if path.corners is not None:
        raise SceneError(f"path.corners: expected none with control = {path.control!r}, whose load factor follows")
    for i, contact in enumerate(scene.contacts):
        if contact.friction:
            raise SceneError(
                f"contacts[{i}].friction ({contact.name!r}): expected none with control = {path.control!r}: friction "
                "needs control = 'load'"
            )
    if path.controlled is not None and path.controlled not in unknowns.free:
        fixed = " among those that are free" if path.controlled in unknowns.fixed else ""
        raise SceneError(f"path.controlled: {unknown(path.controlled, unknowns.free, 'unknown')}{fixed}")


def large_claim_fits(where: str, claim: Claim, scene: SceneData) -> None:
    """Raise SceneError if the claim means nothing at large deformations, or, without them, needs them."""
    measure = claim.measure
    control = "load" if scene.path is None or scene.path.control is None else scene.path.control
    if not scene.large:
        if measure.large:
            raise SceneError(f"{where}.quantity: {claim.quantity!r} expects deformation = 'large'")
        if claim.reached is not None:
            raise SceneError(f"{where}.reached: expected with deformation = 'large' only, got {claim.reached}")
        return
    if measure.small:
        raise SceneError(f"{where}.quantity: {claim.quantity!r} means nothing with deformation = 'large'")
    if claim.quantity.startswith("limit") and control == "load":
        raise SceneError(
            f"{where}.quantity: {claim.quantity!r} expects control = 'displacement' or 'arc-length': load control "
            "jumps over limit points ('snap-through load')"
        )
    if claim.quantity.startswith("snap-through") and control != "load":
        raise SceneError(f"{where}.quantity: {claim.quantity!r} expects control = 'load', got {control!r}")
    if claim.reached is not None and (control != "displacement" or measure.whole_way):
        what = f"{claim.quantity!r} is of the whole path" if measure.whole_way else f"got control = {control!r}"
        raise SceneError(f"{where}.reached: expected with control = 'displacement' only: {what}")
    if control != "load" and (claim.time is not None or claim.load_factor != 1):
        key = "load_factor" if claim.time is None else "time"
        instead = "'reached'" if control == "displacement" else "none"
        raise SceneError(
            f"{where}.{key}: expected {instead} with control = {control!r}, whose load factor comes and goes"
        )


# Whether a scene's motion fits its parts: what has mass, and what starts with which displacement and velocity.


def motion_fits(scene: SceneData, unknowns: Unknowns) -> None:
    """Raise SceneError at the first part that does not fit the motion."""
    if scene.motion is None:
        return
    if scene.path is not None:
        raise SceneError("motion: expected [motion] or [path], got both")
    if scene.study:
        raise SceneError("study: expected none in a motion, whose steps have no knob to sweep")
    for i, contact in enumerate(scene.contacts):
        if contact.slip_origin is not None:
            raise SceneError(
                f"contacts[{i}].slip_origin ({contact.name!r}): expected none in a motion, which finds it itself"
            )
    for i, support in enumerate(scene.supports):
        if support.value is not None and support.value.si:
            raise SceneError(
                f"supports[{i}].value ({support.name!r}): expected 0 in a motion, which holds supports still, got "
                f"{support.value}"
            )
    _has_mass(scene)
    _starts_fit(scene, unknowns)


def _has_mass(scene: SceneData) -> None:
    if scene.membranes:
        raise SceneError("membranes: expected none in a motion, they have no mass")
    for key in ("bars", "bodies"):
        for i, item in enumerate(getattr(scene, key)):
            where = f"{key}[{i}].density ({item.name!r})"
            if item.density is None:
                raise SceneError(f'{where}: expected in a motion, as in "7850 kg/m^3", and missing')
            if key == "bodies" and not item.density.si:
                raise SceneError(f"{where}: expected a positive number in a motion, got {item.density}")
    if not scene.bodies and not scene.masses and not any(bar.density and bar.density.si for bar in scene.bars):
        raise SceneError("motion: expected a bar, body or point mass that has mass, got none")


def _starts_fit(scene: SceneData, unknowns: Unknowns) -> None:
    assert scene.motion is not None
    for key in ("displacements", "velocities"):
        seen: dict[str, str] = {}
        for i, item in enumerate(getattr(scene.motion, key)):
            where = f"motion.{key}[{i}]"
            _one_thing(scene, f"{where}.of", item.of, unknowns)
            expected = 1 if item.of in unknowns.names else len(scene.axes)
            for name in ("value", "to"):
                vector = getattr(item, name)
                if vector is not None and len(vector) != expected:
                    raise SceneError(f"{where}.{name} ({item.of!r}): expected {expected} components, got {len(vector)}")
            if item.to is not None and item.of not in {bar.name for bar in scene.bars}:
                raise SceneError(f"{where}.to ({item.of!r}): expected of a bar only, along which it is linear")
            for name, value in started(scene, item):
                if name in seen:
                    raise SceneError(f"{where} ({item.of!r}): expected {name!r} once, got it in {seen[name]} too")
                seen[name] = where
                if name in unknowns.fixed and value:
                    raise SceneError(f"{where} ({item.of!r}): expected 0 for {name!r}, which is fixed")


def _one_thing(scene: SceneData, where: str, name: str, unknowns: Unknowns) -> None:
    if scene.meshed:
        known = {"body": [body.name for body in scene.bodies]}
    else:
        known = {"bar": [bar.name for bar in scene.bars], "node": [*scene.every_node], "unknown": [*unknowns.names]}
    kinds = [kind for kind, names in known.items() if name in names]
    if not kinds:
        raise SceneError(
            f"{where}: {unknown(name, [n for names in known.values() for n in names], ' or '.join(known))}"
        )
    if len(kinds) > 1:
        raise SceneError(f"{where}: expected a name of one thing, got {name!r}, a {' and a '.join(kinds)}")


def motion_claim_fits(where: str, claim: Claim, scene: SceneData) -> None:
    """Raise SceneError if the claim means nothing in a motion, or, without one, needs it."""
    measure, motion = claim.measure, scene.motion
    in_time = any(any(number.dimension) for number in claim.stated)
    if motion is None:
        if measure.motion:
            raise SceneError(f"{where}.quantity: {claim.quantity!r} expects [motion], and there is none")
        if isinstance(claim.time, Quantity):
            raise SceneError(f"{where}.time: expected a time only with [motion], got {claim.time}")
        if claim.quantity == "event time" and in_time:
            raise SceneError(f"{where}: {claim.quantity!r} expects a pseudo-time, a number, without [motion]")
        return
    if measure.statics:
        raise SceneError(f"{where}.quantity: {claim.quantity!r} is asked of statics, and not in a motion")
    if claim.load_factor != 1:
        raise SceneError(f"{where}.load_factor: expected none in a motion, whose loads are constant")
    if claim.quantity == "event time" and not in_time:
        raise SceneError(f'{where}: {claim.quantity!r} expects a time such as "2 ms" in a motion, got a number')
    if claim.time is None:
        return
    if not isinstance(claim.time, Quantity):
        raise SceneError(f'{where}.time: expected a time such as "2 ms" in a motion, got {claim.time}')
    if not motion.start.si <= claim.time.si <= motion.end:
        raise SceneError(
            f"{where}.time: expected one from {float(motion.start.si):.12g} s to {float(motion.end):.12g} s, where the "
            f"motion ends, got {claim.time}"
        )
    if not measure.solved or measure.whole_way:
        raise SceneError(f"{where}.time: {claim.quantity!r} depends on no time")


# Whether a scene's load path fits its loads, and what it says of its answer the path.


def path_fits(scene: SceneData) -> None:
    """Raise SceneError at the first corner that does not fit the loads, or load that no corner names."""
    if scene.path is None:
        return
    for i, contact in enumerate(scene.contacts):
        if contact.slip_origin is not None:
            raise SceneError(
                f"contacts[{i}].slip_origin ({contact.name!r}): expected none with a load path, which finds it itself"
            )
    if scene.path.corners is None:
        return
    loads = list(load_names(scene))
    for key, name in loads:
        if name is None:
            raise SceneError(f"{key}.name: expected, since the load path has corners, and missing")
    known = {str(name): None for _, name in loads}
    for i, corner in enumerate(scene.path.corners):
        for name in corner:
            if name not in known:
                raise SceneError(f"path.corners[{i}]: {unknown(name, known, 'load')}")
    for key, name in loads:
        if not any(name in corner for corner in scene.path.corners):
            raise SceneError(
                f"path.corners: expected every load in one corner or more, and {name!r} ({key}) is in none"
            )


def time_fits(where: str, claim: Claim, scene: SceneData) -> None:
    """Raise SceneError if the claim is asked of an instant that the scene has not."""
    if scene.motion is not None:
        return
    if isinstance(claim.time, Fraction):
        if scene.path is None:
            raise SceneError(f"{where}.time: expected [path], whose pseudo-time it is, and there is none")
        if not 0 <= claim.time <= end_time(scene):
            raise SceneError(
                f"{where}.time: expected one from 0 to {end_time(scene)}, the end of the path, got {claim.time}"
            )
        if not claim.measure.solved or claim.measure.whole_way:
            raise SceneError(f"{where}.time: {claim.quantity!r} depends on no time")
    if has_corners(scene):
        if claim.load_factor != Fraction(1):
            raise SceneError(f"{where}.load_factor: expected 'time', since the load path has corners")
        if claim.quantity.startswith("closing load"):
            instead = "event time" if claim.quantity == "closing load factor" else "event load"
            raise SceneError(
                f"{where}.quantity: expected {instead!r} with event = 'closed', since the load path has corners, "
                f"got {claim.quantity!r}"
            )
    if claim.load_factor != Fraction(1) and scene.path is None and any(contact.friction for contact in scene.contacts):
        raise SceneError(
            f"{where}.load_factor: expected none with friction and no load path: the answer depends on the way to it"
        )
    if claim.quantity == "slip" and scene.path is not None:
        raise SceneError(f"{where}.quantity: 'slip' expects no [path], along which it starts anew at every step")
