"""Rigid motions that no contact, no friction and no tie of an answer resists, put to rest; forces that are noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.figures import holds, rounded_slips
from contactqp.linalg.condensation import UNRESISTED, Condensation
from contactqp.linalg.friction_states import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, answer_in
from contactqp.linalg.frictional_rows import FrictionalRows
from contactqp.linalg.measures import force_measure, forces_that_meet
from contactqp.linalg.row_sizes import row_sizes
from contactqp.model.arrays import Array
from contactqp.model.coulomb_cone import lengths
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import Answer

# A contact force of this part of the forces that meet there is what a stiffness singular to rounding makes of none.
NOISE = 1e-15


def free_motions(problem: ContactProblem, condensation: Condensation, answer: Answer) -> Array:
    """An orthonormal basis (n, q) of the rigid motions along which no contact that pushes moves and no tie."""
    basis = condensation.rigid.basis
    if not basis.shape[1] or problem.tangent is None or problem.friction is None:
        return basis
    pushes = answer.normal_force > 0
    rows = sp.vstack(
        [
            problem.normal[pushes],
            problem.tangent[np.repeat(pushes & (problem.friction > 0), problem.tangent.shape[0] // problem.contacts)],
            problem.tie,
        ]
    )
    if not rows.shape[0]:
        return basis
    size = np.max(abs(rows) @ abs(basis), axis=1, initial=0.0)
    _, values, rotation = np.linalg.svd((rows @ basis) / np.where(size > 0, size, 1.0)[:, None])
    return np.asarray(basis @ rotation[int(np.sum(values > UNRESISTED)) :].T)


def at_rest(problem: ContactProblem, condensation: Condensation, answer: Answer, free: Array) -> Answer:
    """The answer of least norm along its free motions, where contacts that do not push leave room for it.

    What is taken away leaves its rounding behind, which is refined away.
    """
    if not free.shape[1]:
        return answer
    u = answer.displacement
    resting = replace(answer, displacement=u - free @ (free.T @ u))
    rows = FrictionalRows(problem, condensation)
    for found in (answer_in(problem, condensation, rows, _combination(problem, answer), resting), resting):
        if holds(problem, found):
            return found
    return answer


def _combination(problem: ContactProblem, answer: Answer) -> Status:
    """(m,) open where nothing pushes; sticking where the slip is no more than rounding of the displacement."""
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    slip = (problem.tangent @ answer.displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
    rounding = rounded_slips(row_sizes(problem, problem.tangent).size, answer.displacement, problem.slip_origin)
    way = np.where(slip[:, 0] < 0, SLIP_BACK, SLIP_ON) if slip.shape[1] == 1 else np.full(len(slip), SLIP_ON)
    closed = np.where(lengths(slip) <= rounding, STICK, way)
    return np.where(answer.normal_force > 0, closed, OPEN).astype(np.int8)


def without_noise(problem: ContactProblem, answer: Answer) -> Answer:
    """The answer without contact forces that are beneath the rounding of the stiffness, where it holds without them."""
    force = answer.normal_force
    heard = force_measure(problem.normal, force, forces_that_meet(problem, answer)) > NOISE
    if np.all(heard | (force == 0)) or answer.friction_force is None:
        return answer
    friction = np.where(heard[:, None], answer.friction_force, 0.0)
    quiet = replace(answer, normal_force=np.where(heard, force, 0.0), friction_force=friction)
    return quiet if holds(problem, quiet) else answer
