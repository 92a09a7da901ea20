"""Where the slips of a load step are counted from, when contacts slide far and close on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactqp.analysis.large.constrained_newton import Balance
from contactqp.analysis.large.loaded_body import LoadedBody
from contactqp.elements.deformable import ContactGeometry, ContactState
from contactqp.errors import NotConverged
from contactqp.model.arrays import Array, Vector


@dataclass(frozen=True, eq=False)
class HeldOpen:
    """Contacts some of which are too far away to close."""

    geometry: ContactGeometry
    offset: Vector  # (m,) added to the gaps [length]

    @property
    def contacts(self) -> int:
        """m."""
        return self.geometry.contacts

    def state(self, displacement: Vector) -> ContactState:
        """With wider gaps."""
        state = self.geometry.state(displacement)
        return replace(state, gap=state.gap + self.offset)

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Of the geometry."""
        return self.geometry.curvature(displacement, normal_force)

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Of the geometry."""
        return self.geometry.slip_since(displacement, anchor)

    def positions(self, displacement: Vector) -> Vector:
        """Of the geometry."""
        return self.geometry.positions(displacement)


def balance_with_anchors(
    loaded: LoadedBody,
    position: Array,
    gap: Vector,
    touching: Any,
    solve_with: Callable[[LoadedBody, Array], Balance],
) -> tuple[Balance, Array]:
    """The balance at the end of a step, and the anchors (m, d) of its slips.

    A contact that touched is anchored where it was. One that closes is anchored where it would have met the obstacle
    had it gone on without it: at the fraction of the step at which the gap of that motion vanishes.

    Parameters
    ----------
    position, gap, touching : (m, d), (m,), (m,)
        At the start of the step.
    solve_with : function
        The balance of a body whose slips start at anchors.
    """
    found = solve_with(loaded, position)
    closes = (found.forces.normal > 0) & ~touching
    if not np.any(closes) or loaded.contact is None:
        return found, position
    anchor = position.copy()
    far = np.where(closes, 1e3 * (abs(gap) + float(np.max(abs(gap)))), 0.0)
    free = LoadedBody(loaded.body, HeldOpen(loaded.contact, far), loaded.tie, loaded.friction)
    try:
        beyond = solve_with(free, position)
        end, reached = loaded.contact.positions(beyond.now.displacement), beyond.now.contact.gap - far
    except NotConverged:  # without the contact nothing holds the body: where it lands is all that is known
        end, reached = loaded.contact.positions(found.now.displacement), found.now.contact.gap
    fraction = np.clip(gap / np.maximum(gap - reached, np.finfo(float).tiny), 0.0, 1.0)
    anchor[closes] += (fraction[:, None] * (end - position))[closes]
    return solve_with(loaded, anchor), anchor
