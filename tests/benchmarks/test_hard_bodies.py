"""The hard bodies, smaller: both sparse solvers give one certified answer on each."""

import numpy as np
import pytest

import contactqp as cq
from benchmarks import hard_bodies
from contactqp.linalg import pardiso, schur
from contactqp.linalg.condensation import condense
from contactqp.linalg.pardiso import available


@pytest.mark.slow
@pytest.mark.skipif(not available(), reason="needs pypardiso")
@pytest.mark.parametrize("variant", hard_bodies.VARIANTS)
def test_the_sparse_solver_makes_no_difference(monkeypatch, variant):
    problem = hard_bodies.VARIANTS[variant](1600)
    found = {}
    for solver in schur.SOLVERS:
        monkeypatch.setenv(pardiso.SOLVER_VARIABLE, solver)
        twin = problem.replace(stiffness=problem.stiffness)
        solution = found[solver] = cq.solve(twin)
        assert condense(twin).solver == solver
        assert solution.work.factorisations == 1
        assert solution.certificate.passed
        assert solution.certificate.force_error <= hard_bodies.LARGEST_ERROR
    one, other = found.values()
    assert np.max(abs(one.normal_force - other.normal_force)) <= 1e-14 * np.max(one.normal_force)
    assert np.max(abs(one.displacement - other.displacement)) <= 1e-14 * np.max(abs(one.displacement))
