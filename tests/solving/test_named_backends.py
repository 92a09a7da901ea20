"""A backend asked for by name: what is built round its answer loses none that it has found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import least_norm, sparse_saddle
from contactqp.linalg.extended import ExtendedAnswer
from contactqp.linalg.krylov import uncoupled
from contactqp.linalg.least_norm import presses
from contactqp.linalg.sparse_saddle import REGULARISATIONS, ClosedState, Effort, solved_on
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods import Settings, find
from contactqp.solving.sparse_run import SparseRun
from tests.solving.test_many_rows import nearest_with_differences


def degenerate(
    seed: int, stiff: bool, size: int, rows: int, ties: int, spread: int = 0
) -> tuple[cq.ContactProblem, float]:
    """A program at whose solution, drawn first, more constraints meet than it has unknowns, and its energy.

    Parameters
    ----------
    seed : int
    stiff : whether every unknown has some stiffness, of 2^-20 to 2^4, or three of ten alone
    size, rows, ties : int
    spread : unknowns have units of up to 10^spread
    """
    rng = np.random.default_rng(seed)
    x = np.where(rng.random(size) < 0.5 + 0.1 * stiff, 0.0, rng.integers(1, 9, size) / 4)
    A, G = (rng.integers(-3, 4, (some, size)) * (rng.random((some, size)) < 0.3) for some in (ties, rows))
    units = 10.0 ** rng.integers(-spread, spread + 1, size)
    K = 2.0 ** rng.integers(-20, 5, size) if stiff else (rng.random(size) < 0.3) * rng.integers(1, 5, size)
    tie, closed = rng.integers(-2, 3, ties).astype(float), rng.random(rows) < 0.5
    pushed = np.where(closed, rng.integers(0, 3, rows), 0.0)
    bound = np.where(x == 0, rng.integers(0, 3, size), 0.0)
    load = K * x + A.T @ tie + G.T @ pushed - bound
    limit = G @ x + np.where(closed, 0, rng.integers(1, 4, rows))
    problem = cq.ContactProblem.from_qp(
        sp.diags(units * K * units, format="csr"),
        -units * load,
        G=sp.csr_matrix(G * units),
        h=limit,
        A=sp.csr_matrix(A * units),
        b=A @ x,
        lb=np.zeros(size),
    )
    return problem, float(0.5 * x @ (K * x) - load @ x)


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "seed"), [("piqp", 3), ("piqp", 5), ("piqp", 11), ("clarabel", 5)])
def test_answers_that_condensed_systems_lose_are_settled_on_sparse_ones(backend: str, seed: int) -> None:
    pytest.importorskip(backend)
    problem, least = degenerate(seed, True, 60, 40, 20)
    solution = cq.solve(problem, backend)
    assert solution.certificate.proven
    assert solution.method == backend
    assert solution.energy == pytest.approx(least, rel=1e-12)
    refused, found = solution.work.routes
    assert "the certificate refuses the answer" in refused
    assert found == "sparse: its answer is certified"


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [1, 5])
def test_a_backend_that_stops_on_condensed_systems_is_shown_sparse_ones(seed: int) -> None:
    pytest.importorskip("highspy")
    problem, least = degenerate(seed, True, 20, 12, 6)
    solution = cq.solve(problem, "highs")
    assert solution.certificate.proven
    assert solution.energy == pytest.approx(least, rel=1e-12)
    if not solution.work.routes:
        pytest.skip("this version of HiGHS does not stop here")
    stopped, then = solution.work.routes
    assert stopped.startswith("highs: not solved")
    assert then == "sparse: its answer is certified"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "seed"), [("piqp", 19), ("piqp", 31), ("piqp", 52), ("clarabel", 4), ("clarabel", 16), ("clarabel", 18)]
)
def test_a_backend_is_asked_again_in_other_units_where_its_answer_leads_to_nothing(backend: str, seed: int) -> None:
    pytest.importorskip(backend)
    problem, least = degenerate(seed, False, 40, 20, 12, spread=3)
    solution = cq.solve(problem, backend)
    assert solution.certificate.proven
    assert solution.energy == pytest.approx(least, rel=1e-9)


def portfolio(size: int, seed: int = 0) -> cq.ContactProblem:
    """Shares with risks of 1e-8 to one of their own, a few factors that they load on, and a budget."""
    rng = np.random.default_rng(seed)
    rows = sp.csr_matrix(rng.normal(size=(6, size)) * (rng.random((6, size)) < 0.4))
    risk, start = 10.0 ** rng.uniform(-8, 0, size), rng.uniform(0.0, 1.0, size)
    tie = sp.vstack([rows, sp.csr_matrix(np.ones((1, size)))], format="csr")
    return cq.ContactProblem.from_qp(
        sp.diags(risk, format="csr"),
        rng.normal(size=size) * 1e-2,
        A=tie,
        b=tie @ start,
        lb=np.zeros(size),
        ub=np.full(size, 2.0),
    )


@pytest.mark.slow
def test_few_ties_of_unknowns_that_nothing_couples_take_no_sparse_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise AssertionError("a sparse factorisation of a diagonal stiffness with seven ties")

    monkeypatch.setattr(sparse_saddle, "factorised", none)
    problem = portfolio(3000)
    solution = cq.solve(problem, "clarabel")
    assert solution.certificate.proven
    assert solution.work.retained == problem.dimension


@pytest.mark.parametrize("rows", [0, 1, 5])
def test_the_saddle_point_of_a_diagonal_stiffness_is_that_of_dense_algebra(rows: int) -> None:
    rng = np.random.default_rng(rows)
    diagonal, R, d = rng.uniform(0.1, 1.0, 20), rng.normal(size=(rows, 20)), 1e-7
    solve = uncoupled(sp.diags(diagonal, format="csr"), sp.csr_matrix(R), d)
    assert solve is not None
    right = rng.normal(size=20 + rows)
    matrix = np.block([[np.diag(diagonal + d), R.T], [R, -d * np.eye(rows)]])
    assert solve(right) == pytest.approx(np.linalg.solve(matrix, right), rel=1e-9)


def test_unknowns_that_are_coupled_or_have_no_stiffness_get_sparse_factors() -> None:
    rows, coupled = sp.csr_matrix(np.ones((1, 2))), sp.csr_matrix([[2.0, -1.0], [-1.0, 2.0]])
    assert uncoupled(coupled, rows, 1e-7) is None
    assert uncoupled(sp.csr_matrix((2, 2)), rows, 1e-7) is None
    assert uncoupled(sp.identity(300, format="csr"), sp.identity(300, format="csr"), 1e-7) is None


def test_what_one_set_of_contacts_needs_on_the_diagonal_the_next_is_given_first() -> None:
    """A stiffness of 1e-8 is beneath the 1e-7 that is added first, and sweeps take that back too slowly."""
    stiffness = np.where(np.arange(40) < 4, 1e-8, 1.0)
    load, bounds, tie = stiffness * np.arange(40) / 10, sp.identity(40, format="csr"), np.ones((1, 40))
    problem = cq.ContactProblem(sp.diags(stiffness), load, bounds, np.full(40, 9.0), tie=tie, tie_value=[90.0])
    start, effort = ExtendedAnswer.of(Answer(np.zeros(40), np.zeros(40), None, np.zeros(1))), Effort()
    assert solved_on(problem, np.arange(40) == 0, start, effort).solved
    assert effort.factorisations > 1
    assert effort.first < REGULARISATIONS[0]
    first = effort.factorisations
    assert solved_on(problem, np.arange(40) == 1, start, effort).solved
    assert effort.factorisations == first + 1


def boundary_control(cells: int) -> cq.ContactProblem:
    """Control Poisson's equation by the values at the border, which all come to their upper bound."""
    h, nodes = 1.0 / cells, cells + 1
    second = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(nodes, nodes))
    one, line = sp.identity(nodes), np.linspace(0.0, 1.0, nodes)
    x, y = (values.ravel() for values in np.meshgrid(line, line, indexing="ij"))
    inside = (x > 0) & (x < 1) & (y > 0) & (y < 1)
    equations = sp.csr_matrix(sp.kron(second, one) + sp.kron(one, second))[inside]
    target = np.where(inside, 2.0 * h**2 * (x * (x - 1) + y * (y - 1)), 0.0)
    return cq.ContactProblem.from_qp(
        sp.diags(np.where(inside, h**2, 0.01 * h), format="csr"),
        -target,
        A=equations,
        b=np.zeros(equations.shape[0]),
        lb=np.where(inside, -0.4, -0.05),
        ub=np.where(inside, 0.371, 0.3),
    )


