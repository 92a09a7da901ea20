"""Read and check the data of a contact problem; errors name the argument, what came and what was expected."""

from __future__ import annotations

import numbers
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from decimal import Decimal
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeGuard, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.errors import InvalidProblem, shown
from contactqp.model.arrays import EPS, WORTHWHILE, Array, Vector, on_one_thread, refuse_places_outside
from contactqp.model.printed_stiffness import SOFT, clear_of_printing

Matrix = Any  # scipy.sparse matrix or dense (n, n) array: SciPy's sparse types carry no useful annotations

# Kinds of arrays of real numbers, including Python objects such as Fraction and Decimal, and names of the others.
KINDS = "biufO"
OTHER_KINDS = {"c": "complex numbers", "U": "words", "S": "words", "T": "words", "M": "dates", "m": "durations"}
# Programs print stiffness matrices with at least six digits; a larger asymmetry is not one of rounding.
SYMMETRY_TOLERANCE = 1e-6
# Up to this size definiteness is checked on input, by a dense factorisation, above by that of the bodies.
DEFINITENESS_CHECK_SIZE = 200
# Numbers between the inverse of this power of two (1e-24) and itself (1e24) need no scaling.
FARTHEST = 80
# The most entries of a direction of negative curvature in a message, and what may be behind it.
CURVED_NAMED = 4
BUCKLED = "; beyond its buckling load a structure has such a stiffness: contactqp.large_deformation follows it"

T = TypeVar("T")
# Immutable types.
PLAIN = frozenset((type(None), float, int, bool, str))


def read_only(value: T) -> T:
    """Return the value with all its arrays made read-only, those of sparse matrices and in tuples too.

    An array is copied only if it is a view of a writable one, which another owner could change.
    """
    found: Any = value
    if type(found) in PLAIN or isinstance(found, ReadOnly):
        return value
    if isinstance(found, np.ndarray):
        base = found.base
        if base is not None and isinstance(base, np.ndarray) and base.flags.writeable:
            found = found.copy()
        found.setflags(write=False)
    elif isinstance(found, tuple):
        if found and isinstance(found[0], np.ndarray):
            found = tuple(read_only(part) for part in found)
    elif sp.issparse(found):
        for part in ("data", "indices", "indptr"):
            if hasattr(found, part):
                getattr(found, part).setflags(write=False)
    kept: T = found
    return kept


class ReadOnly:
    """The base of frozen dataclasses that makes their arrays read-only, also after unpickling and copying."""

    def __post_init__(self) -> None:
        for name, value in vars(self).copy().items():
            kind = type(value)
            if kind is np.ndarray and value.base is None:  # most are
                value.setflags(write=False)
            elif kind in PLAIN or (kind is tuple and not value):
                continue
            elif (kept := read_only(value)) is not value:
                object.__setattr__(self, name, kept)

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, read_only(value))


def read_array(name: str, value: Any) -> Array:
    """Return a copy of real numbers of any shape, NaN included, as floats; fractions become floats.

    Raises InvalidProblem: rows of different lengths, words, complex numbers, dates, other objects that are not real
    numbers, masked arrays; `name` stands first in the message.
    """
    refuse_masked(name, value)
    try:
        raw = np.asarray(value)
        if raw.dtype.kind not in KINDS:
            raise TypeError(f"{OTHER_KINDS.get(raw.dtype.kind, raw.dtype)} are not real numbers")
        for entry in raw.flat if raw.dtype.kind == "O" else ():
            if not isinstance(entry, (numbers.Real, Decimal)):
                raise TypeError(f"one of type {type(entry).__name__}")
        return np.array(raw, dtype=float)
    except Exception as error:  # noqa: BLE001  whatever an object says of itself as an array
        raise InvalidProblem(f"{name}: expected real numbers, got {type(value).__name__} ({error})") from None


