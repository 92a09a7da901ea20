"""Whether a scene fits large deformations: bars between nodes, obstacles, and a load path with its control."""

from __future__ import annotations

from typing import TYPE_CHECKING

from contactqp.errors import SceneError
from contactqp.scene.checking_bodies import obstacles_exist_in
from contactqp.scene.unknowns import Unknowns
from contactqp.scene.wording import unknown

if TYPE_CHECKING:
    from contactqp.scene.claims import Claim
    from contactqp.scene.schema import SceneData

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
    _contacts_fit(scene)


def _no_large_keys(scene: SceneData) -> None:
    for i, bar in enumerate(scene.bars):
        if bar.law is not None:
            raise SceneError(f"bars[{i}].law ({bar.name!r}): expected with deformation = 'large' only, got {bar.law!r}")
    if scene.path is not None and scene.path.control is not None:
        raise SceneError(f"path.control: expected with deformation = 'large' only, got {scene.path.control!r}")


def _contacts_fit(scene: SceneData) -> None:
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
