"""Rigid motions that no contact, no friction and no tie of an answer resists, put to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from contactqp.condensation import UNRESISTED, Condensation
from contactqp.factorization import Array
from contactqp.friction.states import holds
from contactqp.problem import ContactProblem
from contactqp.violations import Answer


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


def at_rest(problem: ContactProblem, answer: Answer, free: Array) -> Answer:
    """The answer of least norm along its free motions, where contacts that do not push leave room for it."""
    if not free.shape[1]:
        return answer
    u = answer.displacement
    resting = replace(answer, displacement=u - free @ (free.T @ u))
    return resting if holds(problem, resting) else answer
