"""Newton steps on a set of closed contacts for indefinite tangents, for instance of compressed bars.

The systems are symmetric and indefinite. The closed set, and with Coulomb friction in the plane stick and slip, are
found by the signs of forces and gaps.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.large.deformation import Forces
from contactqp.errors import InvalidProblem, NotConverged
from contactqp.linalg.dense import DENSE_SIZE
from contactqp.linalg.factorization import factorise
from contactqp.model.arrays import EPS, Array, Index, Mask, Vector, inverse_root
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem

# Eigenvalues of a unit-diagonal matrix below this part of the largest are rounding.
ZERO = 1e-12
REFINEMENTS = 2
# Sweeps of equilibration of rows and columns; each halves the exponents of the largest entries.
SWEEPS = 12
# The stiffness of springs for testing whether K is definite on the motions with closed contacts.
SPRING_STIFFNESS = 1e6
# Overlaps below this part of the lengths at the contact are rounding.
OVERLAP_ROUNDING = 1e-14
# The rounding of a length or a force, relative to the lengths and forces at the contact.
ROUNDED_SLIP = 1e-12
# The most changes of the combination per contact.
CHANGES = 20


def in_units_of_its_own(matrix: Any) -> tuple[Any, Index, Index]:
    """Return a square matrix with its largest entries in every row and column near one, and the exponents of two.

    Entry (i, j) of the result is 2^(r_i + c_j) times that of the matrix, exactly (Ruiz 2001). The choice of pivots is
    then independent of the units of length and force. A symmetric matrix stays symmetric.
    """
    entries = sp.coo_array(matrix)
    entries.eliminate_zeros()
    rows, columns = entries.coords
    sizes = np.log2(abs(entries.data))
    r, c = np.zeros(matrix.shape[0]), np.zeros(matrix.shape[1])
    for _ in range(SWEEPS):
        scaled = sizes + r[rows] + c[columns]
        across, down = np.full(len(r), -np.inf), np.full(len(c), -np.inf)
        np.maximum.at(across, rows, scaled)
        np.maximum.at(down, columns, scaled)
        r, c = r - np.where(np.isfinite(across), across, 0.0) / 2, c - np.where(np.isfinite(down), down, 0.0) / 2
    left, right = np.rint(r).astype(np.int64), np.rint(c).astype(np.int64)
    data = np.ldexp(entries.data, left[rows] + right[columns])
    return sp.csc_array(sp.coo_array((data, (rows, columns)), shape=matrix.shape)), left, right


def solve_system(matrix: Any, right: Vector) -> Vector:
    """Return the solution of a square system, dense if small.

    Raises NotConverged: the matrix is singular.
    """
    size = matrix.shape[0]
    matrix, of_rows, of_columns = in_units_of_its_own(matrix)
    right = np.ldexp(right, of_rows)
    try:
        if size <= DENSE_SIZE:
            solved = np.linalg.inv(matrix.toarray()).__matmul__
        else:
            from scipy.sparse.linalg import splu

            solved = splu(sp.csc_matrix(matrix)).solve
        found = solved(right)
        for _ in range(REFINEMENTS):  # refinement makes residuals small relative to each equation's terms (Skeel 1980)
            found = found + solved(right - matrix @ found)
    except (np.linalg.LinAlgError, RuntimeError):  # SuperLU raises RuntimeError for an exactly zero pivot
        raise NotConverged("the system of the closed contacts is singular") from None
    found = np.ldexp(found, of_columns)
    if not np.all(np.isfinite(found)):
        raise NotConverged("the system of the closed contacts is singular")
    return np.asarray(found)


def determinant_sign(matrix: Any) -> float:
    """Return the sign of the determinant of a square matrix, 0 if it is singular."""
    matrix, *_ = in_units_of_its_own(matrix)
    if matrix.shape[0] <= DENSE_SIZE:
        return float(np.linalg.slogdet(matrix.toarray())[0])
    from scipy.sparse.linalg import splu

    try:
        factor = splu(sp.csc_matrix(matrix))
    except RuntimeError:
        return 0.0
    return float(np.prod(np.sign(factor.U.diagonal()))) * _parity(factor.perm_r) * _parity(factor.perm_c)


def _parity(order: Any) -> float:
    """Return 1 for an even permutation, -1 for an odd one: a cycle of length c is c - 1 exchanges."""
    seen, sign = np.zeros(len(order), dtype=bool), 1.0
    for start in range(len(order)):
        at, length = start, 0
        while not seen[at]:
            seen[at], at, length = True, int(order[at]), length + 1
        if length and length % 2 == 0:
            sign = -sign
    return sign


def by_signs(K: Any, load: Vector, normal: Any, gap: Vector, tie: Any, value: Vector, closed: Mask) -> Any:
    """Return a stationary point of 1/2 u'Ku - f'u over E u <= g, A u = b for any symmetric K: u, l, nu, closed set.

    K u + E_B' l + A' nu = f, E_B u = g_B, A u = b is solved on the set B of closed contacts; contacts with l < 0 are
    opened, those with E u > g closed, until none changes. K need not be definite, and there may be other points.

    Raises NotConverged: a singular system, or repeated sets.

    Parameters
    ----------
    K : (n, n) matrix, symmetric, definite or not
    load : (n,) array, f
    normal, gap : (m, n) matrix, (m,) array, E and g
    tie, value : (k, n) matrix, (k,) array, A and b
    closed : (m,) mask, the contacts that are closed at first
    """
    n, m = len(load), len(gap)
    seen: set[bytes] = set()
    one_by_one = False
    for _ in range(4 * m + 4):
        B = np.flatnonzero(closed)
        rows = sp.vstack([normal[B], tie], format="csr")
        matrix = sp.bmat([[K, rows.T], [rows, None]], format="csc") if rows.shape[0] else sp.csc_array(K)
        found = solve_system(matrix, np.concatenate([load, gap[B], value]))
        u, force = found[:n], np.zeros(m)
        force[B] = found[n : n + len(B)]
        excess = normal @ u - gap
        rounding = OVERLAP_ROUNDING * (abs(normal) @ abs(u) + abs(gap))
        wrong = np.where(closed, np.maximum(-force, 0.0), 0.0), np.where(closed, 0.0, excess - rounding)
        if not np.any(wrong[0] > 0) and not np.any(wrong[1] > 0):
            return u, force, found[n + len(B) :], closed
        closed = _changed(closed, *wrong, one_by_one)
        if closed.tobytes() in seen:
            if one_by_one:
                break  # each set determines the next, so that repetition is a cycle
            one_by_one, seen = True, set()
        seen.add(closed.tobytes())
    raise NotConverged("the set of closed contacts comes back: the tangent is indefinite there")


def _changed(closed: Mask, tension: Vector, excess: Vector, one_by_one: bool) -> Mask:
    if not one_by_one:
        return np.asarray((closed & (tension <= 0)) | (excess > 0))
    changed = closed.copy()
    if np.any(excess > 0):
        changed[int(np.argmax(excess))] = True
    else:
        changed[int(np.argmax(tension))] = False
    return changed


def positive_semidefinite(K: Any) -> bool:
    """Return whether K is positive semidefinite up to rounding, by eigenvalues if small, else by signs of pivots."""
    diagonal = np.asarray(K.diagonal(), dtype=float)
    if not np.all(diagonal >= 0):
        return False
    if K.shape[0] <= DENSE_SIZE:
        scale = inverse_root(diagonal)
        eigenvalues = np.linalg.eigvalsh(K.toarray() * np.outer(scale, scale))
        return bool(eigenvalues[0] >= -64 * len(scale) * EPS * max(eigenvalues[-1], 1.0))
    try:
        factorise(K)
    except InvalidProblem:
        return False
    return True


def negative_on(K: Any, rows: Any) -> int:
    """Return the number of independent motions with rows u = 0 and negative energy u'Ku, 0 for a stable equilibrium.

    For a large K it is only 0 or 1 (some), by the pivots of K with stiff springs along the rows.
    """
    if K.shape[0] <= DENSE_SIZE:
        values = np.linalg.eigvalsh(restricted(K, rows))
        return int(np.sum(values < -ZERO * np.max(abs(values), initial=0.0)))
    stiff = SPRING_STIFFNESS * float(np.max(abs(K.diagonal())))
    return 0 if positive_semidefinite(sp.csc_array(K + stiff * (rows.T @ rows))) else 1


def restricted(K: Any, rows: Any) -> Array:
    """Return Z'KZ on an orthonormal basis Z of the motions with rows u = 0."""
    from scipy.linalg import null_space

    dense = K.toarray()
    if not rows.shape[0]:
        return np.asarray(dense)
    Z = null_space(rows.toarray())
    return np.asarray(Z.T @ dense @ Z)


