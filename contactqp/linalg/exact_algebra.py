"""Exact linear algebra by the standard library alone: elimination, solutions, inverses, ranks and linear programs.

Rows are lists of Fractions, and systems small; `contactqp.linalg.rational` does the same for large ones with
python-flint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import gcd, lcm
from typing import Any

Row = list[Fraction]
ZERO, ONE = Fraction(0), Fraction(1)
# The prime 2^61 - 1; rows that are independent modulo a prime are independent.
PRIME = 2**61 - 1


@dataclass(frozen=True)
class Affine:
    """All solutions of a linear system: point + sum of c_k free_k, any c."""

    point: Row  # (n,)
    free: list[Row]  # (k, n)

    def image(self, row: Sequence[Fraction]) -> tuple[Fraction, Row]:
        """Return the value of a linear form at the point, and its coefficients of c (k,)."""
        return dot(row, self.point), [dot(row, direction) for direction in self.free]


def dot(one: Sequence[Fraction], other: Sequence[Fraction]) -> Fraction:
    """Return the scalar product of two rows, skipping zeros."""
    return sum((x * y for x, y in zip(one, other, strict=True) if x and y), ZERO)


def reduced(rows: list[Row], columns: int) -> tuple[list[Row], list[int]]:
    """Return the reduced row echelon form, with pivots among the first `columns`, and the columns of its pivots.

    Rows without a pivot come last. Rows are eliminated as integers without a common divisor: dividing once a row costs
    a third of dividing each of its fractions.
    """
    taken = [Fraction(lcm(*(x.denominator for x in row))) for row in rows]  # the multiple of each row that is kept
    whole = [[int(x * size) for x in row] for row, size in zip(rows, taken, strict=True)]
    pivots = list[int]()
    for j in range(columns):
        r = len(pivots)
        pivot = next((i for i in range(r, len(whole)) if whole[i][j]), None)
        if pivot is None:
            continue
        whole[r], whole[pivot], taken[r], taken[pivot] = whole[pivot], whole[r], taken[pivot], taken[r]
        lead = whole[r]
        for i, row in enumerate(whole):
            if i != r and row[j]:
                common = gcd(lead[j], row[j])
                by, factor = lead[j] // common, row[j] // common
                whole[i], divisor = _primitive(
                    [by * x - factor * y if y else by * x for x, y in zip(row, lead, strict=True)]
                )
                taken[i] *= Fraction(by, divisor)
        pivots.append(j)
    sizes = [*(Fraction(row[j]) for row, j in zip(whole, pivots, strict=False)), *taken[len(pivots) :]]
    return [[x / size if x else ZERO for x in row] for row, size in zip(whole, sizes, strict=True)], pivots


def _primitive(row: list[int]) -> tuple[list[int], int]:
    """Return a row of integers without its greatest common divisor, and that."""
    divisor = gcd(*row) or 1
    return row if divisor == 1 else [x // divisor for x in row], divisor


def solutions(rows: list[Row], unknowns: int) -> Affine | None:
    """Return all solutions of the equations a'x = b, each row being (a, b); None where they contradict each other."""
    rows, pivots = reduced(rows, unknowns)
    if any(row[unknowns] for row in rows[len(pivots) :]):
        return None
    point = [ZERO] * unknowns
    for row, j in zip(rows, pivots, strict=False):
        point[j] = row[unknowns]
    free = []
    for k in sorted(set(range(unknowns)) - set(pivots)):
        direction = [ZERO] * unknowns
        direction[k] = ONE
        for row, j in zip(rows, pivots, strict=False):
            direction[j] = -row[k]
        free.append(direction)
    return Affine(point, free)


def inverse_of(matrix: list[Row]) -> list[Row] | None:
    """Return the inverse of a square matrix, or None if the matrix is singular."""
    n = len(matrix)
    extended = [[*row, *(ONE if i == j else ZERO for j in range(n))] for i, row in enumerate(matrix)]
    found, pivots = reduced(extended, n)
    return [row[n:] for row in found] if len(pivots) == n else None


