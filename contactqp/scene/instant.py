"""Where on the load path or in the motion of its scene an answer stands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.history import Energies, Event, History
from contactqp.analysis.motion.history import is_motion
from contactqp.errors import SceneError
from contactqp.scene.claims import Claim

if TYPE_CHECKING:
    from contactqp.analysis.motion.history import MotionHistory


@dataclass(frozen=True, eq=False)
class Instant:
    """A pseudo-time; without a path, the factor on all loads. `step` is its place in the history, if it is in it.

    In a motion, whose loads are constant, `time` is 1, and `step` says when.
    """

    time: Fraction = Fraction(1)
    history: History | None = None
    step: int | None = None

    @property
    def events(self) -> Sequence[Event]:
        """All changes of contact along the path."""
        return () if self.history is None else self.history.events

    def energies(self, claim: Claim) -> Energies:
        """Since the path set out.

        Raises
        ------
        SceneError
            The path has no step here.
        """
        if self.history is None or self.step is None:
            raise SceneError(f"{claim}: expected a step of the load path")
        return self.history.energies[self.step]

    def event(self, claim: Claim, contacts: Sequence[int]) -> Event:
        """The event that the claim speaks of, of the problem's contacts that are one contact of the scene.

        Raises
        ------
        SceneError
            The path or motion has fewer; several contacts of a side slip or stick one by one.
        """
        if len(contacts) > 1 and claim.event in ("stick", "slip"):
            raise SceneError(f"{claim}: expected 'closed' or 'opened': the nodes of a side slip and stick one by one")
        known = list(_of_group(self.events, contacts)) if len(contacts) > 1 else self._of_one(contacts)
        found = [event for event in known if event.kind == claim.event]
        number = abs(claim.occurrence)
        if len(found) < number:
            what = {"closed": "close", "opened": "open", "stick": "stick", "slip": "slip"}[str(claim.event)]
            times = "" if number == 1 else f" {number} times"
            way = "in the motion" if is_motion(self.history) else "on the load path"
            seen = ", ".join(f"{e.kind} at {e.time:.6g}" for e in known) or "none"
            raise SceneError(f"{claim}: expected contact {claim.at!r} to {what}{times} {way}; its events: {seen}")
        return found[claim.occurrence - (claim.occurrence > 0)]

    def _of_one(self, contacts: Sequence[int]) -> list[Event]:
        return [event for event in self.events if event.contact in contacts]

    def impulses(self) -> NDArray[np.float64]:
        """(m,) what each normal force has given since the motion set out [force time]."""
        motion = self.motion
        force, weight = motion.normal_forces[: (self.step or 0) + 1], motion.motion.scheme.contact_weight()
        acting = weight * force[1:] + (1 - weight) * force[:-1]
        return np.asarray(motion.motion.scheme.body.step * acting.sum(axis=0))

    @property
    def motion(self) -> MotionHistory:
        history = self.history
        assert is_motion(history)  # claims of motions are asked in motions only
        return history

    @property
    def velocity(self) -> Any:
        """(n,) of the free unknowns [length / time]."""
        return self.motion.motion.states[self.step or 0].velocity


def _of_group(events: Sequence[Event], contacts: Sequence[int]) -> Iterator[Event]:
    """When the first of several contacts closes and the last opens."""
    members, closed = set(map(int, contacts)), set[int]()
    for time, together in groupby(events, lambda event: event.time):
        was = bool(closed)
        for event in together:
            if event.contact in members and event.kind in ("closed", "opened"):
                (closed.add if event.kind == "closed" else closed.discard)(event.contact)
        if bool(closed) != was:
            yield Event("closed" if closed else "opened", contacts[0], time)
