"""Where on the load path of its scene an answer stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from contactqp.analysis.history import Energies, Event, History
from contactqp.errors import SceneError
from contactqp.scene.claims import Claim


@dataclass(frozen=True, eq=False)
class Instant:
    """A pseudo-time; without a path, the factor on all loads. `step` is its place in the history, if it is in it."""

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

    def event(self, claim: Claim, contact: int) -> Event:
        """The event that the claim speaks of.

        Raises
        ------
        SceneError
            The path has fewer.
        """
        found = [event for event in self.events if event.kind == claim.event and event.contact == contact]
        if len(found) < claim.occurrence:
            what = {"closed": "close", "opened": "open", "stick": "stick", "slip": "slip"}[str(claim.event)]
            times = "" if claim.occurrence == 1 else f" {claim.occurrence} times"
            seen = ", ".join(f"{e.kind} at {e.time:.6g}" for e in self.events if e.contact == contact) or "none"
            raise SceneError(
                f"{claim}: expected contact {claim.at!r} to {what}{times} on the load path; its events: {seen}"
            )
        return found[claim.occurrence - 1]
