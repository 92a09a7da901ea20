"""Preconditioned conjugate gradients on the displacements admissible by constrained rows, and bounds of their error.

With z = M r, rho_k = r_k'z_k and step lengths a_k,

    |e_0|_K^2 - |e_k|_K^2 = sum of a_j rho_j over j < k            (Hestenes and Stiefel 1952, theorem 6:1)
    |e_k|_K^2 <= rho_k / (least eigenvalue of M K)

and the eigenvalues of the tridiagonal matrix of the steps (Ritz values) approach those of M K from within.

Projections in the metric of D = diag K give the displacements and forces that rows E_A, constrained to g_A, allow:

    closed      x + D^-1 E'(E D^-1 E')^-1 (g - E x)          meets E x = g
    admissible  z - D^-1 E'(E D^-1 E')^-1 E z                meets E z = 0
    forces      l = (E D^-1 E')^-1 E D^-1 r                  the forces on the rows that carry r best
    balanced    r - E' l                                     what they leave of it

The rows may share unknowns. Dependent rows are left out and have no force.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.dense import DenseCholesky
from contactqp.model.arrays import TINY, Array, Vector


class Processes(Protocol):
    """The processes that share a problem; everything but `rank` is collective, and the same on all of them."""

    rank: int

    def sum(self, value: Any) -> Any:
        """Return the sum over the processes of a number or an array."""

    def max(self, value: Any) -> Any:
        """Return the largest over the processes of a number, or of an array entry by entry."""

    def gathered(self, values: Any) -> Any:
        """Return the arrays of all processes, one after the other."""

    def offset(self, count: int) -> int:
        """Return the number of items on earlier processes, where this one has `count`."""

    def broadcast(self, value: Any) -> Any:
        """Return a small value of the first process."""


class OneProcess:
    """The processes of a problem on a single process."""

    rank = 0

    def sum(self, value: Any) -> Any:
        return value

    def max(self, value: Any) -> Any:
        return value

    def gathered(self, values: Any) -> Any:
        return values

    def offset(self, count: int) -> int:
        del count
        return 0

    def broadcast(self, value: Any) -> Any:
        return value


class Projections(Protocol):
    """Projections of displacements and forces by constrained rows."""

    def admit(self, z: Vector) -> None:
        """Remove from z the part that moves the rows, in place."""

    def balanced(self, r: Vector) -> Vector:
        """Return r less the forces on the rows that balance it best."""


class ConstrainedRows(Projections, Protocol):
    """Projections onto the displacements at which some rows are held at their limits."""

    def close(self, x: Vector) -> None:
        """Move x onto the limits of the rows, in place."""

    def forces(self, r: Vector) -> Vector:
        """Return the forces on the rows that balance r best."""


class ConjugateGradients:
    """The state of one run; `step` changes it.

    Parameters
    ----------
    product : callable, K x
    precondition : callable, z = M r, symmetric positive definite
    x, residual : (n,) arrays, where it starts, rows closed, and f - K x there; both are changed in place
    rows : Projections, of the rows that x must keep
    dot : callable, a'b of two vectors
    """

    def __init__(
        self,
        product: Callable[[Vector], Vector],
        precondition: Callable[[Vector], Vector],
        x: Vector,
        residual: Vector,
        rows: Projections,
        dot: Callable[[Vector, Vector], float] = np.dot,
    ) -> None:
        self._product, self._precondition, self._rows, self._dot = product, precondition, rows, dot
        self.x, self.residual = x, residual
        self.unbalanced = rows.balanced(residual)  # the residual less forces on the rows
        self.gained = 0.0  # |e_0|^2 - |e|^2
        self._lengths: list[float] = []  # a_k
        self._ratios: list[float] = []  # rho_k+1 / rho_k
        self._square: float | None = None  # rho of the current residual; None until M is applied to it
        self._before, self._before_size = np.inf, 1.0  # rho of an earlier residual, and its square
        self._direction = np.zeros(0)
        self.fall: Vector | None = None  # a direction d with d'K d < 0, if one was found

    @property
    def steps(self) -> int:
        return len(self._lengths)

    def square(self) -> float:
        """Return rho = r'M r."""
        if self._square is None:
            self._square = self._aim()
        return self._square

    def estimate(self) -> float:
        """Return rho of the last application of M, scaled with the residual; infinite before the first."""
        return self._before * self._size() / self._before_size

    def _aim(self) -> float:
        """Set the next direction and return rho."""
        z = self._precondition(self.unbalanced)
        self._rows.admit(z)
        square = max(float(self._dot(self.unbalanced, z)), 0.0)
        if self._lengths:
            self._ratios.append(square / self._before)
            self._direction *= self._ratios[-1]
            self._direction += z
        else:
            self._direction = z
        self._before, self._before_size = square, max(self._size(), TINY)
        return square

    def _size(self) -> float:
        return float(self._dot(self.unbalanced, self.unbalanced))

    def step(self) -> bool:
        """Make one iteration; return False if rounding or a singular K leaves no direction of descent."""
        square = self.square()
        force = self._product(self._direction)
        stiffness = float(self._dot(self._direction, force))
        if not (square > 0 and stiffness > 0 and np.isfinite(stiffness)):
            self.fall = self._direction if stiffness < 0 else None
            return False
        length = square / stiffness
        self.x += length * self._direction
        force *= length
        self.residual -= force
        self.unbalanced = self._rows.balanced(self.residual)
        self.gained += length * square
        self._lengths.append(length)
        self._square = None
        return True

    def least_eigenvalue(self) -> float:
        """Return the least Ritz value of M K, or one, the largest that M K can have, before the first step."""
        from scipy.linalg import eigvalsh_tridiagonal

        if not self._lengths:
            return 1.0
        a, b = np.array(self._lengths), np.array(self._ratios[: len(self._lengths) - 1])
        diagonal = 1 / a
        diagonal[1:] += b / a[:-1]
        return float(eigvalsh_tridiagonal(diagonal, np.sqrt(b) / a[:-1])[0])


