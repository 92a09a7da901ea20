"""Coulomb's law: the states of contacts, projections onto the cone K = {|r_T| <= mu r_N}, and the law as an equation.

With De Saxce's velocity u + mu |u_T| e_N the law of Signorini and Coulomb is K* contains it, K contains r, and the two
are orthogonal (De Saxce and Feng 1998), that is r = P_K(r - rho (u + mu |u_T| e_N)) for any rho > 0.
Vectors are (m, d), normal component first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import IntEnum
from itertools import product
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem


class ContactState(IntEnum):
    """The state of a contact; in the plane it slips with s < 0 (SLIP_BACK) or s > 0 (SLIP_ON).

    The product of a slipping state with mu l_N is the friction force in the plane. CLOSED is a closed contact without
    friction, where sticking and slipping are not told apart.
    """

    SLIP_BACK = -1
    OPEN = 0
    SLIP_ON = 1
    STICK = 2
    CLOSED = 3


OPEN, STICK, CLOSED = ContactState.OPEN, ContactState.STICK, ContactState.CLOSED
SLIP_BACK, SLIP_ON = ContactState.SLIP_BACK, ContactState.SLIP_ON
Status = NDArray[np.int8]


def plane_states(friction: Any) -> tuple[int, ...]:
    """Return the states that a contact in the plane can be in, its coefficient of friction a float or a Fraction.

    Without friction a closed contact neither sticks nor slips: SLIP_ON, whose friction is zero, stands for it.
    """
    return (OPEN, STICK, SLIP_BACK, SLIP_ON) if friction > 0 else (OPEN, SLIP_ON)


def all_combinations(friction: Iterable[Any]) -> Iterator[tuple[int, ...]]:
    """Return every combination of the states of contacts in the plane, of coefficients of floats or Fractions (m,)."""
    return product(*(plane_states(mu) for mu in friction))


def status_names(status: Status) -> NDArray[np.str_]:
    """Return the names "open", "stick" and "slip" of states (m,)."""
    return np.select([status == OPEN, status == STICK], ["open", "stick"], "slip").astype("<U8")


Vectors = Array  # (m, d)


def lengths(vectors: Vectors) -> Vector:
    """Return |v| of every row, infinite where an entry is, and correct where squares exceed doubles.

    >>> [f"{length:.12g}" for length in lengths(np.array([[3e200, 4e200], [3e-200, 4e-200]]))]
    ['5e+200', '5e-200']
    """
    return np.asarray(np.hypot.reduce(vectors, axis=-1, initial=0.0))


def directions(vectors: Vectors) -> Vectors:
    """Return v/|v| of every row, and zero where v is zero."""
    size = lengths(vectors)[:, None]
    return np.asarray(np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0))


def onto_cone(vectors: Vectors, friction: Vector) -> Vectors:
    """Return the nearest points (m, d) of the cones K with coefficients `friction` (m,)."""
    normal, tangent = vectors[:, 0], vectors[:, 1:]
    size = lengths(tangent)
    factor = (friction * size + normal) / (1.0 + friction**2)
    beyond = np.column_stack([factor, (friction * factor)[:, None] * directions(tangent)])
    projected = np.where((size <= friction * normal)[:, None], vectors, beyond)
    return np.where((friction * size <= -normal)[:, None], 0.0, projected)


def onto_discs(vectors: Vectors, radius: Vector) -> Vectors:
    """Return the nearest points (m, d-1) of discs around zero with these radii (m,)."""
    size = lengths(vectors)
    return np.where((size <= radius)[:, None], vectors, radius[:, None] * directions(vectors))


def de_saxce(velocity: Vectors, friction: Vector) -> Vectors:
    """Return the velocities u + mu |u_T| e_N (m, d), with which Coulomb's law is a normality rule."""
    shifted = velocity.copy()
    shifted[:, 0] += friction * lengths(velocity[:, 1:])
    return shifted


# A friction force within this part of mu r_N, either way, is mu r_N: doubles come no nearer.
ON_CONE = 4 * float(np.finfo(float).eps)


