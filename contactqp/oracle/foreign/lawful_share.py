"""Forces of dependent frictional contacts that obey Coulomb's law, from a displacement.

A touching contact that slips pushes and rubs along one direction, l_N (1, mu s/|s|); one that sticks along any
combination of the edges of its cone, in the plane exactly, in space of an inscribed polygon. The least squares of
equilibrium over such combinations with no negative part are forces within the law, where such forces exist.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.condensation import unknown_scale
from contactqp.linalg.measures import lengths_that_meet, tangential_lengths
from contactqp.model.arrays import Vector
from contactqp.model.coulomb_cone import directions, lengths
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer
from contactqp.oracle.foreign.balancing_forces import balancing_forces
from contactqp.oracle.foreign.judged_contacts import slips

# A gap or a slip of this part of its lengths is none.
NOTHING = 1e-9
# Sides of the polygon that stands for the cone of a sticking contact in space.
SIDES = 32


def lawful_share(problem: ContactProblem, known: Answer, residual: Vector, tied: bool) -> Answer | None:
    """The known displacement with contact forces, and tie forces if `tied`, that obey the law; None without friction.

    `residual` (n,) is f - K u less the tie forces that are known [force].
    """
    slip = slips(problem, known.displacement)
    if slip is None or problem.tangent is None or problem.friction is None:
        return None
    m, width = slip.shape
    gap = problem.gap - problem.normal @ known.displacement
    length = lengths_that_meet(problem, problem.normal, problem.gap, known.displacement)
    touching = gap <= NOTHING * length
    moving = lengths(slip) > NOTHING * tangential_lengths(problem, known.displacement)
    contacts, ways = _edges(touching, moving, directions(slip))
    rubs = problem.friction[contacts, None] * ways
    columns = (width * contacts[:, None] + np.arange(width)).ravel()
    places = np.repeat(np.arange(len(contacts)), width)
    spread = sp.csr_matrix((rubs.ravel(), (places, columns)), shape=(len(contacts), m * width))
    edges = sp.csr_matrix(problem.normal[contacts]) + spread @ sp.csr_matrix(problem.tangent)
    rows = sp.csr_matrix(sp.vstack([edges, sp.csr_matrix(problem.tie)]) if tied else edges)
    pushing_only = np.arange(rows.shape[0]) < len(contacts)
    share, _ = balancing_forces(rows, residual, pushing_only, unknown_scale(problem))
    normal, friction = np.zeros(m), np.zeros(slip.shape)
    np.add.at(normal, contacts, share[: len(contacts)])
    np.add.at(friction, contacts, share[: len(contacts), None] * rubs)
    return Answer(known.displacement, normal, friction, share[len(contacts) :] if tied else known.tie_force)


def _edges(
    touching: NDArray[np.bool_], moving: NDArray[np.bool_], along: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """The contact (q,) and the direction (q, d-1) of each edge that forces may lie along."""
    slipping, sticking = np.flatnonzero(touching & moving), np.flatnonzero(touching & ~moving)
    if along.shape[1] == 1:
        every = np.array([[1.0], [-1.0]])
    else:
        angle = 2 * np.pi * np.arange(SIDES) / SIDES
        every = np.column_stack([np.cos(angle), np.sin(angle)])
    contacts = np.concatenate([slipping, np.repeat(sticking, len(every))])
    return contacts, np.concatenate([along[slipping], np.tile(every, (len(sticking), 1))])
