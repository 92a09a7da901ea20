"""The truss bar: an axial bar in two or three dimensions."""

from __future__ import annotations

import numpy as np

from contactqp.elements import bar
from contactqp.elements.scalars import Number, Numbers, square_root, squared_length


def stiffness(modulus: Number, area: Number, start: Numbers, end: Numbers) -> Numbers:
    """Return K = (E A / L^3) [[d d', -d d'], [-d d', d d']] with d = end - start and L = |d|.

    Parameters
    ----------
    modulus, area : Fraction or float
        E [force / length^2] and A [length^2], positive.
    start, end : (dimension,) arrays
        The two nodes [length], apart from each other.

    Returns
    -------
    (2 dimension, 2 dimension) array [force / length] on (u_start, u_end). Exact where all data are and L is rational.

    Notes
    -----
    Course chapter, Example 2.10. L^2 is kept exact, so an irrational length is rounded once.

    >>> from fractions import Fraction
    >>> K = stiffness(Fraction(315000), Fraction(1), np.array([Fraction(0)] * 2), np.array([Fraction(-3), Fraction(4)]))
    >>> K[0, 0], K[0, 1]
    (Fraction(22680, 1), Fraction(-30240, 1))
    """
    d = np.asarray(end) - np.asarray(start)
    square = squared_length(d)
    block = modulus * area / square / square_root(square) * np.outer(d, d)
    return np.block([[block, -block], [-block, block]])


def axial_force(modulus: Number, area: Number, start: Numbers, end: Numbers, displacement: Numbers) -> Number:
    """Return N = (E A / L^2) d.(u_end - u_start), positive in tension [force]; `displacement` is (u_start, u_end).

    Parameters
    ----------
    modulus, area : Fraction or float
        E [force / length^2] and A [length^2], positive.
    start, end : (dimension,) arrays
        The two nodes [length], apart from each other.
    displacement : (2 dimension,) array
        (u_start, u_end) [length].
    """
    d = np.asarray(end) - np.asarray(start)
    square = squared_length(d)
    stretch = np.dot(d, displacement[len(d) :] - displacement[: len(d)])
    return bar.axial_force(modulus, area, square, stretch)
