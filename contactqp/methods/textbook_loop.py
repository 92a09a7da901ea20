"""The textbook's active-set loop, and the linear algebra that the five classical enforcements share.

The course chapter turns inequality contact into a sequence of equality problems: solve with the contacts that are
thought closed; contacts that penetrate come in, contacts in tension go out; repeat until nothing changes. How a closed
contact is enforced is the only thing in which master-slave, multipliers, penalty, perturbed and augmented Lagrangian
differ, so each of them is one function from a set of closed contacts to a `Step`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, NoEquilibrium, NotConverged
from contactqp.methods.method import Settings
from contactqp.problem import ContactProblem, Matrix, Vector
from contactqp.solution import Candidate

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

# What a chain of a few hundred rounded additions can make of zero, relative to the size of its terms.
ROUNDING = 1e3 * float(np.finfo(float).eps)


class SingularSystem(NotConverged):
    """A textbook system is singular: too few of its contacts are closed."""


@dataclass(frozen=True, eq=False)
class Step:
    """The equality problem's answer for one set of closed contacts."""

    displacement: Vector  # (n,)
    normal_force: Vector  # (m,), zero on the open contacts
    tie_force: Vector  # (k,)
    bound: Mask  # (m,) the closed contacts that took part; dependent rows may leave some out


# A mask of the closed contacts, and an order of preference among them should their rows be dependent.
Enforcement = Callable[[Mask, Indices], Step]


def active_set_loop(
    name: str,
    problem: ContactProblem,
    settings: Settings,
    enforce: Enforcement,
    stiffness: float | Vector = 0.0,
) -> Candidate:
    """Repeat `enforce` on the set of closed contacts until the set no longer changes.

    The first set is that of the contacts penetrated in the free solution; of all contacts where the bodies float
    freely, so that there is no free solution.

    Parameters
    ----------
    name : str
        The method's name, for messages.
    enforce : Enforcement
        Solves the equality problem of one set of closed contacts.
    stiffness : float or (m,) array
        Force that one unit of gap makes in a closed contact [force / length]: beta where contacts are springs, 0 where
        they are exact. Rounding in the gap is seen in the force by this factor.

    Returns
    -------
    Candidate
        `history` is the number of contacts that changed sides, one number an iteration. Not claimed where the loop
        cycles, or where it stops at `settings.max_iter` (10 m + 20) or `settings.time_limit`.

    Raises
    ------
    NotConverged
        The system of some set is singular.
    """
    started, history, seen = time.perf_counter(), list[float](), set[bytes]()
    limit = settings.max_iter or 10 * problem.contacts + 20
    sizes = _Sizes.of(problem)
    closed, preference = _warm_set(problem, settings), np.arange(problem.contacts)
    while True:
        step = enforce(closed, preference) if history else _first_step(enforce, closed, preference)
        incoming, outgoing = _changes(problem, sizes, step, stiffness)
        history.append(float(np.count_nonzero(incoming | outgoing)))
        status = _stop(history, step.bound.tobytes() in seen, limit, settings, started)
        if status:
            return _candidate(step, history, f"{name}: {status}")
        seen.add(step.bound.tobytes())
        closed = (step.bound & ~outgoing) | incoming
        # Where rows are dependent, the contact that has just been seen to penetrate is the one that binds.
        preference = np.argsort(~incoming, kind="stable")


def _candidate(step: Step, history: list[float], status: str) -> Candidate:
    return Candidate(
        step.displacement,
        step.normal_force,
        step.tie_force,
        iterations=len(history),
        claimed=history[-1] == 0,
        status=status,
        history=tuple(history),
    )


def _warm_set(problem: ContactProblem, settings: Settings) -> Mask:
    if settings.warm_start is None:
        return np.zeros(problem.contacts, dtype=bool)
    return np.asarray(settings.warm_start.normal_force > 0)


def _first_step(enforce: Enforcement, closed: Mask, preference: Indices) -> Step:
    try:
        return enforce(closed, preference)
    except SingularSystem:
        if closed.all():
            raise
        return enforce(np.ones_like(closed), preference)


def _stop(history: list[float], repeated: bool, limit: int, settings: Settings, started: float) -> str:
    """Why the loop ends here, or nothing."""
    if history[-1] == 0:
        return "the set of closed contacts no longer changes"
    if repeated:
        return "the active-set loop cycles"
    if len(history) >= limit:
        return f"stopped after {limit} iterations"
    if settings.time_limit is not None and time.perf_counter() - started > settings.time_limit:
        return f"stopped after {settings.time_limit:g} s"
    return ""


