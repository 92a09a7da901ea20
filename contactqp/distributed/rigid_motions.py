"""The motions that nothing resists, body by body, out of the soft motions that a problem brings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.bodies import Bodies
from contactqp.distributed.problem import DistributedProblem
from contactqp.linalg.iteration import FLOATING
from contactqp.linalg.multigrid import energy_ratios, of_size_one
from contactqp.model.arrays import Vector


@dataclass(frozen=True, eq=False)
class FloatingBodies:
    """Motions z with K z = 0 to rounding, those of all bodies side by side."""

    motions: NDArray[np.float64]  # (n_here, r) zero where a body has fewer, or is held
    floats: NDArray[np.bool_]  # (q,) of the bodies on this rank


def floating_bodies(problem: DistributedProblem, bodies: Bodies) -> FloatingBodies:
    """Combinations of the soft motions whose energy is FLOATING of their diagonal's at most. Collective.

    They are found once for a stiffness.
    """
    if "floating bodies" not in problem.shared:
        problem.shared["floating bodies"] = _found(problem, bodies)
    found: FloatingBodies = problem.shared["floating bodies"]
    return found


def without_rigid_part(problem: DistributedProblem, bodies: Bodies, displacement: Vector) -> Vector:
    """`contactqp.linalg.measures.without_rigid_part` of this rank's unknowns. Collective."""
    floating = floating_bodies(problem, bodies)
    if not problem.ranks.any(floating.floats):
        return displacement
    Z, K = floating.motions, problem.diagonal
    width = Z.shape[1]
    products = [bodies.totals((K * Z[:, i])[:, None] * np.column_stack([Z, displacement])) for i in range(width)]
    gram = np.stack(products, axis=1)  # (count, r, r + 1)
    coordinates = np.array([np.linalg.lstsq(g[:, :width], g[:, width:], rcond=None)[0] for g in gram])
    moved = bodies.combined(Z, bodies.told(coordinates.reshape(-1, width, 1)))
    return np.asarray(displacement - moved[:, 0])


def _found(problem: DistributedProblem, bodies: Bodies) -> FloatingBodies:
    B = of_size_one(problem.soft_motions, problem.ranks.max)
    width = B.shape[1]
    # What has no stiffness at all floats by itself, and any metric will do.
    metric = np.where(problem.diagonal > 0, problem.diagonal, 1.0)
    forces = np.column_stack([problem.product(b) for b in B.T]) if width else B
    sizes = np.zeros((2, len(bodies.number), width, width))
    for i, j in np.ndindex(width, width):
        for k, other in enumerate((forces[:, j], metric * B[:, j])):
            sizes[k, :, i, j] = np.bincount(bodies.of, B[:, i] * other, len(bodies.number))
    energy, size = (bodies.sums(part) for part in sizes)
    mixed = np.zeros((bodies.count, width, width))
    for place in np.flatnonzero(np.trace(size, axis1=1, axis2=2) > 0):  # a body that is held everywhere has no motion
        ratios, vectors = energy_ratios(energy[place], size[place])
        free = ratios <= FLOATING
        mixed[place, :, : np.count_nonzero(free)] = vectors[:, free]
    combined = bodies.told(mixed)
    most = int(problem.ranks.max(int(np.sum(np.any(combined, axis=(0, 1))))))
    return FloatingBodies(bodies.combined(B, combined[:, :, :most]), np.any(combined, axis=(1, 2)))