def read_shaped(values: Mapping[str, tuple[Any, tuple[int, ...]]]) -> dict[str, Any]:
    """Return copies of the named arrays, each in the shape given beside it; flat ones are reshaped.

    Raises
    ------
    InvalidProblem
        Another shape, or no real numbers; NaN is not checked.
    """
    arrays = {name: (read_array(name, value), shape) for name, (value, shape) in values.items()}
    for name, (array, shape) in arrays.items():
        if array.shape not in (shape, (int(np.prod(shape)),)):
            raise InvalidProblem(f"{name}: expected shape {shape}, got {array.shape}")
    return {name: array.reshape(shape) for name, (array, shape) in arrays.items()}


def read_answer(problem: Any, u: Any, force: Any, friction: Any, tie: Any) -> dict[str, Any]:
    """Return the arrays of an answer by name; raise InvalidProblem where one is missing or does not fit the problem.

    Parameters
    ----------
    problem : ContactProblem
    u : (n,) array-like, the displacement [length]
    force, tie : (m,) and (k,) array-like, the normal forces and those of ties [force]; `tie` may be None without ties
    friction : (m, d-1) or flat array-like [force]; None where the problem has no friction
    """
    n, m, k = problem.dimension, problem.contacts, problem.ties
    if tie is None and k:
        raise InvalidProblem(f"tie_force: the problem has {k} ties; expected their forces, shape ({k},), got None")
    shaped = {"displacement": (u, (n,)), "normal_force": (force, (m,))}
    shaped["tie_force"] = (np.zeros(0) if tie is None else tie, (k,))
    if problem.slip_origin is not None:
        if friction is None and problem.frictional:
            raise InvalidProblem("friction_force: the problem has friction; expected one force a contact, got None")
        shape = problem.slip_origin.shape
        shaped["friction_force"] = (np.zeros(shape) if friction is None else friction, shape)
    elif friction is not None and np.size(friction):
        raise InvalidProblem("friction_force was given, but the problem has no tangential rows")
    return {"friction_force": None} | read_shaped(shaped)


def is_number(value: Any) -> bool:
    """Return whether a value is one real number; truth values are not, nor are NumPy's durations."""
    if type(value) in (int, float):
        return True
    if not isinstance(value, (int, float, np.integer, np.floating)) or isinstance(value, (bool, np.timedelta64)):
        return False
    try:
        float(value)
        return True
    except Exception as error:  # noqa: BLE001  what a class of somebody else's makes of itself
        return isinstance(error, OverflowError)


def refuse_not_positive(name: str, value: Any) -> None:
    """Raise InvalidProblem unless a number is positive and finite."""
    beyond = isinstance(value, int) and abs(value) > sys.float_info.max
    number = float(value) if isinstance(value, np.floating) else value  # half floats do not compare with 1.8e308
    if beyond or not is_number(value) or not 0 < number < np.inf:
        got = "one beyond 1.8e308" if beyond else shown(value)
        raise InvalidProblem(f"{name}: expected a positive number, got {got}")


def is_whole(value: Any) -> TypeGuard[int]:
    """Return whether a value is one whole number; truth values and durations are not."""
    return is_number(value) and isinstance(value, (int, np.integer))


def is_masked(value: Any) -> bool:
    """Return whether a value is a masked array, without loading NumPy's module of them."""
    masked = sys.modules.get("numpy.ma")
    return masked is not None and isinstance(value, masked.MaskedArray)


def refuse_masked(name: str, value: Any) -> None:
    """Raise InvalidProblem where entries of an array are masked, or may be."""
    if type(value) is np.ndarray:
        return
    if is_masked(value):
        raise InvalidProblem(f"{name}: expected numbers, got a masked array; fill it first: array.filled(value)")
    if isinstance(value, (list, tuple)):
        for part in value:
            if type(part) in PLAIN:
                continue
            if part is value:
                raise InvalidProblem(f"{name}: expected numbers, got a list that holds itself")
            if isinstance(part, (list, tuple)) or is_masked(part):
                refuse_masked(name, part)


