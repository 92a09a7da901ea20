"""The route through cvxpy: signs of its dual values, its solvers, its failures."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.errors import BackendFailed, BackendMissing, InvalidProblem, Unsupported
from contactqp.model.problem import ContactProblem
from contactqp.solving.methods.cvxpy_models import METHODS, solve_modelled
from contactqp.solving.methods.method import Settings
from tests.solving.methods.static_examples import EXAMPLES, TWO_BARS, Example, require_answer

PERMISSIVE = ("CLARABEL", "OSQP", "SCS", "PIQP", "PROXQP", "HIGHS", "DAQP", "QPALM")
SOLVERS = [name for name in PERMISSIVE if name in cp.installed_solvers()]
RAW = 1e-5


def example(name: str) -> Example:
    return next(example for example in EXAMPLES if example.name == name)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
@pytest.mark.parametrize("form", [np.asarray, sp.csc_array], ids=["dense", "sparse"])
def test_signs_and_values(example: Example, form: object) -> None:
    candidate = solve_modelled(example.problem.replace(stiffness=form(example.problem.stiffness)), Settings())
    assert candidate.claimed, candidate.status
    require_answer(example, candidate, RAW)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("name", ["2.13", "tied and touching"])
def test_every_solver_has_the_same_signs(solver: str, name: str) -> None:
    candidate = solve_modelled(example(name).problem, Settings(options={"solver": solver.lower()}))
    require_answer(example(name), candidate, RAW)
    assert solver in candidate.status


def test_a_stiffness_that_rounding_makes_indefinite_is_taken() -> None:
    # Rank one, with an eigenvalue of -1e-17 or so that cvxpy's own test may refuse.
    row = np.array([1.0, -1 / 3, 1 / 7])
    problem = ContactProblem(np.outer(row, row), row, np.eye(3), np.full(3, 0.1))
    assert solve_modelled(problem, Settings()).claimed


def test_solvers_that_are_not_there() -> None:
    with pytest.raises(Unsupported, match="no solver is called 'simplex'"):
        solve_modelled(TWO_BARS, Settings(options={"solver": "simplex"}))
    with pytest.raises(InvalidProblem, match="expected a name"):
        solve_modelled(TWO_BARS, Settings(options={"solver": 3}))
    missing = next(name for name in ("XPRESS", "MOSEK", "CPLEX", "COPT") if name not in cp.installed_solvers())
    with pytest.raises(BackendMissing, match="not installed"):
        solve_modelled(TWO_BARS, Settings(options={"solver": missing}))


def test_a_solver_that_cannot_do_quadratic_programs_fails_in_our_words() -> None:
    with pytest.raises(BackendFailed, match="SCIPY"):
        solve_modelled(TWO_BARS, Settings(options={"solver": "scipy"}))
    with pytest.raises(Unsupported, match="limits of time"):
        solve_modelled(TWO_BARS, Settings(time_limit=1.0, options={"solver": "scipy"}))


def test_infeasible_is_backend_failed_with_cvxpys_word() -> None:
    apart = ContactProblem([[1.0]], [0.0], [[1.0], [-1.0]], [-1.0, -1.0])
    with pytest.raises(BackendFailed, match="infeasible"):
        solve_modelled(apart, Settings())


def test_stopped_early_is_not_claimed() -> None:
    candidate = solve_modelled(TWO_BARS, Settings(max_iter=1, options={"solver": "OSQP"}))
    assert not candidate.claimed
    assert "OSQP" in candidate.status


def test_the_registry_entry() -> None:
    (method,) = METHODS
    assert (method.name, method.options, method.packages) == ("cvxpy", ("solver",), ("cvxpy",))