def lowest_eigenvalue(K: Any) -> float:
    """Return the lowest eigenvalue of K [force / length], or a bound below it for a large K (Gershgorin)."""
    if K.shape[0] <= DENSE_SIZE:
        return float(np.linalg.eigvalsh(K.toarray())[0])
    diagonal = np.asarray(K.diagonal(), dtype=float)
    return float(np.min(diagonal - (np.asarray(abs(K).sum(axis=1)).ravel() - abs(diagonal))))


@dataclass(frozen=True, eq=False)
class Combination:
    """The answer on one combination of open, stick and slip."""

    increment: Vector
    normal: Vector  # (m,)
    friction: Vector  # (m,)
    tie: Vector


def coulomb_by_signs(K: Any, problem: ContactProblem, load: Vector, forces: Forces) -> tuple[Vector, Forces]:
    """Return u and forces with K u + E_N' l_N + E_T' l_T + A' nu = f and Coulomb's law, for any symmetric K.

    Starting with the states of `forces`, states are changed where the answer violates the law: contacts in tension
    open, overlapping ones close and stick, friction beyond mu l_N slips, slip against its friction sticks. All are
    changed at once until a combination is repeated, then once more from closed contacts that all stick: contacts that
    slipped in an earlier step are still at their bounds, and with all of them slipping on nothing may hold the body.
    Then one contact is changed at a time, which closes with slip as it moved. Rows, gaps, slip origins and ties are
    those of `problem`, which has one tangent per contact.

    Raises NotConverged: a singular system, or repeated combinations.

    Parameters
    ----------
    K : (n, n) matrix, symmetric, definite or not
    problem : rows, gaps, slip origins, friction and ties
    load : (n,) array, f
    forces : forces that show the states at first
    """
    if problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        raise ValueError("friction of a problem without tangential rows")
    first = _states(problem.friction, forces)
    sticking = np.where(first == OPEN, OPEN, STICK).astype(np.int8)
    for start, one_by_one in ((first, False), (sticking, False), (first, True), (sticking, True)):
        with suppress(NotConverged):
            return _by_changes(K, problem, load, start, one_by_one)
    raise NotConverged("the combination of stick and slip comes back: the tangent is indefinite there")


