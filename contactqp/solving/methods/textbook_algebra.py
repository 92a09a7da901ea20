"""The common linear algebra of the five classical methods: systems of equations and independent constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, NotConverged, shown
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.factorization import fixing_unknowns, null_space
from contactqp.linalg.runtime import is_nearly_dense
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem, Matrix
from contactqp.model.problem_data import read_array

# The rounding error of a few hundred additions, relative to the size of the terms.
TEXTBOOK_ROUNDING = 1e3 * EPS
# The values of dependent ties must agree to this part of their size, since they are often rounded decimals.
CONTRADICTION = 1e-9


class SingularSystem(NotConverged):
    """A textbook system is singular: too few of its contacts are closed."""


def binding_rows(
    name: str, problem: ContactProblem, closed: Mask, preference: Indices
) -> tuple[Matrix, Vector, Indices, Indices]:
    """Return independent rows of the ties and the closed contacts.

    Ties come first, then the closed contacts in the order of `preference`; a row that depends on those before it is
    left out, and its multiplier is zero.

    Raises NotConverged: ties contradict each other.

    Parameters
    ----------
    name : the method's name, for messages
    problem : ContactProblem
    closed : (m,) mask
    preference : (m,) array of int, all contacts, in the order in which their rows are kept

    Returns
    -------
    rows : (r, n) csr_array, values : (r,)
        [A; E_N] u = [b; g].
    ties, contacts : index arrays
        Which ties and which contacts the rows are, in this order.
    """
    ties = rows_independent_of_earlier(problem.tie)
    refuse_contradiction(name, problem, ties)
    candidates = preference[closed[preference]]
    both = sp.csr_array(sp.vstack([problem.tie[ties], problem.normal[candidates]], format="csr"))
    kept = rows_independent_of_earlier(both)
    contacts = candidates[kept[kept >= ties.size] - ties.size]
    rows = sp.csr_array(sp.vstack([problem.tie[ties], problem.normal[contacts]], format="csr"))
    return rows, np.concatenate([problem.tie_value[ties], problem.gap[contacts]]), ties, contacts


def refuse_contradiction(name: str, problem: ContactProblem, kept: Indices) -> None:
    """Refuse ties that depend on the `kept` ones, A_i = c'A, with contradicting values, b_i != c'b.

    The difference |b_i - c'b| is compared with |b_i| + |c|'|b|, as displacements may vanish. Rows have unit length.
    Each |c_j| includes the rounding error of the largest one.

    Raises NotConverged: the values contradict each other.
    """
    dropped = np.setdiff1d(np.arange(problem.ties), kept)
    if dropped.size == 0:
        return
    length = np.linalg.norm(problem.tie.toarray(), axis=1)
    length[length == 0] = 1.0
    A, b = problem.tie.toarray() / length[:, None], problem.tie_value / length
    weights = np.linalg.lstsq(A[kept].T, A[dropped].T, rcond=None)[0].T
    off = np.abs(b[dropped] - weights @ b[kept])
    rounding = TEXTBOOK_ROUNDING * np.max(np.abs(weights), axis=1, initial=0.0) * np.abs(b[kept]).sum()
    wrong = off > CONTRADICTION * (np.abs(b[dropped]) + np.abs(weights) @ np.abs(b[kept])) + rounding
    if np.any(wrong):
        raise NotConverged(f"{name}: tie {int(dropped[wrong][0])} contradicts the other ties")


def rows_independent_of_earlier(rows: Matrix) -> Indices:
    """Return the increasing indices of the rows that do not depend on the rows before them."""
    count = rows.shape[0]
    if count < 2:
        return np.arange(count)
    unit = rows[:, np.unique(rows.indices)].toarray()
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    # Unit rows are independent if their Gram matrix is this far from singular, which one product shows in most cases.
    off_diagonal = np.abs(unit @ unit.T).sum(axis=1) - 1.0
    if np.all(off_diagonal < 0.5):  # Gershgorin
        return np.arange(count)
    basis, kept = np.zeros((min(unit.shape), unit.shape[1])), list[int]()
    for i, row in enumerate(unit):
        rest = row - basis[: len(kept)].T @ (basis[: len(kept)] @ row)
        rest -= basis[: len(kept)].T @ (basis[: len(kept)] @ rest)  # twice is enough (Kahan, Parlett)
        size = float(np.linalg.norm(rest))
        if size > TEXTBOOK_ROUNDING and len(kept) < len(basis):
            basis[len(kept)] = rest / size
            kept.append(i)
    return np.array(kept, dtype=np.intp)


def spread(values: Vector, where: Indices, size: int) -> Vector:
    """Return an array of `size` zeros with `values` at the indices `where`."""
    full = np.zeros(size)
    full[where] = values
    return full


def contact_stiffness(name: str, key: str, value: Any, contacts: int, *, zero: bool = False) -> Vector:
    """Return a stiffness for each contact (m,) from one number or m numbers, positive (or nonnegative) and finite.

    Raises InvalidProblem: it is anything else.

    Parameters
    ----------
    name, key : the method and its option, for messages
    value : float or (m,) array, what the user gave [force / length]
    contacts : their number m
    zero : whether zero is allowed
    """
    sign = "not negative" if zero else "positive"
    whose = key if name == key else f"{name}: {key}"
    several = f" or {contacts} of them" if contacts > 1 else ""
    expected = f"{whose}: expected a {sign} finite number{several}"
    try:
        values = read_array(key, value)
    except InvalidProblem as error:
        raise InvalidProblem(f"{expected}; {str(error).removeprefix(f'{key}: ')}") from None
    if np.asarray(value).dtype == bool:
        raise InvalidProblem(f"{expected}, got {shown(value)}")
    allowed = (values >= 0 if zero else values > 0) & np.isfinite(values)
    if values.shape not in ((), (contacts,)) or not np.all(allowed):
        raise InvalidProblem(f"{expected}, got {shown(value)}")
    return np.broadcast_to(values, (contacts,)).astype(float)


def springs(problem: ContactProblem, closed: Mask, beta: Vector) -> tuple[Matrix, Vector]:
    """Return K + E' beta E and f + E' beta g over the closed contacts, the two sides of eq. 2.25 of the chapter."""
    E = problem.normal[np.flatnonzero(closed)]
    if sp.issparse(problem.stiffness) or not is_nearly_dense(E):
        spring = E.T @ sp.diags(beta[closed]) @ E
        spring = spring if sp.issparse(problem.stiffness) else spring.toarray()
    else:
        rows = E.toarray()
        spring = (rows.T * beta[closed]) @ rows
    K = problem.stiffness + spring
    return K, problem.load + E.T @ (beta[closed] * problem.gap[closed])


def solve_bordered(
    name: str,
    matrix: Matrix,
    load: Vector,
    rows: Matrix,
    values: Vector,
    corner: Vector | None = None,
    *,
    pushed: Matrix | None = None,
    refined: bool = False,
) -> tuple[Vector, Vector]:
    """Solve [[matrix, pushed'], [rows, diag(corner)]] {x; y} = {load; values}.

    Raises NotConverged: the system is singular.

    Parameters
    ----------
    name : the method's name, for messages
    matrix : (n, n), sparse or dense
    load : (n,)
    rows : (r, n) csr_array
    values : (r,)
    corner : (r,), optional
        Diagonal of the lower right block, zero by default.
    pushed : (r, n) csr_array, optional
        Where the forces y act, `rows` by default; contacts that slip push along other rows than they hold.
    refined : as for `solve_linear`
    """
    n, r = matrix.shape[0], rows.shape[0]
    corner = np.zeros(r) if corner is None else corner
    pushed = rows if pushed is None else pushed
    if r == 0:
        return solve_linear(name, matrix, load, refined=refined), np.zeros(0)
    if sp.issparse(matrix):
        system = sp.bmat([[matrix, pushed.T], [rows, sp.diags(corner)]], format="csc")
    else:
        system = np.block([[matrix, pushed.toarray().T], [rows.toarray(), np.diag(corner)]])
    solution = solve_linear(name, system, np.concatenate([load, values]), refined=refined)
    return solution[:n], solution[n:]


def solve_linear(name: str, matrix: Matrix, load: Array, *, refined: bool = False) -> Array:
    """Solve matrix x = load by LU with partial pivoting, in the numbers as they are.

    An ill-conditioned matrix is accepted, so that rounding appears as in a textbook program. Only a matrix that is
    singular for any scaling of rows and columns is refused.

    Raises NotConverged: the matrix is singular.

    Parameters
    ----------
    name : the method's name, for messages
    matrix : (n, n), sparse or dense
    load : (n,)
    refined : bool
        Whether one step of refinement in the same precision follows. It makes the residual small equation by equation,
        where stiffness beside multiplier rows leaves it small beside the largest equation only (Skeel 1980).
    """
    if matrix.shape[0] == 0:
        return np.zeros_like(load)
    solve = _sparse_lu(matrix) if sp.issparse(matrix) else _dense_lu(matrix)
    if solve is None or _hopeless(matrix, solve):
        raise SingularSystem(
            f"{name}: the system of equations is singular: the bodies are not held by the contacts that are closed, "
            "or springs are so stiff that the bodies' stiffness is lost beside them"
        )
    x = np.asarray(solve(load, False))
    return np.asarray(x + solve(load - matrix @ x, False)) if refined else x


# A function that solves for a right-hand side, with the transposed matrix if the second argument is true.
Solver = Callable[[Array, bool], Array]


def _dense_lu(matrix: Array) -> Solver | None:
    from scipy.linalg import lapack

    # LAPACK is called directly, as it returns a code for a zero pivot where scipy.linalg.lu_factor warns.
    factors, pivots, zero_pivot = lapack.dgetrf(matrix)
    if zero_pivot:
        return None
    return lambda load, transposed: np.asarray(lapack.dgetrs(factors, pivots, load, trans=int(transposed))[0])


def _sparse_lu(matrix: Matrix) -> Solver | None:
    from scipy.sparse.linalg import splu

    try:
        factors = splu(sp.csc_array(matrix))
    except RuntimeError:  # "Factor is exactly singular"
        return None
    return lambda load, transposed: np.asarray(factors.solve(load, "T" if transposed else "N"))


# The number of unknowns up to which the inverse is cheaper than importing an estimator of its norm.
FEW = 10


def _hopeless(matrix: Matrix, solve: Solver) -> bool:
    """Return whether 1 / (|R M C| |(R M C)^-1|) <= n eps in the 1-norm, diagonal R and C equilibrating M.

    Equilibration prevents that a large range of entries, as of a penalty, is mistaken for singularity. For a symmetric
    M both are equal. As rows of multipliers hide a soft stiffness beside them from it, the matrix is also scaled to a
    diagonal of one first, where it has one, and only the other rows and columns are equilibrated.
    """
    size, diagonal = abs(matrix), abs(matrix.diagonal())
    every, bare = np.ones(len(diagonal), dtype=bool), diagonal == 0
    unit = 1 / np.sqrt(np.where(bare, 1.0, diagonal))
    return all(_near_singular(matrix, size, solve, *one) for one in ((np.ones(len(unit)), every), (unit, bare)))


def _near_singular(matrix: Matrix, size: Matrix, solve: Solver, start: Vector, free: Mask) -> bool:
    """Return whether a matrix is singular to rounding, with its `free` rows and columns (n,) equilibrated."""
    n, rows, columns = matrix.shape[0], start, start
    for _ in range(3):  # Ruiz equilibration; it settles in two or three sweeps
        of_rows, of_columns = _row_maxima(size, rows, columns), _row_maxima(size.T, columns, rows)
        rows = rows / np.sqrt(np.where(free & (of_rows > 0), of_rows, 1.0))
        columns = columns / np.sqrt(np.where(free & (of_columns > 0), of_columns, 1.0))
    norm = float(np.max(columns * (size.T @ rows)))
    with np.errstate(all="ignore"):
        bound = norm * _norm_of_inverse(matrix, solve, rows, columns)
    return not bound * n * EPS < 1


def _norm_of_inverse(matrix: Matrix, solve: Solver, rows: Vector, columns: Vector) -> float:
    """Return the 1-norm of (R M C)^-1, for few unknowns from the inverse, else by Hager's and Higham's estimate."""
    n = matrix.shape[0]
    if n <= FEW and not sp.issparse(matrix):
        # One right-hand side at a time, as several would start the threads of OpenBLAS.
        return max(float(np.sum(abs(solve(unit, False) / columns))) for unit in np.diag(1 / rows))
    from scipy.sparse.linalg import LinearOperator, onenormest

    def scaled_solve(x: Array) -> Array:
        return np.asarray(solve(np.ravel(x) / rows, False) / columns)

    def scaled_solve_transposed(x: Array) -> Array:
        return np.asarray(solve(np.ravel(x) / columns, True) / rows)

    inverse = LinearOperator((n, n), matvec=scaled_solve, rmatvec=scaled_solve_transposed, dtype=float)
    return float(onenormest(inverse, t=1))


def _row_maxima(size: Matrix, rows: Vector, columns: Vector) -> Vector:
    """Return max_j r_i |M_ij| c_j for each row i."""
    if sp.issparse(size):
        scaled = sp.diags(rows) @ size @ sp.diags(columns)
        return np.asarray(scaled.max(axis=1).toarray()).ravel()
    return np.asarray((rows[:, None] * size * columns).max(axis=1))


def with_idle_motions_held(problem: ContactProblem, condensation: Condensation) -> ContactProblem:
    """Return the problem with springs at unknowns that hold the rigid motions which no contact and no tie resists.

    No load drives these motions, so that the springs carry no force, and no textbook system is singular by them.
    """
    rows = [condensation.normal, condensation.tie]
    if problem.frictional and condensation.tangent is not None:
        rows.append(condensation.tangent.toarray())
    free = condensation.unresisted(np.vstack(rows) * condensation.scale)
    if not free.shape[1]:
        return problem
    held = fixing_unknowns(condensation.rigid.motions @ free, np.zeros(0, dtype=np.intp), problem.diagonal)
    springs, largest = np.zeros(problem.dimension), float(np.max(problem.diagonal)) or 1.0
    springs[held] = np.where(problem.diagonal[held] > 0, problem.diagonal[held], largest)
    added = sp.diags(springs) if sp.issparse(problem.stiffness) else np.diag(springs)
    return problem.replace(stiffness=problem.stiffness + added, near_null_space=None)


# Components of a dependent unit row, and products of unit rows with unit motions, below this are rounding errors.
ROW_ROUNDING = 1e-10
# The condition number up to which rows are considered to share the rounding errors of motions.
PASSED_ON = 1e-6


@dataclass(frozen=True, eq=False)
class FloatingBodies:
    """The bodies of a problem, in unknowns where the stiffness has a unit diagonal."""

    problem: ContactProblem

    @cached_property
    def rigid(self) -> Array:
        """Return (n, r) orthonormal motions without energy, in unknowns where the stiffness has a unit diagonal."""
        if not condense(self.problem).rigid.count:
            return np.zeros((self.problem.dimension, 0))
        return np.linalg.qr(null_space(self.problem.stiffness).motions / self.scale[:, None])[0]

    @cached_property
    def normal(self) -> Array:
        """Return (m, n) rows of the contacts, of unit length in these unknowns."""
        return self.unit(self.problem.normal)

    @cached_property
    def tie(self) -> Array:
        """Return (k, n) rows of the ties, of unit length in these unknowns."""
        return self.unit(self.problem.tie)

    @cached_property
    def scale(self) -> Vector:
        """Return D (n,) of these unknowns x, u = D x."""
        return unknown_scale(self.problem)

    def unit(self, rows: Any) -> Array:
        """Return rows scaled to unit length in these unknowns; an empty row is left as it is."""
        dense = np.asarray((rows @ sp.diags(self.scale)).toarray())
        length = np.linalg.norm(dense, axis=1, keepdims=True)
        return np.asarray(dense / np.where(length > 0, length, 1.0))

    def held_by(self, unit_rows: Array) -> bool:
        """Return whether unit rows resist every rigid motion."""
        r = self.rigid.shape[1]
        if not r:
            return True
        felt = np.linalg.svd(unit_rows @ self.rigid, compute_uv=False)
        return bool(np.count_nonzero(felt > ROW_ROUNDING) == r)

    def carried(self, rows: Any, forces: Vector) -> Vector:
        """Return the rounding errors of row forces on floating bodies by those of the forces (n,).

        The row forces F balance the bodies by (E Z)'F = Z'f, so that their error is |pinv (E Z)'| times that of Z'f.
        """
        if not self.rigid.shape[1]:
            return np.zeros(rows.shape[0])
        moved = self.unit(rows) @ self.rigid
        shared = (abs(moved) > ROW_ROUNDING) + abs(np.linalg.pinv(moved.T, rcond=PASSED_ON))
        length = np.linalg.norm((rows @ sp.diags(self.scale)).toarray(), axis=1)
        noise = 16 * EPS * (shared @ (abs(self.rigid).T @ (self.scale * forces)))
        return np.asarray(noise / np.where(length > 0, length, 1.0))
