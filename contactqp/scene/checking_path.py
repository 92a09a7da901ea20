"""Whether a scene's load path fits its loads, and what it says of its answer the path."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from contactqp.errors import SceneError
from contactqp.scene.claims import Claim
from contactqp.scene.corners import end_time, has_corners, load_names
from contactqp.scene.wording import unknown

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
