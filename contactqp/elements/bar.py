"""Bars: two nodes on one line with one axial displacement each, and the truss bar in two or three dimensions."""

from __future__ import annotations

import numpy as np

from contactqp.elements.exact import Number, Numbers, square_root, squared_length


def stiffness(modulus: Number, area: Number, length: Number) -> Numbers:
    """K = (E A / L) [[1, -1], [-1, 1]] on the axial displacements (u_1, u_2).

    Parameters
    ----------
    modulus, area, length : Fraction or float
        E [force / length^2], A [length^2], L [length], all positive.

    Returns
    -------
    (2, 2) array [force / length], of Fractions where all three are.

    Notes
    -----
    Course chapter, Example 2.5 (a): a bar held at one end has the stiffness E A / L.

    >>> float(stiffness(2.1e8, 15e-4, 2.0)[0, 0])
    157500.0
    """
    return modulus * area / length * np.array([[1, -1], [-1, 1]])


def axial_force(modulus: Number, area: Number, length: Number, elongation: Number) -> Number:
    """N = (E A / L) elongation, positive in tension [force]."""
    return modulus * area / length * elongation


def truss_stiffness(modulus: Number, area: Number, start: Numbers, end: Numbers) -> Numbers:
    """K = (E A / L^3) [[d d', -d d'], [-d d', d d']] with d = end - start and L = |d|.

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
    >>> end = np.array([Fraction(-3), Fraction(4)])
    >>> K = truss_stiffness(Fraction(315000), Fraction(1), np.array([Fraction(0)] * 2), end)
    >>> K[0, 0], K[0, 1]
    (Fraction(22680, 1), Fraction(-30240, 1))
    """
    d = np.asarray(end) - np.asarray(start)
    square = squared_length(d)
    block = modulus * area / square / square_root(square) * np.outer(d, d)
    return np.block([[block, -block], [-block, block]])


def truss_axial_force(modulus: Number, area: Number, start: Numbers, end: Numbers, displacement: Numbers) -> Number:
    """N = (E A / L^2) d.(u_end - u_start), positive in tension [force]; `displacement` is (u_start, u_end)."""
    d = np.asarray(end) - np.asarray(start)
    square = squared_length(d)
    stretch = np.dot(d, displacement[len(d) :] - displacement[: len(d)])
    return axial_force(modulus, area, square, stretch)
