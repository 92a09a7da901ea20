"""Smoothed aggregation: a symmetric positive definite M near the inverse of a large stiffness, made of products alone.

One V-cycle of algebraic multigrid (Vanek, Mandel and Brezina 1996): coupled unknowns form aggregates, on each of which
the near-null-space B is restricted and orthonormalised (both by pyamg) and smoothed by one step of damped Jacobi,

    P = (I - 4/(3 rho) D^-1 K) T,    K_coarse = P'K P,    D = diag K,    rho = largest eigenvalue of D^-1 K,

and a Chebyshev polynomial of D^-1 K acts before and after the coarse correction (Adams, Brezina, Hu and Tuminaro 2003).

The coarsest level is factorised densely for every set of constrained rows. With t the unknowns that rows touch and o
the others, scaled to a diagonal of ones,

    K_oo = L L',    X = L^-1 K_ot,    S = K_tt - X'X,

so that after a change of the rows only S + E'CE, of few unknowns, is factorised.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendMissing, Unsupported
from contactqp.linalg.pardiso import products
from contactqp.model.arrays import EPS, Array, Indices, Mask, refuse_late

# The most unknowns of the coarsest level. Where rows touch most of them it is factorised for every set of rows, which
# beyond some hundred costs more than another level.
COARSEST, COARSEST_TOUCHED = 1500, 400
# Added to the scaled diagonal of floating bodies on the coarsest level, small compared with deformations and large
# compared with rounding of rigid motions.
LIFT = 1e-10
MOST_LEVELS = 12
# Steps of Lanczos' method give the largest eigenvalue to a few per cent, and a safety factor is applied.
LANCZOS_STEPS, ALLOWANCE = 10, 1.1
# Block storage is used if it increases the entries by no more than this factor.
BLOCK_FILL = 1.2
# A motion is considered rigid if b'Kb / b'Db is below this; one support among a million unknowns gives 1e-6.
FLOATING = 1e-12
# Damping of the Jacobi step on the prolongator times the largest eigenvalue, for the least energy of its columns.
JACOBI = 4 / 3


def available() -> bool:
    """Return whether pyamg is installed, without importing it."""
    return importlib.util.find_spec("pyamg") is not None


@dataclass(frozen=True, eq=False)
class Level:
    """One level: its matrix K, products K x, D, the largest eigenvalue of D^-1 K, and what is prolonged from below."""

    matrix: Any
    product: Callable[[Array], Array]
    diagonal: Array
    largest: float
    prolong: Any = None  # None on the coarsest level
    restrict: Any = None


class Hierarchy:
    """The levels of one stiffness.

    Raises BackendMissing: pyamg is not installed.

    Parameters
    ----------
    stiffness : (n, n) sparse matrix, symmetric positive semidefinite, its diagonal positive
    motions : (n, q) array, optional
        B, motions that cost little energy: the rigid-body motions of elastic bodies. By default the constants, one for
        each unknown of a block where K comes in blocks of three or two. Columns of zeros are left out.
    coarsest : unknowns of the coarsest level at most; by default COARSEST

    Attributes
    ----------
    bodies : (n,) array, the number of the connected part of K that each unknown belongs to
    held : (number of bodies,) array
        The least ratio b'Kb / b'Db of motions b in the span of B for each body, rounding if the body floats.
    soft : (number of bodies,) array of int
        The dimension of the space of motions in the span of B with a ratio of at most FLOATING.
    """

    def __init__(self, stiffness: Any, motions: Array | None = None, coarsest: int | None = None) -> None:
        if not available():
            raise BackendMissing("pyamg is not installed: pip install pyamg")
        try:
            importlib.import_module("pyamg.aggregation")
        except ImportError as error:  # such as one for a newer SciPy
            raise BackendMissing(f"pyamg: {error}; pip install --upgrade pyamg") from error
        matrix = in_blocks(stiffness)
        B = np.zeros((len(matrix.diagonal()), 0)) if motions is None else of_size_one(motions)
        B = B if B.shape[1] else constants(len(B), block_size(matrix))
        self.bodies = _bodies(matrix)
        self.levels: list[Level] = []
        while True:
            refuse_late("the hierarchy of the stiffness was built")
            diagonal, product = _positive(matrix.diagonal()), products(matrix)
            largest = largest_eigenvalue(product, diagonal)
            aggregates = _aggregates(matrix) if matrix.shape[0] > (coarsest or COARSEST) else None
            if not self.levels:  # uncoupled unknowns belong to no aggregate, so K B differs from K T B_coarse
                self.held, self.soft = self._least_energies(B, matrix @ B, diagonal)
            if aggregates is None or len(self.levels) == MOST_LEVELS:
                self.levels.append(Level(matrix, product, diagonal, largest))
                return
            tentative, coarse_B = _tentative(aggregates, B)
            blocks = _as_blocks(matrix)
            smoothing = _scaled_rows(blocks @ tentative, JACOBI / largest / diagonal, tentative)
            prolong = tentative - smoothing
            self.levels.append(Level(matrix, product, diagonal, largest, prolong, prolong.T))
            size = B.shape[1]
            matrix, B = (prolong.T @ (blocks @ prolong)).tobsr((size, size)), coarse_B

    def _least_energies(self, B: Array, forces: Array, diagonal: Array) -> tuple[Array, Indices]:
        """Return min over a of a'(B'KB)a / a'(B'DB)a for each body, and how many are FLOATING; `forces` is K B."""
        q, count = B.shape[1], int(self.bodies.max()) + 1
        energy, size = np.empty((2, count, q, q))
        for i in range(q):
            for j in range(q):
                energy[:, i, j] = np.bincount(self.bodies, B[:, i] * forces[:, j], count)
                size[:, i, j] = np.bincount(self.bodies, B[:, i] * diagonal * B[:, j], count)
        if q == 1:  # K may be diagonal, with as many bodies as unknowns
            ratio = (energy / size).ravel()
            return ratio, (ratio <= FLOATING).astype(np.intp)
        ratios = [energy_ratios(e, s)[0] for e, s in zip(energy, size, strict=True)]
        soft = [np.count_nonzero(ratio <= FLOATING) for ratio in ratios]
        return np.array([ratio[0] for ratio in ratios]), np.array(soft)


def energy_ratios(energy: Array, size: Array) -> tuple[Array, Array]:
    """Return the eigenvalues (p,) and eigenvectors (q, p) of E a = value S a on the range of S, the least first."""
    values, vectors = np.linalg.eigh(size)
    kept = values > EPS * len(size) * values[-1]
    basis = vectors[:, kept] / np.sqrt(values[kept])
    ratios, coordinates = np.linalg.eigh(basis.T @ ((energy + energy.T) / 2) @ basis)
    return ratios, basis @ coordinates


def _positive(diagonal: Array) -> Array:
    """Return a diagonal with ones in place of zeros of coarse unknowns without a motion."""
    return np.where(diagonal > 0, diagonal, 1.0)


def in_blocks(stiffness: Any, total: Callable[[int], int] = int) -> Any:
    """Return K in blocks of three or two unknowns where its entries come in such blocks, else by rows.

    For a part of the rows of K, which cuts no block, `total` sums over all parts.
    """
    rows = sp.csr_matrix(stiffness)
    entries = total(rows.nnz)
    for size in (3, 2):
        if rows.shape[1] % size == 0:
            blocks = rows.tobsr((size, size))
            if total(blocks.data.size) <= BLOCK_FILL * entries:
                return blocks
    return rows


def _as_blocks(matrix: Any) -> Any:
    """Return a CSR matrix as one of blocks of size one, without a copy, so that products with blocks are blocks."""
    if matrix.format == "bsr":
        return matrix
    return sp.bsr_matrix((matrix.data.reshape(-1, 1, 1), matrix.indices, matrix.indptr), shape=matrix.shape)


def block_size(matrix: Any) -> int:
    return int(matrix.blocksize[0]) if matrix.format == "bsr" else 1


def _graph(matrix: Any) -> Any:
    """Return which blocks of unknowns K couples."""
    count = len(matrix.indptr) - 1
    return sp.csr_matrix((np.ones(len(matrix.indices)), matrix.indices, matrix.indptr), shape=(count, count))


def of_size_one(motions: Array, most: Callable[[Array], Array] = np.asarray) -> Array:
    """Return the motions that are not zero, each divided by its largest entry.

    `most` is the maximum, entry by entry, over all processes.
    """
    largest = most(np.max(abs(motions), axis=0, initial=0.0))
    return np.asarray(motions[:, largest > 0] / largest[largest > 0])


def constants(count: int, size: int) -> Array:
    """Return the constant motions (count, size) of unknowns in blocks, one for each unknown of a block."""
    return np.tile(np.eye(size), (count // size, 1))


def _bodies(matrix: Any) -> Indices:
    from scipy.sparse.csgraph import connected_components

    # As the graph is symmetric, strong components equal components and are found without a transposition.
    _, label = connected_components(_graph(matrix), directed=True, connection="strong")
    return np.repeat(label, block_size(matrix))


def _aggregates(matrix: Any) -> Any:
    """Return aggregates of neighbouring blocks as a matrix (blocks, aggregates), None if it is not coarser."""
    from pyamg.aggregation.aggregate import standard_aggregation

    aggregates, _ = standard_aggregation(_graph(matrix))
    return aggregates if 0 < aggregates.shape[1] < aggregates.shape[0] else None


def _tentative(aggregates: Any, B: Array) -> tuple[Any, Array]:
    """Return the tentative prolongation T with T'T = 1, and B_coarse with B = T B_coarse."""
    from pyamg.aggregation.tentative import fit_candidates

    tentative, coarse = fit_candidates(aggregates, B)
    return tentative, coarse


