"""The limit of one linear solve: it is a solve, of bodies that float as well, and it takes time."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import contactqp as cq
from contactqp.study.collecting import linear_solve, linear_solve_seconds
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
