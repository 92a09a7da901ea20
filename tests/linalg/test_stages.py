"""Time by stage: every instant belongs to one stage, work is counted where it is done, and nothing is noted unasked."""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

import contactqp as cq
from contactqp.model.arrays import BUILD, CERTIFY, CONDENSE, METHOD, POLISH, READ, stage, timed


def chain(unknowns: int = 30) -> cq.ContactProblem:
    """Springs in a row, held at one end, that meet a wall at the other."""
    K = [[2.0 * (i == j) - (abs(i - j) == 1) for j in range(unknowns)] for i in range(unknowns)]
    K[-1][-1] = 1.0
    end = [float(i == unknowns - 1) for i in range(unknowns)]
    return cq.ContactProblem(stiffness=K, load=end, normal=[end], gap=[unknowns / 2])


def test_an_instant_belongs_to_the_innermost_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("contactqp.model.arrays.time.perf_counter", lambda: now[0])
    with timed() as clock, stage(READ):
        now[0] += 2.0
        with stage(BUILD):
            now[0] += 4.0
        now[0] += 3.0
    assert clock.seconds[READ] == 5.0
    assert clock.seconds[BUILD] == 4.0


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
    solve, outside = cq.solve, []  # imported before the clock runs
    for _ in range(5):  # whatever else the machine does, it leaves one of them alone
        problem = chain()
        with timed() as clock:
            solution = solve(problem)
        assert {CONDENSE, METHOD, POLISH, CERTIFY} <= set(clock.seconds)
        assert (clock.factorisations, clock.back_substitutions) == (1, solution.work.back_substitutions)
        outside.append(clock.seconds[""] / solution.seconds)
    assert min(outside) < 0.5
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


@pytest.mark.slow
def test_scipy_imported_without_the_rest_of_numpy_has_all_of_it_when_asked() -> None:
    """In a process of its own: names and listing of NumPy are what they were, and SciPy's copy finds what it lacked."""
    code = """
import sys, numpy as np
from contactqp.linalg.runtime import import_scipy
names, listed, own = list(np.__all__), dir(np), {name for name in vars(np) if name.startswith("__")}
import_scipy(); import_scipy()
lean = "numpy.f2py" not in sys.modules or not hasattr(np, "__getattr__")
assert names == np.__all__ and set(listed) <= set(dir(np)) and own == {n for n in vars(np) if n.startswith("__")}
copy = next(module for name, module in sys.modules.items() if name.endswith("array_api_compat.numpy"))
assert copy.testing is np.testing and copy.ma is np.ma and copy.random is np.random
import scipy.stats, scipy.signal, scipy.optimize, scipy.sparse.linalg
print(lean, round(float(scipy.stats.norm.cdf(0.0)), 3), len(scipy.signal.get_window("hann", 4)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["True", "0.5", "4"], done.stderr