def binding_rows(name: str, problem: ContactProblem, closed: Mask, preference: Indices) -> tuple[Matrix, Vector, Indices, Indices]:
    """The rows of the ties and of the closed contacts, without those that follow from others.

    Ties come first, then the closed contacts in the order of `preference`; a row that depends on those before it is left
    out, and its multiplier is zero.

    Returns
    -------
    rows : (r, n) csr_array, values : (r,)
        [A; E_N] u = [b; g].
    ties, contacts : index arrays
        Which ties and which contacts the rows are, in this order.

    Raises
    ------
    NoEquilibrium
        Ties contradict each other.
    """
    ties = independent_rows(problem.tie)
    _refuse_contradiction(name, problem, ties)
    candidates = preference[closed[preference]]
    both = sp.csr_array(sp.vstack([problem.tie[ties], problem.normal[candidates]], format="csr"))
    kept = independent_rows(both)
    contacts = candidates[kept[kept >= ties.size] - ties.size]
    rows = sp.csr_array(sp.vstack([problem.tie[ties], problem.normal[contacts]], format="csr"))
    return rows, np.concatenate([problem.tie_value[ties], problem.gap[contacts]]), ties, contacts


def _refuse_contradiction(name: str, problem: ContactProblem, ties: Indices) -> None:
    if ties.size == problem.ties:
        return
    A, b = problem.tie.toarray(), problem.tie_value
    u = np.linalg.lstsq(A[ties], b[ties], rcond=None)[0]
    wrong = np.abs(A @ u - b) > ROUNDING * (np.abs(A) @ np.abs(u) + np.abs(b))
    if np.any(wrong):
        raise NoEquilibrium(f"{name}: tie {int(np.flatnonzero(wrong)[0])} contradicts the other ties")


def independent_rows(rows: Matrix) -> Indices:
    """Indices, increasing, of the rows that do not depend on the rows before them."""
    count = rows.shape[0]
    if count < 2:
        return np.arange(count)
    unit = rows[:, np.unique(rows.indices)].toarray()
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    # Unit rows whose Gram matrix is this far from singular are independent; the common case, decided by one product.
    off_diagonal = np.abs(unit @ unit.T).sum(axis=1) - 1.0
    if np.all(off_diagonal < 0.5):  # Gershgorin
        return np.arange(count)
    basis, kept = np.zeros((min(unit.shape), unit.shape[1])), list[int]()
    for i, row in enumerate(unit):
        rest = row - basis[: len(kept)].T @ (basis[: len(kept)] @ row)
        rest -= basis[: len(kept)].T @ (basis[: len(kept)] @ rest)  # twice is enough (Kahan, Parlett)
        size = float(np.linalg.norm(rest))
        if size > ROUNDING and len(kept) < len(basis):
            basis[len(kept)] = rest / size
            kept.append(i)
    return np.array(kept, dtype=np.intp)


def spread(values: Vector, where: Indices, size: int) -> Vector:
    """An array of `size` zeros with `values` at the indices `where`."""
    full = np.zeros(size)
    full[where] = values
    return full


@dataclass(frozen=True, eq=False)
class _Sizes:
    """Absolute values of the problem's matrices, for the size of what rounding can do."""

    stiffness: Matrix
    normal: Matrix
    tie: Matrix

    @classmethod
    def of(cls, problem: ContactProblem) -> _Sizes:
        return cls(abs(problem.stiffness), abs(problem.normal), abs(problem.tie))


def _changes(problem: ContactProblem, sizes: _Sizes, step: Step, stiffness: float | Vector) -> tuple[Mask, Mask]:
    """Open contacts that penetrate and closed contacts in tension, both by more than rounding."""
    closed = step.bound
    if problem.contacts == 0:
        return closed, closed
    u, force = np.abs(step.displacement), np.abs(step.normal_force)
    lengths = sizes.normal @ u + np.abs(problem.gap)
    forces = sizes.stiffness @ u + sizes.normal.T @ force + sizes.tie.T @ np.abs(step.tie_force) + np.abs(problem.load)
    # The least force that is felt at one of the contact's unknowns: min over j of F_j / |E_ij|.
    felt = np.minimum.reduceat(forces[sizes.normal.indices] / sizes.normal.data, sizes.normal.indptr[:-1])
    penetration = problem.normal @ step.displacement - problem.gap
    incoming = ~closed & (penetration > ROUNDING * lengths)
    outgoing = closed & (step.normal_force < -ROUNDING * (felt + stiffness * lengths))
    return incoming, outgoing


def contact_stiffness(name: str, key: str, value: Any, contacts: int, *, zero: bool = False) -> Vector:
    """A stiffness per contact (m,) from a number or an array of m numbers, positive (or not negative) and finite.

    Raises
    ------
    InvalidProblem
        It is anything else.
    """
    try:
        values = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    allowed = (values >= 0 if zero else values > 0) & np.isfinite(values)
    if values.shape not in ((), (contacts,)) or not np.all(allowed):
        sign = "not negative" if zero else "positive"
        raise InvalidProblem(f"{name}: {key}: expected a {sign} finite number or {contacts} of them, got {value!r}")
    return np.broadcast_to(values, (contacts,)).astype(float)


