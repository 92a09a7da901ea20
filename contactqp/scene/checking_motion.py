"""Whether a scene's motion fits its parts: what has mass, and what starts with which displacement and velocity."""

from __future__ import annotations

from typing import TYPE_CHECKING

from contactqp.errors import SceneError
from contactqp.scene.starts import started
from contactqp.scene.units import Quantity
from contactqp.scene.unknowns import Unknowns
from contactqp.scene.wording import unknown

if TYPE_CHECKING:
    from contactqp.scene.claims import Claim
    from contactqp.scene.schema import SceneData


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