# A row is dependent if its squared part orthogonal to the others is below this; rounding leaves about 1e-16.
DEPENDENT_SQUARED = 1e-10
# Added to the diagonal, as exactly dependent rows would give a zero pivot, which SuperLU refuses.
LIFTS = (2.0**-52, 2.0**-46, 2.0**-40)

# Pivots of unit rows below which they are nearly parallel, and parallel; entries of groups that are made orthonormal.
NEARLY_PARALLEL, ALIKE, SEPARATED = 1e-5, 256 * float(np.finfo(np.longdouble).eps), 250_000


class IndependentRows:
    """(E C E')^-1 of independent rows of E.

    Parameters
    ----------
    entries : (a, c) CSR matrix, E
    compliance : (c,) array, the diagonal of C
    """

    def __init__(self, entries: Any, compliance: Vector) -> None:
        self._count = entries.shape[0]
        self.kept = np.arange(self._count)
        rows = entries
        while self.kept.size:
            scale = 1 / np.sqrt(rows.multiply(rows) @ compliance)
            unit = sp.diags(scale) @ rows @ sp.diags(np.sqrt(compliance))
            independent = self._factorise(sp.csc_matrix(unit @ unit.T))
            if np.all(independent):
                self._scale = scale
                break
            self.kept = self.kept[independent]
            rows = entries[self.kept]

    def _factorise(self, gram: Any) -> NDArray[np.bool_]:
        """Factorise the scaled Gram matrix of the rows; return which rows do not depend on earlier ones."""
        from scipy.sparse.linalg import splu

        self._factor: Any = None
        if gram.nnz == gram.shape[0]:  # no row shares an unknown with another
            return np.ones(len(self.kept), dtype=bool)
        options = dict(permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        for lift in LIFTS:
            try:
                self._factor = splu(sp.csc_matrix(gram + lift * sp.identity(gram.shape[0])), **options)
                break
            except RuntimeError:  # the added diagonal was lost by rounding
                if lift == LIFTS[-1]:
                    raise
        return np.asarray(self._factor.U.diagonal()[self._factor.perm_c] > DEPENDENT_SQUARED)

    def solve(self, lengths: Vector) -> Vector:
        """Return the forces (a,) that cause the lengths (a,), zero on dependent rows."""
        force = np.zeros(self._count)
        if self.kept.size:
            scaled = self._scale * lengths[self.kept]
            force[self.kept] = self._scale * (scaled if self._factor is None else self._factor.solve(scaled))
        return force


def separated(rows: Any) -> Any:
    """Return rows (q, n) that span the same as sparse rows (k, n), groups of nearly dependent ones orthonormal.

    A sweep of refinement hardly sees what the difference of nearly parallel rows holds. A group shares unknowns, and is
    orthogonalised (Gram and Schmidt) in floats of 64 binary digits where there are any, since the difference has few.
    Large groups stay as they are. None if no group is nearly dependent.
    """
    rows = sp.csr_array(rows, copy=True)
    rows.eliminate_zeros()
    shared = sp.bmat([[None, rows], [rows.T, None]])
    of_row = sp.csgraph.connected_components(shared, directed=False)[1][: rows.shape[0]]
    parts, as_before = [rows[np.flatnonzero(np.bincount(of_row)[of_row] <= 1)]], True
    for group in np.flatnonzero(np.bincount(of_row) > 1):
        few = rows[np.flatnonzero(of_row == group)]
        touched = np.unique(few.indices)
        found = _orthonormal_if_nearly_parallel(few[:, touched]) if few.shape[0] * len(touched) <= SEPARATED else None
        if found is None:
            parts.append(few)
            continue
        place = np.tile(touched, len(found)), np.arange(len(found) + 1) * len(touched)
        as_before = False
        parts.append(sp.csr_array((found.ravel(), *place), shape=(len(found), rows.shape[1])))
    return None if as_before else sp.vstack(parts, format="csr")


def _orthonormal_if_nearly_parallel(rows: Any) -> Array | None:
    """Return orthonormal rows that span the same, without dependent ones; None if no row nearly depends on others."""
    left = rows.toarray().astype(np.longdouble)
    left /= np.sqrt(np.sum(left * left, axis=1))[:, None]
    spanned, least = np.zeros((0, left.shape[1]), dtype=np.longdouble), 1.0
    while len(left):
        sizes = np.sum(left * left, axis=1)
        first = int(np.argmax(sizes))
        least = min(least, pivot := float(np.sqrt(sizes[first])))
        if pivot <= ALIKE:
            break
        row = left[first] / np.sqrt(sizes[first])
        row -= (row @ spanned.T) @ spanned
        row /= np.sqrt(row @ row)
        spanned, left = np.vstack([spanned, row]), np.delete(left, first, axis=0)
        left -= np.outer(left @ row, row)
    return np.asarray(spanned, dtype=float) if least < NEARLY_PARALLEL else None


class AssembledRows:
    """Rows over the unknowns `columns`, constrained to `limit`.

    Parameters
    ----------
    entries : (a, c) CSR matrix
    columns : (c,) array of int, the unknowns
    limit : (a,) array [length]
    compliance : (c,) array, 1/K_jj of these unknowns
    """

    def __init__(self, entries: Any, columns: NDArray[np.intp], limit: Vector, compliance: Vector) -> None:
        self._entries, self._columns, self._compliance, self._limit = entries, columns, compliance, limit
        self._spread = entries.T  # transposed once, not in every projection
        self._gram = IndependentRows(entries, compliance)
        self.redundant = len(self._gram.kept) < entries.shape[0]

    def close(self, x: Vector) -> None:
        """Move x so that E x = g, in place."""
        missing = self._limit - self._entries @ x[self._columns]
        x[self._columns] += self._compliance * (self._spread @ self._gram.solve(missing))

    def admit(self, z: Vector) -> None:
        """Remove from z the part that moves the rows, in place."""
        moved = self._gram.solve(self._entries @ z[self._columns])
        z[self._columns] -= self._compliance * (self._spread @ moved)

    def forces(self, r: Vector) -> Vector:
        """Return the forces l (a,) that balance r best, zero on dependent rows."""
        return self._gram.solve(self._entries @ (self._compliance * r[self._columns]))

    def balanced(self, r: Vector) -> Vector:
        """Return r less the forces on the rows that balance it best."""
        left = r.copy()
        left[self._columns] -= self._spread @ self.forces(r)
        return left


# The number of rows up to which uncoupled unknowns are eliminated onto the multipliers by dense algebra.
FEW_ROWS = 200


def uncoupled(stiffness: Any, rows: Any, regularisation: float) -> Callable[[Vector], Vector] | None:
    """Return a function that solves the regularised saddle point of a diagonal stiffness and few rows, else None.

        [ D   R' ] [ u ]   [ f ]
        [ R  -d  ] [ l ] = [ g ],      (R D^-1 R' + d) l = R D^-1 f - g,      u = D^-1 (f - R' l),      D = K + d

    A sparse solver spends most of its time on an order of elimination there (Schur-complement method, Nocedal and
    Wright 2006, section 16.2).

    Parameters
    ----------
    stiffness : (n, n) sparse matrix, K
    rows : (k, n) sparse matrix, R
    regularisation : d, positive
    """
    (count, n), diagonal = rows.shape, stiffness.diagonal()
    if count > FEW_ROWS or stiffness.nnz > n or not np.all(diagonal > 0):
        return None
    diagonal, across, factor = diagonal + regularisation, sp.csr_matrix(rows.T), None
    if count:
        schur = (rows @ sp.diags(1.0 / diagonal) @ across).toarray() + regularisation * np.eye(count)
        factor = DenseCholesky((schur + schur.T) / 2)

    def solve(right: Vector) -> Vector:
        u: Vector = right[:n] / diagonal
        if factor is None:
            return u
        pushed = factor.solve(rows @ u - right[n:])
        return np.asarray(np.concatenate([u - (across @ pushed) / diagonal, pushed]))

    return solve


# The number of vectors of GMRES between restarts.
RESTART = 60
# The part of a new direction orthogonal to the earlier ones below which it is rounding.
EXHAUSTED = 1e-14


def flexible_gmres(
    along: Callable[[Vector], Vector],
    product: Callable[[Vector], Vector],
    dots: Callable[[Array, Vector], Vector],
    residual: Vector,
    reduction: float,
    most: int,
    first: Vector | None = None,
) -> tuple[Vector, int]:
    """Reduce |r - A z| by GMRES that keeps the preconditioned directions z_k = M v_k (Saad 1993, algorithm 2.2).

    The answer is a sum of these, formed and checked without products or applications of M.

    Parameters
    ----------
    along, product : functions of an (n,) array, M v and A z
    dots : function of vectors (q, n) and one (n,), returns their inner products (q,)
    residual : (n,) array, r
    reduction : the part of |r| at which it ends
    most : the largest number of steps, RESTART at most
    first : (n,) array, optional
        M r, where it is known.

    Returns
    -------
    z : (n,) array
    steps : int, applications of A
    """
    size = float(np.sqrt(dots(residual[None], residual)[0]))
    if not (size > 0 and most > 0):
        return np.zeros_like(residual), 0
    most = min(most, RESTART)
    v, z = np.empty((most + 1, len(residual))), np.empty((most, len(residual)))
    v[0], hessenberg = residual / size, np.zeros((most + 1, most))
    start = np.zeros(most + 1)
    start[0] = size
    for k in range(most):
        z[k] = along(v[k]) if k or first is None else first / size
        w = product(z[k])
        before = float(np.sqrt(dots(w[None], w)[0]))
        for _ in range(2):  # the second time removes rounding of the first
            share = dots(v[: k + 1], w)
            hessenberg[: k + 1, k] += share
            w -= v[: k + 1].T @ share
        hessenberg[k + 1, k] = float(np.sqrt(dots(w[None], w)[0]))
        system = hessenberg[: k + 2, : k + 1]
        y = np.linalg.lstsq(system, start[: k + 2], rcond=None)[0] if np.all(np.isfinite(system)) else np.zeros(k + 1)
        left = float(np.linalg.norm(start[: k + 2] - system @ y))
        if not left > reduction * size or not hessenberg[k + 1, k] > EXHAUSTED * before:
            break
        v[k + 1] = w / hessenberg[k + 1, k]
    return np.asarray(z[: k + 1].T @ y), k + 1
