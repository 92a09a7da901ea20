"""Quadrature on the reference shapes: line [-1, 1], square and cube of it, unit triangle and unit tetrahedron.

All weights are positive and all points lie inside. The numbers are closed forms, none is tabulated.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from math import acos, cos, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from contactqp.model.problem_data import ReadOnly


@dataclass(frozen=True, eq=False)
class Quadrature(ReadOnly):
    """Points (q, d) and weights (q,): the integral over the reference shape is the sum of w_q f(x_q)."""

    points: NDArray[np.float64]
    weights: NDArray[np.float64]


def gauss(order: int, dimension: int) -> Quadrature:
    """Gauss-Legendre in every direction of [-1, 1]^dimension: exact to degree 2 order - 1 in each coordinate."""
    x, w = np.polynomial.legendre.leggauss(order)
    points = np.array(list(itertools.product(x, repeat=dimension)))
    weights = np.prod(list(itertools.product(w, repeat=dimension)), axis=1)
    return Quadrature(points, weights)


def triangle(points: int) -> Quadrature:
    """1, 3 or 6 points, exact to degree 1, 2 or 4 (Strang & Fix 1973, table 4.1; Dunavant 1985)."""
    if points == 1:
        return _on_simplex([(1.0, (1 / 3, 1 / 3, 1 / 3))])
    if points == 3:
        return _on_simplex([(1 / 3, (1 / 6, 1 / 6, 2 / 3))])
    root, spread = sqrt(38 - 44 * sqrt(2 / 5)), sqrt(213125 - 53320 * sqrt(10))
    near, far = (8 - sqrt(10) + root) / 18, (8 - sqrt(10) - root) / 18
    return _on_simplex(
        [
            ((620 + spread) / 3720, (near, near, 1 - 2 * near)),
            ((620 - spread) / 3720, (far, far, 1 - 2 * far)),
        ]
    )


def tetrahedron(points: int) -> Quadrature:
    """1, 4, 8 or 15 points, exact to degree 1, 2, 3 or 5 (Stroud 1971, T3: 1-1, 2-1 and 5-1; eight: below).

    The eight points have equal weights: one barycentric coordinate is 1/4 + 3 s, the others 1/4 - s, for two values of
    s. Exact second and third moments ask for s1^2 + s2^2 = 1/40 and s1^3 + s2^3 = 1/480; then S = s1 + s2 solves
    S^3 - 3 S / 40 + 1 / 240 = 0, and its middle root leaves all points inside.
    """
    if points == 1:
        return _on_simplex([(1.0, (1 / 4,) * 4)])
    if points == 4:
        a = (5 - sqrt(5)) / 20
        return _on_simplex([(1 / 4, (a, a, a, 1 - 3 * a))])
    if points == 8:
        S = cos((acos(-sqrt(10) / 6) - 2 * pi) / 3) / sqrt(10)
        half = sqrt(1 / 80 - S**2 / 4)
        return _on_simplex(
            [(1 / 8, (1 / 4 - s, 1 / 4 - s, 1 / 4 - s, 1 / 4 + 3 * s)) for s in (S / 2 - half, S / 2 + half)]
        )
    r = sqrt(15)
    a, b, c = (7 - r) / 34, (7 + r) / 34, (5 - r) / 20
    return _on_simplex(
        [
            (16 / 135, (1 / 4,) * 4),
            ((2665 + 14 * r) / 37800, (a, a, a, 1 - 3 * a)),
            ((2665 - 14 * r) / 37800, (b, b, b, 1 - 3 * b)),
            (10 / 189, (c, c, 1 / 2 - c, 1 / 2 - c)),
        ]
    )


def _on_simplex(orbits: list[tuple[float, tuple[float, ...]]]) -> Quadrature:
    """Every distinct permutation of the barycentric coordinates of each orbit; the weights sum to 1 / d!."""
    dimension = len(orbits[0][1]) - 1
    points: list[tuple[float, ...]] = []
    weights: list[float] = []
    for weight, barycentric in orbits:
        orbit = sorted(set(itertools.permutations(barycentric)))
        points += [corner[1:] for corner in orbit]
        weights += [weight / (1, 1, 2, 6)[dimension]] * len(orbit)
    return Quadrature(np.array(points), np.array(weights))
