"""Exact answers of small problems: doubles as they stand, Gauss's elimination in Fractions, every condition checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from contactqp.model.problem import ContactProblem
from contactqp.solving.friction.exact_algebra import ZERO, Row, dot, solutions

Rows = list[Row]


@dataclass(frozen=True)
class ExactAnswer:
    """One equilibrium in rational numbers; signs of `ContactProblem`."""

    displacement: tuple[Fraction, ...]  # (n,)
    normal_force: tuple[Fraction, ...]  # (m,)
    friction_force: tuple[Fraction, ...] = ()  # (m,) in the plane, empty without friction


def fractions(values: Any) -> Row:
    """A vector of doubles as it stands."""
    return [Fraction(x) for x in np.asarray(values, dtype=float).ravel().tolist()]


def rows_of(matrix: Any) -> Rows:
    """A matrix of doubles, dense or sparse, as it stands."""
    dense = matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix, dtype=float)
    return [fractions(row) for row in dense]


def answer_with_closed(problem: ContactProblem, closed: Sequence[int]) -> ExactAnswer:
    """The answer whose closed contacts are known: K u + E_A'λ_A = f, E_A u = g_A, all other contacts without force.

    No floating-point solver has a part in it, and what comes out is checked against every condition of the problem.

    Raises
    ------
    ArithmeticError
        The system is singular, or these contacts are not those that are closed.
    """
    K, E = rows_of(problem.stiffness), rows_of(problem.normal)
    f, g = fractions(problem.load), fractions(problem.gap)
    n, count = len(K), len(closed)
    system = [[*row, *(E[i][j] for i in closed), f[j]] for j, row in enumerate(K)]
    system += [[*E[i], *[ZERO] * count, g[i]] for i in closed]
    found = solutions(system, n + count)
    if found is None or found.free:
        raise ArithmeticError("the closed contacts do not determine the answer")
    force = [ZERO] * len(E)
    for i, value in zip(closed, found.point[n:], strict=True):
        force[i] = value
    answer = ExactAnswer(tuple(found.point[:n]), tuple(force))
    refuse_wrong(problem, answer)
    return answer


def refuse_wrong(problem: ContactProblem, answer: ExactAnswer) -> None:
    """Raise unless equilibrium, non-penetration, compression, complementarity and Coulomb's law hold with no tolerance.

    Raises
    ------
    ArithmeticError
        What does not hold.
    """
    u, force = list(answer.displacement), list(answer.normal_force)
    gap = [g - dot(row, u) for g, row in zip(fractions(problem.gap), rows_of(problem.normal), strict=True)]
    if any(_residual(problem, answer)):
        raise ArithmeticError("the forces are not in equilibrium")
    if any(x < 0 for x in gap) or any(x < 0 for x in force):
        raise ArithmeticError("a contact penetrates, or is in tension")
    if any(x and y for x, y in zip(gap, force, strict=True)):
        raise ArithmeticError("a contact carries force across a gap")
    if problem.frictional and not all(_obeys_coulomb(problem, answer, i) for i in range(len(force))):
        raise ArithmeticError("Coulomb's law does not hold")


def _residual(problem: ContactProblem, answer: ExactAnswer) -> Row:
    rows, forces = rows_of(problem.normal), list(answer.normal_force)
    if answer.friction_force:
        rows, forces = [*rows, *rows_of(problem.tangent)], [*forces, *answer.friction_force]
    pushed = [dot([row[j] for row in rows], forces) for j in range(problem.dimension)]
    held = [dot(row, list(answer.displacement)) for row in rows_of(problem.stiffness)]
    return [k + p - f for k, p, f in zip(held, pushed, fractions(problem.load), strict=True)]


def _obeys_coulomb(problem: ContactProblem, answer: ExactAnswer, i: int) -> bool:
    """|λ_T| <= μ λ_N, and λ_T = μ λ_N sign(s) where the slip s is not zero; in the plane."""
    assert problem.friction is not None
    assert problem.slip_origin is not None
    bound = Fraction(float(problem.friction[i])) * answer.normal_force[i]
    rubbing = answer.friction_force[i]
    slip = dot(rows_of(problem.tangent)[i], list(answer.displacement)) - fractions(problem.slip_origin)[i]
    if slip == 0:
        return abs(rubbing) <= bound
    return rubbing == (bound if slip > 0 else -bound)
