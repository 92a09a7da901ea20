"""Whether rational numbers solve a contact problem, statement by statement, with no tolerance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from flint import fmpq, fmpq_mat

from contactqp.oracle.exact.exact_problem import RationalProblem
from contactqp.oracle.exact.rational import zeros


@dataclass(frozen=True, eq=False)
class RationalAnswer:
    """Columns with the signs of `contactqp.Solution`."""

    displacement: fmpq_mat  # (n, 1)
    normal_force: fmpq_mat  # (m, 1)
    friction_force: fmpq_mat  # ((d-1) m, 1), without entries where nothing rubs
    tie_force: fmpq_mat  # (k, 1)


@dataclass(frozen=True)
class Wrong:
    """A statement that does not hold, and where: an unknown, a contact or a tie."""

    statement: str
    place: int


STATEMENTS = (
    "equilibrium",  # K u + E_N'l_N + E_T'l_T + A'nu = f
    "tie",  # A u = b
    "penetration",  # g - E_N u >= 0
    "tension",  # l_N >= 0
    "complementarity",  # l_N (g - E_N u) = 0
    "cone",  # |l_T| <= mu l_N
    "slip direction",  # l_T = mu l_N s / |s| where s != 0
)


def wrong(data: RationalProblem, answer: RationalAnswer) -> Iterator[Wrong]:
    """Every statement that does not hold; none is a proof that the answer solves the problem."""
    u, push, rub = answer.displacement, answer.normal_force, answer.friction_force
    left = data.K * u + data.E.transpose() * push + data.A.transpose() * answer.tie_force - data.f
    if rub.nrows():
        left += data.T.transpose() * rub
    yield from (Wrong("equilibrium", j) for j, x in enumerate(left.entries()) if x != 0)
    yield from (Wrong("tie", i) for i, x in enumerate((data.A * u - data.b).entries()) if x != 0)
    gap, forces = data.gap(u).entries(), push.entries()
    yield from (Wrong("penetration", i) for i, x in enumerate(gap) if x < 0)
    yield from (Wrong("tension", i) for i, x in enumerate(forces) if x < 0)
    yield from (Wrong("complementarity", i) for i, x in enumerate(gap) if x != 0 and forces[i] != 0)
    yield from _wrong_friction(data, answer)


def _wrong_friction(data: RationalProblem, answer: RationalAnswer) -> Iterator[Wrong]:
    width = data.width
    if not width:
        return
    slip = data.slip(answer.displacement).entries()
    rub, forces = answer.friction_force.entries(), answer.normal_force.entries()
    for i, mu in enumerate(data.friction):
        force, moved = rub[width * i : width * (i + 1)], slip[width * i : width * (i + 1)]
        bound = mu * mu * forces[i] * forces[i]
        if _product(force, force) > bound:
            yield Wrong("cone", i)
        if mu == 0 or all(s == 0 for s in moved):
            continue
        along = _product(force, moved)
        # Cauchy and Schwarz: equality means parallel.
        parallel = along * along == _product(force, force) * _product(moved, moved)
        # What carries nothing has no direction of friction.
        if not (parallel and along >= 0 and _product(force, force) == bound):
            yield Wrong("slip direction", i)


def _product(one: list[fmpq], other: list[fmpq]) -> fmpq:
    return sum((x * y for x, y in zip(one, other, strict=True)), fmpq(0))


def status(data: RationalProblem, answer: RationalAnswer) -> tuple[str, ...]:
    """(m,) of "open" | "closed" | "grazing" | "stick" | "slip"."""
    gap, forces = data.gap(answer.displacement).entries(), answer.normal_force.entries()
    width = data.width
    slip = (data.slip(answer.displacement) if width else zeros(0, 1)).entries()
    words = []
    for i, mu in enumerate(data.friction):
        if forces[i] == 0:
            words.append("open" if gap[i] != 0 else "grazing")
        elif mu == 0:
            words.append("closed")
        else:
            words.append("slip" if any(s != 0 for s in slip[width * i : width * (i + 1)]) else "stick")
    return tuple(words)
