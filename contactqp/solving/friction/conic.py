"""Solve quadratic programs over second-order cones by Clarabel, SCS or any solver of cvxpy.

    min 1/2 x'P x + c'x    over    A x + y = b,  y in zeros x nonnegatives x second-order cones

in that order, the cones of one size.

The existence of an answer with Coulomb friction is examined by the balance of forces in their cones, and by the test of
Acary and others (2011): if some velocity u = W y + V l + q lies inside all dual cones K* = {u_N >= mu |u_T|}, the map
from shifts to |u_T| has a fixed point, and there is a solution for any coefficient of friction. It is sufficient, not
necessary.
"""

from __future__ import annotations

import importlib
import itertools
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed, BackendMissing, NoEquilibrium, of_backend
from contactqp.linalg.dense import BALANCED, unknown_scale
from contactqp.linalg.exact_algebra import Polyhedron, Row, solutions
from contactqp.linalg.existence import driven_coordinates, driven_in_cones
from contactqp.linalg.extended import SparseRows, extend
from contactqp.linalg.least_norm import WITHIN_ROUNDING
from contactqp.linalg.measures import forces_that_meet
from contactqp.linalg.nonnegative import highs
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb import corners
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer
from contactqp.solving.friction.local_form import LocalForm
from contactqp.solving.methods import Settings
from contactqp.solving.methods.backends import collected_words

SOLVERS = ("clarabel", "scs", "cvxpy")
# Forces of interior-point methods have errors of the square root of the duality gap, so that the square of this part of
# the tolerance is required, down to rounding.
TIGHTER, TIGHTEST = 0.1, 1e-12


@dataclass(frozen=True, eq=False)
class ConicProgram:
    """One program; the rows of A are `zeros`, then `nonnegatives`, then `cones` of `width` rows each."""

    P: Any  # (n, n) symmetric, positive semidefinite
    c: Vector
    A: Any
    b: Vector
    zeros: int
    nonnegatives: int
    cones: int
    width: int


def solve_conic(program: ConicProgram, solver: str, settings: Settings) -> tuple[Vector, Vector]:
    """Solve a conic program for x and the multipliers z of its rows, P x + c + A'z = 0.

    Raises BackendMissing, BackendFailed: the solver is not installed; it raised, or found nothing finite.
    """
    found = {"clarabel": _clarabel, "scs": _scs, "cvxpy": _cvxpy}[solver](program, settings)
    if found is None or not all(np.all(np.isfinite(part)) for part in found):
        raise BackendFailed(f"{solver}: no finite values")
    return found


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise BackendMissing(f"{name} is not installed: pip install {name}") from error


def _clarabel(program: ConicProgram, settings: Settings) -> tuple[Vector, Vector] | None:
    clarabel = _module("clarabel")
    cones = [clarabel.ZeroConeT(program.zeros), clarabel.NonnegativeConeT(program.nonnegatives)]
    cones += [clarabel.SecondOrderConeT(program.width)] * program.cones
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = max((settings.tolerance * TIGHTER) ** 2, TIGHTEST)
    if settings.time_limit is not None:
        options.time_limit = settings.time_limit
    P, A = sp.csc_matrix(sp.triu(program.P)), sp.csc_matrix(program.A)
    with of_backend("clarabel"):
        solution = clarabel.DefaultSolver(P, program.c, A, program.b, cones, options).solve()
    # The caller judges the answer whatever its status.
    return np.array(solution.x), np.array(solution.z)


def _scs(program: ConicProgram, settings: Settings) -> tuple[Vector, Vector] | None:
    scs = _module("scs")
    data = dict(P=sp.csc_matrix(sp.triu(program.P)), c=program.c, A=sp.csc_matrix(program.A), b=program.b)
    cones = dict(z=program.zeros, l=program.nonnegatives, q=[program.width] * program.cones)
    tolerance = max(settings.tolerance * 1e-2, TIGHTEST)
    limit = {} if settings.time_limit is None else {"time_limit_secs": settings.time_limit}
    with collected_words():
        try:
            solution = scs.SCS(data, cones, verbose=False, eps_abs=tolerance, eps_rel=tolerance, **limit).solve()
        except ValueError as error:
            raise BackendFailed(f"scs: {error}") from error
    return np.asarray(solution["x"]), np.asarray(solution["y"])


