"""The contact and tie forces that hold a displacement, in rational numbers: all of them, and those of least norm.

At a displacement the states of the contacts are known: those without a gap push, along their own slip where they slip,
and with friction of any direction within the cone where they do not. What is left is linear,

    P'l = f - K u,    l_N >= 0,    mu l_N - |l_T| >= 0 where it sticks,

with P the rows along which forces act (`contactqp.oracle.exact.combination`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from flint import fmpq, fmpq_mat

from contactqp.errors import Unsupported
from contactqp.oracle.exact.affine_family import Family, Range, block_of, blocks
from contactqp.oracle.exact.combination import Combination, Direction, System, system_of
from contactqp.oracle.exact.exact_problem import RationalProblem
from contactqp.oracle.exact.rational import (
    NoSolution,
    fraction,
    independent_rows,
    least_change,
    null_space,
    solve_any,
    stack,
    take,
    take_columns,
    zeros,
)

NO_RANGE: Range = (fraction(fmpq(0)), fraction(fmpq(0)))


@dataclass(frozen=True, eq=False)
class Balance:
    """Forces (k + c + b, 1) of a system, its contact forces of least norm and then its ties'."""

    system: System
    forces: fmpq_mat
    only: bool  # no other contact forces hold this displacement
    ranges: tuple[Range, ...]  # (m,) of the normal forces


def states(data: RationalProblem, u: fmpq_mat) -> Combination:
    """Contacts without a gap, which of them stick, and along what the others slip."""
    closed = tuple(i for i, x in enumerate(data.gap(u).entries()) if x == 0)
    rubbing = [i for i in closed if data.friction[i] > 0]
    if not rubbing:
        return Combination(closed)
    slip, w = data.slip(u).entries(), data.width
    stuck, directions = list[int](), dict[int, Direction]()
    for i in rubbing:
        moved = slip[w * i : w * (i + 1)]
        if any(moved):
            directions[i] = unit(moved)
        else:
            stuck.append(i)
    return Combination(closed, tuple(stuck), directions)


def unit(vector: list[fmpq]) -> Direction:
    """v / |v|.

    Raises
    ------
    Unsupported
        |v| is irrational.
    """
    square = sum((x * x for x in vector), fmpq(0))
    p, q = int(square.p), int(square.q)
    root = fmpq(math.isqrt(p), math.isqrt(q))
    if root * root != square:
        raise Unsupported("exact: a contact slips along a direction whose length is irrational")
    return tuple(x / root for x in vector)


def balance(data: RationalProblem, u: fmpq_mat, known: tuple[System, fmpq_mat] | None = None) -> Balance | None:
    """The forces that hold a displacement, None, proven, if none do; `known` are the only ones of their system."""
    chosen = states(data, u)
    if known is not None and known[0].combination.key == chosen.key:
        system, start = known
        directions = zeros(start.nrows(), 0)
    else:
        system = system_of(data, chosen)
        across = system.pushed.transpose()
        found = solve_any(across, data.f - data.K * u)
        if found is None:
            return None
        start, directions = found[0], zeros(across.ncols(), 0) if found[1] else null_space(across)
    conditions = stack(*_conditions(system)) if chosen.closed else zeros(0, start.nrows())
    if not directions.ncols():
        push = start.entries()[data.ties :]
        if any(x < 0 for x in (conditions * start).entries()):
            return None
        return Balance(system, start, True, _laid_out(data, chosen, [(fraction(x), fraction(x)) for x in push]))
    if chosen.stuck and data.width > 1:
        raise Unsupported("exact: contact forces are not unique, and the cones of friction in space are not linear")
    return _least(system, start, directions, conditions)


def _conditions(system: System) -> Iterator[fmpq_mat]:
    """Rows that are not negative on forces: l_N, and mu l_N -+ l_T where it sticks in the plane."""
    data, chosen = system.data, system.combination
    size, k = system.pushed.nrows(), data.ties
    for at, i in enumerate(chosen.closed):
        row = zeros(1, size)
        row[0, k + at] = fmpq(1)
        yield row
        if i in chosen.stuck and data.width == 1:
            rub = k + len(chosen.closed) + chosen.stuck.index(i)
            for sign in (-1, 1):
                row = zeros(1, size)
                row[0, k + at], row[0, rub] = data.friction[i], fmpq(sign)
                yield row


def _least(system: System, start: fmpq_mat, directions: fmpq_mat, conditions: fmpq_mat) -> Balance | None:
    data, chosen = system.data, system.combination
    k, contacts = data.ties, range(data.ties, start.nrows())
    moved = take(directions, contacts)
    # Ties alone may be redundant: directions in which no contact force changes.
    idle = directions * null_space(moved)
    shifts = take_columns(directions, independent_rows(moved.transpose()))
    family = Family(take(start, contacts), take(shifts, contacts), conditions * start, conditions * shifts)
    if not shifts.ncols() and any(x < 0 for x in family.room.entries()):
        return None
    if shifts.ncols():
        try:
            start = start + shifts * family.least()
        except NoSolution:
            return None
    start = least_change(idle, start)
    ranges: list[Range] = [(fraction(x), fraction(x)) for x in start.entries()[k:]]
    for columns in blocks(family.directions, family.slope):
        part = block_of(family, columns)
        entries = [place for place, row in enumerate(part.directions.tolist()) if any(x != 0 for x in row)]
        for place, ends in zip(entries, part.ranges(entries), strict=True):
            ranges[place] = ends
    only = all(low == high and low is not None for low, high in ranges)
    return Balance(system, start, only, _laid_out(data, chosen, ranges))


def _laid_out(data: RationalProblem, chosen: Combination, ranges: list[Range]) -> tuple[Range, ...]:
    known = dict(zip(chosen.closed, ranges, strict=False))
    return tuple(known.get(i, NO_RANGE) for i in range(data.contacts))
