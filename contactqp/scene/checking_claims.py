"""Whether what a case says of its answer fits the scene: names, quantities and methods that exist."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from contactqp.errors import SceneError
from contactqp.scene.checking_bodies import large_claim_fits, motion_claim_fits, time_fits
from contactqp.scene.claims import QUANTITIES, Claim
from contactqp.scene.fields import unknown
from contactqp.scene.unknowns import Unknowns
from contactqp.solving.methods import Method, methods

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData


def claims_fit(scene: SceneData, unknowns: Unknowns) -> None:
    """Raise SceneError at the first claim, study or method that does not fit the scene."""
    places = _places(scene, unknowns)
    for key in ("expect", "published"):
        for i, claim in enumerate(getattr(scene, key)):
            _claim_fits(f"{key}[{i}]", claim, scene, places)
            if claim.method is not None:
                _method_fits(f"{key}[{i}]", claim.method, claim.knobs)
    for i, study in enumerate(scene.study):
        _method_fits(f"study[{i}]", study.method, {**dict([study.knob]), **study.options})
    for i, name in enumerate(scene.report.methods if scene.report else ()):
        _method_exists(f"report.methods[{i}]", name)


def _method_exists(key: str, name: str) -> Method:
    known = {method.name: method for method in methods()}
    if name not in known:
        raise SceneError(f"{key}: {unknown(name, known, 'method')}")
    return known[name]


def _method_fits(where: str, name: str, knobs: Mapping[str, object]) -> None:
    """The method exists, and its knobs are its own, of values that it can have."""
    method = _method_exists(f"{where}.method", name)
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
    """What ``at`` can name, for each thing a quantity can be asked of."""
    named: Callable[[str], tuple[str, ...]] = lambda key: tuple(item.name for item in getattr(scene, key))  # noqa: E731
    return {
        "unknown": unknowns.free,
        "support": named("supports") if scene.meshed else tuple(n for n in unknowns.names if n in unknowns.fixed),
        "contact": named("contacts"),
        "bar": named("bars"),
        "spring": named("springs"),
        "tie": named("ties"),
        "body": tuple(item.name for item in scene.meshed),
        "elastic body": named("bodies"),
        "moving part": named("bodies") if scene.meshed else (*named("bars"), *named("masses")),
        "axis": scene.axes,
    }


def _claim_fits(where: str, claim: Claim, scene: SceneData, places: dict[str, tuple[str, ...]]) -> None:
    measure, kind = claim.measure, "bodies" if scene.meshed else "nodes"
    if measure.of not in (kind, "both"):
        own = ", ".join(repr(name) for name, other in QUANTITIES.items() if other.of in (kind, "both"))
        raise SceneError(f"{where}.quantity: {claim.quantity!r} is asked of scenes of {measure.of}; of {kind}: {own}")
    if claim.near is not None and len(claim.near) != len(scene.axes):
        raise SceneError(f"{where}.near: expected {len(scene.axes)} components, got {len(claim.near)}")
    if measure.at is not None and claim.at not in places[measure.at]:
        raise SceneError(f"{where}.at: {unknown(claim.at, places[measure.at], measure.at)}")
    if measure.at == "bar" and any(bar.divisions > 1 for bar in scene.bars if bar.name == claim.at):
        raise SceneError(f"{where}.at: expected a bar in one piece, got {claim.at!r}, each part of which has its own")
    if measure.along is not None and claim.along not in places[measure.along]:
        raise SceneError(f"{where}.along: {unknown(claim.along, places[measure.along], measure.along)}")
    for j, name in enumerate(claim.unknowns or ()):
        if name not in places["unknown"]:
            raise SceneError(f"{where}.unknowns[{j}]: {unknown(name, places['unknown'], 'unknown')}")
    motion_claim_fits(where, claim, scene)
    large_claim_fits(where, claim, scene)
    if measure.path and scene.path is None and scene.motion is None:
        raise SceneError(f"{where}.quantity: {claim.quantity!r} expects [path], and there is none")
    if measure.friction and not any(c.friction for c in scene.contacts if c.name == claim.at):
        raise SceneError(f"{where}.quantity: {claim.quantity!r} expects a contact with friction, {claim.at!r} has none")
    if claim.quantity == "uniqueness" and not any(c.friction for c in scene.contacts):
        raise SceneError(f"{where}.quantity: {claim.quantity!r} expects a contact with friction, and there is none")
    if claim.load_factor != Fraction(1) and not measure.solved:
        raise SceneError(f"{where}.load_factor: {claim.quantity!r} depends on no load")
    time_fits(where, claim, scene)
