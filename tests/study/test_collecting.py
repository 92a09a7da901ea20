"""The limit of one linear solve: it is a solve, of bodies that float as well, and it takes time."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

import contactqp as cq
from benchmarks.report_twice import misses
from contactqp.study import collecting
from contactqp.study.collecting import (
    UNUSUAL,
    Collector,
    FoundTruth,
    LinearSolve,
    Rounds,
    answer_key,
    linear_solve,
    linear_solve_seconds,
)
from contactqp.study.comparison import Timing
from contactqp.study.reporting import BRIEF_ROUNDS
from contactqp.study.rows import Row
from contactqp.study.running.runner import Progress
from contactqp.study.settings import single_settings
from contactqp.study.statistics import BODY
from tests.examples import two_bars


def test_the_bodies_are_solved_without_contact() -> None:
    solve = linear_solve(two_bars())
    assert solve is not None
    # K = diag(157500, 315000) kN/m under 300 kN at the first tip
    assert solve() == pytest.approx([300 / 157500, 0.0], rel=1e-14)


def test_what_floats_is_held() -> None:
    K = np.array([[2.0, -2.0], [-2.0, 2.0]])
    floating = cq.ContactProblem(stiffness=K, load=[-1.0, -1.0], normal=[[-1.0, 0.0]], gap=[0.5])
    solve = linear_solve(floating)
    assert solve is not None
    assert solve() == pytest.approx([-0.5])  # one of the two is held
    assert linear_solve_seconds(floating) is not None


def test_nothing_elastic_has_no_limit() -> None:
    masses = cq.ContactProblem(stiffness=np.zeros((1, 1)), load=[-1.0], normal=[[-1.0]], gap=[0.0])
    assert linear_solve_seconds(masses) is None


@pytest.mark.sampled(2)
@pytest.mark.parametrize("size", [3, 600, 2100])
def test_every_sparse_solver_solves_and_is_timed(size: int) -> None:
    from scipy.sparse import diags

    chain = diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(size, size), format="csc")
    row = np.zeros((1, size))
    row[0, 0] = -1.0
    problem = cq.ContactProblem(stiffness=chain, load=np.ones(size), normal=row, gap=[0.0])
    solve = linear_solve(problem)
    assert solve is not None
    assert chain @ solve() == pytest.approx(np.ones(size), abs=1e-8)
    seconds = linear_solve_seconds(problem)
    assert seconds is not None
    assert 0 < seconds < 5


def test_another_process_can_be_sent_it() -> None:
    assert pickle.loads(pickle.dumps(linear_solve_seconds)) is linear_solve_seconds


def test_the_smallest_body_is_timed_first_and_then_the_largest() -> None:
    """What the large ones take is known early then, and with it the time that is left; the bar is timed last."""
    settings = [next(single_settings(two_bars(), method)) for method in cq.methods() if method.name in FIRSTS]
    studies: list[Any] = [
        SimpleNamespace(
            name=name, problem=SimpleNamespace(dimension=size), settings=settings, digest=name, scene=SimpleNamespace()
        )
        for name, size in (("large", 9 * BODY), ("middle", 3 * BODY), ("small", BODY), ("bar", 2))
    ]
    nothing: Any = SimpleNamespace()
    collector = Collector(studies, nothing, nothing, nothing, Rounds(1, 1.0), 1.0)
    for study in studies:
        for setting in settings:
            collector._found[answer_key(study, setting)] = Row(seconds=FIRSTS[setting.method.name])
    cells = list(collector._timing_cells(studies))
    assert list(dict.fromkeys(cell.key.partition("/")[0] for cell in cells)) == ["small", "large", "middle", "bar"]
    costs = {
        cell.key.split("/")[1]: cell.cost for cell in cells if cell.key.startswith("large/") and "time" in cell.key
    }
    assert costs["active-set"] == pytest.approx(0.1 * 1.1, abs=0.02)
    assert costs["cvxpy"] == pytest.approx(UNUSUAL * 0.1 * 1.1, abs=0.02)  # its first call loaded packages


# Seconds of first calls.
FIRSTS = {"active-set": 0.1, "lemke": 0.1, "master-slave": 0.1, "cvxpy": 5.0}


class Taken(NamedTuple):
    """What the cells of a case took in a report that was recorded: mean seconds of each kind."""

    unknowns: int
    settings: int  # tried
    timed: int  # that have an answer
    truth: float
    record: float
    answer: float  # the cell of an answer
    first: float  # the first call in it
    timing: float  # the cell of a round
    solves: float


# Reports on two cores of a shared machine, whose load stayed at 2, rose from 2 to 4, and rose from 3 to 9; the second
# in one process. By case, and in the order in which cells ran.
RECORDED = {
    "two processes": (
        2,
        1.9,
        dict(
            hertz_40000=Taken(40833, 25, 20, 2.9, 3.67, 0.599, 0.434, 0.215, 0.662),
            hertz_8000=Taken(8321, 67, 59, 2.5, 2.76, 0.165, 0.103, 0.0533, 0.227),
            hertz_1000=Taken(1045, 78, 70, 0.07, 1.25, 0.0718, 0.0508, 0.0348, 0.0541),
            string_over_floor=Taken(7, 67, 63, 0.024, 1.53, 0.0127, 0.0043, 0.0066, 0.004),
            truss_floor=Taken(2, 67, 63, 0.12, 1.25, 0.0116, 0.0037, 0.0071, 0.0045),
            bar_wall=Taken(1, 67, 63, 0.013, 0.37, 0.0146, 0.0039, 0.0056, 0.0044),
        ),
    ),
    "one process": (
        1,
        2.9,
        dict(
            hertz_40000=Taken(40833, 25, 20, 1.3, 1.55, 0.411, 0.322, 0.340, 0.870),
            hertz_8000=Taken(8321, 67, 59, 0.08, 0.89, 0.104, 0.0685, 0.105, 0.355),
            hertz_1000=Taken(1045, 78, 70, 0.03, 0.45, 0.0803, 0.052, 0.0625, 0.121),
            string_over_floor=Taken(7, 67, 63, 0.008, 0.6, 0.0144, 0.005, 0.0087, 0.0069),
            truss_floor=Taken(2, 67, 63, 0.03, 0.67, 0.0206, 0.0072, 0.0128, 0.0089),
            bar_wall=Taken(1, 67, 63, 0.004, 0.16, 0.0106, 0.0025, 0.0065, 0.0026),
        ),
    ),
    "two processes beside others": (
        2,
        7.2,
        dict(
            hertz_40000=Taken(40833, 25, 20, 6.1, 9.07, 1.66, 1.27, 0.578, 1.39),
            hertz_8000=Taken(8321, 67, 59, 5.2, 6.3, 0.439, 0.25, 0.102, 0.362),
            hertz_1000=Taken(1045, 78, 70, 0.15, 3.72, 0.244, 0.138, 0.0786, 0.143),
            string_over_floor=Taken(7, 67, 63, 0.04, 4.75, 0.0403, 0.0107, 0.0079, 0.008),
            truss_floor=Taken(2, 67, 63, 0.24, 3.89, 0.0216, 0.0063, 0.0093, 0.0025),
            bar_wall=Taken(1, 67, 63, 0.012, 1.01, 0.0442, 0.0125, 0.0106, 0.0029),
        ),
    ),
}


class _Replayed:
    """Runs cells by the clock alone: each takes what those of its kind took when they were recorded."""

    def __init__(self, jobs: int, footprint: float, taken: dict[str, Taken]) -> None:
        self.now, self._jobs, self._footprint, self._taken = 0.0, jobs, footprint, taken
        self._answers = dict.fromkeys(taken, 0)

    @contextmanager
    def _pool(self, size: int) -> Iterator[Any]:
        yield SimpleNamespace(size=size, start=self._start(size), deaths=())

    def side_by_side(self) -> Any:
        return self._pool(self._jobs)

    def alone(self) -> Any:
        return self._pool(1)

    def _start(self, size: int) -> Callable[..., Future[Any]]:
        def start(function: Callable[..., Any], arguments: tuple[Any, ...], _: float) -> Future[Any]:
            seconds, result = self._result(function, arguments[0].name)
            self.now += seconds / size
            future: Future[Any] = Future()
            future.set_result(result)
            return future

        return start

    def _result(self, function: Callable[..., Any], case: str) -> tuple[float, Any]:
        taken = self._taken[case]
        if function is collecting.find_answer:
            self._answers[case] += 1
            answered = self._answers[case] <= taken.timed
            return taken.answer, Row(seconds=taken.first if answered else None)
        return {
            collecting.find_truth: (taken.truth, FoundTruth("its exact values")),
            collecting.make_record: (taken.record, SimpleNamespace()),
            collecting.take_footprint: (self._footprint, SimpleNamespace()),
            collecting.time_linear_solve: (taken.solves, LinearSolve(0.1)),
            collecting.take_time: (taken.timing, Timing((0.1,))),
        }[function]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("recorded", RECORDED)
def test_the_time_that_is_left_is_right_within_a_third_after_the_first_fifth(
    recorded: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """First calls beside others take twice as long as timed ones alone: a report of 37 s said 40 s left after 11."""
    jobs, footprint, taken = RECORDED[recorded]
    workers: Any = _Replayed(jobs, footprint, taken)
    monkeypatch.setattr("contactqp.study.running.runner.time.monotonic", lambda: workers.now)
    shown: list[tuple[float, str]] = []
    progress = Progress(
        lambda what, done, total, left: shown.append((workers.now, f"{what}: {done} of {total}, {left}"))
    )
    journal: Any = SimpleNamespace(find=lambda _: None, write=lambda _, result: result, changed=lambda _: ())
    collector = Collector(
        [_study(name, taken[name]) for name in taken], workers, journal, progress, BRIEF_ROUNDS, 1.0, True
    )
    collector.collect()
    assert len(shown) > 800
    assert not list(misses(shown, workers.now + collecting.FILES))


def _study(name: str, taken: Taken) -> Any:
    settings = [
        SimpleNamespace(method=SimpleNamespace(name=f"method {i}"), variant="", options={}, knob="")
        for i in range(taken.settings)
    ]
    problem = SimpleNamespace(dimension=taken.unknowns)
    return SimpleNamespace(
        name=name, problem=problem, settings=settings, digest=name, scene=SimpleNamespace(file=f"{name}.toml")
    )
