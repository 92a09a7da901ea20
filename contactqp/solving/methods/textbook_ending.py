"""How the textbook's loops end: when they have taken all that they may, and with what candidate."""

from __future__ import annotations

import time
from collections.abc import Sequence

from contactqp.model.solution import Candidate
from contactqp.solving.methods.criss_cross import Step
from contactqp.solving.methods.method import Settings
from contactqp.solving.methods.stick_and_slip import FrictionalStep


class Budget:
    """The iterations and seconds that a loop may take, which begins now: the settings', or `most` iterations."""

    def __init__(self, settings: Settings, most: int) -> None:
        self._most, self._seconds = settings.max_iter or most, settings.time_limit
        self._started = time.perf_counter()

    def spent(self, iterations: int) -> str:
        """Why a loop ends after so many iterations, or nothing."""
        if iterations >= self._most:
            return f"stopped after {self._most} iterations"
        if self._seconds is not None and time.perf_counter() - self._started > self._seconds:
            return f"stopped after {self._seconds:g} s"
        return ""


def last_candidate(
    name: str, step: Step | FrictionalStep, reason: str, history: Sequence[float], together: int | None
) -> Candidate:
    """The last step of a loop that ended for a reason, claimed where it left nothing wrong.

    `together` is how many iterations changed all wrong contacts at once, None if all did.
    """
    one_by_one = "" if together is None else f" (one contact at a time after {together} iterations)"
    return Candidate(
        step.displacement,
        step.normal_force,
        step.tie_force,
        iterations=len(history),
        claimed=history[-1] == 0,
        status=f"{name}: {reason}{one_by_one}",
        history=tuple(history),
    )