def natural_map(force: Vectors, velocity: Vectors, friction: Vector) -> Vectors:
    """Return n = r - P_K(r - v), v = u + mu |u_T| e_N (m, d), which is zero exactly where the law holds.

    It is computed from velocities and the distance of r from the cone, never as a difference of forces or of mu |u_T|,
    beside which velocities would be lost where redundant contacts press on each other or mu is large. In K n is v, in
    its polar cone r. Outside, with the direction t of r_T - u_T and e = |r_T| - mu r_N + |r_T - u_T| - |r_T| - |u_T|,

        n_N = (u_N - mu e) / (1 + mu^2),    n_T = u_T + |u_T| t + (e + mu u_N) t / (1 + mu^2).
    """
    slip, slid, step = velocity[:, 1:], lengths(velocity[:, 1:]), de_saxce(velocity, friction)
    moved = force - step
    given, size, t = lengths(force[:, 1:]), lengths(moved[:, 1:]), directions(moved[:, 1:])
    bound = friction * force[:, 0]
    excess = np.where(abs(given - bound) <= ON_CONE * (given + abs(bound)), 0.0, given - bound)
    # |r_T - u_T| - |r_T| = -u_T'(2 r_T - u_T) / (|r_T - u_T| + |r_T|)
    whole = (size + given)[:, None]
    both = np.divide(moved[:, 1:] + force[:, 1:], whole, out=np.zeros_like(slip), where=whole > 0)
    excess = excess - np.sum(both * slip, axis=1) - slid
    root = np.hypot(1.0, friction)
    across, along = 1.0 / root, friction / root
    # Without friction the cone is a half line, and -0 is no side of it.
    inside = (across * excess + along * velocity[:, 0] + root * slid <= 0) & (moved[:, 0] >= 0)
    normal = across * (across * velocity[:, 0] - along * excess)
    tangential = slip + slid[:, None] * t + (across * (across * excess + along * velocity[:, 0]))[:, None] * t
    missed = np.where((friction * size <= -moved[:, 0])[:, None], force, np.column_stack([normal, tangential]))
    return np.where(inside[:, None], step, missed)


def distance_from_law(force: Vectors, velocity: Vectors, friction: Vector) -> Vector:
    """Return |n| of each contact, or |u_T| + |n| without slip where that is less (m,).

    With its velocities changed by u_T a contact sticks: a large mu makes much of a slip that is rounding.
    """
    sticking = np.column_stack([velocity[:, :1], np.zeros_like(velocity[:, 1:])])
    missed, missed_sticking = (lengths(natural_map(force, each, friction)) for each in (velocity, sticking))
    return np.minimum(missed, missed_sticking + lengths(velocity[:, 1:]))


# Sides of the polygon around the disc of slips: motions between it and the disc, 0.5 % of the slip, are not claimed.
SIDES = 32


def resisting_rows(problem: ContactProblem) -> Any:
    """Return the rows E_N, and E_N + mu t'E_T with friction (CSR): no contact resists a motion z with E z <= 0.

    t are the two directions of the plane, in space the corners of a polygon around the unit circle.
    """
    if not problem.frictional or problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        return problem.normal
    width, rough = problem.slip_origin.shape[1], np.flatnonzero(problem.friction > 0)
    across = sp.diags(np.repeat(problem.friction, width)) @ problem.tangent
    parts = [problem.normal[problem.friction <= 0]]
    for direction in around(width):
        along = sum(direction[k] * across[width * rough + k] for k in range(width))
        parts.append(problem.normal[rough] + along)
    return sp.csr_matrix(sp.vstack(parts))


def around(width: int) -> Array:
    """Return directions t (k, d-1) with max_t t's >= |s| for every slip s: the sides of a circumscribed polygon."""
    if width == 1:
        return np.array([[1.0], [-1.0]])
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    corner: float = 1.0 / np.cos(np.pi / SIDES)
    return corner * np.column_stack([np.cos(angle), np.sin(angle)])


def slips(problem: ContactProblem, displacement: Vector) -> Array | None:
    """Return the slips E_T u - slip_origin, (m, d-1) [length]; None without tangential rows."""
    if problem.tangent is None or problem.slip_origin is None:
        return None
    shape = problem.slip_origin.shape
    return np.asarray((problem.tangent @ displacement).reshape(shape) - problem.slip_origin)
