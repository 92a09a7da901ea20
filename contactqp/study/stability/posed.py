"""A problem of an axis with its truth, and how far from it an answer is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.study.stability.exact_answer import ExactAnswer, answer_with_closed, refuse_wrong
from contactqp.study.truth import Errors, Truth

NO_EQUILIBRIUM = Errors(None, None, None, "there is no equilibrium", float("inf"), 0.0)


@dataclass(frozen=True, eq=False)
class SweptTruth(Truth):
    """A truth whose errors are all dimensionless: where the truth is zero, relative to the sizes that meet there.

    Where there are several equilibria an answer is held against the nearest; where there is none, nothing is right.
    """

    others: tuple[Truth, ...] = ()
    exists: bool = True
    held: bool = False  # known to be held without its contacts: nobody needs to look for rigid motions

    @property
    def _singular(self) -> bool:
        return not self.held and super()._singular

    def errors(self, displacement: Vector, normal_force: Vector, tie_force: Vector | None) -> Errors:
        """The errors of the answer: of u the worst of the measures that decide, of λ the largest contact's."""
        if not self.exists:
            return NO_EQUILIBRIUM
        found = [self._dimensionless(displacement, normal_force, tie_force)]
        found += [other.errors(displacement, normal_force, tie_force) for other in self.others]
        return min(found, key=lambda errors: errors.judged)

    def _dimensionless(self, displacement: Vector, normal_force: Vector, tie_force: Vector | None) -> Errors:
        found = super().errors(displacement, normal_force, tie_force)
        if found.displacement is None:
            return found
        change = displacement - self.displacement
        energy = self._energy(change)
        decisive = energy.judged if energy.relative else self._largest(change)
        if self._singular:
            decisive = max(decisive, self._largest(change))
        force = self._force(normal_force, tie_force)
        return replace(found, displacement=decisive, force=force.judged if force else None)

    def _largest(self, change: Vector) -> float:
        """The largest change of an unknown, against the largest unknown or, where all are zero, the lengths."""
        scale = float(np.max(abs(self.displacement), initial=0.0)) or self._length()
        largest = float(np.max(abs(change), initial=0.0))
        return largest / scale if scale > 0 else largest


@dataclass(frozen=True, eq=False)
class Posed:
    """One problem of an axis.

    `held` and `pushed` are the rows of the linear system of the right answer: E_N of the closed contacts, E_T of those
    that stick; and where their forces act, E_N + μ E_T where they slip.
    """

    problem: ContactProblem
    truth: SweptTruth
    exact: tuple[ExactAnswer, ...]  # every equilibrium; empty where it is not kept as fractions, or there is none
    closed: tuple[int, ...]  # contacts of the first equilibrium
    held: NDArray[np.float64] | None  # (r, n); None where the system is not examined
    pushed: NDArray[np.float64] | None  # (r, n)


def posed_with_closed(problem: ContactProblem, closed: Sequence[int]) -> Posed:
    """A frictionless problem whose closed contacts are known: its truth is solved for in rational numbers.

    Raises
    ------
    ArithmeticError
        These are not the contacts that are closed.
    """
    answer = answer_with_closed(problem, closed)
    rows = problem.normal.toarray()[list(closed)]
    return Posed(problem, truth_of_fractions(problem, answer), (answer,), tuple(closed), rows, rows)


def posed_with_answers(problem: ContactProblem, answers: Sequence[ExactAnswer], held: Any, pushed: Any) -> Posed:
    """A problem whose equilibria are known in closed form, each checked with no tolerance; without any, none exists.

    Raises
    ------
    ArithmeticError
        One of them is none.
    """
    for answer in answers:
        refuse_wrong(problem, answer)
    closed = tuple(i for i, force in enumerate(answers[0].normal_force) if force > 0) if answers else ()
    if not answers:
        nothing = np.zeros(problem.dimension), np.zeros(problem.contacts)
        truth = SweptTruth(problem, *nothing, None, "there is no equilibrium", exists=False)
        return Posed(problem, truth, (), closed, held, pushed)
    first, *others = (truth_of_fractions(problem, answer) for answer in answers)
    return Posed(problem, replace(first, others=tuple(others)), tuple(answers), closed, held, pushed)


def truth_of_fractions(problem: ContactProblem, answer: ExactAnswer) -> SweptTruth:
    """The nearest doubles of an exact answer."""
    source = "rational numbers, from the problem's doubles as they stand"
    return SweptTruth(problem, nearest(answer.displacement), nearest(answer.normal_force), np.zeros(0), source)


def nearest(values: Sequence[Fraction]) -> Vector:
    """The nearest doubles (Python divides integers of any size correctly rounded)."""
    return np.array([x.numerator / x.denominator for x in values], dtype=float)