def _finite(name: str, values: Array) -> None:
    if not np.isfinite(values).all():
        at = np.argwhere(~np.isfinite(values))[0]
        raise InvalidProblem(f"{name}: expected finite numbers, got {values[tuple(at)]} at {at.tolist()}")


def read_vector(name: str, value: ArrayLike, size: int) -> Vector:
    return _finite_vector(name, read_array(name, value), size)


def _finite_vector(name: str, vector: Array, size: int) -> Vector:
    vector = vector[None] if vector.ndim == 0 and size == 1 else vector
    if vector.shape != (size,):
        raise InvalidProblem(f"{name}: expected shape ({size},), got {vector.shape}")
    _finite(name, vector)
    return read_only(vector)


def read_matrix(name: str, value: Any) -> Any:
    """Return a copy of a finite matrix as a float64 CSR array: duplicates summed, indices sorted, zeros dropped.

    Raises InvalidProblem: not a matrix of finite real numbers; `name` stands first in the message.
    """
    if not sp.issparse(value):
        return _rows_of(name, read_array(name, value))
    if value.ndim != 2:
        raise InvalidProblem(f"{name}: expected a matrix, got {shown(value)}")
    if is_masked(getattr(value, "data", None)) or value.dtype.kind not in KINDS:
        read_array(name, value.data)
    refuse_places_outside(name, value)
    rows = sp.csr_array(value, dtype=float, copy=True)
    rows.sum_duplicates()
    if not np.all(np.isfinite(rows.data)):
        at = int(np.flatnonzero(~np.isfinite(rows.data))[0])
        i, j = int(np.searchsorted(rows.indptr, at, side="right")) - 1, int(rows.indices[at])
        raise InvalidProblem(f"{name}: expected finite numbers, got {rows.data[at]} at [{i}, {j}]")
    rows.eliminate_zeros()
    return rows


def _rows_of(name: str, dense: Array) -> Any:
    """Return a matrix of real numbers as a CSR array without explicit zeros."""
    if dense.ndim != 2:
        raise InvalidProblem(f"{name}: expected a matrix, got {dense.ndim} dimension(s) of shape {dense.shape}")
    _finite(name, dense)
    return rows_of_dense(dense, sp.csr_array)


def csr_rows(matrix: Any) -> Any:
    """Return a matrix as a CSR array."""
    if isinstance(matrix, sp.csr_array):
        return matrix
    return sp.csr_array(matrix) if sp.issparse(matrix) else rows_of_dense(np.asarray(matrix), sp.csr_array)


def rows_of_dense(dense: Array, kind: Any) -> Any:
    """Return an array in a CSR format, its entries in the order of the rows, without explicit zeros."""
    row, column = dense.nonzero()
    rows = twin_of(_without_entries(kind, dense.shape))  # SciPy's constructor checks, which takes longer than all below
    rows.indptr = np.zeros(len(dense) + 1, dtype=np.int32)
    np.bincount(row, minlength=len(dense)).cumsum(out=rows.indptr[1:])
    rows.data, rows.indices = dense[row, column], column.astype(np.int32)
    return rows


def read_rows(name: str, value: Any, n: int) -> Any:
    if sp.issparse(value):
        rows = read_matrix(name, value)
    else:
        given = value if isinstance(value, np.ndarray) and not value.size else read_array(name, value)
        if not given.size:
            return no_rows(n)
        rows = _rows_of(name, given[None, :] if given.shape == (n,) else given)  # one row, or several
    if rows.shape[1] != n:
        raise InvalidProblem(f"{name}: expected {n} columns, one for each unknown, got shape {rows.shape}")
    return rows


def no_rows(n: int) -> Any:
    """Return a CSR array without rows over n unknowns."""
    return twin_of(_without_entries(sp.csr_array, (0, n)))


