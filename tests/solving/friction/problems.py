"""Frictional problems with exact answers. Order of unknowns where there are two: tangential or normal as stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

import contactqp as cq
from tests.examples import truss

# Example 2.17 of the course chapter, printed stiffness: the truss touches the floor at this d1x [m].
TOUCH = 533489 / 639328600


def rough_truss(friction: float = 0.3, slip_origin: ArrayLike = TOUCH, **changes: object) -> cq.ContactProblem:
    """Examples 2.17 and 2.18: the two-bar truss over a rough floor (kN, m); slip counts from the touch point."""
    rough = dict(tangent=[[1.0, 0.0]], friction=friction, slip_origin=np.atleast_1d(slip_origin))
    return truss(**(rough | changes))


def two_masses(force: float, slip_origin: ArrayLike = (0.0, 0.0)) -> cq.ContactProblem:
    """Example 2.19: 2 kg and 1 kg on a rough floor, mu = 1/4, springs of 1000 N/m; pulled at the second (N, m).

    Unknowns d1, d2 along the floor, z1, z2 upwards; nothing but the floor holds z.
    """
    stiffness = np.zeros((4, 4))
    stiffness[:2, :2] = [[2000.0, -1000.0], [-1000.0, 1000.0]]
    return cq.ContactProblem(
        stiffness=stiffness,
        load=[0.0, force, -2 * 9.81, -9.81],
        normal=[[0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, -1.0]],
        gap=[0.0, 0.0],
        tangent=np.eye(2, 4),
        friction=0.25,
        slip_origin=np.asarray(slip_origin, dtype=float),
        dof_names=["d1", "d2", "z1", "z2"],
    )


def pad(push: float, friction: float = 0.3, spring: float = 0.0, pressed: float = 12000.0) -> cq.ContactProblem:
    """A rigid pad on an incline: unknowns along it and off it; the weight pushes along and presses on it [N]."""
    return cq.ContactProblem(
        stiffness=[[spring, 0.0], [0.0, 0.0]],
        load=[push, -pressed],
        normal=[[0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0]],
        friction=friction,
    )


def one_contact(compliance: ArrayLike, free: ArrayLike, friction: float) -> cq.ContactProblem:
    """u = W r + q in the order (normal, tangential), r on the body: Klarbring's (1990) one-contact problems."""
    stiffness = np.linalg.inv(np.asarray(compliance, dtype=float))
    return cq.ContactProblem(
        stiffness=(stiffness + stiffness.T) / 2,
        load=stiffness @ np.asarray(free, dtype=float),
        normal=[[-1.0, 0.0]],
        gap=[0.0],
        tangent=[[0.0, 1.0]],
        friction=friction,
    )


def walls_that_conflict() -> cq.ContactProblem:
    """A point between two walls that overlap."""
    return cq.ContactProblem(
        stiffness=np.eye(2),
        load=[0.0, 1.0],
        normal=[[1.0, 0.0], [-1.0, 0.0]],
        gap=[-0.1, -0.1],
        tangent=[[0.0, 1.0]] * 2,
        friction=0.3,
        contact_names=["left", "right"],
    )


def random_problem(rng: np.random.Generator) -> cq.ContactProblem:
    """One to three contacts, weakly to strongly coupled, mu from 0 to 5, some bodies floating, some tied."""
    m = int(rng.integers(1, 4))
    n = 2 * m + int(rng.integers(0, 3))
    rank = n if rng.random() < 0.7 else max(1, n - int(rng.integers(1, 3)))
    shape = rng.normal(size=(n, rank))
    own = rng.random() < 0.5
    normal, tangent = rng.normal(size=(2, m, n))
    if own:
        normal, tangent = -np.eye(2 * m, n)[::2], np.eye(2 * m, n)[1::2]
    k = int(rng.integers(0, 2))
    friction = rng.choice([0.1, 0.3, 0.7, 1.5, 5.0], size=m)
    friction[1:] *= rng.integers(0, 2, size=m - 1)
    return cq.ContactProblem(
        stiffness=shape @ shape.T,
        load=rng.normal(size=n),
        normal=normal,
        gap=0.3 * rng.normal(size=m),
        tangent=tangent,
        friction=friction,
        slip_origin=0.2 * rng.normal(size=m) * rng.integers(0, 2),
        tie=rng.normal(size=(k, n)) if k else None,
        tie_value=0.1 * rng.normal(size=k) if k else None,
    )


@dataclass(frozen=True)
class Known:
    """A frictional problem that was made around its answer."""

    problem: cq.ContactProblem
    displacement: np.ndarray
    normal_force: np.ndarray
    friction_force: np.ndarray
    tie_force: np.ndarray

    def answer(self) -> dict[str, np.ndarray]:
        return dict(
            displacement=self.displacement,
            normal_force=self.normal_force,
            friction_force=self.friction_force,
            tie_force=self.tie_force,
        )


def made_around(
    answer: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    slip: np.ndarray,
    stiffness: np.ndarray,
    rows: tuple[np.ndarray, np.ndarray, np.ndarray],
    gap: np.ndarray,
    friction: np.ndarray,
) -> Known:
    """The load, slip origins and tie values that make u, l_N, l_T, nu with this slip (m, d-1) the answer.

    Rows are normal, tangential and of ties.
    """
    (u, pressed, rubbed, nu), (normal, tangent, tie) = answer, rows
    problem = cq.ContactProblem(
        stiffness=stiffness,
        load=stiffness @ u + normal.T @ pressed + tangent.T @ rubbed.ravel() + tie.T @ nu,
        normal=normal,
        gap=gap,
        tangent=tangent,
        friction=friction,
        slip_origin=(tangent @ u).reshape(slip.shape) - slip,
        tie=tie if len(tie) else None,
        tie_value=tie @ u if len(tie) else None,
    )
    return Known(problem, u, pressed, rubbed, nu)


def known_answer(rng: np.random.Generator, dimension: int, stiff: float = 0.0, m: int | None = None) -> Known:
    """Contacts of all states at random, in the plane or in space; unknowns are scaled by up to 10^(+-stiff)."""
    m = int(rng.integers(1, 5)) if m is None else m
    t = dimension - 1
    n = dimension * m + int(rng.integers(0, 4))
    k = int(rng.integers(0, 2))
    shape = rng.normal(size=(n, n if rng.random() < 0.7 else n - 1))
    scale = 10.0 ** rng.uniform(-stiff, stiff, n)
    K = shape @ shape.T * np.outer(scale, scale)
    K = (K + K.T) / 2
    normal, tangent, tie = (rng.normal(size=(rows, n)) * scale for rows in (m, t * m, k))
    mu = rng.choice([0.0, 0.2, 0.7, 5.0], size=m)
    u = rng.normal(size=n) / scale
    state = rng.choice(["open", "stick", "slip", "grazing"], size=m)
    pressed = np.where(np.isin(state, ["stick", "slip"]), rng.uniform(0.5, 2.0, m), 0.0)
    direction = rng.normal(size=(m, t))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    part = np.where(state == "slip", 1.0, rng.uniform(0.0, 0.9, m))
    rubbed = (mu * pressed * part)[:, None] * direction
    slip = np.where(state == "stick", 0.0, rng.uniform(0.1, 1.0, m))[:, None] * direction
    gap = normal @ u + np.where(state == "open", rng.uniform(0.1, 1.0, m), 0.0)
    nu = rng.normal(size=k)
    return made_around((u, pressed, rubbed, nu), slip, K, (normal, tangent, tie), gap, mu)
