"""Check that the path or motion of a scene and the claims about its answer fit the scene.

Names, quantities, instants and methods must exist.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from contactqp.errors import SceneError
from contactqp.scene.blocks import BLOCKS
from contactqp.scene.blocks.element import Measure
from contactqp.scene.claims import PARAMETERS, QUANTITIES, Claim
from contactqp.scene.fields import no_such, refuse_unknown
from contactqp.scene.schema import Unknowns, end_time, is_rotation, load_names, start_values
from contactqp.scene.units import KINDS, Quantity
from contactqp.solving.methods import Method, methods

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData


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
            refuse_unknown(f"path.corners[{i}]", name, known, "load")
    for key, name in loads:
        if not any(name in corner for corner in scene.path.corners):
            raise SceneError(
                f"path.corners: expected every load in one corner or more, and {name!r} ({key}) is in none"
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
        raise SceneError(f"path.controlled: {no_such(path.controlled, unknowns.free, 'unknown')}{fixed}")


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
    for where, element in scene.elements:
        element.check_motion(where)
    for i, body in enumerate(scene.bodies):
        where = f"bodies[{i}].density ({body.name!r})"
        if body.density is None:
            raise SceneError(f'{where}: expected in a motion, as in "7850 kg/m^3", and missing')
        if not body.density.si:
            raise SceneError(f"{where}: expected a positive number in a motion, got {body.density}")
    if not scene.bodies and not any(element.has_mass for _, element in scene.elements):
        raise SceneError("motion: expected a bar, beam, body or point mass that has mass, got none")


def _starts_fit(scene: SceneData, unknowns: Unknowns) -> None:
    assert scene.motion is not None
    for key, kinds in (("displacements", ("length", "angle")), ("velocities", ("velocity", "angular velocity"))):
        seen: dict[str, tuple[str, Fraction]] = {}
        for i, item in enumerate(getattr(scene.motion, key)):
            where = f"motion.{key}[{i}]"
            _one_thing(scene, f"{where}.of", item.of, unknowns)
            expected = 1 if item.of in unknowns.names else len(scene.axes)
            kind = KINDS[kinds[is_rotation(item.of)]]
            for name in ("value", "to"):
                vector = getattr(item, name)
                if vector is not None and len(vector) != expected:
                    raise SceneError(f"{where}.{name} ({item.of!r}): expected {expected} components, got {len(vector)}")
                if other := [component for component in vector or () if component.dimension != kind.dimension]:
                    told = f'expected {kind.article} such as "{kind.example}", got {other[0]}'
                    raise SceneError(f"{where}.{name} ({item.of!r}): {told}")
            if item.to is not None and item.of not in {one.name for one in scene.divided}:
                raise SceneError(f"{where}.to ({item.of!r}): expected of a bar or beam only, along which it is linear")
            for name, value in start_values(scene, item):
                before, stated = seen.setdefault(name, (where, value))
                if stated != value:
                    unit = scene.system.label(KINDS[kinds[0]].dimension)
                    if is_rotation(name):  # that of a beam turns with what is linear along it
                        unit = "rad" if key == "displacements" else "rad/s"
                    raise SceneError(
                        f"{where} ({item.of!r}): expected {float(stated)!r} {unit} for {name!r}, as {before} states "
                        f"it, got {float(value)!r} {unit}"
                    )
                if name in unknowns.fixed and value:
                    raise SceneError(f"{where} ({item.of!r}): expected 0 for {name!r}, which is fixed")


def _one_thing(scene: SceneData, where: str, name: str, unknowns: Unknowns) -> None:
    if scene.meshed:
        known = {"body": [body.name for body in scene.bodies]}
    else:
        bars, beams = ([one.name for one in members] for members in (scene.bars, scene.beams))
        known = {"bar": bars, "beam": beams, "node": [*scene.every_node], "unknown": [*unknowns.names]}
    kinds = [kind for kind, names in known.items() if name in names]
    if not kinds:
        raise SceneError(
            f"{where}: {no_such(name, [n for names in known.values() for n in names], ' or '.join(known))}"
        )
    if len(kinds) > 1:
        raise SceneError(f"{where}: expected a name of one thing, got {name!r}, a {' and a '.join(kinds)}")


@dataclass(frozen=True)
class _Claimable:
    """The names that the claims of a scene can refer to, collected once."""

    scene: SceneData
    kind: str  # "bodies" or "nodes"
    places: Mapping[str, tuple[str, ...]]  # the names that ``at`` and ``along`` accept
    large: bool
    control: str
    corners: bool
    path_end: Fraction
    frictional: frozenset[str | None]  # the contacts that have friction


def claims_fit(scene: SceneData, unknowns: Unknowns) -> None:
    """Raise SceneError at the first claim, study or method that does not fit the scene."""
    path = scene.path
    claimable = _Claimable(
        scene=scene,
        kind="bodies" if scene.meshed else "nodes",
        places=_places(scene, unknowns),
        large=scene.large,
        control="load" if path is None or path.control is None else path.control,
        corners=path is not None and path.corners is not None,
        path_end=end_time(scene),
        frictional=frozenset(contact.name for contact in scene.contacts if contact.friction),
    )
    known = {method.name: method for method in methods()}
    for key in ("expect", "published"):
        for i, claim in enumerate(getattr(scene, key)):
            _claim_fits(f"{key}[{i}]", claim, claimable)
            if claim.method is not None:
                _method_fits(f"{key}[{i}]", claim.method, claim.knobs, known)
    for i, study in enumerate(scene.study):
        _method_fits(f"study[{i}]", study.method, {**dict([study.knob]), **study.options}, known)
    for i, name in enumerate(scene.report.methods if scene.report else ()):
        _method_exists(f"report.methods[{i}]", name, known)


def _method_exists(key: str, name: str, known: Mapping[str, Method]) -> Method:
    if name not in known:
        raise SceneError(f"{key}: {no_such(name, known, 'method')}")
    return known[name]


def _method_fits(where: str, name: str, knobs: Mapping[str, object], known: Mapping[str, Method]) -> None:
    """Refuse an unknown method, and options that it does not have or whose values are out of range."""
    method = _method_exists(f"{where}.method", name, known)
    own = [*method.options, *(["tolerance"] if method.knob == "tolerance" else [])]
    for knob, stated in knobs.items():
        if knob not in own:
            raise SceneError(f"{where}.{knob}: {name!r} has no such knob; its own: {', '.join(own) or 'none'}")
        for value in stated if isinstance(stated, tuple) else (stated,):
            size: Any = getattr(value, "si", value)
            # Without a penalty the augmented Lagrangian is the Lagrange multiplier method.
            if not isinstance(size, str) and (size < 0 or (size == 0 and not method.exact)):
                raise SceneError(f"{where}.{knob}: expected positive values, got {float(size):g}")


def _places(scene: SceneData, unknowns: Unknowns) -> dict[str, tuple[str, ...]]:
    """Return the names that ``at`` accepts, for each kind of thing that has quantities."""

    def named(*keys: str) -> tuple[str, ...]:
        return tuple(item.name for key in keys for item in getattr(scene, key))

    inertial = [key for key, kind in BLOCKS.items() if kind.inertial]
    return {
        "unknown": unknowns.free,
        "support": named("supports") if scene.meshed else tuple(n for n in unknowns.names if n in unknowns.fixed),
        "contact": named("contacts"),
        **{kind.noun: named(key) for key, kind in BLOCKS.items()},
        "tie": named("ties"),
        "body": named("bodies", "membranes"),
        "elastic body": named("bodies"),
        "moving part": named("bodies") if scene.meshed else named(*inertial),
        "axis": scene.axes,
    }


def _claim_fits(where: str, claim: Claim, claimable: _Claimable) -> None:
    measure, scene, kind, places = claim.measure, claimable.scene, claimable.kind, claimable.places
    if measure.of not in (kind, "both"):
        own = ", ".join(repr(name) for name, other in QUANTITIES.items() if other.of in (kind, "both"))
        raise SceneError(f"{where}.quantity: {claim.quantity!r} is asked of scenes of {measure.of}; of {kind}: {own}")
    _places_fit(where, claim, measure, claimable)
    for j, name in enumerate(claim.unknowns or ()):
        if name not in places["unknown"]:
            raise SceneError(f"{where}.unknowns[{j}]: {no_such(name, places['unknown'], 'unknown')}")
    _derivative_fits(where, claim, claimable)
    _motion_fits(where, claim, measure, scene)
    _large_fits(where, claim, measure, claimable)
    if measure.path and scene.path is None and scene.motion is None:
        raise SceneError(f"{where}.quantity: {claim.quantity!r} expects [path], and there is none")
    if measure.friction and claim.at not in claimable.frictional:
        raise SceneError(f"{where}.quantity: {claim.quantity!r} expects a contact with friction, {claim.at!r} has none")
    if claim.quantity == "uniqueness" and not claimable.frictional:
        raise SceneError(f"{where}.quantity: {claim.quantity!r} expects a contact with friction, and there is none")
    if claim.load_factor != 1 and not measure.solved:
        raise SceneError(f"{where}.load_factor: {claim.quantity!r} depends on no load")
    if scene.motion is None:
        _time_fits(where, claim, measure, claimable)


def _derivative_fits(where: str, claim: Claim, claimable: _Claimable) -> None:
    """Raise SceneError if the claim asks for a derivative that the scene does not have."""
    by, needed = claim.with_respect_to, PARAMETERS.get(str(claim.with_respect_to), ((), None))[1]
    if claimable.corners and (by == "load factor" or claim.quantity == "next event load factor"):
        raise SceneError(f"{where}: expected no load factor, since the load path has corners")
    if by is None:
        return
    if claimable.kind != "nodes" or claimable.large or claimable.scene.motion is not None:
        raise SceneError(
            f"{where}.with_respect_to: expected in statics of nodes at small deformations alone, got {by!r}"
        )
    if needed is not None and claim.of not in claimable.places[needed]:
        raise SceneError(f"{where}.of: {no_such(str(claim.of), claimable.places[needed], needed)}")
    if by == "friction" and claim.of not in claimable.frictional:
        raise SceneError(f"{where}.of: expected a contact with friction, {claim.of!r} has none")


def _places_fit(where: str, claim: Claim, measure: Measure, claimable: _Claimable) -> None:
    scene, places = claimable.scene, claimable.places
    if claim.near is not None and len(claim.near) != len(scene.axes):
        raise SceneError(f"{where}.near: expected {len(scene.axes)} components, got {len(claim.near)}")
    if measure.at is not None and claim.at not in places[measure.at]:
        raise SceneError(f"{where}.at: {no_such(claim.at, places[measure.at], measure.at)}")
    if measure.read is not None:
        scene.element(str(measure.at), str(claim.at)).check_claim(f"{where}.at")
    if measure.along is not None and claim.along not in places[measure.along]:
        raise SceneError(f"{where}.along: {no_such(claim.along, places[measure.along], measure.along)}")


def _large_fits(where: str, claim: Claim, measure: Measure, claimable: _Claimable) -> None:
    """Raise SceneError if the claim means nothing at large deformations, or, without them, needs them."""
    control = claimable.control
    if not claimable.large:
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


def _motion_fits(where: str, claim: Claim, measure: Measure, scene: SceneData) -> None:
    """Raise SceneError if the claim means nothing in a motion, or, without one, needs it."""
    motion = scene.motion
    in_time = claim.quantity == "event time" and any(any(number.dimension) for number in claim.stated)
    if motion is None:
        if measure.motion:
            raise SceneError(f"{where}.quantity: {claim.quantity!r} expects [motion], and there is none")
        if isinstance(claim.time, Quantity):
            raise SceneError(f"{where}.time: expected a time only with [motion], got {claim.time}")
        if in_time:
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


def _time_fits(where: str, claim: Claim, measure: Measure, claimable: _Claimable) -> None:
    """Raise SceneError if the claim asks for an instant that the scene does not have."""
    scene = claimable.scene
    if isinstance(claim.time, Fraction):
        if scene.path is None:
            raise SceneError(f"{where}.time: expected [path], whose pseudo-time it is, and there is none")
        if not 0 <= claim.time <= claimable.path_end:
            raise SceneError(
                f"{where}.time: expected one from 0 to {claimable.path_end}, the end of the path, got {claim.time}"
            )
        if not measure.solved or measure.whole_way:
            raise SceneError(f"{where}.time: {claim.quantity!r} depends on no time")
    if claimable.corners:
        if claim.load_factor != 1:
            raise SceneError(f"{where}.load_factor: expected 'time', since the load path has corners")
        if claim.quantity.startswith("closing load"):
            instead = "event time" if claim.quantity == "closing load factor" else "event load"
            raise SceneError(
                f"{where}.quantity: expected {instead!r} with event = 'closed', since the load path has corners, "
                f"got {claim.quantity!r}"
            )
    if claim.load_factor != 1 and scene.path is None and claimable.frictional:
        raise SceneError(
            f"{where}.load_factor: expected none with friction and no load path: the answer depends on the way to it"
        )
    if claim.quantity == "slip" and scene.path is not None:
        raise SceneError(f"{where}.quantity: 'slip' expects no [path], along which it starts anew at every step")
