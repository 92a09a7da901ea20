"""The right answer to set beside a wrong one; of several equilibria the one nearest to what was given."""

from __future__ import annotations

import numpy as np

from contactqp.errors import ContactQPError
from contactqp.multiplicity import equilibria
from contactqp.problem import ContactProblem
from contactqp.solution import Solution
from contactqp.solving import solve
from contactqp.uniqueness import POSSIBLE, SEVERAL
from contactqp.violations import Answer

# Contacts of which all combinations of open, stick and slip are tried.
FEW = 6


def right_answer(problem: ContactProblem, answer: Answer) -> Solution:
    """A certified solution.

    Raises
    ------
    ContactQPError
        There is none, or none was found.
    """
    found = solve(problem)
    others = found.certificate.uniqueness
    plane = problem.tangent is not None and problem.tangent.shape[0] == problem.contacts
    if not (SEVERAL in others or POSSIBLE in others) or not plane or problem.contacts > FEW:
        return found
    try:
        known = equilibria(problem)
    except ContactQPError:
        return found
    weight = np.sqrt(np.maximum(problem.diagonal, 0.0))
    apart = [float(np.linalg.norm(weight * (one.displacement - answer.displacement))) for one in known]
    return known[int(np.argmin(apart))] if known and np.all(np.isfinite(apart)) else found
