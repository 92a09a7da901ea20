"""The best penalty β: where what it leaves out and what it loses to rounding are together the least.

In exact arithmetic the force is λ β / (S + β): the relative error S / (S + β), about S / β, falls with β. In doubles
λ = β (E u − g), a difference of lengths of the size of the gap: it is a multiple of β ulp(g), so that the relative
error β ulp(g) / λ rises with β. The sum S / β + β ulp(g) / λ is least where both are equal,

    β = √(S λ / ulp(g)),    error = 2 √(S ulp(g) / λ)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from contactqp.study.stability.axes.penalty_stiffness import GAP, STIFFNESS, closed_form


@dataclass(frozen=True)
class BestPenalty:
    """Of a single contact [force / length]."""

    stiffness: float  # S, which the contact feels
    force: float  # λ
    last_place: float  # ulp(g), the spacing of doubles at the gap

    @property
    def penalty(self) -> float:
        """√(S λ / ulp(g))."""
        return math.sqrt(self.stiffness * self.force / self.last_place)

    @property
    def error(self) -> float:
        """2 √(S ulp(g) / λ)."""
        return 2 * math.sqrt(self.stiffness * self.last_place / self.force)

    def error_at(self, penalty: float) -> float:
        """S / (S + β) + β ulp(g) / λ."""
        return self.stiffness / (self.stiffness + penalty) + penalty * self.last_place / self.force

    def quantum(self, penalty: float) -> Fraction:
        """β ulp(g), exactly: the forces that the textbook's λ = β (E u − g) can have are its multiples."""
        return Fraction(penalty) * Fraction(self.last_place)


def of_truss() -> BestPenalty:
    """Of Example 2.10: S = K22 − K12² / K11."""
    (k11, k12), (_, k22) = ((Fraction(x) for x in row) for row in STIFFNESS)
    return BestPenalty(
        stiffness=float(k22 - k12 * k12 / k11),
        force=float(closed_form().normal_force[0]),
        last_place=float(np.spacing(GAP)),
    )
