"""Rates of a load path that the states of the contacts leave open: whether some go on, and whether forces are known."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

from flint import fmpq, fmpq_mat

from contactqp.oracle.exact.combination import System
from contactqp.oracle.exact.proof import RationalAnswer
from contactqp.oracle.exact.rational import beside, fraction, null_space, stack, take, zeros
from contactqp.solving.friction.exact_algebra import Polyhedron

Rooms = Callable[[RationalAnswer], list[fmpq]]


class LooseRates:
    """All solutions of a singular system whose rooms, linear in the rates, are not negative.

    Attributes
    ----------
    empty : bool
        Proven: none.
    forces_known : bool
        All of them have the same contact forces.
    """

    def __init__(self, system: System, motion: fmpq_mat, forces: fmpq_mat, rooms: Rooms) -> None:
        n, rows = system.data.unknowns, system.held.nrows()
        matrix = stack(beside(system.data.K, system.pushed.transpose()), beside(system.held, zeros(rows, rows)))
        null = null_space(matrix)
        size = int(null.ncols())
        columns = [null * _unit(size, j) for j in range(size)]
        ways = [system.answer(take(x, range(n)), take(x, range(n, n + rows))) for x in columns]
        start = [fraction(x) for x in rooms(system.answer(motion, forces))]
        slopes = _transposed([[fraction(x) for x in rooms(way)] for way in ways], len(start))
        region = Polyhedron(start, slopes, size)
        self.empty = region.empty
        self.forces_known = True
        if self.empty:
            return
        pushes = [[fraction(x) for part in _forces(way) for x in part.entries()] for way in ways]
        for row in _transposed(pushes, sum(int(part.nrows()) for part in _forces(ways[0]))):
            if any(row) and self.forces_known:
                low, high = region.range(row)
                self.forces_known = low is not None and high is not None and _product(row, low) == _product(row, high)


def _forces(rate: RationalAnswer) -> tuple[fmpq_mat, fmpq_mat]:
    return rate.normal_force, rate.friction_force


def _unit(size: int, j: int) -> fmpq_mat:
    return fmpq_mat(size, 1, [int(i == j) for i in range(size)])


def _transposed(columns: list[list[Fraction]], rows: int) -> list[list[Fraction]]:
    return [[column[i] for column in columns] for i in range(rows)]


def _product(one: list[Fraction], other: list[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(one, other, strict=True)), Fraction(0))
