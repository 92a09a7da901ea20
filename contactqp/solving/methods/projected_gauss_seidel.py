"""Projected Gauss-Seidel on the linear complementarity problem of the contact forces."""

from __future__ import annotations

import time

import numpy as np

from contactqp.errors import Unsupported
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.complementarity import Complementarity, complementarity_problem, compliance, expand
from contactqp.solving.methods.method import Method, Settings


def solve_projected_gauss_seidel(problem: ContactProblem, settings: Settings) -> Candidate:
    """Sweep over the contacts, l_i <- max(0, l_i - w_i / W_ii) with w = q + W l, until complementarity holds.

    Returns
    -------
    Candidate
        `history` is max over i of |min(w_i, W_ii l_i)| / (|q_i| + sum_j |W_ij| l_j), one number a sweep; the method
        ends when it is at most `settings.tolerance`, and claims no answer after `settings.max_iter` (20000) sweeps.

    Raises
    ------
    Unsupported
        Bodies are held by contacts alone: W does not exist.
    """
    name = "projected-gauss-seidel"
    reduced = compliance(name, problem)
    if reduced.motions.shape[1]:
        raise Unsupported(f"{name}: bodies that only contacts hold have no compliance E K^-1 E'; use lemke")
    lcp = complementarity_problem(problem, reduced)
    start = np.zeros(problem.contacts) if settings.warm_start is None else settings.warm_start.normal_force
    force, history = _sweeps(lcp, np.maximum(start, 0.0), settings)
    displacement, tie_force = expand(problem, reduced, lcp, force, lcp.offset)
    claimed = history[-1] <= settings.tolerance
    status = f"{name}: {'converged to' if claimed else 'stopped at'} {history[-1]:.1e} after {len(history)} sweeps"
    return Candidate(displacement, force, tie_force, len(history), claimed, status, history)


def _sweeps(lcp: Complementarity, force: Vector, settings: Settings) -> tuple[Vector, tuple[float, ...]]:
    q, W, started, history = lcp.offset, lcp.matrix, time.perf_counter(), list[float]()
    diagonal, sizes = np.diag(W), np.abs(W)
    for _ in range(settings.max_iter or 20000):
        for i in range(q.size):
            force[i] = max(0.0, force[i] - (q[i] + W[i] @ force) / diagonal[i])
        lengths = np.abs(q) + sizes @ force
        wrong = np.abs(np.minimum(q + W @ force, diagonal * force))
        history.append(float(np.max(wrong / np.where(lengths > 0, lengths, 1.0), initial=0.0)))
        late = settings.time_limit is not None and time.perf_counter() - started > settings.time_limit
        if history[-1] <= settings.tolerance or late:
            break
    return force, tuple(history)


METHODS = (
    Method(
        name="projected-gauss-seidel",
        kind="complementarity",
        solve=solve_projected_gauss_seidel,
        polish=True,
        scale=True,
        semidefinite=False,
        sparse=False,
        knob="tolerance",
        note="one contact at a time; needs bodies that are held without contact",
    ),
)