def _scaled_rows(product: Any, scale: Array, like: Any) -> Any:
    rows = sp.bsr_matrix(product, blocksize=like.blocksize)
    of_block = np.repeat(np.arange(len(rows.indptr) - 1), np.diff(rows.indptr))
    data = rows.data * scale.reshape(-1, like.blocksize[0])[of_block][:, :, None]
    return sp.bsr_matrix((data, rows.indices, rows.indptr), shape=rows.shape)


def largest_eigenvalue(
    product: Callable[[Array], Array], diagonal: Array, dot: Callable[[Array, Array], float] = np.dot
) -> float:
    """Return the largest eigenvalue of D^-1 K by Lanczos' method from a fixed vector, with a safety factor.

    `dot` is a'b over all processes.
    """
    from scipy.linalg import eigvalsh_tridiagonal

    scale = 1 / np.sqrt(diagonal)
    v = np.random.default_rng(0).standard_normal(len(scale))
    count = int(dot(np.ones_like(v), np.ones_like(v)))
    v /= np.sqrt(dot(v, v))
    before, beta = np.zeros_like(v), 0.0
    alphas, betas = [], []
    for _ in range(min(LANCZOS_STEPS, count)):
        w = scale * product(scale * v) - beta * before
        alphas.append(float(dot(v, w)))
        w -= alphas[-1] * v
        beta = float(np.sqrt(dot(w, w)))
        betas.append(beta)
        if beta <= EPS * count * abs(alphas[0]):
            break
        before, v = v, w / beta
    return float(ALLOWANCE * eigvalsh_tridiagonal(np.array(alphas), np.array(betas[:-1]))[-1])