def _by_changes(
    K: Any, problem: ContactProblem, load: Vector, status: Status, one_by_one: bool
) -> tuple[Vector, Forces]:
    """Change the states that violate the law until none does, all at once or one by one.

    Raises NotConverged: a singular system, or a repeated combination.
    """
    seen = set[bytes]()
    for _ in range(CHANGES * (problem.contacts + 1)):
        answer = _on(K, problem, load, status)
        changed = _lawful(problem, answer, status, one_by_one)
        differ = np.flatnonzero(changed != status)
        if not differ.size:
            return answer.increment, Forces(answer.normal, answer.tie, answer.friction[:, None])
        if status.tobytes() in seen:
            break
        seen.add(status.tobytes())
        if one_by_one:  # the last contact that violates the law (Murty's rule), which ends if the answer is unique
            differ = differ[-1:]
        status = status.copy()
        status[differ] = changed[differ]
    raise NotConverged("a combination of stick and slip comes back")


def _states(coefficient: Vector, forces: Forces) -> Status:
    friction = np.zeros_like(forces.normal) if forces.friction is None else forces.friction[:, 0]
    slips = (abs(friction) >= coefficient * forces.normal * (1 - ROUNDED_SLIP)) & (abs(friction) > 0)
    closed = np.where(slips, np.sign(friction), STICK)
    return np.where(forces.normal > 0, closed, OPEN).astype(np.int8)


def _on(K: Any, problem: ContactProblem, load: Vector, status: Status) -> Combination:
    """Solve with gap 0 at closed contacts, slip 0 at sticking ones, and l_T = +- mu l_N at slipping ones."""
    n, m, k = problem.dimension, problem.contacts, problem.ties
    B, S = np.flatnonzero(status != OPEN), np.flatnonzero(status == STICK)
    E_N, E_T = sp.csr_array(problem.normal), sp.csr_array(problem.tangent)
    ratio = np.where(abs(status) == SLIP_ON, status, 0) * np.asarray(problem.friction)
    pushed = sp.csr_array(E_N[B] + sp.diags(ratio[B]) @ E_T[B]) if B.size else E_N[B]
    rows = sp.vstack([E_N[B], E_T[S], problem.tie], format="csr")
    columns = sp.vstack([pushed, E_T[S], problem.tie], format="csr").T
    matrix = sp.bmat([[K, columns], [rows, None]], format="csc") if rows.shape[0] else sp.csc_array(K)
    origin = np.asarray(problem.slip_origin)[S, 0]
    found = solve_system(matrix, np.concatenate([load, problem.gap[B], origin, problem.tie_value]))
    normal, friction = np.zeros(m), np.zeros(m)
    normal[B] = found[n : n + len(B)]
    friction[S] = found[n + len(B) : n + len(B) + len(S)]
    friction += ratio * normal
    return Combination(found[:n], normal, friction, found[len(found) - k :])


def _lawful(problem: ContactProblem, answer: Combination, status: Status, slipping: bool) -> Status:
    """Return the states that follow from the answer; contacts close sticking, or `slipping` as they moved while
    open.
    """
    u, bound = answer.increment, np.asarray(problem.friction) * answer.normal
    E_T, origin = sp.csr_array(problem.tangent), np.asarray(problem.slip_origin)[:, 0]
    excess, slip = problem.normal @ u - problem.gap, E_T @ u - origin
    apart = ROUNDED_SLIP * (abs(problem.normal) @ abs(u) + abs(problem.gap))
    along = ROUNDED_SLIP * (abs(E_T) @ abs(u) + abs(origin))
    changed = status.copy()
    slides = (status == STICK) & (abs(answer.friction) > bound * (1 + ROUNDED_SLIP))
    changed[slides] = np.where(answer.friction[slides] > 0, SLIP_ON, SLIP_BACK)
    changed[(abs(status) == SLIP_ON) & (status * slip < -along)] = STICK
    closes = (status == OPEN) & (excess > apart)
    changed[closes] = np.where(slip[closes] > 0, SLIP_ON, SLIP_BACK) if slipping else STICK
    changed[(status != OPEN) & (answer.normal < 0)] = OPEN
    return changed
