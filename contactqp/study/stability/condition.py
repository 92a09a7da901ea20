"""Condition numbers of the linear systems that methods solve, in rational numbers, and the errors that they predict."""

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
_OF_METHOD = {
    "penalty": PENALTY,
    "perturbed-lagrangian": PERTURBED,
    "augmented-lagrangian": AUGMENTED,
    "lagrange-multiplier": SADDLE,
    "master-slave": REDUCED,
}
_OF_KIND = {"active set": PLAIN, "complementarity": DELASSUS}


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
        """log₁₀ κ."""
        return None if not self.condition else math.log10(self.condition)

    @property
    def error(self) -> float | None:
        """The predicted relative error in λ."""
        return None if self.rounding is None else self.rounding + (self.modelling or 0.0)


def predict(posed: AxisProblem, method: Method, variant: str, stiffness: float | None) -> Prediction:
    """Return the predicted errors of a method for the right set of closed contacts.

    Parameters
    ----------
    posed : AxisProblem
    method : Method
    variant : str
        "uzawa" or empty.
    stiffness : float or None
        β or κ of a method that has one [force / length].
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
