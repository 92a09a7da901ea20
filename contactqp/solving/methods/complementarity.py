"""Contact as a linear complementarity problem in the contact forces.

    w = q + M z,   w >= 0,   z >= 0,   w'z = 0

With K regular, z is the force l_N, w the gap g - E_N u, q the gap without contact, and M = W = E_N K^-1 E_N' (ties
eliminated). Where bodies float, u has rigid motions Z a besides; their balance Z'(f - E_N' l) = 0 is used to pivot as
many contacts as there are motions, after which z holds the gaps of those contacts and the forces of the others
(a principal pivot transform: M stays positive semidefinite, though no longer symmetric).

Two methods solve the problem as such: Lemke's complementary pivoting, which is finite, and projected Gauss-Seidel.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NotConverged, Unsupported
from contactqp.linalg.factorization import null_space, right_singular
from contactqp.linalg.measures import own_compliance
from contactqp.linalg.runtime import dense_product
from contactqp.model.arrays import Array, Indices, Mask, Vector, stated_limit
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods.method import COMPLEMENTARITY, Method, Settings
from contactqp.solving.methods.textbook_algebra import (
    TEXTBOOK_ROUNDING,
    refuse_contradiction,
    rows_independent_of_earlier,
    solve_linear,
    spread,
)

# A unit motion that changes all gaps by less than this, a lever arm of rounding size, does not act on any contact.
RESISTED = 1e-10
# The load on a unit motion that nothing resists, relative to all loads, up to which it counts as balanced. (It is not
# relative to the load on moving unknowns, as those at rest have displacements of rounding size.)
BALANCED = 1e-9
# The energy of a unit motion, by a stiffness of unit diagonal, from which it is that of a spring and no rounding.
SPRUNG = 1e-3

Dense = Array


@dataclass(frozen=True, eq=False)
class Compliance:
    """The displacements and tie forces without contact and per unit contact force, and the remaining rigid motions.

    u = free - response l + motions a;   nu = tie_free - tie_response l;   motions'(f - E_N' l) = 0
    """

    free: Vector  # (n,)
    response: Dense  # (n, m)
    motions: Dense  # (n, r), orthonormal; not felt by stiffness and ties, each resisted by some contact
    tie_free: Vector  # (k,)
    tie_response: Dense  # (k, m)


def compliance(name: str, problem: ContactProblem) -> Compliance:
    """Eliminate displacements and ties, and return their response to contact forces.

    Raises
    ------
    NotConverged
        The load drives a rigid motion that no contact and no tie resists; or ties contradict each other.
    """
    K = problem.stiffness.toarray() if sp.issparse(problem.stiffness) else problem.stiffness
    ties = rows_independent_of_earlier(problem.tie)
    refuse_contradiction(name, problem, ties)
    A, E = problem.tie[ties].toarray(), problem.normal.toarray()
    rigid = _rigid_motions(problem)
    n, k = problem.dimension, ties.size
    # Rigid motions are scaled with the stiffness, so that their pivots are as large as the others.
    Z = rigid * (float(np.max(K.diagonal(), initial=0.0)) or 1.0)
    system = np.block([[K, A.T, Z], [A, np.zeros((k, k + Z.shape[1]))], [Z.T, np.zeros((Z.shape[1], k + Z.shape[1]))]])
    loads = np.column_stack([problem.load, E.T])
    loads -= rigid @ (rigid.T @ loads)  # the load on rigid motions is balanced separately
    right = np.vstack([loads, np.zeros((k + Z.shape[1], 1 + len(E)))])
    right[n : n + k, 0] = problem.tie_value[ties]
    solved = solve_linear(name, system, right)
    tie_solved = np.zeros((problem.ties, 1 + len(E)))
    tie_solved[ties] = solved[n : n + k]
    motions = _resisted(name, problem, rigid)
    return Compliance(solved[:n, 0], solved[:n, 1:], motions, tie_solved[:, 0], tie_solved[:, 1:])


def _rigid_motions(problem: ContactProblem) -> Dense:
    """Return an orthonormal basis (n, r) of the motions with K Z = 0 and A Z = 0.

    Those that are known of the body are taken: condensed to few unknowns its stiffness may hide them beneath rounding.
    Springs hold those of them that nothing resists.
    """
    known = problem._computed.rigid_motions
    motions = np.linalg.qr(null_space(problem.stiffness).motions if known is None else known)[0]
    if known is not None and motions.shape[1]:
        energies, directions = np.linalg.eigh(motions.T @ (problem.stiffness @ motions))
        motions = motions @ directions[:, energies < SPRUNG]
    return _split(problem.tie, motions)[1]


def _split(rows: Any, motions: Dense) -> tuple[Dense, Dense]:
    """Return orthonormal motions that displace some row, and those that displace none."""
    if motions.shape[1] == 0 or rows.shape[0] == 0:
        return motions[:, :0], motions
    unit = rows.toarray() / np.sqrt(rows.power(2).sum(axis=1))[:, None]
    felt, directions = right_singular(unit @ motions)
    count = int(np.count_nonzero(felt > RESISTED))
    return motions @ directions[:count].T, motions @ directions[count:].T


def _resisted(name: str, problem: ContactProblem, rigid: Dense) -> Dense:
    """Return the rigid motions that displace some contact; raise NotConverged if the load drives the others."""
    resisted, unresisted = _split(problem.normal, rigid)
    if np.any(np.abs(unresisted.T @ problem.load) > BALANCED * np.linalg.norm(problem.load)):
        raise NotConverged(f"{name}: the load drives a rigid motion that no contact and no tie resists")
    return resisted


@dataclass(frozen=True, eq=False)
class Complementarity:
    """w = q + M z, w >= 0, z >= 0, w'z = 0, and which of its pairs have force and gap exchanged."""

    offset: Vector  # q (m,)
    matrix: Dense  # M (m, m), positive semidefinite
    exchanged: Indices  # contacts i whose z_i is the gap and w_i the force

    def force_and_gap(self, w: Vector, z: Vector) -> tuple[Vector, Vector]:
        force, gap = z.copy(), w.copy()
        force[self.exchanged], gap[self.exchanged] = w[self.exchanged], z[self.exchanged]
        return force, gap


