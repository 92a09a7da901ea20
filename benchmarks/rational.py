"""Linear algebra and the linear complementarity problem in rational numbers (python-flint)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat


class NoSolution(Exception):
    """Proven in rational arithmetic: no displacement and forces satisfy the problem."""


class Undecided(Exception):
    """No truth was found within the limit of pivots."""


def rational(x: float) -> fmpq:
    """A float as it stands."""
    return fmpq(*float(x).as_integer_ratio())


def matrix(values: Any) -> fmpq_mat:
    """A dense or sparse matrix of floats as it stands."""
    dense = np.atleast_2d(values.toarray() if hasattr(values, "toarray") else np.asarray(values, dtype=float))
    return fmpq_mat(*dense.shape, [rational(x) for x in dense.ravel()])


def column(values: Any) -> fmpq_mat:
    """A vector of floats, or of rationals, as a column."""
    entries = [x if isinstance(x, fmpq) else rational(x) for x in values]
    return fmpq_mat(len(entries), 1, entries)


def number(x: fmpq) -> float:
    """The nearest float; Python divides integers of any size correctly rounded."""
    return int(x.p) / int(x.q)


def floats(column_: fmpq_mat) -> np.ndarray:
    """A column in the nearest floats."""
    return np.array([number(x) for x in column_.entries()], dtype=float)


def stack(*blocks: fmpq_mat) -> fmpq_mat:
    """Blocks above each other."""
    return fmpq_mat(sum(b.nrows() for b in blocks), blocks[0].ncols(), [x for b in blocks for x in b.entries()])


def beside(*blocks: fmpq_mat) -> fmpq_mat:
    return stack(*(b.transpose() for b in blocks)).transpose()


def zeros(rows: int, columns: int) -> fmpq_mat:
    return fmpq_mat(rows, columns, [0] * (rows * columns))


def take(rows: fmpq_mat, chosen: Iterable[int]) -> fmpq_mat:
    table, chosen = rows.tolist() if rows.nrows() else [], list(chosen)
    return fmpq_mat(len(chosen), rows.ncols(), [x for i in chosen for x in table[i]])


def pivot_columns(reduced: fmpq_mat) -> list[int]:
    """The pivot column of each nonzero row of a reduced row echelon form."""
    firsts = (next((j for j, x in enumerate(row) if x != 0), None) for row in reduced.tolist())
    return [j for j in firsts if j is not None]


def null_space(a: fmpq_mat) -> fmpq_mat:
    """A rational basis (n, r) of the null space."""
    n = a.ncols()
    reduced, _ = a.rref()
    leading, table = pivot_columns(reduced), reduced.tolist()
    free = [j for j in range(n) if j not in set(leading)]
    basis = zeros(n, len(free))
    for c, j in enumerate(free):
        basis[j, c] = fmpq(1)
        for i, p in enumerate(leading):
            basis[p, c] = -table[i][j]
    return basis


def solve_any(a: fmpq_mat, right: fmpq_mat) -> tuple[fmpq_mat, bool] | None:
    """One basic solution of a x = right (one column) and whether it is the only one; None if there is none."""
    reduced, _ = beside(a, right).rref()
    leading, n, table = pivot_columns(reduced), a.ncols(), reduced.tolist()
    if n in leading:
        return None
    x = zeros(n, 1)
    for i, p in enumerate(leading):
        x[p, 0] = table[i][n]
    return x, len(leading) == n


def lemke(M: fmpq_mat, p: fmpq_mat, max_pivots: int) -> tuple[list[fmpq], int]:
    """z of w = p + M z, w >= 0, z >= 0, w'z = 0 for a positive semidefinite M, exactly, and the number of pivots.

    Raises NoSolution on a secondary ray, Undecided after `max_pivots`.
    """
    size = M.nrows()
    identity = fmpq_mat(size, size, [int(i == j) for i in range(size) for j in range(size)])
    cover = fmpq_mat(size, 1, [-1] * size)
    # Columns: w, z, z0, right-hand side; row by row I w - M z - z0 = p.
    table = beside(identity, -1 * M, cover, p).tolist()
    basis, z0, right = list(range(size)), 2 * size, 2 * size + 1
    if all(x >= 0 for x in p.entries()):
        return [fmpq(0)] * size, 0
    row = min(range(size), key=lambda i: [table[i][right], *table[i][:size]])
    entering = z0
    for count in range(1, max_pivots + 1):
        leaving = basis[row]
        _pivot(table, row, entering)
        basis[row] = entering
        if leaving == z0:
            values = {variable: table[i][right] for i, variable in enumerate(basis)}
            return [values.get(size + i, fmpq(0)) for i in range(size)], count
        entering = leaving + size if leaving < size else leaving - size
        rows = [i for i in range(size) if table[i][entering] > 0]
        if not rows:
            raise NoSolution("a secondary ray")
        row = _lexicographic_row(table, rows, entering, basis, z0)
    raise Undecided(f"{max_pivots} pivots")


def _lexicographic_row(table: list[list[fmpq]], rows: list[int], entering: int, basis: list[int], z0: int) -> int:
    size = len(table)
    ratios = {i: table[i][2 * size + 1] / table[i][entering] for i in rows}
    least = min(ratios.values())
    tied = [i for i in rows if ratios[i] == least]
    for i in tied:
        if basis[i] == z0:
            return i
    if len(tied) == 1:
        return tied[0]
    return min(tied, key=lambda i: [table[i][j] / table[i][entering] for j in range(size)])


def _pivot(table: list[list[fmpq]], row: int, column_: int) -> None:
    pivot = table[row][column_]
    lead = table[row] = [x / pivot for x in table[row]]
    for i, other in enumerate(table):
        factor = other[column_]
        if i != row and factor != 0:
            table[i] = [x - factor * y if y != 0 else x for x, y in zip(other, lead, strict=True)]
