"""Exact linear algebra of large matrices by python-flint: systems, null spaces, ranks and definiteness.

Independent rows and columns are found modulo a prime, which is cheap; their system is then solved over the rationals
(by Dixon's lifting if it is large), and the other rows are checked over the rationals, which also reveals an unlucky
prime.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from contactqp.errors import BackendMissing
from contactqp.model.arrays import EPS, Array, refuse_late

try:
    from flint import fmpq, fmpq_mat, nmod_mat
except ImportError:
    raise BackendMissing("exact answers need python-flint: pip install python-flint") from None

# Motions with energy below this, K scaled to a diagonal near one, are examined exactly, up to this number of them.
SOFT, MOST_SOFT = 1e-8, 40
PRIMES = (2**61 - 1, 2**62 - 57, 2**63 - 25, 2**64 - 59)


class NoSolution(Exception):
    """Proven in rational arithmetic: no displacement and forces satisfy the problem."""


class Undecided(Exception):
    """No exact answer was found within the limit of pivots."""


def rational(x: float) -> fmpq:
    """Return a float as an exact rational number."""
    return fmpq(*float(x).as_integer_ratio())


def from_fraction(x: Fraction | int) -> fmpq:
    return fmpq(x.numerator, x.denominator)


def fractions_of(matrix: fmpq_mat) -> Any:
    """Return the entries of a matrix, row by row, as an array of Fractions."""
    array = np.empty(matrix.nrows() * matrix.ncols(), dtype=object)
    array[:] = [fraction(x) for x in matrix.entries()]
    return array


def fraction(x: fmpq) -> Fraction:
    return Fraction(int(x.p), int(x.q))


def matrix(values: Any) -> fmpq_mat:
    """Return a dense or sparse matrix of floats as an exact rational matrix."""
    dense = np.atleast_2d(values.toarray() if hasattr(values, "toarray") else np.asarray(values, dtype=float))
    rows, columns = dense.shape
    return fmpq_mat(rows, columns, [rational(x) if x else fmpq(0) for x in dense.ravel().tolist()])


def column(values: Any) -> fmpq_mat:
    """Return a vector of floats, Fractions or rationals as a column."""
    entries = [_entry(x) for x in values]
    return fmpq_mat(len(entries), 1, entries)


def _entry(x: Any) -> fmpq:
    if isinstance(x, fmpq):
        return x
    return from_fraction(x) if isinstance(x, Fraction) else rational(x)


def number(x: fmpq) -> float:
    """Return the nearest float; Python divides integers of any size correctly rounded."""
    return int(x.p) / int(x.q)


def floats(column_: fmpq_mat) -> Array:
    """Return the nearest floats of a column."""
    return np.array([number(x) for x in column_.entries()], dtype=float)


def fractions(column_: fmpq_mat) -> list[Fraction]:
    return [fraction(x) for x in column_.entries()]


def fraction_rows(values: fmpq_mat) -> list[list[Fraction]]:
    return [[fraction(x) for x in row] for row in values.tolist()]


def stack(*blocks: fmpq_mat) -> fmpq_mat:
    """Return a matrix of blocks above each other."""
    return fmpq_mat(sum(b.nrows() for b in blocks), blocks[0].ncols(), [x for b in blocks for x in b.entries()])


def beside(*blocks: fmpq_mat) -> fmpq_mat:
    """Return the matrix [A, B, ...] of blocks with equally many rows."""
    return stack(*(b.transpose() for b in blocks)).transpose()


def zeros(rows: int, columns: int) -> fmpq_mat:
    return fmpq_mat(rows, columns, [0] * (rows * columns))


def take(rows: fmpq_mat, chosen: Iterable[int]) -> fmpq_mat:
    table, chosen = rows.tolist() if rows.nrows() else [], list(chosen)
    return fmpq_mat(len(chosen), rows.ncols(), [x for i in chosen for x in table[i]])


def take_columns(columns: fmpq_mat, chosen: Iterable[int]) -> fmpq_mat:
    return take(columns.transpose(), chosen).transpose()


def unit_rows(size: int, places: Iterable[int]) -> fmpq_mat:
    """Return the rows (q, size) that pick some of so many entries."""
    chosen = list(places)
    return fmpq_mat(len(chosen), size, [int(i == j) for i in chosen for j in range(size)])


def is_zero(values: fmpq_mat) -> bool:
    return all(x == 0 for x in values.entries())


def dot(one: fmpq_mat, other: fmpq_mat) -> fmpq:
    """Return the scalar product of two columns."""
    return (one.transpose() * other)[0, 0] if one.nrows() else fmpq(0)


def pivot_columns(reduced: Any) -> list[int]:
    """Return the pivot column of each nonzero row of a reduced row echelon form."""
    firsts = (next((j for j, x in enumerate(row) if x != 0), None) for row in reduced.tolist())
    return [j for j in firsts if j is not None]


def independent_columns(a: fmpq_mat, prime: int) -> list[int]:
    """Return a maximal set of columns independent modulo the prime, which are also independent over the rationals."""
    if not a.nrows() or not a.ncols():
        return []
    integers, _ = a.numer_denom()
    reduced, rank = nmod_mat(integers, prime).rref()
    return pivot_columns(reduced)[:rank]


def row_basis(a: fmpq_mat) -> list[int]:
    """Return a basis of the rows, verified by `null_space` if it leaves any out."""
    for prime in PRIMES:
        rows = independent_columns(a.transpose(), prime)
        if len(rows) == a.nrows() or null_space(a.transpose()).ncols() == a.nrows() - len(rows):
            return rows
    raise Undecided("the rank differs modulo every prime")


def null_space(a: fmpq_mat) -> fmpq_mat:
    """Return a rational basis (n, r) of the null space."""
    refuse_late("the null space of a matrix was found in rational numbers")
    n = a.ncols()
    for prime in PRIMES:
        rows, leading = _profile(a, prime)
        known = set(leading)
        free = [j for j in range(n) if j not in known]
        basis = zeros(n, len(free))
        if leading and free:
            chosen = take(a, rows)
            solved = take_columns(chosen, leading).solve(take_columns(chosen, free)).tolist()
            for i, p in enumerate(leading):
                for c in range(len(free)):
                    basis[p, c] = -solved[i][c]
        for c, j in enumerate(free):
            basis[j, c] = fmpq(1)
        if not free or not a.nrows() or is_zero(a * basis):
            return basis
    raise Undecided("the rank differs modulo every prime")


def solve_any(a: fmpq_mat, right: fmpq_mat) -> tuple[fmpq_mat, bool] | None:
    """Return a solution of a x = right (columns) and whether it is unique; None if there is none."""
    refuse_late("a linear system was solved in rational numbers")
    n = a.ncols()
    for prime in PRIMES:
        rows, leading = _profile(a, prime)
        if len(rows) == a.nrows() == n:
            return (a.solve(right) if n else zeros(0, right.ncols())), True
        chosen, core = take(a, rows), zeros(0, 0)
        x = zeros(n, right.ncols())
        if rows:
            core = take_columns(chosen, leading)
            solved = core.solve(take(right, rows)).tolist()
            for i, p in enumerate(leading):
                for c in range(right.ncols()):
                    x[p, c] = solved[i][c]
        if not a.nrows() or a * x == right:
            return x, len(leading) == n or null_space(a).ncols() == 0
        if _combined(a, rows, leading, core):
            return None
    raise Undecided("the rank differs modulo every prime")


def _profile(a: fmpq_mat, prime: int) -> tuple[list[int], list[int]]:
    """Return rows and columns of a regular submatrix of the rank modulo the prime."""
    leading = independent_columns(a, prime)
    rows = independent_columns(take_columns(a, leading).transpose(), prime) if leading else []
    return rows, leading


def _combined(a: fmpq_mat, rows: Sequence[int], leading: Sequence[int], core: fmpq_mat) -> bool:
    """Return whether all rows are combinations of `rows`, so that an unsatisfied equation contradicts them."""
    known = set(rows)
    others = take(a, [i for i in range(a.nrows()) if i not in known])
    if not rows:
        return is_zero(others)
    shares = core.transpose().solve(take_columns(others, leading).transpose()).transpose()
    return bool(shares * take(a, rows) == others)


def least_change(directions: fmpq_mat, x: fmpq_mat) -> fmpq_mat:
    """Return x - Z (Z'Z)^-1 Z'x: x without its part along the columns of Z, which are independent."""
    if not directions.ncols():
        return x
    across = directions.transpose()
    return x - directions * (across * directions).solve(across * x)


def sum_of_products(one: Sequence[Any], other: Sequence[Any]) -> Any:
    """Return the sum of products of two sequences of rationals or balls of python-flint."""
    return sum((x * y for x, y in zip(one, other, strict=True)), fmpq(0))


def is_semidefinite(K: fmpq_mat) -> bool:
    """Return whether z'Kz >= 0 for all z, exactly.

    K has the rank of its rows and columns J, and is then semidefinite if K_JJ is definite. This is proven by a
    floating-point Cholesky factorisation of K_JJ - s I with s a bound of its rounding (Rump 2006, BIT 46, 433); if that
    fails, the motions of negligible energy decide, or at last the leading minors.
    """
    refuse_late("the stiffness was proven to be positive semidefinite")
    n = K.nrows()
    kept = next(
        (
            found
            for prime in PRIMES
            if len(found := independent_columns(K, prime)) == n or null_space(K).ncols() == n - len(found)
        ),
        list(range(n)),
    )
    core = take_columns(take(K, kept), kept)
    if any(core[i, i] <= 0 for i in range(len(kept))):
        return False
    scaled = _scaled(core)
    if not kept or (scaled is not None and _cholesky_proves(scaled[0])):
        return True
    decided = None if scaled is None else _soft_motions_decide(core, *scaled)
    return _minors_prove(core) if decided is None else decided


def _scaled(K: fmpq_mat) -> tuple[Array, Array] | None:
    """Return D K D in doubles and D (n,), powers of two that bring its diagonal near one; None if it overflows."""
    try:
        doubles = np.array([number(x) for x in K.entries()]).reshape(K.nrows(), K.ncols())
    except OverflowError:
        return None
    if not np.all(np.diag(doubles) > 0):  # too small for doubles
        return None
    # Powers of two scale without rounding.
    scale = np.exp2(-np.round(np.log2(np.diag(doubles)) / 2))
    doubles = doubles * np.outer(scale, scale)
    return (doubles, scale) if np.all(np.isfinite(doubles)) else None


def _cholesky_proves(doubles: Array, least: float = 0.0) -> bool:
    """Return whether a Cholesky factorisation proves the least eigenvalue of a matrix to be above `least`."""
    size = len(doubles)
    shift = 2 * (size + 4) * EPS * (np.trace(doubles) + float(np.max(np.sum(abs(doubles), axis=1))))
    try:
        np.linalg.cholesky(doubles - (shift + least) * np.eye(size))
    except np.linalg.LinAlgError:
        return False
    return True


def _soft_motions_decide(K: fmpq_mat, doubles: Array, scale: Array) -> bool | None:
    """Return whether a regular K is definite, by its motions Z of negligible energy; None if undecided.

    If Z'KZ is not definite, neither is K. Else Z and the unknowns i, without those that fix Z, are a basis in which K
    is definite if K_ii > t I, by a factorisation, and Z'KZ - (K_i Z)'(K_i Z)/t is definite, exactly.
    """
    from scipy.linalg import qr

    values, vectors = np.linalg.eigh(doubles)
    soft = values <= SOFT
    count = int(np.count_nonzero(soft))
    if not 0 < count <= min(MOST_SOFT, len(values) - 1):
        return None
    Z = matrix(vectors[:, soft])
    D = fmpq_mat(len(scale), len(scale), [rational(x) for x in np.diag(scale).ravel().tolist()])
    images = D * (K * (D * Z))
    energy = Z.transpose() * images
    if not is_semidefinite(energy):
        return False
    order = qr(vectors[:, soft].T, mode="r", pivoting=True)[1]
    held, rest = order[:count].tolist(), np.sort(order[count:]).tolist()
    part = doubles[np.ix_(rest, rest)]
    least = float(np.exp2(np.floor(np.log2(max(np.linalg.eigvalsh(part)[0], EPS)) - 1)))
    if take(Z, held).det() == 0 or not _cholesky_proves(part, least):
        return None
    across = take(images, rest)
    return True if _minors_prove(energy - across.transpose() * across / rational(least)) else None


def _minors_prove(K: fmpq_mat) -> bool:
    """Return whether Sylvester's criterion holds, by elimination without fractions."""
    integers, _ = K.numer_denom()
    order, _, _, upper = integers.fflu()
    size = integers.nrows()
    in_place = all(order[i, i] == 1 for i in range(size))
    return in_place and all(upper[i, i] > 0 for i in range(size))
