"""How many times larger than they are displacements are drawn."""

from __future__ import annotations

import math

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array

# The largest displacement is drawn as at most this part of the picture's size...
LARGEST = 0.06
# ... and at least this part counts as visible without magnification.
VISIBLE = 0.02
# A gap that goes from g_0 to g is drawn as g_0 + scale (g - g_0), which magnified is an overlap for contacts that have
# closed: of at most this part of the picture's size.
OVERLAP = 0.01


def magnification(scale: float | None, size: float, displacement: Array, initial_gap: Array, gap: Array) -> float:
    """The stated scale, or 1, 2 or 5 times a power of ten that makes the displacements visible.

    Parameters
    ----------
    scale : float or None
        As stated by the user; None to choose one.
    size : float
        Of the undeformed bodies, the largest side of the box around them [length].
    displacement : (N, d) array [length]
    initial_gap, gap : (m,) arrays
        Of all contacts, before and under the load [length].

    Raises
    ------
    InvalidProblem
        A scale that is not finite or not positive.

    >>> magnification(None, 100.0, np.array([[0.0, -0.01]]), np.zeros(1), np.zeros(1))
    500.0
    >>> magnification(None, 100.0, np.array([[0.0, -0.01]]), np.array([0.01]), np.zeros(1))
    100.0
    >>> magnification(None, 100.0, np.array([[0.0, -3.0]]), np.zeros(1), np.zeros(1))
    1.0
    """
    if scale is not None:
        if not (math.isfinite(scale) and scale > 0):
            raise InvalidProblem(f"scale: expected a positive number, got {scale}")
        return float(scale)
    largest = float(np.linalg.norm(displacement, axis=1).max(initial=0.0))
    if largest >= VISIBLE * size or largest == 0:
        return 1.0
    closing = initial_gap - gap
    closes = closing > 0
    allowed = (np.maximum(initial_gap, 0.0) + OVERLAP * size)[closes] / closing[closes]
    return max(1.0, _rounded_down(min([LARGEST * size / largest, *allowed])))


def _rounded_down(value: float) -> float:
    """1, 2 or 5 times a power of ten, not above the value but for rounding."""
    power = 10.0 ** math.floor(math.log10(value * (1 + 1e-12)))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-12)))


def scale_text(scale: float) -> str:
    """What the title says of it.

    >>> scale_text(500.0), scale_text(1.0)
    ('displacements magnified 500 times', 'displacements true to scale')
    """
    return "displacements true to scale" if scale == 1 else f"displacements magnified {scale:g} times"
