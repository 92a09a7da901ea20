"""Time by stage: every instant belongs to one stage, work is counted where it is done, and nothing is noted unasked."""

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

import contactqp as cq
from contactqp.linalg.runtime import BUILD, CERTIFY, CONDENSE, METHOD, POLISH, READ, stage, timed


def chain(unknowns: int = 30) -> cq.ContactProblem:
    """Springs in a row, held at one end, that meet a wall at the other."""
    K = [[2.0 * (i == j) - (abs(i - j) == 1) for j in range(unknowns)] for i in range(unknowns)]
    K[-1][-1] = 1.0
    end = [float(i == unknowns - 1) for i in range(unknowns)]
    return cq.ContactProblem(stiffness=K, load=end, normal=[end], gap=[unknowns / 2])


def test_an_instant_belongs_to_the_innermost_stage():
    with timed() as clock, stage(READ):
        time.sleep(0.02)
        with stage(BUILD):
            time.sleep(0.04)
        time.sleep(0.02)
    assert clock.seconds[READ] == pytest.approx(0.04, abs=0.015)
    assert clock.seconds[BUILD] == pytest.approx(0.04, abs=0.015)


def test_a_stage_that_fails_is_left():
    with timed() as clock:
        with pytest.raises(ValueError, match="no"), stage(READ):
            raise ValueError("no")
        time.sleep(0.01)
    assert clock.seconds[""] >= 0.01


def test_nothing_is_noted_unasked_or_by_other_threads():
    with stage(READ):
        assert cq.solve(chain()).work.back_substitutions > 0
    with timed() as clock, ThreadPoolExecutor(1) as pool:
        assert pool.submit(cq.solve, chain()).result().work.back_substitutions > 0
    assert clock.half_substitutions == 0
    assert set(clock.seconds) == {""}


def test_solving_passes_through_the_stages_once_and_counts_what_the_solution_says():
    problem, solve = chain(), cq.solve  # imported before the clock runs
    with timed() as clock:
        solution = solve(problem)
    assert {CONDENSE, METHOD, POLISH, CERTIFY} <= set(clock.seconds)
    assert clock.seconds[""] < 0.5 * solution.seconds
    assert (clock.factorisations, clock.back_substitutions) == (1, solution.work.back_substitutions)
    with timed() as again:
        solve(problem.replace(load=2 * problem.load))
    assert again.factorisations == 0
    assert CONDENSE not in again.seconds


def test_a_path_costs_one_factorisation():
    problem = chain()
    with timed() as clock:
        history = cq.follow_path(problem, [problem.load * 2], steps=5)
        assert all(solution.certificate.passed for solution in history)
    assert clock.factorisations == 1
    assert clock.back_substitutions >= len(history)