class SingularLevel(Unsupported):
    """A level is singular, as its Cholesky factorisation failed."""


class CoarsestLevel:
    """Factors of K_oo.

    Parameters
    ----------
    matrix : (n, n) sparse matrix, K of the level; an unknown with a zero row gets a diagonal of one
    touched : (t,) array of int, the unknowns that rows may touch
    afloat : (n,) array of bool, optional
        The unknowns of bodies that float, on which K is singular: their diagonal is lifted.
    """

    def __init__(self, matrix: Any, touched: Indices, afloat: Mask | None = None) -> None:
        dense = matrix.toarray()
        empty = np.flatnonzero(np.diag(dense) <= 0)
        dense[empty, empty] = 1.0
        self.scale = 1 / np.sqrt(np.diag(dense))
        dense *= np.outer(self.scale, self.scale)
        if afloat is not None:
            dense[afloat, afloat] += LIFT
        self.touched = touched
        self.others = np.setdiff1d(np.arange(len(dense)), touched)
        self.lower = cholesky(dense[np.ix_(self.others, self.others)])
        coupling = dense[np.ix_(self.others, touched)]
        self.coupling = forward(self.lower, coupling)
        self.schur = dense[np.ix_(touched, touched)] - self.coupling.T @ self.coupling


class HeldCoarsestLevel:
    """(K + E'CE)^-1 on the coarsest level; `added` (t, t) is E'CE of the touched unknowns."""

    def __init__(self, level: CoarsestLevel, added: Array) -> None:
        self._level = level
        scale = level.scale[level.touched]
        self._lower = cholesky(level.schur + np.outer(scale, scale) * added)

    def solve(self, right: Array) -> Array:
        level, scaled = self._level, self._level.scale * right
        inner = forward(level.lower, scaled[level.others])
        x = np.empty_like(scaled)
        at = backward(self._lower, forward(self._lower, scaled[level.touched] - level.coupling.T @ inner))
        x[level.touched] = at
        inner -= level.coupling @ at
        x[level.others] = backward(level.lower, inner)
        return level.scale * x


def cholesky(matrix: Array) -> Array:
    """Return Cholesky's L of a matrix with a diagonal of about one.

    Raises
    ------
    SingularLevel
    """
    from scipy.linalg import cholesky as factor

    if not len(matrix):
        return matrix
    try:
        return np.asarray(factor(matrix, lower=True, check_finite=False))
    except np.linalg.LinAlgError:
        raise SingularLevel(
            "pyamg: the stiffness is singular, or too near to it to be solved by iteration; factorise it instead: "
            "CONTACTQP_SPARSE_SOLVER=pardiso or superlu"
        ) from None


def forward(lower: Array, right: Array) -> Array:
    """Return L^-1 right, also for empty matrices, which LAPACK refuses."""
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(lower, right, lower=True, check_finite=False)) if right.size else right.copy()


def backward(lower: Array, right: Array) -> Array:
    """Return L'^-1 right."""
    from scipy.linalg import solve_triangular

    if not right.size:
        return right.copy()
    return np.asarray(solve_triangular(lower, right, lower=True, trans="T", check_finite=False))