def rank(rows: Sequence[Mapping[int, Fraction]]) -> int:
    """Return the number of independent rows, each given by its nonzero entries.

    The rank modulo a prime never exceeds the true one and is cheap; if it is not full, the elimination is repeated in
    rational numbers.
    """
    found = _pivot_count([{j: _residue(x) for j, x in row.items()} for row in rows], modular=True)
    return found if found == len(rows) else _pivot_count([dict(row) for row in rows], modular=False)


def _residue(x: Fraction) -> int:
    return x.numerator * pow(x.denominator, -1, PRIME) % PRIME


def _pivot_count(rows: list[dict[int, Any]], modular: bool) -> int:
    """Count the pivots of Gaussian elimination, row by row."""
    pivots: dict[int, dict[int, Any]] = {}
    for row in sorted(rows, key=len):
        rest = {j: x for j, x in row.items() if x}
        while rest:
            lead = min(rest)
            if lead not in pivots:
                scale = pow(rest[lead], -1, PRIME) if modular else 1 / rest[lead]
                pivots[lead] = {j: x * scale % PRIME if modular else x * scale for j, x in rest.items()}
                break
            factor = rest[lead]
            for j, x in pivots[lead].items():
                value = rest.get(j, 0) - factor * x
                value = value % PRIME if modular else value
                if value:
                    rest[j] = value
                else:
                    rest.pop(j, None)
    return len(pivots)


class Polyhedron:
    """The set {c : room_i + slope_i'c >= 0}, c (k,) free, as a dictionary of the simplex method.

    Bland's rule chooses the pivots, so that every search ends.

    Basic variables are c and some rooms, nonbasic ones rooms that are zero; directions in which no room changes are
    excluded as `lines`.
    """

    def __init__(self, room: Sequence[Fraction], slope: Sequence[Row], size: int) -> None:
        # One row for each variable: its value and its slopes in the nonbasic variables.
        self._size = size
        unit = [[ONE if i == j else ZERO for j in range(size)] for i in range(size)]
        self._rows: list[Row] = [[ZERO, *row] for row in unit] + [
            [value, *row] for value, row in zip(room, slope, strict=True)
        ]
        self._nonbasic = list(range(size))
        for j in range(size):
            leaving = next(
                (i for i in range(size, len(self._rows)) if i not in self._nonbasic and self._rows[i][j + 1]), None
            )
            if leaving is not None:
                self._pivot(leaving, j)
        self.lines = [j for j in range(size) if self._nonbasic[j] < size]
        self.empty = not self._feasible()

    def point(self) -> Row:
        """Return one point (k,) of the set, which must not be empty."""
        return [row[0] for row in self._rows[: self._size]]

    def range(self, row: Sequence[Fraction]) -> tuple[Row | None, Row | None]:
        """Return the points (k,) with the least and the largest row'c, None where it is unbounded."""
        return self._furthest([-x for x in row]), self._furthest(row)

    def _furthest(self, row: Sequence[Fraction]) -> Row | None:
        while True:
            gain = [sum((x * self._rows[i][j + 1] for i, x in enumerate(row) if x), ZERO) for j in range(self._size)]
            if any(gain[j] for j in self.lines):
                return None
            entering = min((j for j in range(self._size) if gain[j] > 0), key=lambda j: self._nonbasic[j], default=None)
            if entering is None:
                return self.point()
            steps = [
                (self._rows[i][0] / -self._rows[i][entering + 1], i)
                for i in self._rooms()
                if self._rows[i][entering + 1] < 0
            ]
            if not steps:
                return None
            self._pivot(min(steps)[1], entering)

    def _feasible(self) -> bool:
        """Make all rooms nonnegative by Bland's dual rule; return whether this is possible."""
        while True:
            leaving = next((i for i in self._rooms() if self._rows[i][0] < 0), None)
            if leaving is None:
                return True
            entering = min(
                (j for j in range(self._size) if j not in self.lines and self._rows[leaving][j + 1] > 0),
                key=lambda j: self._nonbasic[j],
                default=None,
            )
            if entering is None:
                return False
            self._pivot(leaving, entering)

    def _rooms(self) -> list[int]:
        """Return the rooms that are basic variables."""
        return [i for i in range(self._size, len(self._rows)) if i not in self._nonbasic]

    def _pivot(self, leaving: int, j: int) -> None:
        """Exchange the basic variable `leaving` for the nonbasic variable j."""
        entering, row = self._nonbasic[j], self._rows[leaving]
        scale = ONE / row[j + 1]
        # nonbasic_j = (leaving - rest) / slope
        solved = [-x * scale for x in row]
        solved[j + 1] = scale
        self._nonbasic[j] = leaving
        for i, other in enumerate(self._rows):
            if (factor := other[j + 1]) and i != leaving:
                changed = [x + factor * y for x, y in zip(other, solved, strict=True)]
                changed[j + 1] = factor * scale
                self._rows[i] = changed
        self._rows[entering] = solved
        unit = [ZERO] * (self._size + 1)
        unit[j + 1] = ONE
        self._rows[leaving] = unit


