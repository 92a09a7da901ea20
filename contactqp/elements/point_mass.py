"""The point mass: a body of no extent; in statics it is its weight, in dynamics an inertia too."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.elements.scalars import Number, Numbers


def weight(mass: Number, gravity: Any) -> Numbers:
    """Return f = m g, (dimension,) [force]; `gravity` is the vector of acceleration, downwards where it points down.

    >>> weight(2.0, [0.0, -9.81]).tolist()
    [0.0, -19.62]
    """
    f: Numbers = mass * np.asarray(gravity)
    return f


def inertia(mass: Number, dimension: int) -> Numbers:
    """Return M = m I, (dimension, dimension) [mass]."""
    M: Numbers = mass * np.eye(dimension, dtype=int)
    return M