def _cvxpy(program: ConicProgram, settings: Settings) -> tuple[Vector, Vector] | None:
    cp = _module("cvxpy")
    x = cp.Variable(len(program.c))
    energy = 0.5 * cp.quad_form(x, cp.psd_wrap(sp.csc_matrix(program.P))) + program.c @ x
    A, b = sp.csr_matrix(program.A), program.b
    z, first = program.zeros, program.zeros + program.nonnegatives
    constraints: list[Any] = []
    if z:
        constraints.append(A[:z] @ x == b[:z])
    if program.nonnegatives:
        constraints.append(A[z:first] @ x <= b[z:first])
    if program.cones:
        room = cp.reshape(b[first:] - A[first:] @ x, (program.width, program.cones), order="F")
        constraints.append(cp.SOC(room[0], room[1:], axis=0))
    model = cp.Problem(cp.Minimize(energy), constraints)
    solver = settings.options.get("solver", "CLARABEL")
    with collected_words(), of_backend("cvxpy"):
        model.solve(solver=solver, verbose=False)
    if x.value is None:
        return None
    multipliers = [np.atleast_1d(constraint.dual_value) for constraint in constraints[: bool(z) + bool(first - z)]]
    if program.cones:
        top, rest = constraints[-1].dual_value
        multipliers.append(
            np.vstack([np.atleast_2d(top), np.asarray(rest).reshape(-1, program.cones)]).ravel(order="F")
        )
    return np.asarray(x.value), np.concatenate(multipliers) if multipliers else np.zeros(0)


def diagonal_rows(values: Array) -> Any:
    """Return a sparse diagonal matrix of the entries of an array."""
    return sp.csc_array(sp.diags(np.ravel(values)))


SOLVER, SETTINGS = "clarabel", Settings(tolerance=1e-9)


