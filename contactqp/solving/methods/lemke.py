"""Lemke's complementary pivoting, a finite method for the linear complementarity problem of the contact forces."""

from __future__ import annotations

import time

import numpy as np

from contactqp.errors import NotConverged
from contactqp.linalg.runtime import stated_limit
from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.complementarity import (
    Complementarity,
    Dense,
    complementarity_problem,
    compliance,
    expand,
)
from contactqp.solving.methods.method import Method, Settings
from contactqp.solving.methods.textbook_algebra import TEXTBOOK_ROUNDING


def solve_lemke(problem: ContactProblem, settings: Settings) -> Candidate:
    """Pivot by Lemke's method (Cottle, Pang, Stone, The Linear Complementarity Problem, 1992, section 4.4).

    An artificial variable z0 makes the start feasible, w = q + M z + d z0; pivots follow complementarity until z0
    leaves. Lexicographic ratio tests exclude cycling. M is positive semidefinite, so that in exact arithmetic the
    method either solves the problem or ends on a ray where there is no solution; floating bodies included.

    Raises
    ------
    NotConverged
        The path ends on a ray: no contact forces satisfy the conditions, or rounding hides those that do. Or the load
        drives a rigid motion that no contact and no tie resists, or ties contradict each other.
    """
    reduced = compliance("lemke", problem)
    lcp = complementarity_problem(problem, reduced)
    limit = settings.max_iter or 100 * (problem.contacts + 1)
    basis, pivots, status = lemke_basis(lcp.offset, lcp.matrix, limit, settings.time_limit)
    w, z = basic_solution(lcp, basis)
    force, gap = lcp.force_and_gap(w, z)
    displacement, tie_force = expand(problem, reduced, lcp, force, gap)
    return Candidate(displacement, force, tie_force, pivots, claimed=not status, status=f"lemke: {status or 'solved'}")


def lemke_basis(q: Vector, M: Dense, limit: int, time_limit: float | None = None) -> tuple[Mask, int, str]:
    """Follow Lemke's path.

    Returns
    -------
    basis : (m,) mask
        Pairs whose z is basic (w is zero).
    pivots : int
    status : str
        Empty when solved, otherwise why the path was left.
    """
    m, started = q.size, time.perf_counter()
    scale = 1.0 / np.sqrt(np.where(np.diag(M) > 0, np.diag(M), 1.0))
    # Columns w, z, z0, right-hand side of w - M z - d z0 = q, scaled so that M has ones on its diagonal.
    tableau = np.hstack([np.eye(m), -scale[:, None] * M * scale, -np.ones((m, 1)), (scale * q)[:, None]])
    basic = np.arange(m)
    if np.all(q >= 0):
        return _in_z(basic), 0, ""
    row = _lexicographic_minimum(tableau, np.arange(m), np.ones(m))
    entering = 2 * m
    for pivots in range(1, limit + 1):
        leaving = int(basic[row])
        _pivot(tableau, row, entering)
        basic[row] = entering
        if leaving == 2 * m:
            return _in_z(basic), pivots, ""
        if time_limit is not None and time.perf_counter() - started > time_limit:
            return _in_z(basic), pivots, f"stopped after {stated_limit(time_limit)}"
        entering = leaving + m if leaving < m else leaving - m
        row = _leaving_row(tableau, basic, entering)
        if row < 0:
            raise NotConverged(
                f"lemke: a ray after {pivots} pivots: no contact forces satisfy the conditions, or rounding hides "
                "those that do"
            )
    return _in_z(basic), limit, f"stopped after {limit} pivots"


def _in_z(basic: Indices) -> Mask:
    """Return which z are basic (m,)."""
    m = len(basic)
    return np.isin(np.arange(m, 2 * m), basic)


def _leaving_row(tableau: Dense, basic: Indices, entering: int) -> int:
    """Return the row that blocks the entering variable, that of z0 if it is among them; -1 where no row blocks it."""
    m = len(basic)
    column = tableau[:, entering]
    # A pivot that is rounding against its column would be division by noise.
    rows = np.flatnonzero(column > TEXTBOOK_ROUNDING * max(1.0, float(np.max(np.abs(column)))))
    if rows.size == 0:
        return -1
    ratio = np.maximum(tableau[rows, -1], 0.0) / column[rows]
    size = float(np.max(np.abs(tableau[:, -1])))
    z0 = np.flatnonzero(basic[rows] == 2 * m)
    if z0.size and ratio[z0[0]] <= ratio.min() + TEXTBOOK_ROUNDING * size / column[rows[z0[0]]]:
        return int(rows[z0[0]])
    return _lexicographic_minimum(tableau, rows, column)


def _lexicographic_minimum(tableau: Dense, rows: Indices, column: Vector) -> int:
    """Return the row whose (right-hand side, inverse basis) / column is lexicographically least."""
    m = len(tableau)
    for j in (-1, *range(m)):
        ratio = tableau[rows, j] / column[rows]
        least = float(ratio.min())
        rows = rows[
            ratio <= least + TEXTBOOK_ROUNDING * max(abs(least), float(np.max(np.abs(tableau[rows, j] / column[rows]))))
        ]
        if rows.size == 1:
            break
    return int(rows[0])


def _pivot(tableau: Dense, row: int, column: int) -> None:
    tableau[row] /= tableau[row, column]
    others = tableau[:, column].copy()
    others[row] = 0.0
    tableau -= np.outer(others, tableau[row])


def basic_solution(lcp: Complementarity, basis: Mask) -> tuple[Vector, Vector]:
    """Return w and z of a complementary basis, computed afresh so that rounding of the pivots does not stay in them."""
    q, M = lcp.offset, lcp.matrix
    z = np.zeros(q.size)
    if np.any(basis):
        # Least squares, for contacts whose rows depend on each other.
        z[basis] = np.linalg.lstsq(M[np.ix_(basis, basis)], -q[basis], rcond=None)[0]
    w = q + M @ z
    w[basis] = 0.0
    return w, z


METHODS = (
    Method(
        name="lemke",
        kind="complementarity",
        solve=solve_lemke,
        polish=True,
        scale=True,
        sparse=False,
        note="complementary pivoting with lexicographic ratio tests; finite",
    ),
)
