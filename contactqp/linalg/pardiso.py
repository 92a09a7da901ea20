"""Call MKL by the library of pypardiso: PARDISO's Cholesky factors with a Schur complement, and sparse products.

With `perm` = 1 at the retained unknowns and iparm(36) = 1 the factorisation stops before them and returns the dense S;
phase 331 is then the forward elimination of a load, whose retained entries are f_S, and phase 333 the backward
substitution that starts from given retained entries (Intel oneMKL Developer Reference, PARDISO iparm parameters).
Products of large sparse matrices run on MKL's threads too.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import weakref
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import BackendFailed, BackendMissing, free_memory
from contactqp.linalg.runtime import MOST_OF_MEMORY, stoppable
from contactqp.model.arrays import Array, Indices, refuse_late
from contactqp.model.problem import ContactProblem

POSITIVE_DEFINITE, INDEFINITE, UNSYMMETRIC = 2, -2, 11
ANALYSE, FACTORISE, SOLVE, FORWARD, BACKWARD, RELEASE = 11, 22, 33, 331, 333, -1
NOT_POSITIVE = -4
# Places in iparm, counted from zero.
DEFAULTS_OVERRIDDEN, ORDERING, PERMUTATION, PERTURBATION, ZERO_BASED, SCHUR, KEEP_DIAGONAL = 0, 1, 4, 9, 34, 35, 55
MINIMUM_DEGREE, NESTED_DISSECTION, SCHUR_ONLY = 0, 2, 1
STATED_ORDER, ORDER_RETURNED = 1, 2
# Memory reported by the analysis [kibibytes]: its peak, its permanent part, and that of factors and solutions.
PEAK_OF_ANALYSIS, STAYS, OF_FACTORS = 14, 15, 16
# The place where the analysis reports the entries of the factors, if it holds a negative number before.
ENTRIES, ASKED = 17, -1
# Unsymmetric matrices are scaled and matched, which moves large entries to the diagonal.
SCALING, MATCHING = 10, 12
# The environment variable of pypardiso with the path of the library.
STATED = "PYPARDISO_MKL_RT"
# Pivots of an indefinite matrix beneath 10^-13 of it are raised to that.
LEAST_PIVOT = 13
# Plane meshes are recognised by their average and largest number of entries per row. Up to this number of unknowns
# minimum degree orders them in half the time of nested dissection without more fill-in; for larger ones, and in space,
# its factors are slower, and for saddle points of programs it may take minutes.
OF_PLANES, LONGEST_ROW, OF_FEW_UNKNOWNS = 25, 50, 100_000
# The allowed growth of entries per row of factors in a given order, relative to those for which it was found.
FILLS_IN = 1.5
# Products of smaller matrices are not worth starting threads.
MANY_ENTRIES = 500_000
# In MKL's sparse products: the matrix itself and not its transpose, of no special kind, its blocks by rows.
NOT_TRANSPOSED, GENERAL, BLOCKS_BY_ROWS = 10, 20, 101
# Factors of more entries take longer than a second, and are stopped by Ctrl-C and at a time limit.
LONG = 3e7
# The number of matrices with the same pattern per analysis, and the phase that releases the factors of one.
OF_ONE_ANALYSIS, RELEASE_ONE = 2, 0


class NotPositive(Exception):
    """A pivot is zero or negative."""


class FillsIn(Exception):
    """In the given order the factors would have too many entries; nothing was factorised."""


class TooLarge(BackendFailed):
    """The factors are predicted not to fit into the free memory; nothing was factorised."""


# The environment variable that chooses the sparse solver, by default the fastest. "pyamg" selects the iteration, unless
# a caller needs factors.
SOLVER_VARIABLE = "CONTACTQP_SPARSE_SOLVER"


def available() -> bool:
    """Return whether PARDISO is installed and not switched off by `SOLVER_VARIABLE`, without loading it."""
    return os.environ.get(SOLVER_VARIABLE, "") != "superlu" and importlib.util.find_spec("pypardiso") is not None


@cache
def _library() -> Any:
    if importlib.util.find_spec("pypardiso") is None:
        raise BackendMissing("pardiso: pypardiso is not installed: pip install pypardiso")
    # Its threads would otherwise wait by spinning and slow down other work between calls.
    os.environ.setdefault("KMP_BLOCKTIME", "0")
    path = None if os.environ.get(STATED) else _installed()
    if path is not None:
        return ctypes.CDLL(path)
    from pypardiso.scipy_aliases import pypardiso_solver

    return ctypes.CDLL(pypardiso_solver.libmkl._name)


def _installed() -> str | None:
    """Return the library where the package mkl has installed it (Linux and macOS), or None.

    pypardiso searches all folders of the environment, which may take seconds.
    """
    from importlib.metadata import PackageNotFoundError, files

    try:
        paths = [file.locate() for file in files("mkl") or () if file.name.startswith("libmkl_rt.")]
    except PackageNotFoundError:
        return None
    return next((str(path) for path in paths if os.path.exists(path)), None)


class Pardiso:
    """K = L L' up to the retained unknowns; of an indefinite matrix L D L', pivots of size one and two; else L U.

    Parameters
    ----------
    matrix : (n, n) sparse matrix
    retained : (r,) array of int, unknowns that are not eliminated
    kind : int, POSITIVE_DEFINITE, INDEFINITE or UNSYMMETRIC
    order : (n,) array of int, optional
        The unknowns in the order in which they are eliminated, where none is retained; by default `ordering` finds one.
    most_entries : how many entries factors in a stated order may have
    ordering : NESTED_DISSECTION or MINIMUM_DEGREE

    Raises
    ------
    NotPositive
        A pivot is zero or negative: the matrix without the retained unknowns is singular or indefinite.
    FillsIn
        In the given order the factors would have too many entries.
    TooLarge
        The factors are predicted to need more memory than is free.
    BackendMissing, BackendFailed
        PARDISO is not installed, or failed.
    """

    def __init__(
        self,
        matrix: Any,
        retained: Indices,
        kind: int = POSITIVE_DEFINITE,
        order: Indices | None = None,
        most_entries: float = np.inf,
        ordering: int = NESTED_DISSECTION,
    ) -> None:
        upper = _entries_of(matrix, kind)
        if upper.nnz > np.iinfo(np.int32).max:
            raise BackendFailed(f"pardiso: {upper.nnz} entries are more than its 32-bit indices can count")
        self.size = int(upper.shape[0])
        # The unknowns that are retained, else the order of elimination.
        chosen = np.zeros(self.size, dtype=np.int32)
        chosen[retained] = 1
        settings = np.zeros(64, dtype=np.int32)
        settings[[DEFAULTS_OVERRIDDEN, ORDERING]] = 1, ordering
        settings[[ZERO_BASED, KEEP_DIAGONAL]] = 1
        settings[[PERTURBATION, ENTRIES]] = LEAST_PIVOT, ASKED
        if kind == UNSYMMETRIC:
            settings[[SCALING, MATCHING]] = 1
        if len(retained):
            settings[SCHUR] = SCHUR_ONLY
        elif order is not None:
            settings[PERMUTATION], chosen = STATED_ORDER, np.ascontiguousarray(order, dtype=np.int32)
        else:
            settings[PERMUTATION] = ORDER_RETURNED
        self._analysis, self._number = _Analysis(upper, kind, settings, chosen), 1
        self._values = np.ascontiguousarray(upper.data, dtype=np.float64)
        self._call(ANALYSE, np.zeros(1), np.zeros(1))
        if order is not None and self.entries_of_factors > most_entries:
            raise FillsIn
        self._refuse_too_large(len(retained))
        refuse_late("the stiffness was factorised")
        self.schur = np.zeros((len(retained), len(retained)))
        self._factorise()

    def beside(self, matrix: Any) -> Pardiso | None:
        """Return the factors of another matrix with the same pattern, by the analysis of this one.

        None if the pattern differs, or if the analysis already serves a second matrix.

        Raises
        ------
        NotPositive, TooLarge, BackendFailed
            As `Pardiso`.
        """
        upper, analysis = _entries_of(matrix, self._analysis.kind), self._analysis
        if analysis.second is not None or self.schur.size or not analysis.is_of(upper):
            return None
        made = object.__new__(Pardiso)
        made.size, made.schur = self.size, self.schur
        made._analysis, made._number = analysis, OF_ONE_ANALYSIS
        made._values = np.ascontiguousarray(upper.data, dtype=np.float64)
        made._refuse_too_large(0)
        made._factorise()
        analysis.second = weakref.finalize(made, analysis.release_second)
        return made

    def _factorise(self) -> None:
        library: Any = _library() if self.entries_of_factors > LONG else None
        with stoppable(getattr(library, "mkl_set_progress", None)):
            self._call(FACTORISE, np.zeros(1), self.schur if self.schur.size else np.zeros(1))
        self.smallest_pivot = self._smallest_pivot() if self._analysis.kind == POSITIVE_DEFINITE else np.nan

    @property
    def order(self) -> Indices:
        """Return the order of elimination of the unknowns (n,), if none is retained."""
        return self._analysis.chosen.astype(np.intp)

    @property
    def entries_of_factors(self) -> int:
        """Return the number of entries of the factors predicted by the analysis."""
        return int(self._analysis.settings[ENTRIES])

    @property
    def predicted_memory(self) -> int:
        """Return the bytes that analysis, factors and solutions take at their peak, as the analysis predicts."""
        told = self._analysis.settings
        return 1024 * max(int(told[PEAK_OF_ANALYSIS]), int(told[STAYS]) + int(told[OF_FACTORS]))

    def _refuse_too_large(self, retained: int) -> None:
        """Raise TooLarge before the system would end the process for lack of memory."""
        needed, free = self.predicted_memory + 8 * retained**2, free_memory()
        if free is not None and needed > MOST_OF_MEMORY * free:
            raise TooLarge(
                f"the factors of {self.size} unknowns need about {needed / 2**30:.1f} GiB, {free / 2**30:.1f} GiB are "
                "free: free memory, take a coarser mesh, or solve on several ranks (engine='petsc')"
            )

    def solve_all(self, right: Array) -> Array:
        """Return K^-1 right, where no unknown is retained."""
        return self._solve(SOLVE, right)

    def forward(self, right: Array) -> Array:
        """Return L^-1 right on the interior and f_S on the retained unknowns."""
        return self._solve(FORWARD, right)

    def backward(self, right: Array) -> Array:
        """Return u from L^-1 f on the interior and u_c on the retained unknowns, of one load (n,) or (n, q)."""
        return self._solve(BACKWARD, right)

    def _solve(self, phase: int, right: Array) -> Array:
        solution = np.zeros(right.shape, order="F")
        self._call(phase, np.array(right, dtype=np.float64, order="F"), solution)
        return solution

    def _call(self, phase: int, right: Array, solution: Array) -> None:
        self._analysis.call(phase, self._number, self._values, right, solution)

    def _smallest_pivot(self) -> float:
        """Return the least ratio of a pivot to its diagonal entry, the pivot of the matrix with unit diagonal."""
        pivots, before, error = np.zeros(self.size), np.zeros(self.size), ctypes.c_int32(0)
        _library().pardiso_getdiag(
            *(_pointer(self._analysis.handle), _pointer(pivots), _pointer(before)),
            *(ctypes.byref(ctypes.c_int32(self._number)), ctypes.byref(error)),
        )
        if error.value:
            raise BackendFailed(f"pardiso: error {error.value} when its pivots were asked for")
        eliminated = self.size - len(self.schur)  # in the order of elimination, the retained unknowns last
        return float(np.min(pivots[:eliminated] / before[:eliminated], initial=1.0))


class _Analysis:
    """PARDISO's analysis of a pattern, and the factors of up to two matrices with it.

    Attributes
    ----------
    kind : POSITIVE_DEFINITE, INDEFINITE or UNSYMMETRIC
    handle, settings : (64,) arrays of int, PARDISO's pt and iparm
    chosen : (n,) array of int, its perm
    second : callable, optional
        The function that releases the factors of a second matrix, None if there are none.
    """

    def __init__(self, entries: Any, kind: int, settings: NDArray[np.int32], chosen: NDArray[np.int32]) -> None:
        self.kind, self.settings, self.chosen = kind, settings, chosen
        self.handle = np.zeros(64, dtype=np.int64)
        self._starts, self._columns = entries.indptr.astype(np.int32), entries.indices.astype(np.int32)
        self.second: Any = None
        self._release = weakref.finalize(self, _release, self.handle, settings, kind)

    def is_of(self, entries: Any) -> bool:
        """Return whether a matrix has the analysed pattern."""
        return np.array_equal(entries.indptr, self._starts) and np.array_equal(entries.indices, self._columns)

    def call(self, phase: int, number: int, values: Array, right: Array, solution: Array) -> None:
        """Call PARDISO for the first or the second matrix.

        Raises NotPositive, BackendFailed as `Pardiso` does.

        Parameters
        ----------
        phase, number : ANALYSE and the like; 1 or OF_ONE_ANALYSIS
        values : array, the entries of that matrix
        right, solution : arrays, right-hand sides (n,) or (n, q), and what is found for them
        """
        error, size = ctypes.c_int32(0), len(self._starts) - 1
        most = 1 if self.settings[SCHUR] else OF_ONE_ANALYSIS
        count = right.shape[1] if right.ndim == 2 else 1
        _library().pardiso(
            _pointer(self.handle),
            *(ctypes.byref(ctypes.c_int32(given)) for given in (most, number, self.kind, phase, size)),
            *(_pointer(array) for array in (values, self._starts, self._columns, self.chosen)),
            *(ctypes.byref(ctypes.c_int32(count)), _pointer(self.settings), ctypes.byref(ctypes.c_int32(0))),
            *(_pointer(right), _pointer(solution), ctypes.byref(error)),
        )
        if error.value == NOT_POSITIVE:
            raise NotPositive
        if error.value:
            raise BackendFailed(f"pardiso: error {error.value} in phase {phase}")

    def release_second(self) -> None:
        """Release the factors of the second matrix."""
        nothing, self.second = np.zeros(1), None
        self.call(RELEASE_ONE, OF_ONE_ANALYSIS, nothing, nothing, nothing)


class EliminationOrder:
    """The order of elimination of the unknowns of a stiffness and its saddle points, found once.

    Finding it takes most of the time of a factorisation in the plane. Rows of contacts and ties are eliminated after
    the last of their unknowns, so that pivots of unknowns are positive, those of rows negative, and the small diagonal
    of a row is never a pivot, as it could be in an order for the saddle point.
    """

    def __init__(self, unknowns: int) -> None:
        self._place = np.full(unknowns, np.nan)  # rank of each unknown, NaN if unknown
        self._entries = 0.0  # entries per row of the factors that it was found for
        self._of_saddle = False  # whether it was found with rows below the stiffness
        self.wide = False  # whether the last matrix was not a narrow band
        self.band: Any = None  # the last band (`schur.Band`)

    def factorised(self, matrix: Any, unknowns: Indices, kind: int = POSITIVE_DEFINITE) -> Pardiso:
        """Return the factors of a matrix whose first rows are those of these unknowns of the stiffness.

        Raises NotPositive, TooLarge, BackendMissing, BackendFailed as `Pardiso` does.
        """
        nothing, rows = np.zeros(0, dtype=np.intp), matrix.shape[0] * (2 if kind == UNSYMMETRIC else 1)
        order = self._known(matrix, unknowns)
        if order is not None:
            try:
                return Pardiso(matrix, nothing, kind, order, FILLS_IN * self._entries * rows)
            except FillsIn:
                pass
        by_degree = matrix.shape[0] == len(unknowns) and _in_the_plane(matrix)
        found = Pardiso(matrix, nothing, kind, ordering=MINIMUM_DEGREE if by_degree else NESTED_DISSECTION)
        place = np.empty(found.size)
        place[found.order] = np.arange(found.size)
        self._place[:] = np.nan
        self._place[unknowns], self._entries = place[: len(unknowns)], found.entries_of_factors / rows
        self._of_saddle = found.size > len(unknowns)
        return found

    def _known(self, matrix: Any, unknowns: Indices) -> Indices | None:
        """Return the order of elimination if that of the unknowns is known, else None."""
        place = self._place[unknowns]
        if np.any(np.isnan(place)) or (self._of_saddle and matrix.shape[0] == len(unknowns)):
            return None  # bodies joined by ties are dissected differently
        by_rows, first = matrix if matrix.format == "csr" else matrix.T, len(unknowns)
        entries = sp.csr_array(by_rows[first:, :first])
        last = np.full(entries.shape[0], np.inf)
        filled = np.flatnonzero(np.diff(entries.indptr))
        if filled.size:
            last[filled] = np.maximum.reduceat(place[entries.indices], entries.indptr[filled])
        return np.argsort(np.concatenate([place, last]), kind="stable")


def _in_the_plane(matrix: Any) -> bool:
    """Return whether a compressed matrix has the rows of a stiffness of few unknowns in the plane."""
    longest = int(np.max(np.diff(matrix.indptr), initial=0))
    return bool(matrix.nnz <= OF_PLANES * matrix.shape[0] <= OF_PLANES * OF_FEW_UNKNOWNS and longest <= LONGEST_ROW)


def elimination_order(problem: ContactProblem) -> EliminationOrder:
    """Return the order of elimination of a problem's stiffness, shared with its equilibrated twin."""
    of_stiffness = problem._computed.of_stiffness
    if of_stiffness.elimination_order is None:
        of_stiffness.elimination_order = EliminationOrder(problem.dimension)
    order: EliminationOrder = of_stiffness.elimination_order
    return order