def refuse_unbalanced(form: LocalForm) -> None:
    """Raise NoEquilibrium if the load of a local problem drives free joints in a way that no force of a cone resists.

    The proof is a motion g of joints without compliance with V g in K* at every contact and s'g > 0: all forces r of
    the cones satisfy r'V g >= 0, but balance requires r'V g = -s'g. It is searched within polyhedra in K* and checked
    in extended precision.
    """
    hard = np.flatnonzero(form.joint_signs < 0)
    V, s = form.V[:, hard], form.s[hard]
    if not np.any(s) or np.any(form.R[:, hard]):
        return
    V = V.reshape(form.m, form.d, len(hard))
    motion, rows = driven_in_cones(
        s,
        partial(_resisting, V, form.mu),
        lambda rows: rows / np.where((size := np.max(abs(rows), axis=1, keepdims=True)) > 0, size, 1.0),
        np.zeros((0, len(hard))),
        (lambda along: V[:, 1:] @ along) if form.d > 2 else None,
    )
    if motion is None:
        return
    resisted = (SparseRows(sp.csr_matrix(rows)) @ extend(motion)).double()
    terms = (abs(V[:, 0]) + form.mu[:, None] * abs(V[:, 1:]).sum(axis=1)) @ abs(motion)  # of which rows are sums
    rounding = WITHIN_ROUNDING * np.tile(terms, len(rows) // form.m)
    if np.any(resisted > np.maximum(BALANCED * (abs(rows) @ abs(motion)), rounding)):
        return
    if extend(s).dot(extend(motion)) > BALANCED * float(abs(s) @ abs(motion)):
        raise NoEquilibrium("friction: the load drives a rigid motion that neither contacts nor friction hold")


def _resisting(V: Array, mu: Vector, sides: Array | None, within: bool) -> Array:
    """Return rows whose products with g are not positive where V g, of V (m, d, p), lies in all dual cones K*.

    Without `within` they may not be positive elsewhere, too. The polygons of the cones have these sides (m, k).
    """
    directions = corners(len(mu), V.shape[1] - 1, sides, within)
    return np.vstack([-V[:, 0] + mu[:, None] * np.einsum("iw,iwp->ip", one, V[:, 1:]) for one in directions])


# The smallest relative eigenvalue of a regular matrix; the largest denominators of a proof's weights; the number of
# contacts up to which dense eigenvalues are cheap.
REGULAR, LARGEST_DENOMINATOR, MOST_WEIGHTED = 1e-10, 10_000, 300


def refuse_penetrated(form: LocalForm) -> None:
    """Raise NoEquilibrium if no forces at all keep the contacts of a local problem from penetrating.

    The proof are weights y >= 0 of normal velocities that no force changes, W_N'y = 0 and V_N'y = 0, with y'q_N < 0:
    then y'u_N = y'q_N < 0, where no u_N may be negative. For forces of the cones alone c = W_N'y with c'r <= 0 would
    do, but then y'W_NN y = y'c_N <= 0, and c is zero where W is semidefinite. A linear program proposes the weights,
    which are verified in rational numbers. Problems with more than 300 contacts are not examined.
    """
    d = form.d
    if form.m > MOST_WEIGHTED or not np.any(form.q[::d] < 0):
        return
    W = form.W[::d].toarray() if form.sparse else form.W[::d]
    values = np.linalg.eigvalsh((W[:, ::d] + W[:, ::d].T) / 2)
    if values[0] > REGULAR * values[-1]:
        return
    rows = np.vstack([W.T, form.V[::d].T])
    size = np.max(abs(rows), axis=1)
    weights = driven_coordinates(-form.q[::d], -np.eye(form.m), rows[size > 0] / size[size > 0, None])
    if weights is None or not np.any(weights > 0):
        return
    largest = float(np.max(weights))
    y = [Fraction(max(w, 0.0) / largest).limit_denominator(LARGEST_DENOMINATOR) for w in weights.tolist()]
    scale = form.problem.contact_scale.tolist()
    if _proven(form.problem, [w * Fraction(s) for w, s in zip(y, scale, strict=True)]):
        where = ", ".join(form.problem.contact_name(i) for i in range(form.m) if y[i])
        raise NoEquilibrium(f"no contact forces keep {where} from being penetrated, proven in rational numbers")


# Directions of the plane with rational unit vectors: a polygon of tangents to the circle, which it exceeds by 1 %.
_FIRST = [(1, 0, 1), (24, 7, 25), (12, 5, 13), (15, 8, 17), (4, 3, 5), (3, 4, 5), (8, 15, 17), (5, 12, 13), (7, 24, 25)]
_QUADRANT = [(Fraction(x, r), Fraction(y, r)) for x, y, r in _FIRST]
TANGENTS = [side for x, y in _QUADRANT for side in ((x, y), (-y, x), (-x, -y), (y, -x))]
# Contacts and unknown displacements and forces up to which all choices of closed contacts are looked at in rationals.
MOST_CLOSED, MOST_EQUATIONS = 4, 24
# Rounding of the data could make no more of what is left unbalanced, and of overlaps, than this part of all that meets.
UNBALANCED = 1e-6


def refuse_unbalanced_in_space(problem: ContactProblem, answer: Answer) -> None:
    """Raise NoEquilibrium if no forces in cones around those of friction balance the load, whichever contacts close.

    With the contacts of a set closed, E_N u = g there and no force elsewhere, K u + E'l + A'n = f is linear in u and
    the forces; that l_N >= 0, |l_T| <= mu l_N in a polygon around the circle, and gaps >= 0 has no solution is proven
    by the simplex method in rational numbers, for each set, where floats find much more missing than rounding of the
    forces and lengths that meet in some answer. Larger problems, and those in the plane, whose combinations are listed,
    are not examined.
    """
    n, m, k = problem.dimension, problem.contacts, problem.ties
    if problem.tangent is None or problem.friction is None or problem.tangent.shape[0] == m:
        return
    if m > MOST_CLOSED or n + 3 * m + k > MOST_EQUATIONS:
        return
    sets, scale = list(itertools.product((True, False), repeat=m)), unknown_scale(problem)
    size = float(np.max(forces_that_meet(problem, answer) * scale, initial=0.0))
    for rows, limit in ((problem.normal, problem.gap), (problem.tie, problem.tie_value)):
        length = abs(rows) @ abs(answer.displacement) + abs(np.where(np.isfinite(limit), limit, 0.0))
        unit = abs(rows) @ scale
        size = max(size, float(np.max(length / np.where(unit > 0, unit, np.inf), initial=0.0)))
    if not 0 < size < np.inf or any(_missing(problem, scale, size, closed) <= UNBALANCED for closed in sets):
        return
    columns, reachable = n + 3 * m + k, np.isfinite(problem.gap)
    rows = sp.hstack([problem.stiffness, problem.normal.T, problem.tangent.T, problem.tie.T])
    equations = [*_equations(rows, problem.load, columns), *_equations(problem.tie, problem.tie_value, columns)]
    touching = _equations(problem.normal, np.where(reachable, problem.gap, 0.0), columns)
    friction = [Fraction(mu) for mu in problem.friction.tolist()]
    for closed in sets:
        if np.any(~reachable & closed):
            continue
        held, rooms = [*equations], list[Row]()
        for i, mu in enumerate(friction):
            push, *drag = n + i, n + m + 2 * i, n + m + 2 * i + 1
            if closed[i]:
                held.append(touching[i])
                rooms.append(_few({push: Fraction(1)}, columns))
                rooms += [_few({push: mu, drag[0]: -x, drag[1]: -y}, columns) for x, y in TANGENTS]
            else:
                held += [_few({force: Fraction(1)}, columns) for force in (push, *drag)]
                rooms += [[*(-x for x in touching[i][:-1]), touching[i][-1]]] * int(reachable[i])
        if (found := solutions(held, columns)) is not None:
            seen = [(found.image(room[:-1]), room[-1]) for room in rooms]
            region = Polyhedron(
                [at + more for (at, _), more in seen], [slope for (_, slope), _ in seen], len(found.free)
            )
            if not region.empty:
                return
    raise NoEquilibrium(
        "whichever contacts close, no normal forces that push, with friction of at most mu times these, balance the "
        "load, proven in rational numbers; lower the load to what friction holds, or hold the body"
    )


def _missing(problem: ContactProblem, scale: Vector, size: float, closed: tuple[bool, ...]) -> float:
    """Return the least t to which displacements and forces in their polygons leave the conditions of a set unmet.

    Unknowns are divided by their scale and all by a size, both of the energy's root; rows have unit length. Residuals
    of the balance, of ties and of closed contacts are at most t, and gaps of the others at least -t.
    """
    n, m, k, shut = problem.dimension, problem.contacts, problem.ties, np.array(closed, dtype=bool)
    K = sp.csr_array(problem.stiffness).toarray() * np.outer(scale, scale)
    parts = [sp.csr_array(part).toarray() * scale for part in (problem.normal, problem.tangent, problem.tie)]
    E, T, A = (part / np.where((length := np.linalg.norm(part, axis=1)) > 0, length, 1.0)[:, None] for part in parts)
    E_length, T_length, A_length = (np.linalg.norm(part, axis=1) for part in parts)
    gap = np.where(E_length > 0, problem.gap, 0.0) / np.where(E_length > 0, E_length, 1.0) / size
    tied = problem.tie_value / np.where(A_length > 0, A_length, 1.0) / size
    balance = np.hstack([K, E.T, T.T, A.T])
    still = np.zeros((1, 3 * m + k))
    near = np.isfinite(gap)
    lengths_of = [np.hstack([rows, np.repeat(still, len(rows), axis=0)]) for rows in (A, E[shut], E[near])]
    equal = np.vstack([balance, *lengths_of[:2]])
    right = np.concatenate([problem.load * scale / size, tied, gap[shut]])
    cones, friction = np.zeros((m * len(TANGENTS), balance.shape[1])), np.asarray(problem.friction)
    for i in range(m):
        own = slice(i * len(TANGENTS), (i + 1) * len(TANGENTS))
        cones[own, n + i] = -friction[i]
        for axis, j in enumerate((2 * i, 2 * i + 1)):
            cones[own, n + m + j] = np.array(TANGENTS, dtype=float)[:, axis] * E_length[i] / (T_length[j] or 1.0)
    unmet = np.vstack([equal, -equal, lengths_of[2]])
    rows = np.vstack([np.hstack([unmet, -np.ones((len(unmet), 1))]), np.hstack([cones, np.zeros((len(cones), 1))])])
    bounds: list[tuple[float | None, float | None]] = [(None, None)] * balance.shape[1] + [(0.0, None)]
    for i in range(m):
        bounds[n + i] = (0.0, None if shut[i] else 0.0)
    limits = np.concatenate([right, -right, gap[near], np.zeros(len(cones))])
    found = highs(np.append(np.zeros(balance.shape[1]), 1.0), A_ub=rows, b_ub=limits, bounds=bounds)
    return 0.0 if found is None else float(found.x[-1])


def _equations(rows: Any, right: Vector, columns: int) -> list[Row]:
    """Return rows and their right-hand sides as Fractions, zeros between them."""
    dense = sp.csr_array(rows).toarray()
    none = [Fraction(0)] * (columns - dense.shape[1])
    return [[*map(Fraction, row), *none, Fraction(b)] for row, b in zip(dense.tolist(), right.tolist(), strict=True)]


def _few(entries: dict[int, Fraction], columns: int) -> Row:
    """Return a row with few entries, its right-hand side zero."""
    return [entries.get(j, Fraction(0)) for j in range(columns + 1)]


def _proven(problem: LocalProblem, weights: list[Fraction]) -> bool:
    """Return whether these weights of normal velocities (m,) prove infeasibility in rational numbers."""
    d, driven = problem.dimension, Fraction(0)
    rows = [sp.csr_array(some) for some in (problem.delassus, problem.bilateral)]
    sums = [[Fraction(0)] * some.shape[1] for some in rows]
    for i in np.flatnonzero([weight > 0 for weight in weights]).tolist():
        driven += weights[i] * Fraction(float(problem.offset[d * i]))
        for some, total in zip(rows, sums, strict=True):
            own = slice(some.indptr[d * i], some.indptr[d * i + 1])
            for j, value in zip(some.indices[own].tolist(), some.data[own].tolist(), strict=True):
                total[j] += weights[i] * Fraction(value)
    return driven < 0 and not any(map(any, sums))


def balancing_forces(form: LocalForm) -> Array | None:
    """Return forces (m, d) in their cones with the least |V'r + s|; None where there is no load s."""
    hard = np.flatnonzero(form.joint_signs < 0)
    V, s = form.V[:, hard], form.s[hard]
    if not np.any(s):
        return None
    size, p = form.m * form.d, len(hard)
    slope = np.ones((form.m, form.d))
    slope[:, 0] = form.mu
    normal = sp.csr_array((-np.ones(form.m), (np.arange(form.m), form.d * np.arange(form.m))), shape=(form.m, size))
    # min 1/2 |w|^2 over w = (V'r + s) / |s|: sparse, as 1/2 |V'r + s|^2 is not.
    load = float(np.linalg.norm(s))
    cones = sp.hstack([sp.vstack([normal, -diagonal_rows(slope)]), sp.csr_array((form.m + size, p))])
    program = ConicProgram(
        P=sp.csc_array(sp.diags(np.append(np.zeros(size), np.ones(p)))),
        c=np.zeros(size + p),
        A=sp.csc_array(sp.vstack([sp.hstack([sp.csr_array(V.T), -sp.identity(p)]), cones])),
        b=np.append(-s / load, np.zeros(form.m + size)),
        zeros=p,
        nonnegatives=form.m,
        cones=form.m,
        width=form.d,
    )
    try:
        r = load * solve_conic(program, SOLVER, SETTINGS)[0][:size]
    except BackendFailed:
        return None
    return r.reshape(form.m, form.d)


def interior_margin(form: LocalForm) -> float:
    """Return the largest x <= 1 with W y + V l + q - x e_N in K* for some y and l; where positive, a solution exists.

    Scaled: contacts have a compliance of one and q has entries of size one.
    """
    soft, hard = np.flatnonzero(form.joint_signs > 0), np.flatnonzero(form.joint_signs < 0)
    size, p = form.m * form.d, form.joints
    order = np.concatenate([soft, hard])
    V, q = form.V[:, order], form.q.reshape(form.m, form.d)
    slope = np.ones((form.m, form.d))
    slope[:, 1:] = form.mu[:, None]
    scale = diagonal_rows(slope)
    towards = np.zeros((form.m, form.d))
    towards[:, 0] = -1.0
    reach = sp.hstack([sp.csr_array(form.W), sp.csr_array(V), sp.csr_array(towards.reshape(-1, 1))])
    balance = sp.hstack(
        [
            sp.csr_array(form.V[:, soft].T),
            sp.csr_array(form.R[np.ix_(soft, soft)]),
            sp.csr_array((len(soft), len(hard) + 1)),
        ]
    )
    limit = sp.csr_array(([1.0], ([0], [size + p])), shape=(1, size + p + 1))
    program = ConicProgram(
        P=sp.csc_array((size + p + 1, size + p + 1)),
        c=np.append(np.zeros(size + p), -1.0),
        A=sp.csc_array(sp.vstack([balance, limit, -scale @ reach])),
        b=np.concatenate([-form.s[soft], [1.0], (slope * q).ravel()]),
        zeros=len(soft),
        nonnegatives=1,
        cones=form.m,
        width=form.d,
    )
    x, _ = solve_conic(program, SOLVER, SETTINGS)
    return float(x[-1])