@pytest.mark.slow
def test_forces_that_are_unique_are_not_shared_anew_however_large_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Multipliers of the equations are thousands of times the load; a linear program over them took 12 s of 10 000."""
    pressed: list[bool] = []

    def noted(state: ClosedState) -> bool:
        pressed.append(presses(state))
        return pressed[-1]

    def none(*_: object) -> None:
        raise AssertionError("a linear program for forces that are unique")

    monkeypatch.setattr(least_norm, "presses", noted)
    monkeypatch.setattr(least_norm, "with_least_forces", none)
    solution = cq.solve(boundary_control(60))
    assert solution.certificate.proven
    assert pressed == [True]
    assert np.sum(solution.normal_force > 0) > 100


@pytest.mark.slow
def test_all_is_made_of_the_answer_of_a_backend_that_stopped_early() -> None:
    """Its guess of the closed contacts leads nowhere; Newton's steps along the central path from it lead on."""
    problem, _ = nearest_with_differences(400, 2, 0.7)
    clarabel = find("clarabel")

    def stopped(shown: cq.ContactProblem, settings: Settings) -> Candidate:
        found = clarabel.solve(shown, replace(settings, tolerance=1e-2))
        return replace(found, claimed=False, status="clarabel: AlmostSolved")

    solution = SparseRun(problem, replace(clarabel, solve=stopped), Settings()).finish()
    assert solution.certificate.proven
    assert solution.displacement == pytest.approx(cq.solve(problem).displacement, abs=1e-12)
