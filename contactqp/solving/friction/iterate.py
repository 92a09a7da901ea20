"""The iterates that algorithms of the local form hand to each other, and Aitken's relaxation of a fixed point."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from contactqp.errors import NotConverged
from contactqp.linalg.runtime import seconds_left, stated_limit
from contactqp.model.arrays import Array, Vector
from contactqp.solving.friction.local_form import LocalForm


@dataclass(frozen=True, eq=False)
class Iterate:
    """Forces on the way, scaled as their `LocalForm`."""

    force: Array  # (m, d)
    joint_force: Vector  # (p,)
    error: float  # of the natural map, `LocalForm.error`
    iterations: int = 0
    history: tuple[float, ...] = ()

    @classmethod
    def at(cls, form: LocalForm, force: Array, joint: Vector, iterations: int = 0) -> Iterate:
        """Return an iterate with its error."""
        return cls(force, joint, form.error(force, joint), iterations)

    @classmethod
    def nothing(cls, form: LocalForm) -> Iterate:
        """No force anywhere, bodies at rest or, where that is better, where joints have them."""
        none = np.zeros((form.m, form.d))
        starts = (cls.at(form, none, joint) for joint in (np.zeros(form.joints), form.joint_force(none)))
        return min(starts, key=lambda one: one.error)


class Deadline:
    """A limit in seconds, if any, counted from when it is made, and never later than the end of the call."""

    def __init__(self, limit: float | None) -> None:
        left = seconds_left()
        limit = left if limit is None or (left is not None and left < limit) else limit
        self._end = np.inf if limit is None else time.perf_counter() + limit
        self._limit = limit

    @property
    def left(self) -> float | None:
        """Seconds, None without a limit."""
        return None if self._limit is None else max(self._end - time.perf_counter(), 0.0)

    @property
    def passed(self) -> bool:
        return time.perf_counter() > self._end

    def refuse_if_passed(self, who: str) -> None:
        if self.passed:
            raise NotConverged(f"{who}: stopped at the time limit of {stated_limit(self._limit)}")


# What has been tried from an iterate is tried again from one whose error is this part of it.
NEARER = 0.5
# The factor stays between these: a full step, and one small enough for mu = 20 mu_c.
RELAXATION = (0.05, 1.0)


def aitken(
    relaxation: float, before: Vector | None, missing: Vector, dot: Callable[[Vector, Vector], float] = np.dot
) -> float:
    """The next factor (Irons and Tuck 1969), from F(b) - b of the step before, None at first, and of this one."""
    if before is None:
        return relaxation
    change = missing - before
    size = float(dot(change, change))
    wanted = relaxation if size == 0 else -relaxation * float(dot(before, change)) / size
    return float(np.clip(wanted, *RELAXATION))
