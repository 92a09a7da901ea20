"""Eliminate the interior unknowns of a stiffness by a sparse factorisation, as condensation needs.

With the interior unknowns i and the retained unknowns c,

    S = K_cc - K_ci K_ii^-1 K_ic,    f_S = f_c - K_ci K_ii^-1 f_i,    u_i = K_ii^-1 (f_i - K_ic u_c)

There are four ways with one interface. MKL PARDISO (`LastBlock`) and SciPy's SuperLU (`TrailingBlock`) factorise K
with the retained unknowns last and find S at the end of the factors; `BackSubstitution` factorises K_ii alone and
solves once for every retained unknown; `NestedBlock` continues from any of these to fewer unknowns. The choice is made
in `contactqp.linalg.condensation.eliminate`.

SuperLU is given springs T > 0 on c,

    [ K_ii  K_ic     ]   [ L_ii      ] [ U_ii  U_ic ]
    [ K_ci  K_cc + T ] = [ L_ci L_cc ] [       U_cc ],      S + T = L_cc U_cc.

S is singular where bodies float, S + T never is. One solve with K + T reduces a load, another expands a displacement:

    (K + T) x = (f_i, 0),                    f_S = f_c - K_ci K_ii^-1 f_i = f_c + (S + T) x_c
    (K + T) d = (0, (S + T)(u_c - x_c)),     u = x + d

T is a good part of the diagonal of K_cc: S + T is then well conditioned, and S loses to T no more digits than the
difference K_cc - K_ci K_ii^-1 K_ic loses anyway.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.linalg import qr, solve_triangular
from scipy.linalg.lapack import dgbtrf, dgbtrs

from contactqp.errors import BackendFailed, InvalidProblem
from contactqp.linalg.dense import LIFT, SUSPICIOUS_PIVOT, DenseCholesky, refuse_negative
from contactqp.linalg.factorization import DIAGONAL_PIVOTS, MINIMUM_DEGREE, fill_reducing_order, forget_triangles
from contactqp.linalg.pardiso import INDEFINITE, EliminationOrder, NotPositive, Pardiso, available
from contactqp.linalg.runtime import lapack, silenced_output
from contactqp.model.arrays import RUNNING, Array, Indices, Vector, inverse_root, refuse_late
from contactqp.model.problem import ContactProblem

# T for a diagonal of K near one. On blocks, plates, beams and lattices, floating or with a contrast of 1e12, S is as
# accurate as without springs and up to 30 times more than with T = 1; f_S is as accurate as with T = 1 and up to 20
# times more than with 2^-10.
SPRING = 2.0**-4
# Up to this number of retained unknowns their columns of (K + T)^-1 are kept, so that a product replaces the second
# solve.
FEW_TRAILING = 16
# The number of columns of SuperLU's largest supernode.
LARGEST_SUPERNODE = 200


class TrailingBlock:
    """S and solves with K + T, from one sparse factorisation; it needs at least one interior unknown.

    Raises InvalidProblem: a pivot of K_ii is negative beyond rounding: the matrix is indefinite.
    """

    solver = "superlu"

    def __init__(self, stiffness: Any, retained: Indices) -> None:
        self._retained = retained
        # Scaling by powers of two does not round and keeps the rigid motions of K.
        self._scale = 2.0 ** np.round(np.log2(inverse_root(stiffness.diagonal())))
        self._springs = SPRING / self._scale[retained] ** 2
        self.half_substitutions = self._responses = 0
        scaled = sp.csr_matrix(sp.diags(self._scale) @ stiffness @ sp.diags(self._scale))
        eliminated = np.ones(scaled.shape[0], dtype=bool)
        eliminated[retained] = False
        interior = np.flatnonzero(eliminated)
        interior = interior[fill_reducing_order(scaled[interior][:, interior])]
        self._order = np.concatenate([interior, retained])
        matrix = sp.csc_matrix(scaled[self._order][:, self._order])
        self._factor, lifted = _factorise(matrix, len(interior))
        pivots, held = _pivots_and_trailing_block(self._factor, len(interior))
        before = matrix.diagonal()[: len(interior)]
        smallest = float(np.min(pivots / np.where(before > 0, before, 1.0)))
        refuse_negative(smallest)
        self.smallest_pivot = min(smallest, 0.0) if lifted else smallest
        held[np.diag_indices_from(held)] -= SPRING
        self.schur: Array = (held + held.T) / 2 / np.outer(self._scale[retained], self._scale[retained])

    def reduce(self, load: Vector) -> tuple[Vector, Vector]:
        right = load.copy()
        right[self._retained] = 0.0
        x = self._solve(right)
        return load[self._retained] + self._force(x[self._retained]), x

    def expand(self, retained: Vector, state: Vector) -> Vector:
        force = self._force(retained - state[self._retained])
        u = state + self._response(force)
        u[self._retained] = retained
        return u

    def expand_motions(self, retained: Array) -> Array:
        nothing = np.zeros(len(self._order))
        return np.column_stack([self.expand(column, nothing) for column in retained.T])

    def _response(self, force: Vector) -> Vector:
        """Return (K + T)^-1 times a force (p,) on the retained unknowns; after a few calls its columns are kept."""
        if 0 < len(force) <= FEW_TRAILING and self._responses > len(force):
            return np.asarray(self._columns @ force)
        self._responses += 1
        right = np.zeros(len(self._order))
        right[self._retained] = force
        return self._solve(right)

    @cached_property
    def _columns(self) -> Array:
        """(n, p) (K + T)^-1 on the retained unknowns."""
        unit = np.zeros((len(self._order), len(self._retained)))
        unit[self._retained] = np.eye(len(self._retained))
        return np.column_stack([self._solve(column) for column in unit.T])

    def _force(self, displacement: Vector) -> Vector:
        """Return the force (S + T) u_c of a displacement of the retained unknowns."""
        return np.asarray(self.schur @ displacement + self._springs * displacement)

    def _solve(self, right: Vector) -> Vector:
        """Return (K + T)^-1 right."""
        self.half_substitutions += 2
        if (clock := RUNNING.get()) is not None:
            clock.half_substitutions += 2
        solution = np.empty_like(right)
        solution[self._order] = self._factor.solve((self._scale * right)[self._order])
        return solution * self._scale


def _factorise(matrix: Any, interior: int) -> tuple[Any, bool]:
    """Return the factors of K + T in the given order, and whether K_ii was shifted because of a zero pivot."""
    from scipy.sparse.linalg import splu

    for lift in (0.0, LIFT * matrix.shape[0]):
        refuse_late("the stiffness was factorised")
        added = np.where(np.arange(matrix.shape[0]) < interior, lift, SPRING)
        try:
            # After zero pivots in a supernode of its largest size SuperLU calls BLAS with dimensions that are refused
            # in print, before it reports that the matrix is singular.
            with silenced_output() if matrix.shape[0] > LARGEST_SUPERNODE else nullcontext():
                factor = splu(sp.csc_matrix(matrix + sp.diags(added)), permc_spec="NATURAL", **DIAGONAL_PIVOTS)
        except RuntimeError:  # SuperLU's message for a zero pivot above zeros
            continue
        if np.array_equal(factor.perm_r, factor.perm_c):  # else it exchanged rows because of a zero pivot
            return factor, lift > 0
    raise InvalidProblem("stiffness: expected positive semidefinite, got a pivot of zero that no lift takes away")


def _pivots_and_trailing_block(factor: Any, interior: int) -> tuple[Vector, Array]:
    """Return the pivots (q,) of K_ii, and the trailing block L_cc U_cc."""
    first, last = factor.perm_c[:interior], factor.perm_c[interior:]
    lower, upper = (triangle[:, last][last].toarray() for triangle in (factor.L, factor.U))
    pivots = factor.U.diagonal()[first]
    forget_triangles(factor)
    return pivots, lower @ upper


# Up to this ratio of interior to retained unknowns S is computed by back-substitutions. SuperLU's elimination of the
# retained unknowns in a dense block costs 2.5 to 6 times as much at a ratio of one, 0.7 to 2 times at three.
FEW = 4
# The size from which on loading PARDISO for a sparse factorisation pays.
LARGE = 2000
# The most operations of factors of a band with row exchanges (less than a second).
OF_BAND = 1e9
# The part of its entries from which on a matrix fills its factors, so that LAPACK's dense ones take less time, in the
# place of SuperLU's (a twentieth of it, a fifth for a hundred unknowns), and of PARDISO's.
NEARLY_DENSE = (0.05, 0.2)
# The half bandwidth up to which LAPACK's band factors take a tenth of the time of a sparse solver, which mostly orders;
# and the entries per row above which no band is searched.
NARROW, ENTRIES_OF_NARROW = 16, 12
SOLVERS = ("superlu", "pardiso")
CHOICES = (*SOLVERS, "pyamg")


class Elimination(Protocol):
    """Factors of K_ii, and the Schur complement S."""

    solver: str  # whose factors they are
    schur: Array  # (p, p) S
    smallest_pivot: float  # of K_ii with a diagonal of ones

    @property
    def half_substitutions(self) -> int:
        """Return the number of substitutions, forward or backward, with one right-hand side each."""

    def reduce(self, load: Vector) -> tuple[Vector, Vector]:
        """Return f_S (p,), and the state that `expand` needs."""

    def expand(self, retained: Vector, state: Vector) -> Vector:
        """Return u (n,) from u_c and the load that was reduced."""

    def expand_motions(self, retained: Array) -> Array:
        """Return u (n, q) without a load from several u_c (p, q)."""


class LastBlock:
    """S by PARDISO; half a back-substitution reduces a load, the other half expands a displacement."""

    solver = "pardiso"

    def __init__(self, stiffness: Any, retained: Indices) -> None:
        self._retained = retained
        self._factor = Pardiso(stiffness, retained)
        self.smallest_pivot = self._factor.smallest_pivot
        self.schur = self._factor.schur
        self.half_substitutions = 0

    def reduce(self, load: Array) -> tuple[Array, Array]:
        """Return one load (n,), or several (n, q), on the retained unknowns, and the state that `expand` needs."""
        if not load.any():
            return np.zeros((len(self._retained), *load.shape[1:])), np.zeros_like(load)
        self._count(load)
        eliminated = self._factor.forward(load)
        return eliminated[self._retained], eliminated

    def expand(self, retained: Array, state: Array) -> Array:
        """Return all unknowns, (n,) or (n, q), from the retained ones and the state of `reduce`."""
        self._count(state)
        right = state.copy()
        right[self._retained] = retained
        return self._factor.backward(right)

    def expand_motions(self, retained: Array) -> Array:
        right = np.zeros((self._factor.size, retained.shape[1]))
        right[self._retained] = retained
        self._count(right)
        return self._factor.backward(right)

    def _count(self, right: Array) -> None:
        """Count half a back-substitution for each right-hand side."""
        count = right.shape[1] if right.ndim > 1 else 1
        self.half_substitutions += count
        if (clock := RUNNING.get()) is not None:
            clock.half_substitutions += count


class NestedBlock:
    """An elimination that retains fewer unknowns than another one, the others being eliminated from its dense S.

    With the eliminated unknowns r, S_cc - S_cr S_rr^-1 S_rc is the Schur complement of K onto c, without another sparse
    factorisation.

    Raises NotPositive: S_rr is singular by its pivots.
    """

    def __init__(self, outer: Elimination, outer_retained: Indices, retained: Indices) -> None:
        self._outer, self._before, self.solver = outer, outer.half_substitutions, outer.solver
        kept = np.isin(outer_retained, retained)
        self._kept, self._gone = np.flatnonzero(kept), np.flatnonzero(~kept)
        S = outer.schur
        self._factor = DenseCholesky(S[np.ix_(self._gone, self._gone)])
        if self._factor.smallest_pivot < SUSPICIOUS_PIVOT:
            raise NotPositive
        self.smallest_pivot = min(outer.smallest_pivot, self._factor.smallest_pivot)
        self._follow = self._factor.solve(S[np.ix_(self._gone, self._kept)])  # S_rr^-1 S_rc
        block = S[np.ix_(self._kept, self._kept)] - S[np.ix_(self._kept, self._gone)] @ self._follow
        self.schur: Array = (block + block.T) / 2

    @property
    def half_substitutions(self) -> int:
        """Return the number of substitutions with the sparse factors."""
        return self._outer.half_substitutions - self._before

    def reduce(self, load: Vector) -> tuple[Vector, Vector]:
        reduced, state = self._outer.reduce(load)
        gone = reduced[self._gone]
        return reduced[self._kept] - self._follow.T @ gone, np.concatenate([state, self._factor.solve(gone)])

    def expand(self, retained: Vector, state: Vector) -> Vector:
        outer, gone = np.split(state, [len(state) - len(self._gone)])
        return self._outer.expand(self._among(retained, gone - self._follow @ retained), outer)

    def expand_motions(self, retained: Array) -> Array:
        return self._outer.expand_motions(self._among(retained, -self._follow @ retained))

    def _among(self, kept: Array, gone: Array) -> Array:
        both = np.empty((len(self._kept) + len(self._gone), *kept.shape[1:]))
        both[self._kept], both[self._gone] = kept, gone
        return both


def same_matrix(one: Any, other: Any) -> bool:
    """Return whether two matrices, dense, sparse or None, have the same entries."""
    if one is other:
        return True
    if one is None or other is None or one.shape != other.shape:
        return False
    return bool(abs(sp.csr_matrix(one) - sp.csr_matrix(other)).nnz == 0)


def factorised(matrix: Any, kind: int, order: EliminationOrder, unknowns: Indices) -> Callable[[Vector], Vector]:
    """Return a function that solves with a sparse matrix: by LAPACK where it is nearly dense or a narrow
    band, by PARDISO, by SuperLU.

    PARDISO is used where it is installed and pays.

    Raises BackendFailed: the solver ran out of memory, or met a pivot of zero.

    Parameters
    ----------
    matrix : (p, p) sparse matrix, its first rows are those of the unknowns
    kind : `INDEFINITE` and the like
    order : EliminationOrder, of the unknowns of the stiffness
    unknowns : (q,) array of int, those of the stiffness that the matrix contains
    """
    if not matrix.shape[0]:
        return np.copy
    large = matrix.shape[0] > LARGE and available()
    if matrix.nnz >= NEARLY_DENSE[large] * matrix.shape[0] ** 2:
        return _dense_factors(matrix)
    if matrix.shape[0] > LARGE and not order.wide:
        band: Band | None = order.band if order.band is not None and order.band.fits(matrix) else None
        if band is None and matrix.nnz <= ENTRIES_OF_NARROW * matrix.shape[0]:
            band = Band(matrix)
        order.wide = band is None or band.width > NARROW
        if band is not None and not order.wide:
            order.band = band
            return band.factorised(matrix)
    if large:
        try:
            return order.factorised(matrix, unknowns, kind).solve_all
        except NotPositive:
            # K has negative curvature, which `refuse_indefinite` examines.
            return order.factorised(matrix, unknowns, INDEFINITE).solve_all
    from scipy.sparse.linalg import splu

    try:
        solve: Callable[[Vector], Vector] = splu(matrix, permc_spec=MINIMUM_DEGREE, **DIAGONAL_PIVOTS).solve
    except (RuntimeError, ValueError) as error:
        raise BackendFailed(f"superlu: {error}") from error
    return solve


def _dense_factors(matrix: Any) -> Callable[[Vector], Vector]:
    """Return a function that solves with a matrix by LAPACK's dense factors with row exchanges.

    Raises BackendFailed: the matrix is singular.
    """
    factors, exchanges, singular = lapack().dgetrf(matrix.toarray(order="F"), overwrite_a=1)
    if singular:
        raise BackendFailed(f"lapack: pivot {singular} is zero")
    return lambda right: np.asarray(lapack().dgetrs(factors, exchanges, right)[0])


class Band:
    """The reverse Cuthill-McKee order of a sparse symmetric matrix (p, p), which makes its band narrow."""

    def __init__(self, matrix: Any) -> None:
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        matrix.sum_duplicates()
        self._indices, self._starts = matrix.indices, matrix.indptr
        self._order = reverse_cuthill_mckee(sp.csr_matrix(matrix), symmetric_mode=True)
        place = np.empty_like(self._order)
        place[self._order] = np.arange(len(place), dtype=place.dtype)
        entries = matrix.tocoo()
        self._row, self._column = place[entries.row], place[entries.col]
        self.width = int(np.max(abs(self._row - self._column), initial=0))

    def fits(self, matrix: Any) -> bool:
        """Return whether a matrix has the pattern of this order."""
        return np.array_equal(self._starts, matrix.indptr) and np.array_equal(self._indices, matrix.indices)

    def factorised(self, matrix: Any) -> Callable[[Vector], Vector]:
        """Return a function that solves with a matrix of this order by LAPACK's factors with row exchanges.

        Raises BackendFailed: the matrix is singular.
        """
        size, width, order = len(self._order), self.width, self._order
        band = np.zeros((3 * width + 1, size), order="F")
        band[2 * width + self._row - self._column, self._column] = matrix.data
        factors, exchanges, singular = dgbtrf(band, width, width, overwrite_ab=1)
        if singular:
            raise BackendFailed(f"lapack: pivot {singular} is zero")

        def solve(right: Vector) -> Vector:
            found = np.empty(right.shape)
            found[order] = dgbtrs(factors, width, width, right[order], exchanges)[0]
            return found

        return solve


def in_narrow_band(stiffness: Any, rows: Any) -> bool:
    """Return whether reverse Cuthill-McKee order makes the saddle point of a stiffness and rows a narrow band."""
    count = rows.shape[0]
    if stiffness.nnz + 2 * rows.nnz > ENTRIES_OF_NARROW * (stiffness.shape[0] + count):
        return False
    saddle = sp.bmat([[stiffness, rows.T], [rows, sp.csr_matrix((count, count))]], format="csc")
    return Band(saddle).width <= NARROW


def with_pivots(matrix: Any) -> Callable[[Vector], Vector]:
    """Return a function that solves with a sparse symmetric matrix by LAPACK's factors of its band, with row exchanges.

    (With row exchanges SuperLU may end the process where a matrix is nearly singular.)

    Raises BackendFailed: the matrix is singular, or its band is so wide that factors take more than `OF_BAND` products.

    Parameters
    ----------
    matrix : (p, p) sparse matrix
    """
    band, size = Band(matrix), matrix.shape[0]
    if size * band.width**2 > OF_BAND:
        raise BackendFailed(f"lapack: factors of a band of {band.width} beside the diagonal of {size} take too long")
    return band.factorised(matrix)


class PivotedSaddle:
    """The saddle point of nearly dependent closed contacts and ties, by factors with row exchanges.

        [ a K  E_C' ] [ u   ]   [ a f ]
        [ E_C       ] [ a l ] = [ g_C ]

    With a below the least singular value of the rows the condition number of the matrix is that of the rows instead of
    its square (Bjorck 1996, section 2.5.1). Springs beside K make it regular where motions are free.

    Raises BackendFailed: the rows are dependent, or the factors may have too many entries.

    Parameters
    ----------
    problem : ContactProblem, equilibrated
    closed : (c,) array of int, the closed contacts
    part, spring : float, a, and what is added to the diagonal of K
    """

    def __init__(self, problem: ContactProblem, closed: Indices, part: float, spring: float = 0.0) -> None:
        K = problem.stiffness_rows + spring * sp.identity(problem.dimension)
        rows = sp.vstack([problem.normal[closed], problem.tie])
        self._part, self._contacts = part, len(closed)
        self._factor = with_pivots(sp.bmat([[part * K, rows.T], [rows, None]], format="csc"))

    def correction(self, force: Vector, gap: Vector, tie: Vector) -> tuple[Vector, Vector, Vector, int]:
        """Return corrections of u, l and nu for residuals, and the back-substitutions: one."""
        u, carried = np.split(self._factor(np.concatenate([self._part * force, gap, tie])), [len(force)])
        return u, carried[: self._contacts] / self._part, carried[self._contacts :] / self._part, 1


# Singular values of unit rows, and of the stiffness, below this part of the largest count as zero.
OF_NO_RANK = 1e-11
# The most operations of dense factors of rows (some tenths of a second).
OF_RANK = 5e8


class RankedSaddle:
    """The saddle point of dependent closed contacts and ties, by dense rank-revealing factors.

    With Q R P' = [E_C' A'] and its first r columns Y, u = Y y + Z z: r rows give y, equilibrium along Z gives z, and
    along Y the minimum-norm forces (Nocedal and Wright 2006, section 16.2).

    Parameters
    ----------
    problem : ContactProblem, equilibrated
    closed : (c,) array of int, the closed contacts
    """

    def __init__(self, problem: ContactProblem, closed: Indices) -> None:
        rows = sp.vstack([problem.normal[closed], problem.tie]).toarray()
        length = np.linalg.norm(rows, axis=1)
        self._length, self._contacts = np.where(length > 0, length, 1.0), len(closed)
        Q, R, self._order = qr((rows / self._length[:, None]).T, pivoting=True)
        pivots = abs(np.diag(R))
        rank = int(np.sum(pivots > OF_NO_RANK * np.max(pivots, initial=0.0)))
        self._Y, Z, self._R = Q[:, :rank], Q[:, rank:], R[:rank, :rank]
        self._shared = qr(R[:rank].T, mode="economic")  # of dependent rows
        self._K = problem.stiffness_rows
        sizes, motions = np.linalg.eigh(Z.T @ (self._K @ Z))
        resisted = sizes > OF_NO_RANK * np.max(sizes, initial=0.0)
        self._motions, self._sizes = Z @ motions[:, resisted], sizes[resisted]

    def correction(self, force: Vector, gap: Vector, tie: Vector) -> tuple[Vector, Vector, Vector, int]:
        """Return corrections of u, l and nu for residuals, and the back-substitutions: one."""
        rank = len(self._R)
        wanted = (np.concatenate([gap, tie]) / self._length)[self._order][:rank]
        u = self._Y @ solve_triangular(self._R, wanted, trans=1)
        u += self._motions @ (self._motions.T @ (force - self._K @ u) / self._sizes)
        carried = np.zeros(len(self._order))
        factor, triangle = self._shared
        carried[self._order] = factor @ solve_triangular(triangle, self._Y.T @ (force - self._K @ u), trans=1)
        carried /= self._length
        return u, carried[: self._contacts], carried[self._contacts :], 1
