"""Trusses with closed forms at large displacements, and what Newton's method should show on them."""

from __future__ import annotations

import numpy as np

import contactqp as cq

RISE, MODULUS = 0.2, 100.0


def arch(rise=RISE, modulus=MODULUS, law="green"):
    """Von Mises' truss: two bars from supports at (-1, 0) and (1, 0) to a node at (0, rise); unknowns (u_x, u_y)."""
    truss = cq.NonlinearTruss([[-1, 0], [0, rise], [1, 0]], [[0, 1], [1, 2]], modulus=modulus, area=1.0, law=law)
    return cq.Supported(truss, held=[0, 1, 4, 5])


def arch_load(w, rise=RISE, modulus=MODULUS):
    """P(w) = E A0 / L0^3 w (w - h)(w - 2 h), downwards, for the node w below where it starts."""
    return modulus / (1 + rise**2) ** 1.5 * w * (w - rise) * (w - 2 * rise)


def arch_limit(rise=RISE, modulus=MODULUS):
    """The limit load 2 sqrt(3) / 9 E A0 h^3 / L0^3 and its w = (1 - 1 / sqrt(3)) h."""
    return 2 * np.sqrt(3) / 9 * modulus * rise**3 / (1 + rise**2) ** 1.5, (1 - 1 / np.sqrt(3)) * rise


def node_over(obstacle, rise=RISE):
    """The node of the arch against an obstacle."""
    return cq.ObstacleContact([[0.0, rise]], obstacle)


def orders(iterations, least=1e-12):
    """Orders of convergence log(e_3 / e_2) / log(e_2 / e_1) once the closed contacts have settled, of errors that
    rounding has not spoilt."""
    settled = max((k for k, iteration in enumerate(iterations) if iteration.changed or iteration.shift), default=0)
    errors = np.array([iteration.error for iteration in iterations[settled:]])
    errors = errors[errors > least]
    steps = np.diff(np.log(errors))
    return steps[1:] / steps[:-1]
