"""Every equilibrium of a small problem with Coulomb friction: all combinations of open, stick, slip either way.

Each combination is a linear system (`contactqp.solving.friction.combinations`) in the scaled forces l of contacts and
ties and the coordinates a of rigid motions Z of the bodies,

    R x = R S^+ f - W l + R Z a,   W = R S^+ R',   Z'R'l = Z'f,   A x = b,

and what it gives is refined on the problem in twice double precision, which also tells whether it is an equilibrium.
Above a critical coefficient of friction there may be none or several (Klarbring 1990).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.figures import holds
from contactqp.errors import Unsupported
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.friction_states import FrictionalRows, Status, answer_in
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer
from contactqp.solving.friction.combinations import Combinations, refuse_many

# Of the largest displacement that the loads make without contacts, what rounding may leave of another.
NOTHING = 1e-12
# Displacements that move the contacts alike, to this part of the lengths that meet there, are one.
SAME = 1e-8


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One equilibrium, and the combination that it was found in."""

    status: Status  # (m,) of OPEN, STICK, SLIP_BACK, SLIP_ON
    answer: Answer


def all_equilibria(problem: ContactProblem, condensation: Condensation) -> tuple[Equilibrium, ...]:
    """Every equilibrium that differs from the others in its displacement; none is an empty tuple.

    Where contacts are redundant, many forces belong to one displacement: one of them is given.

    Raises
    ------
    Unsupported
        There are more than eight contacts.
    """
    if (reason := refuse_many(problem.contacts)) is not None:
        raise Unsupported(reason)
    rows = FrictionalRows(problem, condensation)
    found: list[Equilibrium] = []
    for status, start in _Systems(problem, condensation, rows).plausible():
        answer = answer_in(problem, condensation, rows, status, start)
        if holds(problem, answer) and not any(_same(problem, answer, other.answer) for other in found):
            found.append(Equilibrium(status, answer))
    return tuple(found)


def _same(problem: ContactProblem, one: Answer, other: Answer) -> bool:
    """Whether two displacements move every contact alike, each in the lengths that meet there."""
    weight = np.sqrt(np.where(problem.diagonal > 0, problem.diagonal, np.max(problem.diagonal) or 1.0))
    largest = np.maximum(abs(one.displacement), abs(other.displacement))
    size = SAME * largest + NOTHING * np.max(weight * largest, initial=0.0) / weight
    rows = [problem.normal]
    if problem.tangent is not None and problem.friction is not None:
        rows.append(problem.tangent[problem.friction > 0])  # in the plane, one row a contact
    difference = one.displacement - other.displacement
    return all(bool(np.all(abs(row @ difference) <= abs(row) @ size)) for row in rows)


class _Systems:
    """The combinations of one problem, and the displacement that belongs to their forces and motions."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, rows: FrictionalRows) -> None:
        self._way, self._rows = condensation, rows
        load, self._inner = condensation.reduce_load(problem.load)
        load = load * rows.scale
        self._m, R = problem.contacts, rows.all_rows
        self._free = rows.compliance @ load
        # R x = base + slope y.
        base, slope = R @ self._free, np.hstack([-R @ rows.compliance @ R.T, R @ rows.motions])
        target, drive = np.concatenate(rows.lengths(problem)), rows.motions.T @ load
        balance = np.hstack([(R @ rows.motions).T, np.zeros((rows.motions.shape[1],) * 2)])
        of_contacts, tied = slice(2 * self._m), slice(2 * self._m, None)
        self._combinations = Combinations(
            coefficient=rows.coefficient,
            base=base[of_contacts],
            slope=slope[of_contacts],
            target=target[of_contacts],
            fixed=np.vstack([slope[tied], balance]),
            fixed_right=np.concatenate([(target - base)[tied], drive]),
            nothing=NOTHING * max(float(np.max(abs(part), initial=0.0)) for part in (base, drive)),
        )

    def plausible(self) -> Iterator[tuple[Status, Answer]]:
        """Combinations whose signs hold, or miss by what may be rounding."""
        for status, y in self._combinations.plausible():
            yield status, self._answer(y)

    def _answer(self, y: Vector) -> Answer:
        rows, m = self._rows, self._m
        forces, motion = np.split(y, [len(rows.all_rows)])
        x = self._free - rows.compliance @ rows.all_rows.T @ forces + rows.motions @ motion
        lengths: tuple[NDArray[np.float64], ...] = (rows.normal_length, rows.tangent_length, rows.tie_length)
        normal, friction, tie = (
            force / length for force, length in zip(np.split(forces, [m, 2 * m]), lengths, strict=True)
        )
        return Answer(self._way.expand(x * rows.scale, self._inner), normal, friction[:, None], tie)
