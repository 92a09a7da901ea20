"""Rods, blocks and masses whose motion is known in closed form."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

import contactqp as cq

LENGTH, MODULUS, DENSITY, SPEED, GAP = 10.0, 900.0, 1.0, 10.0, 5.0
WAVE = np.sqrt(MODULUS / DENSITY)


def rod_matrices(elements: int, length: float = LENGTH, lumped: bool = True) -> tuple[sp.csc_matrix, sp.csc_matrix]:
    """K and M of a rod of unit area in linear elements."""
    h, ones = length / elements, np.ones(elements)
    middle = np.r_[1.0, 2 * np.ones(elements - 1), 1.0]
    K = sp.diags([middle, -ones, -ones], [0, 1, -1]) * MODULUS / h
    M = sp.diags(middle / 2) if lumped else sp.diags([middle / 3, ones / 6, ones / 6], [0, 1, -1])
    return sp.csc_matrix(K), sp.csc_matrix(M * DENSITY * h)


def rod_at_wall(elements: int, gap: float = GAP, gravity: float = 0.0, lumped: bool = True) -> tuple:
    """A rod whose first node meets a wall at -gap: the problem and its mass."""
    K, M = rod_matrices(elements, lumped=lumped)
    load = -gravity * np.asarray(M.sum(axis=1)).ravel()
    rows = sp.csr_matrix(([-1.0], ([0], [0])), shape=(1, elements + 1))
    return cq.ContactProblem(stiffness=K, load=load, normal=rows, gap=[gap]), M


def thrown_rod(scheme: str, elements: int = 100, courant: float = 1.0, duration: float = 2.0, **knobs: object) -> tuple:
    """Doyen, Ern and Piperno's first benchmark: touch at 0.5, release at 0.5 + 2L/c, force |v| sqrt(E rho) = 300."""
    problem, mass = rod_at_wall(elements)
    step = courant * LENGTH / elements / WAVE
    still, velocity = np.zeros(elements + 1), np.full(elements + 1, -SPEED)
    return cq.impact(problem, mass, still, velocity, duration, step, scheme, **knobs), step


def sliding_block(friction: float = 0.3, mass: float = 2.0, gravity: float = 9.81) -> cq.ContactProblem:
    """A rigid block on a plane, unknowns (x, y)."""
    return cq.ContactProblem(
        stiffness=np.zeros((2, 2)),
        load=[0.0, -mass * gravity],
        normal=[[0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0]],
        friction=friction,
    )


def brick(friction: float, corners: int) -> cq.ContactProblem:
    """A rigid brick of unit mass over a plane, unknowns (translation, rotation), with redundant contacts."""
    places = [(1, 1), (1, -1), (-1, 1), (-1, -1), (0, 1), (1, 0), (0, -1), (-1, 0)][:corners]
    arms = [np.array([x, y, -0.5]) for x, y in places]
    normal = [-np.r_[0.0, 0.0, 1.0, np.cross(arm, [0.0, 0.0, 1.0])] for arm in arms]
    tangent = [np.r_[way, np.cross(arm, way)] for arm in arms for way in np.eye(3)[:2]]
    load = [0.0, 0.0, -10.0, 0.0, 0.0, 0.0]
    return cq.ContactProblem(
        np.zeros((6, 6)), load, np.array(normal), np.full(corners, 0.05), tangent=np.array(tangent), friction=friction
    )


def times_of(history: cq.MotionHistory, kind: str) -> list[float]:
    """The times of all events of a kind."""
    return [event.time for event in history.events if event.kind == kind]