def springs(problem: ContactProblem, closed: Mask, beta: Vector) -> tuple[Matrix, Vector]:
    """K + E' beta E and f + E' beta g over the closed contacts: the left and right side of the course chapter's eq. 2.25."""
    E = problem.normal[np.flatnonzero(closed)]
    spring = E.T @ sp.diags(beta[closed]) @ E
    K = problem.stiffness + (spring if sp.issparse(problem.stiffness) else spring.toarray())
    return K, problem.load + E.T @ (beta[closed] * problem.gap[closed])


def solve_bordered(
    name: str, matrix: Matrix, load: Vector, rows: Matrix, values: Vector, corner: Vector | None = None
) -> tuple[Vector, Vector]:
    """Solve [[matrix, rows'], [rows, diag(corner)]] {x; y} = {load; values}.

    Parameters
    ----------
    matrix : (n, n), sparse or dense
    load : (n,)
    rows : (r, n) csr_array
    values : (r,)
    corner : (r,), optional
        Diagonal of the lower right block, zero by default.

    Raises
    ------
    NotConverged
        The system is singular.
    """
    n, r = matrix.shape[0], rows.shape[0]
    corner = np.zeros(r) if corner is None else corner
    if r == 0:
        return solve_linear(name, matrix, load), np.zeros(0)
    if sp.issparse(matrix):
        system = sp.bmat([[matrix, rows.T], [rows, sp.diags(corner)]], format="csc")
    else:
        C = rows.toarray()
        system = np.block([[matrix, C.T], [C, np.diag(corner)]])
    solution = solve_linear(name, system, np.concatenate([load, values]))
    return solution[:n], solution[n:]


def solve_linear(name: str, matrix: Matrix, load: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve matrix x = load by LU with partial pivoting, in the numbers as they are.

    A bad condition alone refuses nothing: rounding is to show as it would in the textbook's own program. Only a matrix
    that is singular however its rows and columns are scaled is refused.

    Raises
    ------
    NotConverged
        The matrix is singular.
    """
    if matrix.shape[0] == 0:
        return np.zeros_like(load)
    solve = _sparse_lu(matrix) if sp.issparse(matrix) else _dense_lu(matrix)
    if solve is None or _hopeless(matrix, solve):
        raise SingularSystem(
            f"{name}: the bodies are not held by the contacts that are closed and by the ties (the system of equations is singular)"
        )
    return np.asarray(solve(load))


Solver = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def _dense_lu(matrix: NDArray[np.float64]) -> Solver | None:
    from scipy.linalg import lapack

    # LAPACK itself rather than scipy.linalg.lu_factor: a zero pivot is a return code here, not a warning.
    factors, pivots, zero_pivot = lapack.dgetrf(matrix)
    if zero_pivot:
        return None
    return lambda load: np.asarray(lapack.dgetrs(factors, pivots, load)[0])


def _sparse_lu(matrix: Matrix) -> Solver | None:
    from scipy.sparse.linalg import splu

    try:
        factors = splu(sp.csc_array(matrix))
    except RuntimeError:  # "Factor is exactly singular"
        return None
    return lambda load: np.asarray(factors.solve(load))


def _hopeless(matrix: Matrix, solve: Solver) -> bool:
    """Whether 1 / (|S M S| |(S M S)^-1|) <= n eps in the 1-norm, with the S that equilibrates the symmetric M.

    With S, stiffness beside penalty or beside multiplier rows is not mistaken for singularity.
    """
    from scipy.sparse.linalg import LinearOperator, onenormest

    n = matrix.shape[0]
    size = abs(matrix)
    scale = np.ones(n)
    for _ in range(3):  # Ruiz equilibration; it settles in two or three sweeps
        largest = _row_maxima(size, scale)
        scale = scale / np.sqrt(np.where(largest > 0, largest, 1.0))
    norm = float(np.max(scale * (size.T @ scale)))

    def scaled_solve(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(solve(np.ravel(x) / scale) / scale)

    inverse = LinearOperator((n, n), matvec=scaled_solve, rmatvec=scaled_solve, dtype=float)
    with np.errstate(all="ignore"):
        bound = norm * float(onenormest(inverse, t=1))
    return not bound * n * np.finfo(float).eps < 1


def _row_maxima(size: Matrix, scale: Vector) -> Vector:
    """max over j of s_i |M_ij| s_j for each row i."""
    if sp.issparse(size):
        scaled = sp.diags(scale) @ size @ sp.diags(scale)
        return np.asarray(scaled.max(axis=1).toarray()).ravel()
    return np.asarray((scale[:, None] * size * scale).max(axis=1))
