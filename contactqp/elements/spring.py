"""Springs between two nodes or from a node to the ground, and point masses: a weight, in dynamics an inertia too."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.elements.scalars import Number, Numbers, square_root, squared_length, unit_vector


def stiffness(constant: Number, direction: Any) -> Numbers:
    """Return K = k [[n n', -n n'], [-n n', n n']] between two nodes, n = direction / |direction|.

    Parameters
    ----------
    constant : Fraction or float
        k [force / length], positive.
    direction : (dimension,) array
        Of any length.

    Returns
    -------
    (2 dimension, 2 dimension) array [force / length], exact where all data are (n n' is rational even where n is not).

    >>> stiffness(3.0, [2.0]).tolist()
    [[3.0, -3.0], [-3.0, 3.0]]
    """
    block = to_ground(constant, direction)
    return np.block([[block, -block], [-block, block]])


def to_ground(constant: Number, direction: Any) -> Numbers:
    """Return K = k n n' of a spring between a node and the ground, (dimension, dimension) [force / length]."""
    d = np.asarray(direction)
    unit_vector(d, "spring direction")
    block: Numbers = constant / squared_length(d) * np.outer(d, d)
    return block


def force(constant: Number, direction: Any, relative: Any) -> Number:
    """Return k n.(u_end - u_start), positive in tension [force]; `relative` is u_end - u_start, (dimension,)."""
    d = np.asarray(direction)
    value: Number = constant * np.dot(d, np.asarray(relative)) / square_root(squared_length(d))
    return value


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
