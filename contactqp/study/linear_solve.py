"""The physical limit of a contact problem: what one linear solve of its bodies costs."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.condensation import condense, fixing_unknowns
from contactqp.linalg.factorization import factorise
from contactqp.linalg.iteration import iterated
from contactqp.linalg.pardiso import NotPositive, Pardiso
from contactqp.linalg.schur import LastBlock
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem

# Solves timed at most, and the seconds of them after which a median is good enough.
REPEATS, ENOUGH = 9, 0.2


def linear_solve_seconds(problem: ContactProblem) -> float | None:
    """Seconds of one factorisation of K and one back-substitution of the load, by the sparse solver of contact.

    Contacts and ties are left out, and where the bodies then float, as few unknowns are held as it takes. The median of
    at most nine solves after a first; finding what to hold is not timed. None where a body is too large to factorise,
    and where nothing is elastic.
    """
    solve = None if iterated(problem) else linear_solve(problem)
    if solve is None:
        return None
    solve()
    times: list[float] = []
    while len(times) < REPEATS and sum(times) < ENOUGH:
        started = time.perf_counter()
        solve()
        times.append(time.perf_counter() - started)
    return statistics.median(times)


def linear_solve(problem: ContactProblem) -> Callable[[], Vector] | None:
    """What is timed: from the stiffness of the unknowns that are not held to their displacement; None if all are."""
    way = condense(problem)
    held = fixing_unknowns(way.rigid.motions, np.zeros(0, dtype=np.intp), problem.diagonal)
    moving = np.setdiff1d(np.arange(problem.dimension), held)
    if not moving.size:
        return None
    stiffness, load = sp.csr_matrix(problem.stiffness_rows[moving][:, moving]), problem.load[moving]
    by_pardiso = way.solver == LastBlock.solver and _positive(stiffness)
    return (lambda: _pardiso(stiffness).solve_all(load)) if by_pardiso else lambda: factorise(stiffness).solve(load)


def _pardiso(stiffness: Any) -> Pardiso:
    return Pardiso(stiffness, np.zeros(0, dtype=np.intp))


def _positive(stiffness: Any) -> bool:
    """Whether PARDISO factorises it: where bodies hardly do not float it may not, and contact does without it too."""
    try:
        _pardiso(stiffness)
    except NotPositive:
        return False
    return True