def twin_of(matrix: Any) -> Any:
    """Return another sparse matrix with the same arrays: `copy.copy` without what it looks up for any other object."""
    twin = object.__new__(type(matrix))
    vars(twin).update(vars(matrix))
    return twin


@lru_cache(maxsize=32)
def _without_entries(kind: Any, shape: tuple[int, int]) -> Any:
    """Return a shared, read-only matrix of zeros in a CSR format."""
    zeros = read_only(kind(shape))
    zeros.has_canonical_format = True
    return zeros


def read_gap(value: ArrayLike, size: int) -> Vector:
    """Read initial gaps (m,); a contact with an infinite gap never closes."""
    gap = read_array("gap", value)
    gap = gap[None] if gap.ndim == 0 and size == 1 else gap
    if gap.shape == (size,) and (gap == -np.inf).any():
        at = int(np.argmax(gap == -np.inf))
        raise InvalidProblem(f"gap: expected finite numbers, or inf where a contact never closes, got -inf at [{at}]")
    if gap.shape == (size,) and (gap == np.inf).any():
        _finite_vector("gap", np.where(gap == np.inf, 0.0, gap), size)
        return read_only(gap)
    return _finite_vector("gap", gap, size)


def read_stiffness(value: Any, motions: ArrayLike | None = None) -> tuple[Matrix, float, float]:
    """Read a stiffness; return K, its asymmetry, and its relative change by restored rigid motions
    (`printed_stiffness`).
    """
    dense = not sp.issparse(value)
    if dense and (definite := _definite(value)) is not None:
        read_motions(motions, len(definite))
        return read_only(definite), 0.0, 0.0
    K = read_matrix("stiffness", value)
    n = K.shape[0]
    if K.shape != (n, n) or n == 0:
        raise InvalidProblem(f"stiffness: expected a square matrix of one row at least, got shape {K.shape}")
    diagonal = K.diagonal()
    if np.any(diagonal < 0):
        j = int(np.argmin(diagonal))
        raise InvalidProblem(f"stiffness: expected positive semidefinite, got K[{j}, {j}] = {diagonal[j]:.6g}")
    row, root = np.repeat(np.arange(n), np.diff(K.indptr)), np.sqrt(diagonal)
    pair = root[row] * root[K.indices]
    outside = np.abs(K.data) > (1 + SYMMETRY_TOLERANCE) * pair
    if outside.any():
        at = int(np.flatnonzero(outside)[0])
        i, j = int(row[at]), int(K.indices[at])
        raise InvalidProblem(
            f"stiffness: indefinite, |K[{i}, {j}]| = {abs(K.data[at]):.6g} "
            f"exceeds sqrt(K[{i}, {i}] K[{j}, {j}]) = {pair[at]:.6g}"
        )
    asymmetry = 0.0
    if not _symmetric(K):
        difference = abs(K - K.T).tocoo()
        relative = difference.data / (root[difference.row] * root[difference.col])
        worst = int(np.argmax(relative))
        asymmetry = float(relative[worst])
        if asymmetry > SYMMETRY_TOLERANCE:
            i, j = int(difference.row[worst]), int(difference.col[worst])
            raise InvalidProblem(
                f"stiffness: expected symmetric, got K[{i}, {j}] and K[{j}, {i}] that differ by {asymmetry:.3g} "
                f"of sqrt(K[{i}, {i}] K[{j}, {j}]) (at most {SYMMETRY_TOLERANCE:g} is symmetrised)"
            )
        K = sp.csr_array((K + K.T) / 2)
    stated = read_motions(motions, n)
    if n <= DEFINITENESS_CHECK_SIZE and _resists_every_motion(K.toarray()):
        return (read_only(K.toarray()) if dense else sp.csc_array(K)), asymmetry, 0.0
    cleared = clear_of_printing(K, stated)
    K, change = (K, 0.0) if cleared is None else (cleared.stiffness, cleared.change)
    if n <= DEFINITENESS_CHECK_SIZE:
        _refuse_indefinite(K.toarray())
    return (read_only(K.toarray()) if dense else sp.csc_array(K)), asymmetry, change


