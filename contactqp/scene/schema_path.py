"""The keys of a load path."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from contactqp.scene import fields
from contactqp.scene.fields import Block, Name, Number

# How the points of a path at large deformations are picked, and the keys that each way has of its own.
CONTROLS: dict[str, tuple[str, ...]] = {
    "load": (),
    "displacement": ("controlled", "target"),
    "arc-length": ("arc_length",),
}

# What loads are multiplied by, by their names.
Corner = dict[Name, Number]


class LoadPath(Block):
    """How the loads come: all together from nothing to their values, or from corner to corner.

    A corner says what the loads are multiplied by there; a load that it does not name is zero there. Loads are called
    by their `name`, those of one name together, and ``gravity`` is what masses and bodies weigh::

        corners = [{ gravity = 1 }, { gravity = 1, push = 1 }, { gravity = 1, push = -0.5 }]

    In between each factor is linear in the pseudo-time, which is 0 where nothing is loaded, 1 at the first corner, 2 at
    the second. Each way from corner to corner has `steps` equal steps. With ``events = "exact"`` every change of
    contact is found exactly, in steps between its events and the corners, and `steps` are only for drawing curves.

    With ``deformation = "large"`` there are 10 `steps` if none are stated, and `control` says how they are taken. By
    ``"load"``, the default, the load factor grows. By ``"displacement"`` the unknown `controlled` goes to `target` in
    equal steps, and by ``"arc-length"`` each step is `arc_length` long; then the load factor follows, and the path goes
    through limit points.
    """

    steps: Annotated[int, Field(strict=True, ge=1, le=1_000_000)] | None = None
    events: Literal["exact"] | None = None
    corners: Annotated[tuple[Corner, ...], Field(min_length=1, max_length=1000)] | None = None
    control: Literal["load", "displacement", "arc-length"] | None = None
    controlled: Name | None = None
    target: fields.Length | None = None
    arc_length: fields.PositiveLength | None = None

    @model_validator(mode="after")
    def _own_keys(self) -> Self:
        control = self.control or "load"
        for owner, keys in CONTROLS.items():
            for key in keys:
                if owner != control and getattr(self, key) is not None:
                    raise ValueError(f"{key}: expected with control = {owner!r} only, got it with {control!r}")
        for key in CONTROLS["displacement"] if control == "displacement" else ():
            if getattr(self, key) is None:
                raise ValueError(f"{key}: expected with control = 'displacement', and missing")
        return self