def _pointer(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _entries_of(matrix: Any, kind: int) -> Any:
    """Return the entries of a matrix in PARDISO's form, by rows with ascending columns.

    Of a symmetric matrix it needs every entry of the diagonal, also those that are zero.
    """
    entries = sp.csr_array(matrix) if kind == UNSYMMETRIC else upper_triangle(matrix)
    entries.sort_indices()
    if kind == UNSYMMETRIC:
        return entries
    filled, stored = np.flatnonzero(np.diff(entries.indptr)), np.zeros(entries.shape[0], dtype=bool)
    stored[filled] = entries.indices[entries.indptr[filled]] == filled
    missing = np.flatnonzero(~stored)
    if not missing.size:
        return entries
    starts = entries.indptr + np.searchsorted(missing, np.arange(len(entries.indptr)))
    first = entries.indptr[missing]
    columns, values = np.insert(entries.indices, first, missing), np.insert(entries.data, first, 0.0)
    return sp.csr_array((values, columns, starts), shape=entries.shape)


def upper_triangle(matrix: Any) -> Any:
    """Return the upper triangle of a symmetric matrix by rows."""
    by_rows = sp.csr_array(matrix.T if matrix.format == "csc" else matrix)
    rows = np.repeat(np.arange(by_rows.shape[0]), np.diff(by_rows.indptr))
    right = by_rows.indices >= rows
    kept, starts = np.flatnonzero(right), np.concatenate([[0], np.cumsum(right)])[by_rows.indptr]
    return sp.csr_array((by_rows.data[kept], by_rows.indices[kept], starts), shape=by_rows.shape)


def _release(handle: Any, settings: Any, matrix_kind: int) -> None:
    """Give the factors' memory back."""
    nothing, one = np.zeros(1), ctypes.c_int32(1)
    size, kind, phase = ctypes.c_int32(1), ctypes.c_int32(matrix_kind), ctypes.c_int32(RELEASE)
    _library().pardiso(
        *(_pointer(handle), ctypes.byref(one), ctypes.byref(one), ctypes.byref(kind), ctypes.byref(phase)),
        *(ctypes.byref(size), _pointer(nothing), _pointer(nothing), _pointer(nothing), _pointer(nothing)),
        *(ctypes.byref(one), _pointer(settings), ctypes.byref(ctypes.c_int32(0))),
        *(_pointer(nothing), _pointer(nothing), ctypes.byref(ctypes.c_int32(0))),
    )


class _Description(ctypes.Structure):
    """MKL's matrix_descr: kind, triangle and diagonal."""

    _fields_ = (("kind", ctypes.c_int), ("triangle", ctypes.c_int), ("diagonal", ctypes.c_int))


class _Products:
    """y = A x on MKL's threads, from the arrays of a square matrix, which must not change.

    A row is summed by one thread in the order of its entries, so the result does not depend on the number of threads.

    Raises BackendFailed: MKL does not take the matrix.
    """

    def __init__(self, matrix: Any) -> None:
        self._matrix, self._starts = matrix, np.ascontiguousarray(matrix.indptr, dtype=np.int32)
        self._columns = np.ascontiguousarray(matrix.indices, dtype=np.int32)
        self._values = np.ascontiguousarray(matrix.data, dtype=np.float64)
        self._handle, size = np.zeros(1, dtype=np.int64), len(self._starts) - 1
        shape: tuple[Any, ...] = (size, size)
        create = _library().mkl_sparse_d_create_csr
        if matrix.format == "bsr":
            create, shape = _library().mkl_sparse_d_create_bsr, (BLOCKS_BY_ROWS, size, size, matrix.blocksize[0])
        starts = self._starts.ctypes.data
        _refuse_status(
            create(
                *(_pointer(self._handle), 0, *shape),
                *(ctypes.c_void_p(starts), ctypes.c_void_p(starts + self._starts.itemsize)),
                *(_pointer(self._columns), _pointer(self._values)),
            )
        )
        handle = ctypes.c_void_p(int(self._handle[0]))
        self._made, self._release = handle, weakref.finalize(self, _library().mkl_sparse_destroy, handle)

    def __call__(self, x: Array) -> Array:
        right = np.ascontiguousarray(x, dtype=np.float64)
        product, one, zero = np.empty_like(right), ctypes.c_double(1.0), ctypes.c_double(0.0)
        described = _Description(GENERAL, 0, 0)
        _refuse_status(
            _library().mkl_sparse_d_mv(
                *(NOT_TRANSPOSED, one, self._made, described, _pointer(right), zero, _pointer(product)),
            )
        )
        return product


def _refuse_status(status: int) -> None:
    if status:
        raise BackendFailed(f"MKL: status {status} of a sparse product")


def products(matrix: Any) -> Callable[[Array], Array]:
    """Return the product A x of a square matrix (n, n), by rows or in blocks, with vectors (n,).

    A large matrix is multiplied on the threads of MKL where pypardiso is installed and not switched off by
    `SOLVER_VARIABLE`, the others by SciPy. The matrix must not change afterwards.
    """
    if matrix.format not in ("csr", "bsr") or not MANY_ENTRIES <= matrix.data.size <= np.iinfo(np.int32).max:
        return matrix.__matmul__  # type: ignore[no-any-return]
    return _Products(matrix) if available() else matrix.__matmul__
