"""The string: two nodes on a straight line under a constant tension, which resists what moves them apart across it."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.elements.scalars import Number, Numbers, square_root, squared_length


def stiffness(tension: Number, start: Any, end: Any) -> Numbers:
    """Return K = (T / h) [[P, -P], [-P, P]] with P = I - d d' / h^2, d = end - start and h = |d|.

    Across the string, on the deflections (w_start, w_end), that is (T / h) [[1, -1], [-1, 1]]: the energy is the
    integral of T/2 w'^2. Along the string nothing resists. Small slopes; the tension does not change.

    Parameters
    ----------
    tension : Fraction or float
        T [force], positive.
    start, end : (dimension,) arrays
        The two nodes [length], apart from each other, in two dimensions or three.

    Returns
    -------
    (2 dimension, 2 dimension) array [force / length] on (u_start, u_end). Exact where all data are and h is rational.

    Notes
    -----
    Course chapter, Example 2.22: -T w'' + b = 0 for a load b per length that acts down.

    >>> stiffness(1.0, [0.0, 0.0], [0.25, 0.0])[1::2, 1::2].tolist()
    [[4.0, -4.0], [-4.0, 4.0]]
    """
    d = np.asarray(end) - np.asarray(start)
    square = squared_length(d)
    across: Numbers = np.eye(len(d), dtype=int) - np.outer(d, d) / square
    block = (tension / square_root(square)) * across
    return np.block([[block, -block], [-block, block]])


def uniform_load(per_length: Any, start: Any, end: Any) -> Numbers:
    """Return f = (h / 2) (b, b): the consistent load of a constant b on shape functions that are linear.

    Parameters
    ----------
    per_length : (dimension,) array
        b [force / length], per length of the string.
    start, end : (dimension,) arrays
        The two nodes [length].

    Returns
    -------
    (2 dimension,) array [force] on (u_start, u_end).

    >>> uniform_load([0.0, -3.0], [0.0, 0.0], [2.0, 0.0]).tolist()
    [0.0, -3.0, 0.0, -3.0]
    """
    half = square_root(squared_length(np.asarray(end) - np.asarray(start))) / 2
    return np.tile(half * np.asarray(per_length), 2)
