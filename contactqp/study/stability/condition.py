"""Condition numbers of what methods solve, exactly, and the errors that they predict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from contactqp.linalg.exact_algebra import ZERO, Row, dot, inverse_of, solutions
from contactqp.solving.methods import Method
from contactqp.study.stability.axis_problem import AxisProblem, Rows, exact_rows, fractions

PLAIN, SADDLE = "K", "[K Eᵀ; E 0]"
PENALTY, PERTURBED, AUGMENTED = "K+EᵀβE", "[K Eᵀ; E -1/κ]", "[K+EᵀβE Eᵀ; E 0]"
DELASSUS, REDUCED = "E K⁻¹ Eᵀ", "TᵀK T, E T = 0"
# The linear systems that methods solve for the right set of closed contacts, as rational numbers.

_OF_METHOD = {
    "penalty": PENALTY,
    "perturbed-lagrangian": PERTURBED,
    "augmented-lagrangian": AUGMENTED,
    "lagrange-multiplier": SADDLE,
    "master-slave": REDUCED,
}
_OF_KIND = {"active set": PLAIN, "complementarity": DELASSUS}


def system_of(method: Method, variant: str) -> str:
    """The matrix that a method factorises; of the quadratic programming backends the one that they regularise."""
    if variant == "uzawa":
        return PENALTY
    return _OF_METHOD.get(method.name) or _OF_KIND.get(method.kind, SADDLE)


@dataclass(frozen=True)
class Blocks:
    """K u + pushed'λ = f, held u = g of the closed contacts; they differ where something slips."""

    stiffness: Rows  # (n, n)
    held: Rows  # (r, n)
    pushed: Rows  # (r, n)
    load: Row  # (n,)
    gap: Row  # (r,)

    def matrix(self, name: str, stiffness: Fraction) -> Rows | None:
        """The matrix of that name, with β or κ where it has one; None where it needs the inverse of a singular K."""
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
        columns = zip(*self.pushed, strict=True) if self.pushed else [()] * len(self.load)
        load = [f + springs * dot(list(p), self.gap) for f, p in zip(self.load, columns, strict=True)]
        return load if name == PENALTY else [*load, *self.gap]

    def _with_springs(self, beta: Fraction) -> Rows:
        K = [list(row) for row in self.stiffness]
        for p, h in zip(self.pushed, self.held, strict=True):
            K = [[x + beta * p[i] * y for x, y in zip(row, h, strict=True)] for i, row in enumerate(K)]
        return K

    def _bordered(self, top: Rows, corner: Fraction) -> Rows:
        r = len(self.held)
        above = [[*row, *(p[i] for p in self.pushed)] for i, row in enumerate(top)]
        return above + [[*h, *(corner if i == j else ZERO for j in range(r))] for i, h in enumerate(self.held)]

    def _delassus(self) -> Rows | None:
        inverse = inverse_of(self.stiffness)
        if inverse is None:
            return None
        return [[dot(h, [dot(row, p) for row in inverse]) for p in self.pushed] for h in self.held]

    def _reduced(self) -> Rows:
        n = len(self.stiffness)
        found = solutions([[*row, ZERO] for row in self.held], n)
        basis = found.free if found is not None else []
        return [[dot(a, [dot(row, b) for row in self.stiffness]) for b in basis] for a in basis]


# Half of the spacing of doubles in [1, 2): the largest relative error of one rounding.
UNIT_ROUNDOFF = 2.0**-53
# An inverse in rational numbers takes a second at this size.
SMALL = 26


@dataclass(frozen=True)
class Prediction:
    """What is known of a method on a problem before it is run; None where it does not apply, or `missing` says why."""

    system: str  # the matrix that it factorises
    condition: float | None = None  # κ = ‖A‖₂ ‖A⁻¹‖₂
    # Skeel's: the relative change of the largest force by relative changes of one part in every entry of A and b.
    force_condition: float | None = None
    modelling: float | None = None  # relative error in λ of an approximate method in exact arithmetic, S / (S + β)
    rounding: float | None = (
        None  # relative error in λ by rounding: β ulp / λ of the penalty method, else u times Skeel's
    )
    missing: str = ""

    @property
    def digits_lost(self) -> float | None:
        """log₁₀ κ."""
        return None if not self.condition else math.log10(self.condition)

    @property
    def error(self) -> float | None:
        """The predicted relative error in λ."""
        return None if self.rounding is None else self.rounding + (self.modelling or 0.0)


def predict(posed: AxisProblem, method: Method, variant: str, stiffness: float | None) -> Prediction:
    """For the right set of closed contacts; `stiffness` is β or κ of a method that has one, and 0 if it is None."""
    return _predict(posed, system_of(method, variant), variant == "" and not method.exact, stiffness or 0.0)


@lru_cache(maxsize=128)
def _predict(posed: AxisProblem, system: str, approximate: bool, stiffness: float) -> Prediction:
    size = posed.problem.dimension + len(posed.closed)
    if posed.held is None or posed.pushed is None or size > SMALL:
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
    held, pushed = exact_rows(posed.held), exact_rows(posed.pushed)
    return Blocks(exact_rows(problem.stiffness), held, pushed, fractions(problem.load), [dot(row, u) for row in held])


def _norm(matrix: Rows) -> float:
    """The spectral norm; the entries' rounding to doubles changes it by one part in 1e15."""
    largest = max((abs(x) for row in matrix for x in row), default=ZERO)
    scaled = np.array([[float(x / largest) for x in row] for row in matrix]) if largest else np.zeros((1, 1))
    return float(np.linalg.norm(scaled, 2)) * float(largest)


def _force_errors(blocks: Blocks, system: str, approximate: bool, beta: Fraction) -> dict[str, Any]:
    """Skeel's condition number, modelling and rounding; those of the saddle point system for methods that solve it in
    steps."""
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
    """ulp of the largest length that meets at a closed contact."""
    lengths = [abs(x * y) for row in blocks.held for x, y in zip(row, u, strict=True)]
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
    forces = [beta * (dot(row, x) - g) for row, g in zip(blocks.held, blocks.gap, strict=True)]
    moved = [
        beta * (dot([abs(a) for a in row], changes) + abs(g)) for row, g in zip(blocks.held, blocks.gap, strict=True)
    ]
    return _Solved(x, forces, moved)
