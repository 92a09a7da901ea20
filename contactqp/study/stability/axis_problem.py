"""Axes of difficulty, and their problems with exact solutions in rational numbers that errors are measured against."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.bounds import REDUNDANT
from contactqp.certificate.uniqueness import FORCES, SEVERAL
from contactqp.linalg.exact_algebra import ZERO, Row, dot, solutions
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.study.truth import Errors, Truth

Rows = list[Row]


@dataclass(frozen=True)
class ExactAnswer:
    """One equilibrium in rational numbers, with the signs of `ContactProblem`."""

    displacement: tuple[Fraction, ...]  # (n,)
    normal_force: tuple[Fraction, ...]  # (m,)
    friction_force: tuple[Fraction, ...] = ()  # (m,) in the plane, empty without friction


def fractions(values: Any) -> Row:
    """Return a vector of doubles as fractions, exactly."""
    return [Fraction(x) for x in np.asarray(values, dtype=float).ravel().tolist()]


def exact_rows(matrix: Any) -> Rows:
    """Return the rows of a matrix of doubles, dense or sparse, as fractions, exactly."""
    dense = matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix, dtype=float)
    return [fractions(row) for row in dense]


def answer_with_closed(problem: ContactProblem, closed: Sequence[int]) -> ExactAnswer:
    """Solve K u + E_A'λ_A = f, E_A u = g_A for the closed contacts A, all other contacts without force.

    Gaussian elimination in fractions solves it, and the answer is checked against every condition of the problem.

    Raises
    ------
    ArithmeticError
        The system is singular, or these contacts are not those that are closed.
    """
    K, E = exact_rows(problem.stiffness), exact_rows(problem.normal)
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
    gap = [g - dot(row, u) for g, row in zip(fractions(problem.gap), exact_rows(problem.normal), strict=True)]
    if any(_residual(problem, answer)):
        raise ArithmeticError("the forces are not in equilibrium")
    if any(x < 0 for x in gap) or any(x < 0 for x in force):
        raise ArithmeticError("a contact penetrates, or is in tension")
    if any(x and y for x, y in zip(gap, force, strict=True)):
        raise ArithmeticError("a contact carries force across a gap")
    if problem.frictional and not all(_obeys_coulomb(problem, answer, i) for i in range(len(force))):
        raise ArithmeticError("Coulomb's law does not hold")


def _residual(problem: ContactProblem, answer: ExactAnswer) -> Row:
    rows, forces = exact_rows(problem.normal), list(answer.normal_force)
    if answer.friction_force:
        rows, forces = [*rows, *exact_rows(problem.tangent)], [*forces, *answer.friction_force]
    pushed = [dot([row[j] for row in rows], forces) for j in range(problem.dimension)]
    elastic = [dot(row, list(answer.displacement)) for row in exact_rows(problem.stiffness)]
    return [k + p - f for k, p, f in zip(elastic, pushed, fractions(problem.load), strict=True)]


def _obeys_coulomb(problem: ContactProblem, answer: ExactAnswer, i: int) -> bool:
    """Check |λ_T| <= μ λ_N, and λ_T = μ λ_N sign(s) where the slip s is not zero; in the plane."""
    assert problem.friction is not None
    assert problem.slip_origin is not None
    bound = Fraction(float(problem.friction[i])) * answer.normal_force[i]
    friction_force = answer.friction_force[i]
    slip = dot(exact_rows(problem.tangent)[i], list(answer.displacement)) - fractions(problem.slip_origin)[i]
    if slip == 0:
        return abs(friction_force) <= bound
    return friction_force == (bound if slip > 0 else -bound)


NO_EQUILIBRIUM = Errors(None, None, None, "there is no equilibrium", float("inf"), 0.0)


@dataclass(frozen=True, eq=False)
class SweptTruth(Truth):
    """A truth whose errors are all dimensionless: where the truth is zero, relative to the sizes that meet there.

    Where there are several equilibria an answer is compared with the nearest; where there is none, no answer is right.
    """

    others: tuple[Truth, ...] = ()
    exists: bool = True
    supported: bool = False  # known to have no rigid motions without its contacts, which are then not computed

    @property
    def _singular(self) -> bool:
        return not self.supported and super()._singular

    def errors(self, displacement: Vector, normal_force: Vector, tie_force: Vector | None) -> Errors:
        """Return the errors of an answer: of u the worst of the deciding measures, of λ that of the largest contact."""
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
        """Return the largest change relative to the largest unknown or, where all are zero, to the lengths."""
        scale = float(np.max(abs(self.displacement), initial=0.0)) or self._length()
        largest = float(np.max(abs(change), initial=0.0))
        return largest / scale if scale > 0 else largest


@dataclass(frozen=True, eq=False)
class AxisProblem:
    """One problem of an axis, with the linear system of its right answer.

    `constraint_rows` are E_N of the closed contacts and E_T of those that stick. `force_rows` say where their forces
    act: they are the same rows, and E_N + μ E_T of contacts that slip.
    """

    problem: ContactProblem
    truth: SweptTruth
    exact: tuple[ExactAnswer, ...]  # every equilibrium; empty where it is not kept as fractions, or there is none
    closed: tuple[int, ...]  # contacts of the first equilibrium
    constraint_rows: NDArray[np.float64] | None  # (r, n); None where the system is not examined
    force_rows: NDArray[np.float64] | None  # (r, n)


def problem_with_closed(problem: ContactProblem, closed: Sequence[int]) -> AxisProblem:
    """Return a frictionless problem with known closed contacts, whose truth is computed in rational numbers.

    Raises
    ------
    ArithmeticError
        These are not the contacts that are closed.
    """
    answer = answer_with_closed(problem, closed)
    rows = problem.normal.toarray()[list(closed)]
    return AxisProblem(problem, truth_of_fractions(problem, answer), (answer,), tuple(closed), rows, rows)


def problem_with_answers(
    problem: ContactProblem, answers: Sequence[ExactAnswer], constraint_rows: Any, force_rows: Any
) -> AxisProblem:
    """Return a problem whose equilibria are known in closed form, each of which is checked with no tolerance.

    Parameters
    ----------
    problem : ContactProblem
    answers : sequence of ExactAnswer
        All equilibria; empty where none exists.
    constraint_rows, force_rows : (r, n) arrays
        The linear system of the first one, see `AxisProblem`.

    Raises
    ------
    ArithmeticError
        One of the answers is no equilibrium.
    """
    for answer in answers:
        refuse_wrong(problem, answer)
    closed = tuple(i for i, force in enumerate(answers[0].normal_force) if force > 0) if answers else ()
    if not answers:
        nothing = np.zeros(problem.dimension), np.zeros(problem.contacts)
        truth = SweptTruth(problem, *nothing, None, "there is no equilibrium", exists=False)
        return AxisProblem(problem, truth, (), closed, constraint_rows, force_rows)
    first, *others = (truth_of_fractions(problem, answer) for answer in answers)
    return AxisProblem(
        problem, replace(first, others=tuple(others)), tuple(answers), closed, constraint_rows, force_rows
    )


def truth_of_fractions(problem: ContactProblem, answer: ExactAnswer) -> SweptTruth:
    """Return the nearest doubles of an exact answer as the truth."""
    source = "rational numbers, from the problem's doubles as they stand"
    return SweptTruth(
        problem, nearest_doubles(answer.displacement), nearest_doubles(answer.normal_force), np.zeros(0), source
    )


def nearest_doubles(values: Sequence[Fraction]) -> Vector:
    """Return the nearest doubles (Python rounds the quotient of integers of any size correctly)."""
    return np.array([x.numerator / x.denominator for x in values], dtype=float)


# The rounding of the truth to doubles, which may add to an error that equals its bound.
ROUNDING = 1e-12


def certificate_statement(truth: SweptTruth, solution: Solution) -> str:
    """Return the statement by which a passing certificate admits an error above 1e-6; empty where it has none.

    That uniqueness was not examined, or that other answers are not excluded, is no such statement.
    """
    certificate = solution.certificate
    if SEVERAL in certificate.uniqueness:
        return f"the certificate says: {'; '.join(certificate.uniqueness)}"
    if not truth.exists:
        return ""
    if certificate.force_bound is None:
        statements = [text for text in certificate.reasons if text.startswith("force_bound") and REDUNDANT in text]
        statements += [finding for finding in certificate.uniqueness if finding == FORCES]
        resultants = replace(truth, unique_forces=False)
        errors = resultants.errors(solution.displacement, solution.normal_force, solution.tie_force)
        return f"the certificate says: {statements[0]}" if statements and errors.small else ""
    off = np.abs(solution.normal_force - truth.normal_force)
    allowed = certificate.force_bound + ROUNDING * np.abs(truth.normal_force)
    together = replace(truth, unique_forces=False).errors(solution.displacement, truth.normal_force, solution.tie_force)
    if bool(np.all(off <= allowed)) and together.small:
        return f"the certificate's own force bound is {float(np.max(certificate.force_bound)):.1e}"
    return ""


# Values as near as this to one are named by their distance from it.
NEXT_TO_ONE = 1e-2


@dataclass(frozen=True)
class Axis:
    """One axis of difficulty: its values, and a function from a value to a problem with its truth.

    `pose` returns the same problem for the same value, always. Values are powers of two where that keeps the data
    doubles.
    """

    name: str
    title: str
    quantity: str  # what the values are, with its unit: the title of an axis of a chart
    values: tuple[float, ...]
    pose: Callable[[float], AxisProblem] = field(repr=False)
    about: str = ""  # what is swept, and why
    labels: tuple[str, ...] = ()  # of the values, where they are no numbers
    # Where the values are a method's own knob: the names of the methods that are swept, and their knobs.
    knobs: Mapping[str, str] = field(default_factory=dict)
    # The largest value that is tried, and why: beyond it the study would take too long.
    largest: float = float("inf")
    why_largest: str = ""

    def label(self, value: float) -> str:
        """Return the value in words."""
        if self.labels:
            return self.labels[self.values.index(value)]
        return f"1{value - 1:+.2g}" if 0 < abs(value - 1) < NEXT_TO_ONE else f"{value:.4g}"


def powers_of_two(*exponents: int) -> tuple[float, ...]:
    """Return 2^e for each exponent e."""
    return tuple(2.0**e for e in exponents)
