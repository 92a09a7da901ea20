"""Random integers that are the same on every platform and in every version of Python, and lattices made of them."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import TypeVar

from contactqp.oracle.gallery.algebra import Rows, clean

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
