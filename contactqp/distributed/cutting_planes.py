"""The least of a sum of sizes, h(a) = sum_j |b_j'a| over a with w'a = 1, from few sums: Kelley's cutting planes (1960).

The sums s = sum_j sign(b_j'a) b_j for some a tell that h(a) = s'a, and h(c) >= |s'c| for every other c. The least t
with t >= |s'c| for all s so far, a linear program of a few unknowns, is a lower bound, and its c is asked next. With
six unknowns and a hundred thousand summands a hundred questions bring the bounds together.
"""

from __future__ import annotations

import numpy as np

from contactqp.errors import NotConverged
from contactqp.model.arrays import Vector

# How near to each other the bounds end: figures are read with a few digits.
NEAR = 1e-9
MOST_QUESTIONS = 1000
# The linear program's own, beneath NEAR.
LP_TOLERANCE = 1e-10


class CuttingPlanes:
    """The search for one minimum.

    Parameters
    ----------
    weight : (p,) array
        w, not zero. h is the norm of some basis, its parts h(e_i) of about one size.

    Attributes
    ----------
    question : (p,) array
        The a whose sums are wanted next.
    best : (p,) array
        The a with the least h(a) / |w'a| so far.
    done : bool
        Whether that is the least.
    """

    def __init__(self, weight: Vector) -> None:
        self._weight = weight / np.max(abs(weight))
        self._least = np.inf
        self._cuts: list[Vector] = []
        self.best, self.done = self._weight, False
        self._questions = [self._weight, *np.eye(len(weight))]  # these bound the program

    @property
    def question(self) -> Vector:
        return np.asarray(self._questions[0])

    def tell(self, sums: Vector) -> None:
        """Take the sums of the question, and ask the next.

        Raises
        ------
        NotConverged
            The bounds did not come together.
        """
        asked = self._questions.pop(0)
        along = abs(float(self._weight @ asked))
        value = float(sums @ asked) / along if along > 0 else np.inf
        if value < self._least:
            self._least, self.best = value, asked
        self._cuts.append(sums)
        if self._questions:
            return
        following, lower = _program(np.array(self._cuts), self._weight)
        self._questions = [following]
        self.done = self._least - lower <= NEAR * self._least
        if not self.done and len(self._cuts) >= MOST_QUESTIONS:
            raise NotConverged(f"the balance of forces could not be judged: {MOST_QUESTIONS} motions were too few")


def _program(cuts: Vector, weight: Vector) -> tuple[Vector, float]:
    """argmin and least t >= |s'c| over c with w'c = 1."""
    from scipy.optimize import linprog

    count, width = cuts.shape
    one = np.ones((count, 1))
    found = linprog(
        np.append(np.zeros(width), 1.0),
        A_ub=np.block([[cuts, -one], [-cuts, -one]]),
        b_ub=np.zeros(2 * count),
        A_eq=np.append(weight, 0.0)[None],
        b_eq=[1.0],
        bounds=[(None, None)] * width + [(0, None)],
        method="highs",
        options={"primal_feasibility_tolerance": LP_TOLERANCE, "dual_feasibility_tolerance": LP_TOLERANCE},
    )
    if found.x is None:
        raise NotConverged(f"the balance of forces could not be judged: {found.message}")
    return np.asarray(found.x[:width]), float(found.x[width])
