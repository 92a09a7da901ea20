"""The data of a frictional problem as rational numbers: its floats as they stand, or what they were rounded from."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.model.problem import ContactProblem
from contactqp.solving.friction.exact_algebra import Row

# What symmetrising a printed stiffness and rounding may differ from an exact value, of the largest entry.
ROUNDED = 1e-9
NAMES = ("stiffness", "load", "normal", "gap", "tangent", "friction", "slip_origin", "tie", "tie_value")


class ExactData:
    """Matrices are lists of rows.

    Raises
    ------
    InvalidProblem
        A name is unknown, a value is no rational number, or it does not round to the problem's.
    """

    def __init__(self, problem: ContactProblem, exact: dict[str, Any]) -> None:
        unknown = sorted(set(exact) - set(NAMES))
        if unknown:
            raise InvalidProblem(f"exact_equilibria: expected exact {', '.join(NAMES)}, got {unknown[0]!r}")
        self._problem, self._exact = problem, exact
        self.stiffness, self.normal, self.tangent, self.tie = (
            self._matrix(name) for name in ("stiffness", "normal", "tangent", "tie")
        )
        self.load, self.gap, self.friction, self.slip_origin, self.tie_value = (
            self._vector(name) for name in ("load", "gap", "friction", "slip_origin", "tie_value")
        )
        for i, row in enumerate(self.stiffness):
            if any(row[j] != self.stiffness[j][i] for j in range(i)):
                raise InvalidProblem(f"stiffness: expected exactly symmetric, row {i} is not")
        # A contact that cannot slide has no friction to speak of.
        still = [not any(row) and not origin for row, origin in zip(self.tangent, self.slip_origin, strict=True)]
        self.friction = [Fraction(0) if idle else mu for idle, mu in zip(still, self.friction, strict=True)]

    def _matrix(self, name: str) -> list[Row]:
        known = getattr(self._problem, name)
        floats = known.toarray() if hasattr(known, "toarray") else np.asarray(known)
        flat = self._numbers(name, floats)
        width = floats.shape[1]
        return [flat[i * width : (i + 1) * width] for i in range(len(floats))]

    def _vector(self, name: str) -> Row:
        known = self._problem.finite_gap if name == "gap" else getattr(self._problem, name)
        return self._numbers(name, np.asarray(known))

    def _numbers(self, name: str, floats: np.ndarray[Any, Any]) -> Row:
        if name not in self._exact:
            return [Fraction(float(x)) for x in floats.ravel()]
        given = self._exact[name]
        given = np.asarray(given.toarray() if hasattr(given, "toarray") else given, dtype=object)
        if name == "friction" and given.ndim == 0:
            given = np.broadcast_to(given, floats.shape)
        if given.size != floats.size:
            raise InvalidProblem(f"{name}: expected {floats.size} exact values, got {given.size}")
        values = [_fraction(name, x) for x in given.ravel()]
        allowed = ROUNDED * float(np.max(abs(floats), initial=0.0))
        for value, rounded in zip(values, floats.ravel().tolist(), strict=True):
            if not abs(float(value) - rounded) <= allowed:
                raise InvalidProblem(f"{name}: expected what rounds to the problem's {rounded:g}, got {value}")
        return values


def _fraction(name: str, value: Any) -> Fraction:
    try:
        return Fraction(value)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        raise InvalidProblem(f"{name}: expected rational numbers, got {value!r}") from None
