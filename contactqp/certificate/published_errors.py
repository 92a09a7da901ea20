"""Errors that other codes publish, each by its own formula and name: to compare with, not to judge by.

All of them take the natural map with rho = 1, n = r - P_K(r - u - mu |u_T| e_N), which adds forces to velocities: they
depend on units and on how a problem is scaled. r is the force on the body and u the velocity, gap or slip of each
contact, in the order (N, T) or (N, T1, T2); a ContactProblem has r = (l_N, -l_T), u = (g - E_N u, E_T u - slip_origin).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.linalg.extended_rows import velocity_of
from contactqp.model.arrays import Vector
from contactqp.model.coulomb_cone import natural_map
from contactqp.model.floating_point import own_floating_point
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_array

# Siconos divides by no scale that is smaller than these.
LEAST_LOCAL_SCALE = float(np.finfo(float).eps)
LEAST_GLOBAL_SCALE = float(np.sqrt(np.finfo(float).eps))


@own_floating_point
def siconos_local_error(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None) -> float:
    """|n| / max(|q|, |r|, |u|) with u = W r + q: Siconos's `fc3d_compute_error`, and its like in the plane.

    The division is left out where the scale is no larger than machine precision.

    Parameters
    ----------
    force : (m, d) or flat array
        r, on the body.
    joint_force : (p,) array, needed where the problem has joints

    Raises
    ------
    InvalidProblem
        Wrong shapes.

    Examples
    --------
    >>> one = LocalProblem(delassus=[[1.0, 0.0], [0.0, 1.0]], offset=[-3.0, 4.0], friction=0.5, dimension=2)
    >>> siconos_local_error(one, [0.0, 0.0])  # n = (-12, 6)/5, |q| = 5
    0.5366563145999496
    """
    r, residual, velocity = _local(problem, force, joint_force)
    scale = max(float(np.linalg.norm(part)) for part in (problem.offset, r, velocity))
    return residual / scale if scale > LEAST_LOCAL_SCALE else residual


@own_floating_point
def acary_bremond_huber_error(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None) -> float:
    """|n| / |q|: the error of the comparison of solvers by Acary, Bremond and Huber (2018).

    Raises
    ------
    InvalidProblem
        Wrong shapes, or q = 0.
    """
    size = float(np.linalg.norm(problem.offset))
    if size == 0:
        raise InvalidProblem("offset: the error is relative to |q|, and q is zero")
    return _local(problem, force, joint_force)[1] / size


@own_floating_point
def fclib_merit_1(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None) -> float:
    """|n| / (1 + sqrt(|q|)) + |V'r + R l + s| / (1 + |s|): FCLIB's `fclib_merit_local` with MERIT_1.

    The root is FCLIB's own: it takes that of a norm. There is no such merit in the plane.

    Raises
    ------
    InvalidProblem
        Wrong shapes.
    Unsupported
        Two dimensions.
    """
    if problem.dimension != 3:
        raise Unsupported("fclib_merit_1: FCLIB defines it in three dimensions only")
    r, residual, _ = _local(problem, force, joint_force)
    joint = _joints(problem, joint_force)
    left = problem.bilateral.T @ r.ravel() + problem.bilateral_delassus @ joint + problem.bilateral_offset
    merit = residual / (1 + np.sqrt(np.linalg.norm(problem.offset)))
    return float(merit + np.linalg.norm(left) / (1 + np.linalg.norm(problem.bilateral_offset)))


@own_floating_point
def siconos_global_error(
    problem: ContactProblem, displacement: ArrayLike, normal_force: ArrayLike, friction_force: ArrayLike
) -> float:
    """|q + H r - M v| / max(|q|, |M v|, |H r|) + |n| / max(|u|, |r|): Siconos's `gfc3d_compute_error`.

    M is the stiffness, q the load, v the displacement, H r = -E_N'l_N - E_T'l_T and u = (gap, slip). Neither part is
    divided by a scale of sqrt(machine precision) or less.

    Parameters
    ----------
    displacement : (n,) array [length]
    normal_force : (m,) array [force], positive in compression
    friction_force : (m, d-1) or flat array [force], l_T, along the slip

    Raises
    ------
    InvalidProblem
        Wrong shapes, or no tangential rows.
    Unsupported
        The problem has ties, which Siconos's form has not.
    """
    if problem.tangent is None or problem.slip_origin is None or problem.friction is None:
        raise InvalidProblem("siconos_global_error: expected a problem with tangential rows and friction")
    if problem.ties:
        raise Unsupported("siconos_global_error: the formula has no ties, and the problem has")
    v = _shaped("displacement", displacement, (problem.dimension,))
    pressed = _shaped("normal_force", normal_force, (problem.contacts,))
    rubbed = _shaped("friction_force", friction_force, problem.slip_origin.shape)
    inner = problem.stiffness_rows @ v
    outer = -(problem.normal.T @ pressed) - problem.tangent.T @ rubbed.ravel()
    slip = (problem.tangent @ v).reshape(rubbed.shape) - problem.slip_origin
    u, r = np.column_stack([problem.gap - problem.normal @ v, slip]), np.column_stack([pressed, -rubbed])
    balance = _scaled(problem.load + outer - inner, problem.load, inner, outer)
    return balance + _scaled(natural_map(r, u, problem.friction), u, r)


def _scaled(error: Any, *scales: Any) -> float:
    size, scale = float(np.linalg.norm(error)), max(float(np.linalg.norm(part)) for part in scales)
    return size / scale if scale > LEAST_GLOBAL_SCALE else size


def _local(
    problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None
) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """r, |n| and u."""
    r = _shaped("force", force, (problem.contacts, problem.dimension))
    velocity = velocity_of(problem, r, _joints(problem, joint_force))
    return r, float(np.linalg.norm(natural_map(r, velocity, problem.friction))), velocity


def _joints(problem: LocalProblem, joint_force: ArrayLike | None) -> Vector:
    return _shaped("joint_force", [] if joint_force is None else joint_force, (problem.joints,))


def _shaped(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = read_array(name, value)
    if array.shape not in (shape, (int(np.prod(shape)),)):
        raise InvalidProblem(f"{name}: expected shape {shape}, got {array.shape}")
    return array.reshape(shape)