def _definite(value: Any) -> Array | None:
    """Return a small array that is exactly symmetric and clearly definite, None otherwise."""
    if isinstance(value, np.ndarray) and value.size > DEFINITENESS_CHECK_SIZE**2:
        return None
    K = read_array("stiffness", value)
    small = K.ndim == 2 and K.shape[0] == K.shape[1] and 0 < len(K) <= DEFINITENESS_CHECK_SIZE
    if not (small and np.isfinite(K).all() and (K == K.T).all() and _resists_every_motion(K)):
        return None
    return K + 0.0  # no zero has a sign


def _symmetric(K: Any) -> bool:
    """Return whether K, in canonical CSR, is symmetric to the last digit."""
    if K.shape[0] <= DEFINITENESS_CHECK_SIZE:
        dense = K.toarray()
        return np.array_equal(dense, dense.T)
    other = K.T.tocsr()
    pairs = ((K.indptr, other.indptr), (K.indices, other.indices), (K.data, other.data))
    return all(np.array_equal(a, b) for a, b in pairs)


def _resists_every_motion(K: Array) -> bool:
    """Return whether K is definite by more than lost digits could account for.

    `clear_of_printing` scales by the powers of two nearest to 1/sqrt(K_jj): its eigenvalues are at least half of these.
    """
    diagonal = K.diagonal()
    if not (diagonal > 0).all():
        return False
    root = np.sqrt(diagonal)
    return eigenvalues_exceed(2 * SOFT, K / (root[:, None] * root))


def eigenvalues_exceed(least: float, matrix: Array) -> bool:
    """Return whether all eigenvalues of a small symmetric matrix exceed a number, as far as rounding tells.

    The matrix less this number has Cholesky factors then, which take a tenth of the time that eigenvalues take.
    """
    with on_one_thread() if len(matrix) >= WORTHWHILE else nullcontext():
        try:
            np.linalg.cholesky(matrix - least * np.eye(len(matrix)))
        except np.linalg.LinAlgError:
            return False
    return True


def eigenvalues_of(matrix: Array) -> Array:
    """Return the eigenvalues of a small symmetric matrix, the lowest first, on one thread of BLAS."""
    with on_one_thread() if len(matrix) >= WORTHWHILE else nullcontext():
        return np.asarray(np.linalg.eigvalsh(matrix), dtype=float)


def _refuse_indefinite(K: Array) -> None:
    scale = np.sqrt(np.where(np.diag(K) > 0, np.diag(K), 1.0))
    scaled = K / np.outer(scale, scale)
    # Rounding of an exactly semidefinite matrix moves its eigenvalues by a few n eps; printed digits by
    # SYMMETRY_TOLERANCE.
    rounding = 64 * len(K) * EPS
    if eigenvalues_exceed(-rounding / 2, scaled):
        return
    eigenvalues = eigenvalues_of(scaled)
    if eigenvalues[0] < -rounding * max(eigenvalues[-1], 1.0):
        direction = np.linalg.eigh(scaled)[1][:, 0] / scale
        raise InvalidProblem(
            f"stiffness: expected positive semidefinite, got an indefinite matrix (eigenvalue {eigenvalues[0]:.3g} "
            f"after scaling its diagonal to one){_curved(K, direction)}{_advice_on_digits(eigenvalues[0])}"
        )


def _curved(K: Array, direction: Array) -> str:
    """Return a text about a direction whose curvature is negative in rational arithmetic, else None."""
    z = direction / np.max(abs(direction))
    parts = [(int(j), Fraction(float(z[j]))) for j in np.flatnonzero(z)]
    curvature = sum(a * b * Fraction(float(K[i, j])) for i, a in parts for j, b in parts)
    if curvature >= 0:
        return ""
    named = ", ".join(f"{z[j]:.3g} at unknown {j}" for j in np.argsort(-abs(z), kind="stable")[:CURVED_NAMED] if z[j])
    return f": z'Kz = {float(curvature):.3g} for z = {named}{', ...' if len(parts) > CURVED_NAMED else ''}"


