"""Axes of difficulty, and their problems with exact solutions in rational numbers that errors are measured against.

Also in rational numbers: the condition numbers of the linear systems that methods solve, and the errors they predict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from contactqp.linalg.exact_algebra import ZERO, Row, dot, inverse_of, solutions
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.solving.methods import Method
from contactqp.solving.methods.method import ACTIVE_SET, COMPLEMENTARITY
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

    Raises ArithmeticError: the system is singular, or these contacts are not those that are closed.
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

    Raises ArithmeticError: what does not hold.
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
    constraint_rows: Array | None  # (r, n); None where the system is not examined
    force_rows: Array | None  # (r, n)


def problem_with_closed(problem: ContactProblem, closed: Sequence[int]) -> AxisProblem:
    """Return a frictionless problem with known closed contacts, whose truth is computed in rational numbers.

    Raises ArithmeticError: these are not the contacts that are closed.
    """
    answer = answer_with_closed(problem, closed)
    rows = problem.normal.toarray()[list(closed)]
    return AxisProblem(problem, truth_of_fractions(problem, answer), (answer,), tuple(closed), rows, rows)


def problem_with_answers(
    problem: ContactProblem, answers: Sequence[ExactAnswer], constraint_rows: Any, force_rows: Any
) -> AxisProblem:
    """Return a problem whose equilibria are known in closed form, each of which is checked with no tolerance.

    Raises ArithmeticError: one of the answers is not an equilibrium.

    Parameters
    ----------
    problem : ContactProblem
    answers : sequence of ExactAnswer, all equilibria; empty where none exists
    constraint_rows, force_rows : (r, n) arrays, the linear system of the first one, see `AxisProblem`
    """
    for answer in answers:
        refuse_wrong(problem, answer)
    closed = tuple(i for i, force in enumerate(answers[0].normal_force) if force > 0) if answers else ()
    if not answers:
        nothing = np.zeros(problem.dimension), np.zeros(problem.contacts)
        truth = SweptTruth(*nothing, None, "there is no equilibrium", exists=False, problem=problem)
        return AxisProblem(problem, truth, (), closed, constraint_rows, force_rows)
    first, *others = (truth_of_fractions(problem, answer) for answer in answers)
    return AxisProblem(
        problem, replace(first, others=tuple(others)), tuple(answers), closed, constraint_rows, force_rows
    )


def truth_of_fractions(problem: ContactProblem, answer: ExactAnswer) -> SweptTruth:
    """Return the nearest doubles of an exact answer as the truth."""
    source = "rational numbers, from the problem's doubles as they stand"
    u, force = nearest_doubles(answer.displacement), nearest_doubles(answer.normal_force)
    return SweptTruth(u, force, np.zeros(0), source, problem=problem)


def nearest_doubles(values: Sequence[Fraction]) -> Vector:
    """Return the nearest doubles (Python rounds the quotient of integers of any size correctly)."""
    return np.array([x.numerator / x.denominator for x in values], dtype=float)


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
    labels: tuple[str, ...] = ()  # of the values, where they are not numbers
    # Where the values are a method's own knob: the names of the methods that are swept, and their knobs.
    knobs: Mapping[str, str] = field(default_factory=dict)

    def label(self, value: float) -> str:
        """Return the value in words."""
        if self.labels:
            return self.labels[self.values.index(value)]
        return f"1{value - 1:+.2g}" if 0 < abs(value - 1) < NEXT_TO_ONE else f"{value:.4g}"


def powers_of_two(*exponents: int) -> tuple[float, ...]:
    """Return 2^e for each exponent e."""
    return tuple(2.0**e for e in exponents)


PLAIN, SADDLE = "K", "[K Eᵀ; E 0]"
PENALTY, PERTURBED, AUGMENTED = "K+EᵀβE", "[K Eᵀ; E -1/κ]", "[K+EᵀβE Eᵀ; E 0]"
DELASSUS, REDUCED = "E K⁻¹ Eᵀ", "TᵀK T, E T = 0"
_OF_METHOD = {
    "penalty": PENALTY,
    "perturbed-lagrangian": PERTURBED,
    "augmented-lagrangian": AUGMENTED,
    "lagrange-multiplier": SADDLE,
    "master-slave": REDUCED,
}
_OF_KIND = {ACTIVE_SET: PLAIN, COMPLEMENTARITY: DELASSUS}


def system_of(method: Method, variant: str) -> str:
    """Return the name of the matrix that a method factorises; of QP backends the one that they regularise."""
    if variant == "uzawa":
        return PENALTY
    return _OF_METHOD.get(method.name) or _OF_KIND.get(method.kind, SADDLE)


@dataclass(frozen=True)
class Blocks:
    """K u + P'λ = f, C u = g of the closed contacts: P are `force_rows`, C are `constraint_rows`, see `AxisProblem`."""

    stiffness: Rows  # (n, n)
    constraint_rows: Rows  # (r, n)
    force_rows: Rows  # (r, n)
    load: Row  # (n,)
    gap: Row  # (r,)

    def matrix(self, name: str, stiffness: Fraction) -> Rows | None:
        """Return the matrix of a name, with β or κ if it has one; None where it needs the inverse of a singular K."""
        if name == PENALTY:
            return self._with_springs(stiffness)
        if name == DELASSUS:
            return self._delassus()
        if name == REDUCED:
            return self._reduced()
        if name == PLAIN:
            return self.stiffness
        top = self._with_springs(stiffness) if name == AUGMENTED else self.stiffness
        return self._bordered(top, -1 / stiffness if name == PERTURBED else ZERO)

    def right_hand_side(self, name: str, stiffness: Fraction) -> Row:
        """Return the right-hand side of the systems in u, or in u and λ."""
        springs = stiffness if name in (PENALTY, AUGMENTED) else ZERO
        columns = zip(*self.force_rows, strict=True) if self.force_rows else [()] * len(self.load)
        load = [f + springs * dot(list(p), self.gap) for f, p in zip(self.load, columns, strict=True)]
        return load if name == PENALTY else [*load, *self.gap]

    def _with_springs(self, beta: Fraction) -> Rows:
        K = [list(row) for row in self.stiffness]
        for p, h in zip(self.force_rows, self.constraint_rows, strict=True):
            K = [[x + beta * p[i] * y for x, y in zip(row, h, strict=True)] for i, row in enumerate(K)]
        return K

    def _bordered(self, top: Rows, corner: Fraction) -> Rows:
        r = len(self.constraint_rows)
        above = [[*row, *(p[i] for p in self.force_rows)] for i, row in enumerate(top)]
        return above + [
            [*h, *(corner if i == j else ZERO for j in range(r))] for i, h in enumerate(self.constraint_rows)
        ]

    def _delassus(self) -> Rows | None:
        inverse = inverse_of(self.stiffness)
        if inverse is None:
            return None
        return [[dot(h, [dot(row, p) for row in inverse]) for p in self.force_rows] for h in self.constraint_rows]

    def _reduced(self) -> Rows:
        n = len(self.stiffness)
        found = solutions([[*row, ZERO] for row in self.constraint_rows], n)
        basis = found.free if found is not None else []
        return [[dot(a, [dot(row, b) for row in self.stiffness]) for b in basis] for a in basis]


