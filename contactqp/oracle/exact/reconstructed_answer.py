"""Guess rational numbers from an approximation if an enclosure is undecided, and prove them."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NotCertified, NotConverged
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import AnswerOf, Solution
from contactqp.oracle.exact.enclosed_answer import FLOATS_THAT_FLOAT, LOCAL, MINIMUM, is_convex, regular
from contactqp.oracle.exact.exact_solution import ExactSolution, Fractions
from contactqp.oracle.exact.rational_answer import PROVEN, Asked, symmetrised
from contactqp.oracle.exact.refinement import Fixed, FixedMatrix, Integers, Refined, fixed, refine

# Digits of the approximation, and those of them that are assumed right.
DIGITS, RIGHT = 80, 72
# Rational numbers are guessed from an approximation of many digits, and proven in integers.
#
# Numbers with small denominators are found by continued fractions; the common denominator of previous numbers makes
# those of the next ones smaller. The proof is that all conditions of the problem are checked in integers without
# rounding. This is the last step of exact linear and quadratic programming: Gleixner, Steffy and Wolter (2016),
# INFORMS Journal on Computing 28, 449.

# Two numbers of this denominator differ in the digits that are assumed right.
LARGEST_DENOMINATOR = 2**110


@dataclass(frozen=True, eq=False)
class Column:
    """The numbers `integers` / `denominator`."""

    integers: Integers
    denominator: int

    def times(self, rows: Any, less: Any) -> Column:
        """Return rows x - less for a matrix and a vector of floats."""
        product = FixedMatrix(sp.csr_matrix(rows)) @ Fixed(self.integers, 0)
        found = product - _times(fixed(less), self.denominator)
        return Column(found.integers << max(-found.bits, 0), self.denominator << max(found.bits, 0))

    def fractions(self) -> Fractions:
        array = np.empty(len(self.integers), dtype=object)
        array[:] = [Fraction(x, self.denominator) for x in self.integers.tolist()]
        return array


# An answer without friction, each part with one denominator.
Reconstructed = AnswerOf[Column, None]


def reconstruct(refined: Refined) -> Reconstructed | None:
    """Return the proven exact answer near an approximation, None if none with small numbers exists."""
    u = guessed(refined.displacement)
    push, tie = guessed(refined.normal_force), guessed(refined.tie_force)
    if u is None or push is None or tie is None:
        return None
    answer = Reconstructed(u, push, None, tie)
    return answer if solves(refined.problem, answer) else None


def guessed(values: Fixed) -> Column | None:
    """Return the nearest numbers with one small denominator, None if none are near enough.

    >>> third = Fixed(np.array([2**400 // 3, 5 * 2**399], dtype=object), 400)
    >>> [str(x) for x in guessed(third).fractions()]
    ['1/3', '5/2']
    """
    exact = values.fractions().tolist()
    off = Fraction(max((abs(x) for x in exact), default=Fraction(0))) / 10**RIGHT
    common = 1
    for x in exact:
        near = simplest(x * common - off * common, x * common + off * common)
        common *= near.denominator
        if common > LARGEST_DENOMINATOR:
            return None
    integers = np.empty(len(exact), dtype=object)
    integers[:] = [round(x * common) for x in exact]
    return Column(integers, common)


def simplest(low: Fraction, high: Fraction) -> Fraction:
    """Return the fraction of least denominator in [low, high], by continued fractions.

    >>> simplest(Fraction(3141, 1000), Fraction(3142, 1000)), simplest(Fraction(-1, 3), Fraction(1, 9))
    (Fraction(245, 78), Fraction(0, 1))
    """
    if low <= 0 <= high:
        return Fraction(0)
    if high < 0:
        return -simplest(-high, -low)
    terms = []
    while True:
        whole = math.ceil(low)
        if whole <= high:
            terms.append(whole)
            break
        whole -= 1
        terms.append(whole)
        low, high = 1 / (high - whole), 1 / (low - whole)
    found = Fraction(terms.pop())
    while terms:
        found = terms.pop() + 1 / found
    return found


def solves(problem: ContactProblem, answer: Reconstructed) -> bool:
    """Return whether an answer satisfies all conditions of a frictionless problem of floats, checked in integers."""
    u, push, tie = answer.displacement, answer.normal_force, answer.tie_force
    K = FixedMatrix(sp.csr_matrix(problem.stiffness))
    Et, At = (FixedMatrix(sp.csr_matrix(sp.csr_matrix(x).T)) for x in (problem.normal, problem.tie))
    # multiplied by all three denominators
    left = [_times(fixed(problem.load), u.denominator * push.denominator * tie.denominator)]
    left += [_times(K @ Fixed(u.integers, 0), -push.denominator * tie.denominator)]
    left += [_times(Et @ Fixed(push.integers, 0), -u.denominator * tie.denominator)]
    left += [_times(At @ Fixed(tie.integers, 0), -u.denominator * push.denominator)]
    overlap, tied = u.times(problem.normal, problem.gap), u.times(problem.tie, problem.tie_value)
    return (
        not any(_sum(left).integers)
        and not any(tied.integers)
        and all(x <= 0 for x in overlap.integers)
        and all(x >= 0 for x in push.integers)
        and not any(x and y for x, y in zip(overlap.integers, push.integers, strict=True))
    )


def _times(values: Fixed, factor: int) -> Fixed:
    return Fixed(values.integers * factor, values.bits)


def _sum(parts: Iterable[Fixed]) -> Fixed:
    total, *others = parts
    for part in others:
        total = total + part
    return total


ONLY = "the rows of all contacts without gap are independent: these are the only forces that hold this displacement"


def prove_by_reconstruction(asked: Asked, first: Solution) -> ExactSolution | None:
    """Return the proven rational answer nearest to a refined one, None if none is found or it is not unique."""
    problem = asked.problem
    try:
        found = reconstruct(refine(problem, asked.method, DIGITS, first=first, **asked.options))
        if found is None:
            return None
        gap = -found.displacement.times(problem.normal, problem.gap).fractions()
        regular(problem, np.flatnonzero(gap == 0), first)
        convex = is_convex(problem)
        if not convex:
            regular(problem, np.flatnonzero(found.normal_force.fractions() > 0), first)
    except (NotCertified, NotConverged):
        return None
    return _answer(asked, found, gap, convex)


def _answer(asked: Asked, found: Reconstructed, gap: Fractions, convex: bool) -> ExactSolution:
    problem = asked.problem
    u, push = found.displacement.fractions(), found.normal_force.fractions()
    ranges = np.empty((problem.contacts, 2), dtype=object)
    ranges[:, 0], ranges[:, 1] = push, push
    none, slip = None, None
    if problem.tangent is not None and problem.slip_origin is not None:
        shape = problem.slip_origin.shape
        slip = found.displacement.times(problem.tangent, problem.slip_origin).fractions().reshape(shape)
        none = np.full(shape, Fraction(0), dtype=object)
    load = fixed(problem.load).fractions()
    # u'(K u - f) - f'u
    twice = found.displacement.times(problem.stiffness, problem.load).fractions() - load
    return ExactSolution(
        problem=problem,
        displacement=u,
        normal_force=push,
        friction_force=none,
        tie_force=found.tie_force.fractions(),
        gap=gap,
        slip=slip,
        contact_status=tuple(_status(x, force) for x, force in zip(gap, push, strict=True)),
        rational=True,
        radius=None,
        unique_forces=True,
        force_range=ranges,
        free_motions=(),
        energy=sum((x * y for x, y in zip(u, twice, strict=True)), Fraction(0)) / 2,
        equilibria=None,
        uniqueness=(),
        events=(),
        data=asked.source,
        way="iterative refinement, and the fractions nearest to it",
        proof=(*PROVEN, ONLY, MINIMUM if convex else LOCAL),
        notes=symmetrised(problem) + (() if convex else (FLOATS_THAT_FLOAT,)),
        method=asked.method,
        seconds=time.perf_counter() - asked.started,
    )


def _status(gap: Fraction, force: Fraction) -> str:
    return "closed" if force else "open" if gap else "grazing"
