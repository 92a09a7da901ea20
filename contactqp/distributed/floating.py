"""Bodies that no support holds, of which ranks have parts: their rigid motions, and displacements without these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactqp.distributed.problem import Bodies, DistributedProblem
from contactqp.distributed.rows import Rows
from contactqp.linalg.floating import FloatingMotions
from contactqp.linalg.multigrid import FLOATING, energy_ratios, of_size_one
from contactqp.model.arrays import Array, Mask, Vector


@dataclass(frozen=True, eq=False)
class FloatingBodies:
    """The motions z of all bodies with K z = 0 to rounding, side by side."""

    motions: Array  # (n_here, r) zero where a body has fewer than r, or is supported
    floats: Mask  # (q,) whether each body on this rank floats


def floating_bodies(problem: DistributedProblem, bodies: Bodies) -> FloatingBodies:
    """Return the combinations of known motions whose energy is at most FLOATING times that of their diagonal.

    They are computed once for a stiffness. Collective.
    """
    found: FloatingBodies | None = problem.computed.floating_bodies
    if found is None:
        problem.computed.floating_bodies = found = _find_floating(problem, bodies)
    return found


def _find_floating(problem: DistributedProblem, bodies: Bodies) -> FloatingBodies:
    known = problem.near_null_space
    if problem.rigid_motions is not None:
        known = np.hstack([known, problem.rigid_motions])
    B = of_size_one(known, problem.ranks.max)
    width = B.shape[1]
    # What has no stiffness at all floats by itself, and any metric will do.
    metric = np.where(problem.diagonal > 0, problem.diagonal, 1.0)
    forces = np.column_stack([problem.product(b) for b in B.T]) if width else B
    sizes = np.zeros((2, len(bodies.numbers), width, width))
    for i, j in np.ndindex(width, width):
        for k, other in enumerate((forces[:, j], metric * B[:, j])):
            sizes[k, :, i, j] = np.bincount(bodies.index, B[:, i] * other, len(bodies.numbers))
    energy, size = (bodies.sums(part) for part in sizes)
    mixed = np.zeros((bodies.count, width, width))
    for place in np.flatnonzero(np.trace(size, axis1=1, axis2=2) > 0):  # a body that is held everywhere has no motion
        ratios, vectors = energy_ratios(energy[place], size[place])
        free = ratios <= FLOATING
        mixed[place, :, : np.count_nonzero(free)] = vectors[:, free]
    combined = bodies.from_homes(mixed)
    most = int(problem.ranks.max(int(np.sum(np.any(combined, axis=(0, 1))))))
    return FloatingBodies(bodies.combined(B, combined[:, :, :most]), np.any(combined, axis=(1, 2)))


def without_rigid_part(problem: DistributedProblem, bodies: Bodies, displacement: Vector) -> Vector:
    """Return the displacement (n_here,) less its rigid part, as `contactqp.linalg.measures` does. Collective."""
    floating = floating_bodies(problem, bodies)
    if not problem.ranks.any(floating.floats):
        return displacement
    Z, K = floating.motions, problem.diagonal
    width = Z.shape[1]
    products = [bodies.totals((K * Z[:, i])[:, None] * np.column_stack([Z, displacement])) for i in range(width)]
    gram = np.stack(products, axis=1)  # (count, r, r + 1)
    coordinates = np.array([np.linalg.lstsq(g[:, :width], g[:, width:], rcond=None)[0] for g in gram])
    moved = bodies.combined(Z, bodies.from_homes(coordinates.reshape(-1, width, 1)))
    return np.asarray(displacement - moved[:, 0])


def floating_motions(problem: DistributedProblem, rows: Rows, compliance: Vector) -> FloatingMotions:
    """Return the rigid motions of all bodies with the rows, whose E_i D^-1 E_i' is the compliance. Collective."""
    own = _motions(problem)
    return FloatingMotions(problem.ranks, problem.metric, own, problem.contacts, rows.lengths, compliance)


def _motions(problem: DistributedProblem) -> Array:
    """Return the rigid motions (n_here, r) of all bodies, D-orthonormal, body by body. Collective."""
    ranks, bodies = problem.ranks, Bodies(problem.ranks, problem.body)
    found = floating_bodies(problem, bodies)
    columns = [
        np.where(problem.body == body, motion, 0.0)
        for body in np.unique(ranks.gathered(bodies.numbers[found.floats]))
        for motion in found.motions.T
    ]
    acting = [z for z in columns if ranks.any(z != 0)]
    return np.column_stack(acting) if acting else np.zeros((len(problem.load), 0))
