"""Solutions that are finished when they are looked at: once each, from either end, and refused again if refused."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis.history import LazySolutions


@dataclass
class _Counted:
    """A spring loaded with so much, and how often somebody has looked."""

    load: float
    looks: list[float] = field(default_factory=list)

    def finish(self) -> cq.Solution:
        self.looks.append(self.load)
        if self.load < 0:
            raise cq.NotCertified("refused", None)
        return cq.solve(cq.ContactProblem(stiffness=[[1.0]], load=[self.load], normal=[[1.0]], gap=[9.0]))


def test_each_is_finished_once_and_only_when_it_is_looked_at() -> None:
    steps = [_Counted(float(k)) for k in range(4)]
    solutions = LazySolutions(steps)
    assert len(solutions) == 4
    assert not any(step.looks for step in steps)
    assert solutions[-1].displacement == solutions[3].displacement == 3.0
    assert solutions[-1] is solutions[np.int64(3)]
    assert [step.looks for step in steps] == [[], [], [], [3.0]]
    assert [float(solution.displacement[0]) for solution in solutions[2:0:-1]] == [2.0, 1.0]
    assert [len(step.looks) for step in steps] == [0, 1, 1, 1]
    assert [solution.displacement[0] for solution in solutions] == [0.0, 1.0, 2.0, 3.0]
    assert [len(step.looks) for step in steps] == [1, 1, 1, 1]


def test_it_grows_and_takes_what_is_finished() -> None:
    solutions = LazySolutions()
    assert list(solutions) == []
    solution = _Counted(2.0).finish()
    solutions.append(_Counted(1.0))
    solutions.append(solution)
    assert len(solutions) == 2
    assert solutions[-1] is solution


@pytest.mark.parametrize("index", [2, -3])
def test_there_is_nothing_beyond_the_ends(index: int) -> None:
    with pytest.raises(IndexError):
        LazySolutions([_Counted(1.0), _Counted(2.0)])[index]


def test_what_is_refused_is_refused_again() -> None:
    solutions = LazySolutions([_Counted(-1.0), _Counted(2.0)])
    for _look in range(2):
        with pytest.raises(cq.NotCertified, match="refused"):
            solutions[0]
    assert solutions[1].displacement == 2.0