# The largest relative error of one rounding: half the spacing of doubles in [1, 2).
UNIT_ROUNDOFF = 2.0**-53
# Largest size of an inverse in rational numbers, which takes a second.
SMALL = 26


@dataclass(frozen=True)
class Prediction:
    """The predicted errors of a method on a problem; None where they do not apply, or where `missing` says why."""

    system: str  # the matrix that it factorises
    condition: float | None = None  # κ = ‖A‖₂ ‖A⁻¹‖₂
    # Skeel's: the relative change of the largest force by relative changes of one part in every entry of A and b.
    force_condition: float | None = None
    modelling: float | None = None  # relative error in λ of an approximate method in exact arithmetic, S / (S + β)
    # Relative error in λ by rounding: β ulp / λ of the penalty method, else u times Skeel's.
    rounding: float | None = None
    missing: str = ""

    @property
    def digits_lost(self) -> float | None:
        """Return the digits that the condition number may cost, log₁₀ κ; None where it is not known."""
        return None if not self.condition else math.log10(self.condition)

    @property
    def error(self) -> float | None:
        """Return the predicted relative error in λ."""
        return None if self.rounding is None else self.rounding + (self.modelling or 0.0)


def predict(posed: AxisProblem, method: Method, variant: str, stiffness: float | None) -> Prediction:
    """Return the predicted errors of a method for the right set of closed contacts.

    Parameters
    ----------
    posed : AxisProblem
    method : Method
    variant : "uzawa" or empty
    stiffness : float or None, β or κ of a method that has one [force / length]
    """
    return _predict(posed, system_of(method, variant), variant == "" and not method.exact, stiffness or 0.0)


