"""Members between two nodes and point masses: bars of trusses, springs, strings and plane beams.

Stiffness matrices act on the displacements of both nodes, those of the first before those of the second. They are
exact, in Fractions, where all data and the length of the member are rational.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.elements.scalars import Number, Numbers, square_root, squared_length, unit_vector


def truss_stiffness(modulus: Number, area: Number, start: Numbers, end: Numbers) -> Numbers:
    """Return K = (E A / L^3) [[d d', -d d'], [-d d', d d']] with d = end - start and L = |d|.

    Parameters
    ----------
    modulus, area : Fraction or float, E [force / length^2] and A [length^2], positive
    start, end : (dimension,) arrays, the two nodes [length], apart from each other

    Returns
    -------
    (2 dimension, 2 dimension) array [force / length] on (u_start, u_end). Exact where all data are and L is rational.

    Notes
    -----
    Course chapter, Examples 2.5 (a) and 2.10. L^2 is kept exact, so an irrational length is rounded once.

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
    """Return N = (E A / L^2) d.(u_end - u_start), positive in tension [force]; `displacement` is (u_start, u_end).

    Parameters
    ----------
    modulus, area : Fraction or float, E [force / length^2] and A [length^2], positive
    start, end : (dimension,) arrays, the two nodes [length], apart from each other
    displacement : (2 dimension,) array, (u_start, u_end) [length]
    """
    d = np.asarray(end) - np.asarray(start)
    square = squared_length(d)
    stretch = np.dot(d, displacement[len(d) :] - displacement[: len(d)])
    force: Number = modulus * area / square * stretch
    return force


def spring_stiffness(constant: Number, direction: Any) -> Numbers:
    """Return K = k [[n n', -n n'], [-n n', n n']] between two nodes, n = direction / |direction|.

    Parameters
    ----------
    constant : Fraction or float, k [force / length], positive
    direction : (dimension,) array, of any length

    Returns
    -------
    (2 dimension, 2 dimension) array [force / length], exact where all data are (n n' is rational even where n is not).

    >>> spring_stiffness(3.0, [2.0]).tolist()
    [[3.0, -3.0], [-3.0, 3.0]]
    """
    block = spring_to_ground(constant, direction)
    return np.block([[block, -block], [-block, block]])


def spring_to_ground(constant: Number, direction: Any) -> Numbers:
    """Return K = k n n' of a spring between a node and the ground, (dimension, dimension) [force / length]."""
    d = np.asarray(direction)
    unit_vector(d, "spring direction")
    block: Numbers = constant / squared_length(d) * np.outer(d, d)
    return block


def spring_force(constant: Number, direction: Any, relative: Any) -> Number:
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


def point_mass_matrix(mass: Number, dimension: int) -> Numbers:
    """Return M = m I, (dimension, dimension) [mass]."""
    M: Numbers = mass * np.eye(dimension, dtype=int)
    return M


def string_stiffness(tension: Number, start: Any, end: Any) -> Numbers:
    """Return K = (T / h) [[P, -P], [-P, P]] with P = I - d d' / h^2, d = end - start and h = |d|.

    Across the string, on the deflections (w_start, w_end), that is (T / h) [[1, -1], [-1, 1]]: the energy is the
    integral of T/2 w'^2. There is no stiffness along the string. Slopes are small and the tension is constant.

    Parameters
    ----------
    tension : Fraction or float, T [force], positive
    start, end : (dimension,) arrays, the two nodes [length], apart from each other, in two dimensions or three

    Returns
    -------
    (2 dimension, 2 dimension) array [force / length] on (u_start, u_end). Exact where all data are and h is rational.

    Notes
    -----
    Course chapter, Example 2.22: -T w'' + b = 0 for a load b per length that acts down.

    >>> string_stiffness(1.0, [0.0, 0.0], [0.25, 0.0])[1::2, 1::2].tolist()
    [[4.0, -4.0], [-4.0, 4.0]]
    """
    d = np.asarray(end) - np.asarray(start)
    square = squared_length(d)
    across: Numbers = np.eye(len(d), dtype=int) - np.outer(d, d) / square
    block = (tension / square_root(square)) * across
    return np.block([[block, -block], [-block, block]])


def string_load(per_length: Any, start: Any, end: Any) -> Numbers:
    """Return f = (h / 2) (b, b): the consistent load of a constant b on shape functions that are linear.

    Parameters
    ----------
    per_length : (dimension,) array, b [force / length], per length of the string
    start, end : (dimension,) arrays, the two nodes [length]

    Returns
    -------
    (2 dimension,) array [force] on (u_start, u_end).

    >>> string_load([0.0, -3.0], [0.0, 0.0], [2.0, 0.0]).tolist()
    [0.0, -3.0, 0.0, -3.0]
    """
    half = square_root(squared_length(np.asarray(end) - np.asarray(start))) / 2
    return np.tile(half * np.asarray(per_length), 2)


