"""Ties as matrices, in exact numbers: A, its rank, and the problem that is left on the masters.

    A_s u_s + A_m u_m = b    gives    u = T u_m + c,    T = [I; -A_s^-1 A_m],    c = [0; A_s^-1 b]
    K^ = T'K T,    f^ = T'(f - K c)

(course chapter, eqs 2.17-2.20, with the term K_us A_s^-1 b that the printed first right-hand block of 2.20 lacks).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from contactqp.elements.scalars import Number
from contactqp.errors import SceneError
from contactqp.scene.building import ExactProblem

Rows = list[list[Fraction]]


def tie_matrix(exact: ExactProblem, columns: Sequence[str]) -> list[Number]:
    """A on the given unknowns, row by row."""
    return [tie.row.get(name, Fraction(0)) for tie in exact.ties for name in columns]


def rank(exact: ExactProblem) -> int:
    """The number of independent ties."""
    free = exact.unknowns.free
    return len(_eliminate([[Fraction(tie.row.get(name, 0)) for name in free] for tie in exact.ties], len(free))[1])


def reduced_stiffness(exact: ExactProblem, masters: Sequence[str]) -> list[Number]:
    """K^ = T'KT, row by row in the order of the masters."""
    T, _ = _transformation(exact, masters)
    K = exact.stiffness
    return [
        sum((T[i][a] * Fraction(k) * T[j][b] for (i, j), k in K.items() if i in T and j in T), Fraction(0))
        for a in range(len(masters))
        for b in range(len(masters))
    ]


def reduced_load(exact: ExactProblem, masters: Sequence[str]) -> list[Number]:
    """f^ = T'(f - K c)."""
    T, c = _transformation(exact, masters)
    residual = {name: Fraction(exact.load.get(name, 0)) for name in T}
    for (i, j), k in exact.stiffness.items():
        if i in T and j in T:
            residual[i] -= Fraction(k) * c[j]
    return [sum((T[name][a] * residual[name] for name in T), Fraction(0)) for a in range(len(masters))]


def _transformation(
    exact: ExactProblem, masters: Sequence[str]
) -> tuple[dict[str, list[Fraction]], dict[str, Fraction]]:
    """T and c of u = T u_m + c, by the names of the unknowns."""
    slaves = [name for name in exact.unknowns.free if name not in masters]
    order = [*slaves, *masters]
    rows = [[Fraction(tie.row.get(name, 0)) for name in order] + [Fraction(tie.value)] for tie in exact.ties]
    reduced, pivots = _eliminate(rows, len(slaves))
    if len(pivots) != len(slaves):
        raise SceneError(
            f"unknowns: expected masters that decide the {len(slaves)} others by the ties, got {list(masters)}"
        )
    T = {name: [Fraction(name == master) for master in masters] for name in masters}
    c = dict.fromkeys(masters, Fraction(0))
    for name, row in zip(slaves, reduced, strict=False):
        T[name] = [-entry for entry in row[len(slaves) : -1]]
        c[name] = row[-1]
    return T, c


def _eliminate(rows: Rows, columns: int) -> tuple[Rows, list[int]]:
    """Gauss-Jordan on the first columns, exactly; the rows with pivots come first."""
    rows = [list(row) for row in rows]
    pivots: list[int] = []
    for column in range(columns):
        top = len(pivots)
        found = next((i for i in range(top, len(rows)) if rows[i][column]), None)
        if found is None:
            continue
        rows[top], rows[found] = rows[found], rows[top]
        rows[top] = [entry / rows[top][column] for entry in rows[top]]
        for i, row in enumerate(rows):
            if i != top and row[column]:
                rows[i] = [entry - row[column] * above for entry, above in zip(row, rows[top], strict=True)]
        pivots.append(column)
    return rows, pivots