@lru_cache(maxsize=128)
def _predict(posed: AxisProblem, system: str, approximate: bool, stiffness: float) -> Prediction:
    size = posed.problem.dimension + len(posed.closed)
    if posed.constraint_rows is None or posed.force_rows is None or size > SMALL:
        return Prediction(system, missing=f"{size} rows are too many for an inverse in rational numbers")
    blocks, beta = _blocks(posed), Fraction(stiffness)
    matrix = blocks.matrix(system, beta)
    if matrix is None:
        return Prediction(system, missing="K is singular")
    if not matrix:
        return Prediction(system, missing="nothing is left to solve")
    inverse = inverse_of(matrix)
    if inverse is None:
        return Prediction(system, missing="it is singular")
    return Prediction(system, _norm(matrix) * _norm(inverse), **_force_errors(blocks, system, approximate, beta))


def _blocks(posed: AxisProblem) -> Blocks:
    problem, u = posed.problem, fractions(posed.truth.displacement)
    rows, force_rows = exact_rows(posed.constraint_rows), exact_rows(posed.force_rows)
    gap = [dot(row, u) for row in rows]
    return Blocks(exact_rows(problem.stiffness), rows, force_rows, fractions(problem.load), gap)


def _norm(matrix: Rows) -> float:
    """Return the spectral norm; rounding the entries to doubles changes it by one part in 1e15."""
    largest = max((abs(x) for row in matrix for x in row), default=ZERO)
    scaled = np.array([[float(x / largest) for x in row] for row in matrix]) if largest else np.zeros((1, 1))
    return float(np.linalg.norm(scaled, 2)) * float(largest)


def _force_errors(blocks: Blocks, system: str, approximate: bool, beta: Fraction) -> dict[str, Any]:
    """Return Skeel's condition number and the errors of modelling and rounding.

    For methods that solve the saddle point system in steps they are those of that system.
    """
    exact = _solved(blocks, SADDLE, beta)
    if exact is None or not any(exact.forces):
        return {}
    name = system if system in (PENALTY, PERTURBED, AUGMENTED) else SADDLE
    solved = _solved(blocks, name, beta)
    if solved is None:
        return {}
    largest = max(abs(x) for x in exact.forces)
    number = float(max(solved.force_changes) / largest)
    modelling = None
    if approximate:
        off = max(abs(x - y) for x, y in zip(solved.forces, exact.forces, strict=True))
        modelling = float(off / largest)
    rounding = UNIT_ROUNDOFF * number
    if name == PENALTY:
        rounding = float(beta) * _last_place(blocks, exact.displacement) / float(largest)
    return dict(force_condition=number, modelling=modelling, rounding=rounding)


def _last_place(blocks: Blocks, u: Row) -> float:
    """Return the ulp of the largest length that meets at a closed contact."""
    lengths = [abs(x * y) for row in blocks.constraint_rows for x, y in zip(row, u, strict=True)]
    return float(np.spacing(float(max([*lengths, *(abs(g) for g in blocks.gap)]))))


@dataclass(frozen=True)
class _Solved:
    displacement: Row
    forces: Row
    force_changes: Row  # what relative changes of one part make of the forces


def _solved(blocks: Blocks, name: str, beta: Fraction) -> _Solved | None:
    matrix = blocks.matrix(name, beta)
    inverse = None if matrix is None else inverse_of(matrix)
    if matrix is None or inverse is None:
        return None
    right = blocks.right_hand_side(name, beta)
    x = [dot(row, right) for row in inverse]
    sizes = [dot([abs(a) for a in row], [abs(b) for b in x]) + abs(r) for row, r in zip(matrix, right, strict=True)]
    changes = [dot([abs(a) for a in row], sizes) for row in inverse]
    n = len(blocks.stiffness)
    if name != PENALTY:
        return _Solved(x[:n], x[n:], changes[n:])
    forces = [beta * (dot(row, x) - g) for row, g in zip(blocks.constraint_rows, blocks.gap, strict=True)]
    moved = [
        beta * (dot([abs(a) for a in row], changes) + abs(g))
        for row, g in zip(blocks.constraint_rows, blocks.gap, strict=True)
    ]
    return _Solved(x, forces, moved)