def complementarity_problem(problem: ContactProblem, reduced: Compliance) -> Complementarity:
    """Return the linear complementarity problem of the contacts, w = q + M z.

    Without rigid motions q = g - E_N u_free, M = E_N response. With them, w = q + W l - N a and N'l = Z'f (N = E_N Z):
    as many contacts B as there are motions, with N_B regular, give l_B and a from these equations.
    """
    E, m = problem.normal, problem.contacts
    own = np.sqrt(own_compliance(problem, E))
    W, sizes = dense_product(E, reduced.response), dense_product(abs(E), abs(reduced.response))
    sizes = np.maximum(sizes, np.outer(own, own))
    W = _without_rounding((W + W.T) / 2, (sizes + sizes.T) / 2)
    lengths = abs(np.where(np.isfinite(problem.gap), problem.gap, 0.0)) + abs(E) @ abs(reduced.free)
    lengths = np.maximum(lengths, own * np.max(np.sqrt(problem.diagonal) * abs(reduced.free), initial=0.0))
    q = _without_rounding(problem.gap - E @ reduced.free, lengths)
    N, balance = E @ reduced.motions, reduced.motions.T @ problem.load
    if N.shape[1] == 0:
        return Complementarity(q, W, np.zeros(0, dtype=np.intp))
    from scipy.linalg import qr

    N = _without_rounding(N, abs(E).sum(axis=1)[:, None] * np.max(abs(reduced.motions), axis=0))
    unit = N / np.sqrt(E.power(2).sum(axis=1))[:, None]
    B = qr(unit.T, mode="r", pivoting=True)[1][: N.shape[1]]
    R = np.setdiff1d(np.arange(m), B)
    # l = T y + l0 with y the forces of R; l_B = N_B'^-1 (Z'f - N_R' y).
    inverse = np.linalg.inv(N[B].T)
    T = np.zeros((m, R.size))
    T[R, np.arange(R.size)] = 1.0
    T[B] = _without_rounding(-inverse @ N[R].T, abs(inverse) @ abs(N[R].T))
    l0 = spread(_without_rounding(inverse @ balance, abs(inverse) @ (abs(reduced.motions).T @ problem.load_size)), B, m)
    # w_R - (N_R N_B^-1) w_B = T'(q + W l), for the motions a drop out of T'N = 0.
    offset, matrix = np.zeros(m), np.zeros((m, m))
    offset[B] = l0[B]
    offset[R] = _without_rounding(T.T @ (q + W @ l0), abs(T).T @ (lengths + sizes @ abs(l0)))
    matrix[np.ix_(B, R)] = T[B]
    matrix[np.ix_(R, B)] = -T[B].T
    matrix[np.ix_(R, R)] = _without_rounding(T.T @ W @ T, abs(T).T @ sizes @ abs(T))
    return Complementarity(offset, matrix, B)


