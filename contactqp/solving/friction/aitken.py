"""Aitken's relaxation of a fixed point of friction bounds, b <- b + w (F(b) - b)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from contactqp.model.arrays import Vector

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
