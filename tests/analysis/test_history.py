"""A history is data: it can be pickled, copied and sliced, and its solutions are finished once, on first access.

Solutions that are refused are refused again; what is no path is refused in one line.
"""

from __future__ import annotations

import copy
import pickle
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis.history import LazySolutions
from contactqp.analysis.load_path import changes

LOADS = [[-1.0, -3.0], [-1.0, 3.0]]


def klarbring() -> cq.ContactProblem:
    return cq.ContactProblem(
        stiffness=[[5.0, -2.0], [-2.0, 1.0]],
        load=[0.0, 0.0],
        normal=[[-1.0, 0.0]],
        gap=[0.1],
        tangent=[[0.0, 1.0]],
        friction=0.3,
    )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("way", [dict(steps=3), dict(events="exact"), dict(steps=3, algorithm="aclm")], ids=str)
def test_a_history_survives_pickling_and_copying(way: dict[str, Any]) -> None:
    history = cq.follow_path(klarbring(), loads=LOADS, **way)
    for kept in (pickle.loads(pickle.dumps(history)), copy.deepcopy(history)):
        assert len(kept) == len(history)
        assert kept.events == history.events
        assert kept.energies == history.energies
        np.testing.assert_array_equal(kept.times, history.times)
        np.testing.assert_array_equal(kept.displacements, history.displacements)


def test_a_frictionless_history_survives_pickling() -> None:
    smooth = cq.ContactProblem(stiffness=[[2.0]], load=[0.0], normal=[[1.0]], gap=[0.5])
    for way in (dict(steps=3), dict(events="exact")):
        history = cq.follow_path(smooth, loads=[[3.0]], **way)
        kept = pickle.loads(pickle.dumps(history))
        assert kept.events == history.events
        np.testing.assert_array_equal(kept.normal_forces, history.normal_forces)


class Unfinished:
    """A step that its certificate refuses when it is looked at."""

    def finish(self) -> cq.Solution:
        raise cq.NotCertified("step 2 is refused", cq.solve(klarbring()))


def test_a_history_with_a_refused_step_can_be_sent_and_still_refuses_it() -> None:
    path = cq.follow_path(klarbring(), loads=LOADS, steps=1)
    steps = LazySolutions([path[0], path[1], Unfinished()])
    history = cq.History(steps, path.times, lambda: changes(steps, path.times))
    error = cq.NotConverged("stopped at step 2", history)
    for kept in (pickle.loads(pickle.dumps(error)).history, copy.deepcopy(error).history, copy.copy(history)):
        np.testing.assert_array_equal(kept[1].displacement, history[1].displacement)
        for look in (lambda kept=kept: kept[2], lambda kept=kept: kept.events):
            with pytest.raises(cq.NotCertified, match="step 2 is refused") as caught:
                look()
            assert caught.value.solution.certificate is not None


def test_the_associated_relaxation_takes_no_path() -> None:
    with pytest.raises(cq.Unsupported, match="associated"):
        cq.follow_path(klarbring(), loads=LOADS, steps=2, algorithm="associated")


def test_loads_that_are_none() -> None:
    with pytest.raises(cq.InvalidProblem, match="follow_path: loads: expected a sequence"):
        cq.follow_path(klarbring(), loads=None)


def test_dimensions_and_empty_problems(capfd: pytest.CaptureFixture[str]) -> None:
    data = dict(delassus=[[1.0, 2.0], [2.0, 5.0]], offset=[-7.0, -17.0], friction=0.3)
    assert cq.LocalProblem(**data, dimension=2.0).contacts == 1
    nothing = cq.LocalProblem(delassus=np.zeros((0, 0)), offset=[], friction=0.3, dimension=3)
    assert cq.solve(nothing, algorithm="admm").force.shape == (0, 3)
    assert capfd.readouterr() == ("", "")


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
