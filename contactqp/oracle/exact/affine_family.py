"""All x = start + N c that meet v + G c >= 0, in rational numbers: the one of least norm, and how far entries range."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

from flint import fmpq_mat

from contactqp.oracle.exact.lemke import lemke
from contactqp.oracle.exact.rational import fraction, take, take_columns
from contactqp.solving.friction.exact_algebra import Polyhedron

# Lemke's method takes about as many pivots as there are conditions.
MOST_PIVOTS = 2000

Range = tuple[Fraction | None, Fraction | None]


@dataclass(frozen=True, eq=False)
class Family:
    """Directions are independent columns."""

    start: fmpq_mat  # (n, 1)
    directions: fmpq_mat  # (n, r)
    room: fmpq_mat  # (p, 1) v
    slope: fmpq_mat  # (p, r) G

    def least(self) -> fmpq_mat:
        """c (r, 1) of the x of least Euclidean norm:

            N'(start + N c) = G's,    w = v + G c >= 0,  s >= 0,  w's = 0.

        Raises
        ------
        NoSolution
            Proven: no member meets the conditions.
        """
        across = self.directions.transpose()
        square = across * self.directions
        free = -1 * square.solve(across * self.start)
        room = self.room + self.slope * free
        if all(x >= 0 for x in room.entries()):
            return free
        pull = square.solve(self.slope.transpose())
        push, _ = lemke(self.slope * pull, room, MOST_PIVOTS)
        return free + pull * fmpq_mat(len(push), 1, push)

    def ranges(self, entries: Iterable[int]) -> list[Range]:
        """The least and the largest value of each entry of x, None where it is unbounded; a member exists."""
        slopes = [[fraction(x) for x in row] for row in self.slope.tolist()]
        rooms = [fraction(x) for x in self.room.entries()]
        # A condition that no direction changes is met or there is no member.
        kept = [i for i, slope in enumerate(slopes) if any(slope)]
        region = Polyhedron([rooms[i] for i in kept], [slopes[i] for i in kept], int(self.directions.ncols()))
        found: list[Range] = []
        for entry in entries:
            row, at = [fraction(x) for x in self.directions.tolist()[entry]], fraction(self.start[entry, 0])
            low, high = region.range(row) if any(row) else ([Fraction(0)] * len(row), [Fraction(0)] * len(row))
            ends = [
                None if end is None else at + sum((x * y for x, y in zip(row, end, strict=True)), Fraction(0))
                for end in (low, high)
            ]
            found.append((ends[0], ends[1]))
        return found


def blocks(directions: fmpq_mat, slope: fmpq_mat) -> list[list[int]]:
    """Columns that share no row with others, so that each block can be ranged over by itself."""
    group = list(range(int(directions.ncols())))
    for row in [*directions.tolist(), *slope.tolist()]:
        touched = [j for j, x in enumerate(row) if x != 0]
        for j in touched[1:]:
            old, new = group[j], group[touched[0]]
            group = [new if g == old else g for g in group]
    return [[j for j, g in enumerate(group) if g == name] for name in dict.fromkeys(group)]


def block_of(family: Family, columns: list[int]) -> Family:
    """The family in which only these directions move, with the conditions that they change."""
    slope = take_columns(family.slope, columns)
    rows = [i for i, row in enumerate(slope.tolist()) if any(x != 0 for x in row)]
    return Family(family.start, take_columns(family.directions, columns), take(family.room, rows), take(slope, rows))
