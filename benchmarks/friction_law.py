"""Coulomb's law written out once more, in plain NumPy and apart from the package's certificate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import contactqp as cq
from benchmarks.friction_families import Posed

Array = NDArray[np.float64]


def plain_answer(posed: Posed, solution: cq.Solution) -> tuple[Array, Array, Array, Array]:
    """u, l_N, l_T (m, d-1) and nu in the numbers the problem was made in."""
    units = posed.units
    force = units.row / units.force
    assert solution.friction_force is not None
    return (
        solution.displacement / units.unknown / units.length,
        solution.normal_force * force,
        solution.friction_force * force[:, None],
        solution.tie_force / units.force,
    )


def broken(posed: Posed, solution: cq.Solution) -> float:
    """By how much an answer breaks equilibrium, contact, cone or slip direction, of the largest length or force."""
    p = posed.plain
    assert p.tangent is not None
    assert p.slip_origin is not None
    assert p.friction is not None
    u, normal, friction, tie = plain_answer(posed, solution)
    K = np.asarray(p.stiffness.toarray() if hasattr(p.stiffness, "toarray") else p.stiffness)
    E_N, E_T, A = p.normal.toarray(), p.tangent.toarray(), p.tie.toarray()
    balance = K @ u + E_N.T @ normal + E_T.T @ friction.ravel() + A.T @ tie - p.load
    # The displacement is held by doubles: what that changes of K u is no fault of the answer. Resultants know no u.
    balance = np.maximum(abs(balance) - 16 * np.finfo(float).eps * (abs(K) @ abs(u)), 0.0)
    resultant = _rigid(K).T @ (E_N.T @ normal + E_T.T @ friction.ravel() + A.T @ tie - p.load)
    gap, slip = p.gap - E_N @ u, (E_T @ u).reshape(p.slip_origin.shape) - p.slip_origin
    meeting = (abs(E_T) @ abs(u)).reshape(slip.shape) + abs(p.slip_origin)
    rounding = 4 * np.finfo(float).eps * np.linalg.norm(meeting, axis=1) if slip.shape[1] > 1 else 0.0
    parts = (balance, resultant, A @ u - p.tie_value, *_law(normal, friction, gap, slip, p.friction, rounding))
    return _worst(parts, (u, normal, friction, p.load, _lengths_at_rest(p)))


def _lengths_at_rest(plain: cq.ContactProblem) -> Array:
    """The smallest open gap where nothing acts and nothing overlaps: there is no other length to be right by."""
    still = not np.any(plain.load) and not np.any(plain.tie_value) and not np.any(plain.gap < 0)
    open_ones = plain.gap[(plain.gap > 0) & np.isfinite(plain.gap)]
    return np.asarray(np.min(open_ones, keepdims=True)) if still and open_ones.size else np.zeros(0)


def _rigid(K: Array) -> Array:
    """Motions (n, q) with K z = 0, the largest entry of each one."""
    root = 1.0 / np.sqrt(np.where(np.diag(K) > 0, np.diag(K), 1.0))
    values, vectors = np.linalg.eigh(K * np.outer(root, root))
    motions = root[:, None] * vectors[:, values <= 1e-13]
    return np.asarray(motions / np.max(abs(motions), axis=0, initial=1e-300))


def broken_locally(problem: cq.LocalProblem, solution: cq.LocalSolution) -> float:
    """The same of a problem in local form, r_T = -l_T, contacts scaled to a compliance of one; far ones are no size."""
    scale = _contact_scale(problem)
    r = solution.force / scale[:, None]
    u = scale[:, None] * (problem.delassus.toarray() @ solution.force.ravel() + problem.offset).reshape(r.shape)
    parts = _law(r[:, 0], -r[:, 1:], u[:, 0], u[:, 1:], problem.friction)
    return _worst(parts, (r, driven(problem, solution), np.minimum(abs(u), 1.0)))


def driven(problem: cq.LocalProblem, solution: cq.LocalSolution) -> Array:
    """W r (d m,) with every contact scaled to a compliance of one: what tells one answer from another."""
    scale = np.repeat(_contact_scale(problem), problem.dimension)
    return np.asarray(scale * (problem.delassus.toarray() @ solution.force.ravel()))


def size_of_offsets(problem: cq.LocalProblem) -> Array:
    """(m,) the largest |q| of every contact, scaled to a compliance of one."""
    return np.asarray(_contact_scale(problem) * np.max(abs(problem.offset).reshape(problem.contacts, -1), axis=1))


def _contact_scale(problem: cq.LocalProblem) -> Array:
    size = problem.delassus.diagonal().reshape(problem.contacts, -1).max(axis=1)
    return np.asarray(1.0 / np.sqrt(np.where(size > 0, size, 1.0)))


def _law(
    normal: Array, friction: Array, gap: Array, slip: Array, coefficient: Array, rounding: Array | float = 0.0
) -> tuple[Array, ...]:
    """What is left of each; `rounding` is that of the slips, by which the direction of a small one is not known."""
    size, slipped = np.linalg.norm(friction, axis=1), np.linalg.norm(slip, axis=1)
    direction = slip / np.where(slipped > 0, slipped, 1.0)[:, None]
    turned = coefficient * abs(normal) * np.minimum(rounding / np.where(slipped > 0, slipped, 1.0), 1.0)
    opposing = np.linalg.norm(friction - (coefficient * normal)[:, None] * direction, axis=1)
    opposing = np.maximum(opposing - turned, 0.0)
    return (
        np.minimum(gap, normal),
        np.maximum(size - coefficient * normal, 0.0) / (1 + coefficient),
        np.minimum(slipped, opposing) / (1 + coefficient),
    )


def _worst(parts: tuple[Array, ...], sizes: tuple[Array, ...]) -> float:
    size = max(float(np.max(abs(v), initial=0.0)) for v in sizes)
    worst = max(float(np.max(abs(part), initial=0.0)) for part in parts)
    return worst / size if size > 0 else worst


def seen(problem: cq.ContactProblem) -> Array:
    """A projection (n, n) that takes away motions that neither stiffness, ties nor the law see."""
    assert problem.tangent is not None
    assert problem.friction is not None
    K = np.asarray(problem.stiffness.toarray() if hasattr(problem.stiffness, "toarray") else problem.stiffness)
    rubs = np.repeat(problem.friction > 0, problem.tangent.shape[0] // problem.contacts)
    rows = np.vstack([K, problem.normal.toarray(), problem.tangent.toarray()[rubs], problem.tie.toarray()])
    length = np.linalg.norm(rows, axis=1, keepdims=True)  # soft bodies beside stiff ones are seen, too
    _, values, rotation = np.linalg.svd(rows / np.where(length > 0, length, 1.0))
    free = rotation[int(np.sum(values > 1e-10 * values[0])) :]
    return np.asarray(np.eye(len(K)) - free.T @ free)
