"""The linear system of one combination of open, closed, stick and slip, in rational numbers.

    [ K    A'   P'   T_b' ] [ u   ]   [ f ]
    [ A                   ] [ nu  ] = [ b ]       c: closed contacts, b: those of them that stick,
    [ E_c                 ] [ l_N ]   [ g ]       P = E_c, with mu t'E_T added where a contact slips along t
    [ T_b                 ] [ l_T ]   [ o ]

Without friction P = E_c: the system of a closed set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from flint import fmpq, fmpq_mat

from contactqp.oracle.exact.exact_problem import RationalProblem
from contactqp.oracle.exact.proof import RationalAnswer
from contactqp.oracle.exact.rational import beside, solve_any, stack, take, zeros

Direction = tuple[fmpq, ...]  # (d-1,) of unit length


@dataclass(frozen=True)
class Combination:
    """Which contacts are closed, which of these stick, and along what the others slip."""

    closed: tuple[int, ...]
    stuck: tuple[int, ...] = ()
    directions: Mapping[int, Direction] = field(default_factory=dict)

    @property
    def key(self) -> Any:
        return self.closed, self.stuck, tuple(sorted((i, tuple(map(str, t))) for i, t in self.directions.items()))


@dataclass(frozen=True, eq=False)
class System:
    """Rows that hold displacements, and those along which forces act."""

    data: RationalProblem
    combination: Combination
    held: fmpq_mat  # (k + c + b, n) A, E_c, T_b
    limit: fmpq_mat  # (k + c + b, 1)
    pushed: fmpq_mat  # (k + c + b, n) A, P, T_b

    def solve(self) -> tuple[fmpq_mat, fmpq_mat, bool] | None:
        """u, the forces (k + c + b, 1), and whether both are the only ones; None, proven, where there is none."""
        n, rows = self.data.unknowns, self.held.nrows()
        matrix = stack(beside(self.data.K, self.pushed.transpose()), beside(self.held, zeros(rows, rows)))
        found = solve_any(matrix, stack(self.data.f, self.limit))
        if found is None:
            return None
        x, only = found
        return take(x, range(n)), take(x, range(n, n + rows)), only

    def answer(self, u: fmpq_mat, forces: fmpq_mat) -> RationalAnswer:
        """The forces laid out contact by contact."""
        data, chosen, values = self.data, self.combination, forces.entries()
        push, rub = zeros(data.contacts, 1), zeros(data.T.nrows(), 1)
        k, w = data.ties, data.width
        for at, i in enumerate(chosen.closed):
            push[i, 0] = values[k + at]
            for axis, t in enumerate(chosen.directions.get(i, ())):
                rub[w * i + axis, 0] = data.friction[i] * t * values[k + at]
        for at, i in enumerate(chosen.stuck):
            for axis in range(w):
                rub[w * i + axis, 0] = values[k + len(chosen.closed) + w * at + axis]
        return RationalAnswer(u, push, rub, take(forces, range(k)))


def system_of(data: RationalProblem, combination: Combination) -> System:
    closed, w = combination.closed, data.width
    normal = take(data.E, closed)
    sticking = [w * i + axis for i in combination.stuck for axis in range(w)]
    stuck, origin = take(data.T, sticking), take(data.slip_origin, sticking)
    pushes = normal
    if combination.directions:
        drag = zeros(len(closed), data.unknowns)
        table = data.T.tolist()
        for at, i in enumerate(closed):
            for axis, t in enumerate(combination.directions.get(i, ())):
                for j, x in enumerate(table[w * i + axis]):
                    if x != 0:
                        drag[at, j] = drag[at, j] + data.friction[i] * t * x
        pushes = normal + drag
    return System(
        data,
        combination,
        held=stack(data.A, normal, stuck),
        limit=stack(data.b, take(data.g, closed), origin),
        pushed=stack(data.A, pushes, stuck),
    )