def beam_stiffness(modulus: Number, area: Number, inertia: Number, start: Numbers, end: Numbers) -> Numbers:
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
    start, end : (2,) arrays, the two nodes [length], apart from each other

    Returns
    -------
    (6, 6) array on (u_x, u_y, theta) of start and end; theta turns the first axis towards the second
    (counter-clockwise). Entries in [force / length], [force], [force length]. Exact where all data are and L is
    rational.

    >>> K = beam_stiffness(1.0, 1.0, 2.0, np.array([0.0, 0.0]), np.array([0.0, 2.0]))
    >>> float(K[3, 3]), float(K[4, 4]), float(K[5, 5])  # a cantilever along the second axis
    (3.0, 0.5, 4.0)
    """
    d = np.asarray(end) - np.asarray(start)
    length = square_root(squared_length(d))
    rotation = _beam_rotation(d, length)
    local = _local_beam_stiffness(modulus * area / length, modulus * inertia / squared_length(d) / length, length)
    K: Numbers = rotation.T @ local @ rotation
    return K


def beam_load(per_length: Any, start: Any, end: Any) -> Numbers:
    """Return the consistent load of a constant b on cubic bending and linear stretching: exact at the ends of a beam.

    On (u, theta) of the start it is (L b / 2, L^2 b_n / 12), on those of the end (L b / 2, -L^2 b_n / 12), with b_n
    across the beam, to the left of its direction.

    Parameters
    ----------
    per_length : (2,) array, b [force / length], per length of the beam, along the axes
    start, end : (2,) arrays, the two nodes [length]

    Returns
    -------
    (6,) array on (u_x, u_y, theta) of start and end, in [force] and [force length].

    >>> beam_load([0.0, -12.0], [0.0, 0.0], [2.0, 0.0]).tolist()
    [0.0, -12.0, -4.0, 0.0, -12.0, 4.0]
    """
    b, d = np.asarray(per_length), np.asarray(end) - np.asarray(start)
    length = square_root(squared_length(d))
    force, moment = length * b / 2, length * (d[0] * b[1] - d[1] * b[0]) / 12
    return np.array([*force, moment, *force, -moment])


def beam_mass(density: Number, area: Number, start: Numbers, end: Numbers, lumped: bool = False) -> Numbers:
    """Return M = integral of rho A N'N of cubic bending and linear stretching, or its diagonal, lumped.

    The lumped one is the diagonal scaled to the mass (Hinton, Rock and Zienkiewicz 1976): half of it at either end, and
    rho A L^3 / 78 against rotation. The rotary inertia of the sections, rho I, is left out.

    Parameters
    ----------
    density, area : Fraction or float, rho [force time^2 / length^4], A [length^2]
    start, end : (2,) arrays, the two nodes [length]
    lumped : bool

    Returns
    -------
    (6, 6) array on (u_x, u_y, theta) of start and end. Exact where all data are and L is rational.

    >>> M = beam_mass(420.0, 1.0, np.array([0.0, 0.0]), np.array([1.0, 0.0]))
    >>> M[0, [0, 3]].tolist(), M[1, [1, 2, 4, 5]].tolist()
    ([140.0, 70.0], [156.0, 22.0, 54.0, -13.0])
    """
    d = np.asarray(end) - np.asarray(start)
    length = square_root(squared_length(d))
    m, s = density * area * length, length
    if lumped:
        return np.diag([m / 2, m / 2, m * s * s / 78] * 2)
    local = np.array(
        [
            [140, 0, 0, 70, 0, 0],
            [0, 156, 22 * s, 0, 54, -13 * s],
            [0, 22 * s, 4 * s * s, 0, 13 * s, -3 * s * s],
            [70, 0, 0, 140, 0, 0],
            [0, 54, 13 * s, 0, 156, -22 * s],
            [0, -13 * s, -3 * s * s, 0, -22 * s, 4 * s * s],
        ]
    )
    rotation = _beam_rotation(d, length)
    M: Numbers = rotation.T @ (m / 420 * local) @ rotation
    return M


def beam_displacements(start: Numbers, end: Numbers, ends: Numbers, at: Numbers) -> Numbers:
    """Return the (k, 2) displacements along the axis of an unloaded beam, from those of its ends.

    Linear along the beam; across it the cubic that has the deflections and slopes of the ends,

        v = (1 - 3s^2 + 2s^3) v_1 + L (s - 2s^2 + s^3) theta_1 + (3s^2 - 2s^3) v_2 + L (s^3 - s^2) theta_2.

    Parameters
    ----------
    start, end : (2,) arrays, the two nodes [length]
    ends : (6,) array, (u_x, u_y, theta) of start and end [length, length, 1]
    at : (k,) array
        s: 0 at the start, 1 at the end [-].

    >>> v = beam_displacements([0.0, 0.0], [2.0, 0.0], np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.75]), np.array([0.5]))
    >>> v.tolist()  # a cantilever under a force at its tip: s^2 (3 - s) / 2
    [[0.0, 0.3125]]
    """
    d = np.asarray(end) - np.asarray(start)
    length = square_root(squared_length(d))
    u_1, v_1, theta_1, u_2, v_2, theta_2 = _beam_rotation(d, length) @ np.asarray(ends)
    s = np.asarray(at)
    u = (1 - s) * u_1 + s * u_2
    v = (1 - 3 * s**2 + 2 * s**3) * v_1 + (3 * s**2 - 2 * s**3) * v_2
    v = v + length * ((s - 2 * s**2 + s**3) * theta_1 + (s**3 - s**2) * theta_2)
    across = np.array([-d[1], d[0]]) / length
    moved: Numbers = np.outer(u, d / length) + np.outer(v, across)
    return moved


def _local_beam_stiffness(a: Number, b: Number, length: Number) -> Numbers:
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


def _beam_rotation(d: Numbers, length: Number) -> Numbers:
    """Return the rotation from global to local unknowns: [[c, s, 0], [-s, c, 0], [0, 0, 1]] for each node."""
    c, s = d[0] / length, d[1] / length
    block = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return np.kron(np.eye(2, dtype=int), block)
