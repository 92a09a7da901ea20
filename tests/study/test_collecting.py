"""The limit of one linear solve: it is a solve, of bodies that float as well, and it takes time."""

from __future__ import annotations

import pickle
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.study.collecting import UNUSUAL, Collector, Rounds, answer_key, linear_solve, linear_solve_seconds
from contactqp.study.rows import Row
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
