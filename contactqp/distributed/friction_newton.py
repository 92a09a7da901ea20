"""Newton's method on Coulomb's law over the ranks: from one combination of open, stick and slip to the next.

Early combinations are solved loosely. One that comes again is solved until the answer, its friction put onto Coulomb's
law, is in equilibrium; it is the answer if every figure of the certificate is small then.
"""

from __future__ import annotations

import numpy as np

from contactqp.certificate.certificate import ROUNDING_OF_ANSWERS
from contactqp.distributed.answer import DistributedAnswer
from contactqp.distributed.bodies import Bodies
from contactqp.distributed.friction_rows import FrictionRows
from contactqp.distributed.friction_states import Iterate, States
from contactqp.distributed.friction_system import CombinationSystem
from contactqp.distributed.violations import violations
from contactqp.distributed.worst import worst
from contactqp.linalg.measures import ratio
from contactqp.model.arrays import Vector
from contactqp.model.solution import FIGURES

# Combinations tried from one start.
MOST = 25
# What GMRES leaves of a combination that may not be the last, and of one that came again, a round.
LOOSE, TIGHT = 1e-3, 1e-7
# Rounds of GMRES on a combination that came again, each on the residual anew.
ROUNDS = 4
# Of the tolerance, what the equilibrium and all figures of an answer may be.
EQUILIBRIUM, FIGURE = 0.3, 0.7
# What is left of the forces that meet at an unknown when their rounding is all that is left.
ROUNDING = 4 * np.finfo(float).eps
# An error in energy, squared, of so many times what GMRES could not take off is rounding too.
STUCK = 4.0


class FrictionNewton:
    """Everything is collective."""

    def __init__(self, rows: FrictionRows, tolerance: float, energy: float) -> None:
        self._rows, self._way, self._problem = rows, rows.way, rows.problem
        self._tolerance, self._energy = tolerance, energy

    def run(self, start: Iterate) -> Iterate | None:
        """The answer from a start, or None where the combinations lead nowhere."""
        here, before = start, None
        chosen: States | None = None
        seen: dict[object, int] = {}
        for _ in range(MOST):
            chosen = self._rows.coulomb(here, chosen)
            if not self._held(chosen):
                return None
            mark = self._way.mark(chosen.flags)
            again = mark == before
            seen[mark] = seen.get(mark, 0) + 1
            if seen[mark] > 2 and not again:
                return None  # round and round
            system = CombinationSystem(self._rows, chosen)
            x, error = self._solved(system, system.closed(here.displacement), again)
            if self._way.any(~np.isfinite(x)):
                return None
            here, before = system.iterate(x), mark
            if again:
                answer = self._rows.within(here, chosen)
                if self._balances(system, answer, STUCK * error) and self.holds(answer):
                    return answer
        return None

    def _held(self, chosen: States) -> bool:
        """Whether what is closed and what sticks holds every rigid motion that the load drives."""
        if not self._way.floating.count:
            return True
        floating = self._rows.sticking(chosen.stick)[0].floating
        return floating.holds(chosen.closed, self._problem.load)

    def _solved(self, system: CombinationSystem, x: Vector, tight: bool) -> tuple[Vector, float]:
        """The displacement, and the error in energy, squared, that is left of it."""
        left = system.unbalanced(system.residual(x))
        for _ in range(ROUNDS if tight else 1):
            if self._small(x, left, ROUNDING) or (tight and self._enough(system, x, left, 0.0)):
                break
            x = system.improved(x, left, TIGHT if tight else LOOSE)
            left = system.unbalanced(system.residual(x))
        return x, system.error(left)

    def _small(self, x: Vector, left: Vector, part: float) -> bool:
        sizes = self._way.product_sizes(x) + abs(self._problem.load)
        return not self._way.any(~(ratio(abs(left), sizes) <= part))

    def _enough(self, system: CombinationSystem, x: Vector, left: Vector, floor: float) -> bool:
        if not self._small(x, left, EQUILIBRIUM * self._tolerance):
            return False
        work = self._way.dot(x, self._way.product(x))
        return system.error(left) <= max(self._energy**2 * work, floor)

    def _balances(self, system: CombinationSystem, answer: Iterate, floor: float) -> bool:
        x = answer.displacement
        return self._enough(system, x, self._rows.outer(answer) - self._way.product(x), floor)

    def holds(self, answer: Iterate) -> bool:
        """Whether every figure of the certificate but `balance`, which equilibrium implies, is small."""
        problem = self._problem
        given = DistributedAnswer(answer.displacement, answer.normal, answer.rub, answer.tie)
        found = violations(problem, given, Bodies(problem.ranks, problem.body), ROUNDING_OF_ANSWERS * self._tolerance)
        figures = worst(problem.ranks, *(getattr(found, name) for name in FIGURES if name != "balance"))
        return all(figure <= FIGURE * self._tolerance for figure in figures)
