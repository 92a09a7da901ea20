"""The gallery computes with sparse rows of rational numbers and draws problems by the standard library alone."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import TypeVar

from contactqp.linalg.exact_algebra import rank

Row = Mapping[int, Fraction]
Rows = tuple[Row, ...]
Numbers = tuple[Fraction, ...]
Given = int | str | Fraction

ZERO = Fraction(0)


def numbers(values: Iterable[Given]) -> Numbers:
    """Fractions of integers, fractions and strings such as "3/7" and "6883.1"."""
    return tuple(Fraction(value) for value in values)


def rows_of(values: Iterable[Sequence[Given]]) -> Rows:
    """Sparse rows of dense ones."""
    return tuple({j: Fraction(x) for j, x in enumerate(row) if Fraction(x)} for row in values)


def clean(rows: Iterable[Mapping[int, Given]]) -> Rows:
    """Rows without their zeros, columns in order."""
    return tuple({j: Fraction(row[j]) for j in sorted(row) if row[j]} for row in rows)


def times(rows: Rows, vector: Sequence[Fraction]) -> Numbers:
    """rows @ vector."""
    return tuple(sum((x * vector[j] for j, x in row.items()), ZERO) for row in rows)


def transposed_times(rows: Rows, vector: Sequence[Fraction], size: int) -> Numbers:
    """rows' @ vector, (size,)."""
    total = [ZERO] * size
    for row, value in zip(rows, vector, strict=True):
        if value:
            for j, x in row.items():
                total[j] += x * value
    return tuple(total)


def plus(*vectors: Sequence[Fraction]) -> Numbers:
    """Return the sum of vectors of one length."""
    return tuple(sum(parts, ZERO) for parts in zip(*vectors, strict=True))


def columns_are_independent(rows: Rows, size: int) -> bool:
    """Return whether rows x = 0 has no solution (size,) but zero."""
    return rank(transposed(rows, size)) == size


def transposed(rows: Rows, size: int) -> Rows:
    """Return the columns (size) as rows."""
    columns: list[dict[int, Fraction]] = [{} for _ in range(size)]
    for i, row in enumerate(rows):
        for j, x in row.items():
            columns[j][i] = x
    return tuple(columns)


def dominance(stiffness: Rows) -> Fraction:
    """min_i (K_ii - sum |K_ij|) of a symmetric K: where positive, no eigenvalue is smaller (Gershgorin 1931)."""
    return min(
        2 * row.get(i, ZERO) - sum((abs(x) for x in row.values()), ZERO)
        if row.get(i, ZERO) > 0
        else -sum((abs(x) for x in row.values()), ZERO)
        for i, row in enumerate(stiffness)
    )


def largest_row_sum(stiffness: Rows) -> Fraction:
    """max_i sum |K_ij|: no eigenvalue of a symmetric K is larger."""
    return max(sum((abs(x) for x in row.values()), ZERO) for row in stiffness)


# Random integers that are the same on every platform and in every version of Python, and lattices made of them.

T = TypeVar("T")
Node = tuple[int, int]
# The neighbours of a node of a lattice that stand after it.
AFTER = ((1, 0), (0, 1), (1, 1), (-1, 1))


class Draw:
    """Draws that depend on a name alone: of Python's generator only `random()` is promised to stay as it is."""

    def __init__(self, name: str) -> None:
        self._random = random.Random(name).random

    def integer(self, low: int, high: int) -> int:
        """low ... high, both included."""
        return low + int(self._random() * (high - low + 1))

    def among(self, values: Sequence[T]) -> T:
        return values[self.integer(0, len(values) - 1)]

    def some(self, values: Sequence[T], count: int) -> list[T]:
        """`count` different ones, in the order in which they stand."""
        left = list(range(len(values)))
        taken = [left.pop(self.integer(0, len(left) - 1)) for _ in range(min(count, len(left)))]
        return [values[i] for i in sorted(taken)]


class Springs:
    """A stiffness (n, n) that grows spring by spring: K += k t't for a row t of integers."""

    def __init__(self, unknowns: int) -> None:
        self._rows: list[dict[int, Fraction]] = [{} for _ in range(unknowns)]

    def add(self, stiffness: int | Fraction, row: dict[int, int]) -> None:
        for i, x in row.items():
            for j, y in row.items():
                self._rows[i][j] = self._rows[i].get(j, Fraction(0)) + stiffness * x * y

    def rows(self) -> Rows:
        return clean(self._rows)


def lattice(springs: Springs, columns: int, rows: int, stiffness: Callable[[], int | Fraction], first: int = 0) -> None:
    """Springs between neighbours of a plane grid, along the diagonals too: only rigid motions strain none of them.

    Node (i, j) has the unknowns 2 a and 2 a + 1, x and z, a = first + j columns + i.
    """
    for j in range(rows):
        for i in range(columns):
            for dx, dz in AFTER:
                if 0 <= i + dx < columns and j + dz < rows:
                    a, b = first + j * columns + i, first + (j + dz) * columns + i + dx
                    row = {2 * a: dx, 2 * a + 1: dz, 2 * b: -dx, 2 * b + 1: -dz}
                    springs.add(stiffness(), {k: x for k, x in row.items() if x})