def _without_rounding(values: Dense, sizes: Dense) -> Dense:
    """Return values, set to zero where they are within the rounding of terms of these sizes.

    Pivots depend on signs, so rounding errors must be exactly zero, as for a contact on a tied unknown, which has
    neither gap nor compliance. Sizes are then those of other contacts: compliances of the row's own unknowns with all
    others fixed, and the largest motion.
    """
    return np.where(abs(values) > TEXTBOOK_ROUNDING * sizes, values, 0.0)


def expand(
    problem: ContactProblem, reduced: Compliance, lcp: Complementarity, force: Vector, gap: Vector
) -> tuple[Vector, Vector]:
    """Return displacements and tie forces of contact forces; gaps of the exchanged contacts determine rigid motions.

    Parameters
    ----------
    problem : ContactProblem
    reduced : Compliance
    lcp : Complementarity
    force, gap : (m,) arrays, the solution of the complementarity problem
    """
    displacement = reduced.free - reduced.response @ force
    B = lcp.exchanged
    if B.size:
        approach = (problem.gap - problem.normal @ displacement - gap)[B]
        displacement = displacement + reduced.motions @ np.linalg.solve((problem.normal @ reduced.motions)[B], approach)
    return displacement, reduced.tie_free - reduced.tie_response @ force


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
    answer = Answer(displacement, force, None, tie_force)
    return Candidate(answer, pivots, claimed=not status, status=f"lemke: {status or 'solved'}")


def lemke_basis(q: Vector, M: Dense, limit: int, time_limit: float | None = None) -> tuple[Mask, int, str]:
    """Follow Lemke's path to w = q + M z, w >= 0, z >= 0, w'z = 0.

    Raises NotConverged: the path ends in a ray.

    Parameters
    ----------
    q : (m,) array
    M : (m, m) array, positive semidefinite
    limit : the largest number of pivots
    time_limit : seconds

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
    # A pivot of rounding size relative to its column is skipped.
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
    """Return w and z of a complementary basis, computed from the data without the rounding errors of the pivots."""
    q, M = lcp.offset, lcp.matrix
    z = np.zeros(q.size)
    if np.any(basis):
        # Least squares, as rows of contacts may be dependent.
        z[basis] = np.linalg.lstsq(M[np.ix_(basis, basis)], -q[basis], rcond=None)[0]
    w = q + M @ z
    w[basis] = 0.0
    return w, z


def solve_projected_gauss_seidel(problem: ContactProblem, settings: Settings) -> Candidate:
    """Sweep over the contacts, l_i <- max(0, l_i - w_i / W_ii) with w = q + W l, until complementarity holds.

    Raises Unsupported: bodies are held by contacts alone: W does not exist.

    Returns
    -------
    Candidate
        `history` is max over i of |min(w_i, W_ii l_i)| / (|q_i| + sum_j |W_ij| l_j), one number a sweep; the method
        ends when it is at most `settings.tolerance`, and claims no answer after `settings.max_iter` (20000) sweeps.
    """
    name = "projected-gauss-seidel"
    reduced = compliance(name, problem)
    if reduced.motions.shape[1]:
        raise Unsupported(f"{name}: bodies that only contacts hold have no compliance E K^-1 E'; use lemke")
    lcp = complementarity_problem(problem, reduced)
    start = np.zeros(problem.contacts) if settings.warm_start is None else settings.warm_start.answer.normal_force
    force, history = _sweeps(lcp, np.maximum(start, 0.0), settings)
    displacement, tie_force = expand(problem, reduced, lcp, force, lcp.offset)
    claimed = history[-1] <= settings.tolerance
    status = f"{name}: {'converged to' if claimed else 'stopped at'} {history[-1]:.1e} after {len(history)} sweeps"
    return Candidate(Answer(displacement, force, None, tie_force), len(history), claimed, status, history)


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
        name="lemke",
        kind=COMPLEMENTARITY,
        solve=solve_lemke,
        polish=True,
        scale=True,
        sparse=False,
        note="complementary pivoting with lexicographic ratio tests; finite",
    ),
    Method(
        name="projected-gauss-seidel",
        kind=COMPLEMENTARITY,
        solve=solve_projected_gauss_seidel,
        polish=True,
        scale=True,
        semidefinite=False,
        sparse=False,
        knob="tolerance",
        note="one contact at a time; needs bodies that are held without contact",
    ),
)
