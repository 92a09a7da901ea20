"""The plane Euler-Bernoulli beam: two nodes with two displacements and a rotation each."""

from __future__ import annotations

import numpy as np

from contactqp.elements.scalars import Number, Numbers, square_root, squared_length


def stiffness(modulus: Number, area: Number, inertia: Number, start: Numbers, end: Numbers) -> Numbers:
    """Return K = R' K_local R of cubic bending and linear stretching.

        K_local = [[ a,    0,    0, -a,    0,    0],        a = E A / L
                   [ 0,  12b,  6bL,  0, -12b,  6bL],        b = E I / L^3
                   [ 0,  6bL, 4bL2,  0, -6bL, 2bL2],
                   [-a,    0,    0,  a,    0,    0],
                   [ 0, -12b, -6bL,  0,  12b, -6bL],
                   [ 0,  6bL, 2bL2,  0, -6bL, 4bL2]]

    Parameters
    ----------
    modulus, area, inertia : Fraction or float
        E [force / length^2], A [length^2], I, the second moment of area [length^4], positive.
    start, end : (2,) arrays
        The two nodes [length], apart from each other.

    Returns
    -------
    (6, 6) array on (u_x, u_y, theta) of start and end; theta turns the first axis towards the second
    (counter-clockwise). Entries in [force / length], [force], [force length]. Exact where all data are and L is
    rational.

    >>> K = stiffness(1.0, 1.0, 2.0, np.array([0.0, 0.0]), np.array([0.0, 2.0]))
    >>> float(K[3, 3]), float(K[4, 4]), float(K[5, 5])  # a cantilever along the second axis
    (3.0, 0.5, 4.0)
    """
    d = np.asarray(end) - np.asarray(start)
    length = square_root(squared_length(d))
    rotation = _rotation(d, length)
    local = _local(modulus * area / length, modulus * inertia / squared_length(d) / length, length)
    K: Numbers = rotation.T @ local @ rotation
    return K


def displacements(start: Numbers, end: Numbers, ends: Numbers, at: Numbers) -> Numbers:
    """Return the (k, 2) displacements along the axis of an unloaded beam, from those of its ends.

    Linear along the beam; across it the cubic that has the deflections and slopes of the ends,

        v = (1 - 3s^2 + 2s^3) v_1 + L (s - 2s^2 + s^3) theta_1 + (3s^2 - 2s^3) v_2 + L (s^3 - s^2) theta_2.

    Parameters
    ----------
    start, end : (2,) arrays
        The two nodes [length].
    ends : (6,) array
        (u_x, u_y, theta) of start and end [length, length, 1].
    at : (k,) array
        s: 0 at the start, 1 at the end [-].

    >>> v = displacements([0.0, 0.0], [2.0, 0.0], np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.75]), np.array([0.5]))
    >>> v.tolist()  # a cantilever under a force at its tip: s^2 (3 - s) / 2
    [[0.0, 0.3125]]
    """
    d = np.asarray(end) - np.asarray(start)
    length = square_root(squared_length(d))
    u_1, v_1, theta_1, u_2, v_2, theta_2 = _rotation(d, length) @ np.asarray(ends)
    s = np.asarray(at)
    u = (1 - s) * u_1 + s * u_2
    v = (1 - 3 * s**2 + 2 * s**3) * v_1 + (3 * s**2 - 2 * s**3) * v_2
    v = v + length * ((s - 2 * s**2 + s**3) * theta_1 + (s**3 - s**2) * theta_2)
    across = np.array([-d[1], d[0]]) / length
    moved: Numbers = np.outer(u, d / length) + np.outer(v, across)
    return moved


def _local(a: Number, b: Number, length: Number) -> Numbers:
    s, r, q = 12 * b, 6 * b * length, 2 * b * length * length
    return np.array(
        [
            [a, 0, 0, -a, 0, 0],
            [0, s, r, 0, -s, r],
            [0, r, 2 * q, 0, -r, q],
            [-a, 0, 0, a, 0, 0],
            [0, -s, -r, 0, s, -r],
            [0, r, q, 0, -r, 2 * q],
        ]
    )


def _rotation(d: Numbers, length: Number) -> Numbers:
    """Return the rotation from global to local unknowns: [[c, s, 0], [-s, c, 0], [0, 0, 1]] for each node."""
    c, s = d[0] / length, d[1] / length
    block = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return np.kron(np.eye(2, dtype=int), block)
