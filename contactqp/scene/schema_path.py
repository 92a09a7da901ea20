"""The keys of a load path."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from contactqp.scene.fields import Block, Name, Number

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
    """

    steps: Annotated[int, Field(strict=True, ge=1, le=1_000_000)] | None = None
    events: Literal["exact"] | None = None
    corners: Annotated[tuple[Corner, ...], Field(min_length=1, max_length=1000)] | None = None