def _advice_on_digits(eigenvalue: float) -> str:
    """Return advice for a negative eigenvalue, which lost digits may have caused if it is small."""
    if eigenvalue < -SYMMETRY_TOLERANCE * 10:
        return BUCKLED
    return f"; if it was printed with few digits, print more, or state the rigid motions as near_null_space{BUCKLED}"


def read_friction(
    tangent: Any, friction: ArrayLike | None, slip_origin: ArrayLike | None, m: int, n: int, known: bool = False
) -> tuple[Matrix | None, Vector | None, Array | None]:
    """Return tangential rows, coefficients (m,) and slip origins (m, d-1); None for each without tangential rows.

    Parameters
    ----------
    tangent, friction, slip_origin : as `ContactProblem` takes them; coefficients and origins are 0 by default
    m, n : int, numbers of contacts and of unknowns
    known : bool, whether the rows have been read and checked already
    """
    if tangent is None:
        if friction is not None and np.any(read_array("friction", friction) != 0):
            raise InvalidProblem("friction: a coefficient was given without tangent, the directions of slip")
        if slip_origin is not None:
            raise InvalidProblem("slip_origin was given without tangent, the directions of slip")
        return None, None, None
    E_T = tangent if known else read_rows("tangent", tangent, n)
    if E_T.shape[0] not in (m, 2 * m):
        raise InvalidProblem(f"tangent: expected {m} rows (2D) or {2 * m} rows (3D), got {E_T.shape[0]}")
    per_contact = E_T.shape[0] // m if m else 1
    coefficient = read_coefficient(0.0 if friction is None else friction, m)
    origin = np.zeros((m, per_contact)) if slip_origin is None else read_array("slip_origin", slip_origin)
    if not m and not origin.size:
        origin = np.zeros((0, per_contact))  # without contacts the number of rows per contact is unknown
    if origin.shape not in ((m * per_contact,), (m, per_contact)):
        raise InvalidProblem(
            f"slip_origin: expected shape ({m}, {per_contact}) or ({m * per_contact},), got {origin.shape}"
        )
    _finite("slip_origin", origin)
    return E_T, coefficient, read_only(origin.reshape(m, per_contact))


def read_coefficient(friction: ArrayLike, m: int) -> Vector:
    """Return Coulomb's coefficient of every contact (m,), given as one number or one for each."""
    coefficient = read_array("friction", friction)
    if np.asarray(friction).dtype == bool:
        raise InvalidProblem(f"friction: expected a coefficient, got {shown(friction)}")
    if coefficient.ndim == 0:
        coefficient = np.full(m, float(coefficient))
    coefficient = read_vector("friction", coefficient, m)
    if np.any(coefficient < 0):
        i = int(np.argmin(coefficient))
        raise InvalidProblem(f"friction: expected a coefficient >= 0, got {coefficient[i]:.6g} at contact {i}")
    return coefficient


def read_motions(value: ArrayLike | None, n: int) -> Array | None:
    if value is None:
        return None
    motions = read_array("near_null_space", value)
    if motions.ndim != 2 or motions.shape[0] != n:
        raise InvalidProblem(f"near_null_space: expected shape ({n}, q), one motion a column, got {motions.shape}")
    _finite("near_null_space", motions)
    return read_only(motions)


def are_near_one(values: Array, farthest: int = FARTHEST) -> bool:
    """Return whether the binary exponents of all numbers but zeros are at most `farthest` and at least its inverse."""
    size = abs(values[values != 0])
    return not size.size or bool(size.min() >= 2.0 ** (-farthest - 1) and size.max() < 2.0**farthest)
