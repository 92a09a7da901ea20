"""The bar: two nodes on one line, one axial displacement each."""

from __future__ import annotations

import numpy as np

from contactqp.elements.scalars import Number, Numbers


def stiffness(modulus: Number, area: Number, length: Number) -> Numbers:
    """Return K = (E A / L) [[1, -1], [-1, 1]] on the axial displacements (u_1, u_2) [force / length].

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
    """Return N = (E A / L) elongation, positive in tension [force].

    Parameters
    ----------
    modulus, area, length : Fraction or float
        E [force / length^2], A [length^2], L [length], all positive.
    elongation : Fraction or float
        u_2 - u_1 [length].
    """
    return modulus * area / length * elongation