def contradiction(rows: Sequence[Mapping[int, Fraction]], limits: Row, signed: int) -> Row | None:
    """Return weights y by which rows x <= limit (the first `signed`) and rows x = limit contradict each other, or None.

    By Farkas' lemma y'rows = 0, y'limits = -1 and y_i >= 0 for the first ones, which exist exactly if no x fits.
    """
    if rank(rows) == len(rows):
        return None
    columns = sorted({j for row in rows for j in row})
    balance = [[*(row.get(j, ZERO) for row in rows), ZERO] for j in columns]
    found = solutions(balance, len(rows))
    free = [] if found is None else found.free
    excess = [dot(direction, limits) for direction in free]
    if not any(excess):
        return None
    slopes = [[direction[i] for direction in free] for i in range(signed)]
    least = Polyhedron([ZERO] * signed + [ONE], [*slopes, excess], len(free)).range(excess)[0]
    if least is None or not dot(excess, least) < 0:
        return None
    return [dot([direction[i] for direction in free], least) for i in range(len(rows))]


class Region:
    """The set {c : value + slope'c >= 0 for all forms}; c may have no entries."""

    def __init__(self, forms: list[tuple[Fraction, Row]], size: int) -> None:
        self._forms = forms
        self._polyhedron = None
        if size:
            self._polyhedron = Polyhedron([value for value, _ in forms], [slope for _, slope in forms], size)
            self.empty = self._polyhedron.empty
        else:
            self.empty = min((value for value, _ in forms), default=ZERO) < 0

    def point(self) -> Row:
        return [] if self._polyhedron is None else self._polyhedron.point()

    def seen_from(self, affine: Affine) -> list[tuple[Fraction, tuple[Fraction, Row]]]:
        """Return the forms restricted to an affine part of the region."""
        return [(value, affine.image(slope)) for value, slope in self._forms]

    def ends(self, slopes: list[Row]) -> list[Row] | None:
        """Return the points where forms of these slopes differ most.

        The list is empty where all points give the same values; None means that the values are unbounded both ways.
        """
        if self._polyhedron is None:
            return []
        basis, pivots = reduced(slopes, len(self._polyhedron.point()))
        ends = []
        for row in basis[: len(pivots)]:
            low, high = self._polyhedron.range(row)
            if low is None and high is None:
                return None
            if low is None or high is None or dot(row, low) != dot(row, high):
                ends += [end for end in (low, high) if end is not None]
        return ends


def cancelling(rows: Sequence[Sequence[float]]) -> list[Fraction] | None:
    """Return the rational weights with which rows cancel, by elimination, None unless unique up to a factor."""
    balance = [[*map(Fraction, column), ZERO] for column in zip(*rows, strict=True) if any(column)]
    found = solutions(balance, len(rows))
    return found.free[0] if found is not None and len(found.free) == 1 else None


def cancel(rows: Any, weights: list[Fraction], part: Fraction = ZERO) -> bool:
    """Return whether the weighted rows of a CSC matrix cancel in every column to a part of their entries' sum."""
    for j in range(rows.shape[1]):
        at = slice(rows.indptr[j], rows.indptr[j + 1])
        entries = zip(rows.indices[at].tolist(), rows.data[at].tolist(), strict=True)
        terms = [weights[i] * Fraction(value) for i, value in entries]
        if abs(sum(terms, ZERO)) > part * sum(map(abs, terms), ZERO):
            return False
    return True
