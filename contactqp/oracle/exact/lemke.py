"""Lemke's method in rational numbers, with lexicographic ratio tests: finite, and its ray proves infeasibility.

Cottle, Pang and Stone (1992), The Linear Complementarity Problem, section 4.4.
"""

from __future__ import annotations

from flint import fmpq, fmpq_mat

from contactqp.oracle.exact.rational import NoSolution, Undecided, beside


def lemke(M: fmpq_mat, p: fmpq_mat, max_pivots: int) -> tuple[list[fmpq], int]:
    """z of w = p + M z, w >= 0, z >= 0, w'z = 0 for a positive semidefinite M, exactly, and the number of pivots.

    Raises NoSolution on a secondary ray, Undecided after `max_pivots`.
    """
    size = M.nrows()
    if all(x >= 0 for x in p.entries()):
        return [fmpq(0)] * size, 0
    identity = fmpq_mat(size, size, [int(i == j) for i in range(size) for j in range(size)])
    cover = fmpq_mat(size, 1, [-1] * size)
    # Columns: w, z, z0, right-hand side; row by row I w - M z - z0 = p.
    table = beside(identity, -1 * M, cover, p).tolist()
    basis, z0, right = list(range(size)), 2 * size, 2 * size + 1
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
