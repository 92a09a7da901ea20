"""Every condition of a contact problem, checked in Fractions entry by entry, with no code of the gallery."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

Rows = Sequence[Mapping[int, Fraction]]


def broken_conditions(data: Any, answer: Any) -> list[str]:
    """The names of the conditions that an answer breaks; none where it is right."""
    u = answer.displacement
    friction = [x for row in answer.friction_force for x in row]
    left = [_dot(row, u) - f for row, f in zip(data.stiffness, data.load, strict=True)]
    for rows, forces in ((data.normal, answer.normal_force), (data.tangent, friction), (data.tie, answer.tie_force)):
        for row, force in zip(rows, forces, strict=True):
            for j, x in row.items():
                left[j] += x * force
    broken = ["equilibrium"] if any(left) else []
    gap = [g - _dot(row, u) for row, g in zip(data.normal, data.gap, strict=True)]
    broken += ["gap"] if tuple(gap) != answer.gap else []
    broken += ["penetration"] if min(gap, default=0) < 0 else []
    broken += ["tension"] if min(answer.normal_force, default=0) < 0 else []
    broken += ["complementarity"] if any(a * b for a, b in zip(gap, answer.normal_force, strict=True)) else []
    tied = [_dot(row, u) for row in data.tie]
    broken += ["tie"] if tied != list(data.tie_value) else []
    return broken + (_broken_friction(data, answer) if data.tangent else [])


def _broken_friction(data: Any, answer: Any) -> list[str]:
    width = len(data.tangent) // len(data.normal)
    slid = [_dot(row, answer.displacement) - o for row, o in zip(data.tangent, data.slip_origin, strict=True)]
    broken = set()
    for i, (mu, pressed, force) in enumerate(
        zip(data.friction, answer.normal_force, answer.friction_force, strict=True)
    ):
        slip = slid[width * i : width * (i + 1)]
        broken |= {"slip"} if tuple(slip) != answer.slip[i] else set()
        square = sum(x * x for x in slip)
        broken |= {"cone"} if sum(x * x for x in force) > (mu * pressed) ** 2 else set()
        if square:
            # force = mu pressed slip / |slip|, squared and with its sign: no root is taken.
            along = all(
                t * t * square == (mu * pressed * s) ** 2 and t * s >= 0 for t, s in zip(force, slip, strict=True)
            )
            broken |= set() if along else {"slip direction"}
    return sorted(broken)


def is_semidefinite(rows: Rows) -> bool:
    """Symmetric and positive semidefinite, by integer elimination (Bareiss 1968): no pivot is negative, and where one
    is zero its whole row is."""
    if any(row != {j: rows[j].get(i, None) for j in row} for i, row in enumerate(rows)):
        return False
    if all(2 * row.get(i, 0) >= sum(abs(x) for x in row.values()) for i, row in enumerate(rows)):
        return True  # diagonally dominant
    scale = math.lcm(*(x.denominator for row in rows for x in row.values()))
    n = len(rows)
    left = [[int(row.get(j, 0) * scale) for j in range(n)] for row in rows]
    last = 1
    for i in range(n):
        pivot, row = left[i][i], left[i]
        if pivot < 0 or (pivot == 0 and any(row[i:])):
            return False
        if pivot == 0:
            continue
        for j in range(i + 1, n):
            factor, other = left[j][i], left[j]
            left[j] = [0] * (i + 1) + [(pivot * other[k] - factor * row[k]) // last for k in range(i + 1, n)]
        last = pivot
    return True


def doubles(values: Iterable[Fraction]) -> bool:
    """Whether every number is a double."""
    return all(Fraction(float(x)) == x for x in values)


def _dot(row: Mapping[int, Fraction], vector: Sequence[Fraction]) -> Fraction:
    return sum((x * vector[j] for j, x in row.items()), Fraction(0))
