"""The linear systems that methods solve for the right set of closed contacts, as rational numbers."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from contactqp.solving.friction.exact_algebra import ONE, ZERO, Row, dot, reduced, solutions
from contactqp.solving.methods import Method
from contactqp.study.stability.exact_answer import Rows

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
        """That of the systems in u or in u and λ."""
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


def inverse_of(matrix: Rows) -> Rows | None:
    """The inverse; None of a singular matrix."""
    n = len(matrix)
    extended = [[*row, *(ONE if i == j else ZERO for j in range(n))] for i, row in enumerate(matrix)]
    found, pivots = reduced(extended, n)
    return [row[n:] for row in found] if len(pivots) == n else None
