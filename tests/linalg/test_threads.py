"""Problems that share a factorisation may be solved from several threads, and BLAS gets its threads back."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import threadpoolctl

import contactqp as cq
from contactqp.model import arrays
from tests.blocks_in_space import on_paraboloid


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["pardiso", "superlu"])
def test_loads_of_one_body_in_threads(solver, monkeypatch):
    monkeypatch.setenv("CONTACTQP_SPARSE_SOLVER", solver)
    if solver == "pardiso":
        pytest.importorskip("pypardiso")
    base = on_paraboloid((8, 8, 5))
    loads = [base.replace(load=(0.5 + 0.05 * k) * base.load) for k in range(10)]
    expected = [cq.solve(problem.replace(stiffness=problem.stiffness)) for problem in loads]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(cq.solve, loads))
    for one, other in zip(found, expected, strict=True):
        assert one.certificate.proven
        np.testing.assert_allclose(one.normal_force, other.normal_force, rtol=0, atol=1e-15 * other.normal_force.max())
    assert sum(solution.work.factorisations for solution in found) == 1


def test_limits_that_overlap_are_lifted_by_the_last(monkeypatch):
    monkeypatch.setattr(arrays, "WORTHWHILE", 1)
    problem = cq.ContactProblem(stiffness=[[2.0]], load=[1.0], normal=[[1.0]], gap=[0.1])

    def counts() -> list[int]:
        return [library["num_threads"] for library in arrays._openblas().info()]

    with threadpoolctl.threadpool_limits(2, "blas"):
        before = counts()
        first, second = arrays.one_blas_thread(problem), arrays.one_blas_thread(problem)
        first.__enter__(), second.__enter__()
        assert set(counts()) <= {1}
        first.__exit__(None, None, None)
        assert set(counts()) <= {1}
        second.__exit__(None, None, None)
        assert counts() == before


def test_copies_are_problems_without_what_was_computed():
    problem = cq.ContactProblem(stiffness=[[2.0]], load=[1.0], normal=[[1.0]], gap=[0.1])
    force = cq.solve(problem).normal_force
    for twin in (copy.deepcopy(problem), pickle.loads(pickle.dumps(problem))):
        assert cq.solve(twin).normal_force == force


@pytest.mark.slow
def test_paths_of_one_body_in_threads():
    base = on_paraboloid((6, 6, 4))
    expected = cq.follow_path(base.replace(stiffness=base.stiffness), [base.load], steps=3).normal_forces
    with ThreadPoolExecutor(3) as pool:
        histories = list(pool.map(lambda _: cq.follow_path(base, [base.load], steps=3), range(6)))
        forces = list(pool.map(lambda history: history.normal_forces, histories))
    for found in forces:
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15 * expected.max())


@pytest.mark.sampled(2)
@pytest.mark.parametrize("ask", ["solve", "certify", "follow_path", "impact"])
def test_dense_systems_of_contacts_have_one_thread_on_a_small_body_too(ask: str, monkeypatch) -> None:
    """On a membrane of 737 unknowns with 217 contacts two threads of BLAS spun; the body was thought too small."""
    m = arrays.WORTHWHILE + 8
    chain = 2 * np.eye(m) - np.eye(m, k=1) - np.eye(m, k=-1)
    problem = cq.ContactProblem(stiffness=chain, load=np.ones(m), normal=np.eye(m), gap=np.linspace(0.1, 500.0, m))
    rest, seen = np.zeros(m), set()
    solution = cq.solve(problem)

    def cholesky(*args, **options):
        seen.update(library["num_threads"] for library in arrays._openblas().info())
        return original(*args, **options)

    from contactqp.linalg import factorization

    original = factorization.DenseCholesky.__init__
    monkeypatch.setattr(factorization.DenseCholesky, "__init__", cholesky)
    fresh = problem.replace(stiffness=chain)
    with threadpoolctl.threadpool_limits(2, "blas"):
        {
            "solve": lambda: cq.solve(fresh),
            "certify": lambda: cq.certify(fresh, solution.displacement, solution.normal_force),
            "follow_path": lambda: cq.follow_path(fresh, [fresh.load], steps=2),
            "impact": lambda: cq.impact(fresh, np.eye(m), rest, rest, 0.02, 0.01),
        }[ask]()
    assert seen == {1}


def test_a_dense_stiffness_is_judged_on_one_thread(monkeypatch) -> None:
    """Two threads made reading a hundred unknowns 28 times slower beside other work."""
    m, seen = arrays.WORTHWHILE + 8, set()
    original = np.linalg.cholesky

    def factors(matrix):
        seen.update(library["num_threads"] for library in arrays._openblas().info())
        return original(matrix)

    monkeypatch.setattr(np.linalg, "cholesky", factors)
    chain = 2 * np.eye(m) - np.eye(m, k=1) - np.eye(m, k=-1)
    with threadpoolctl.threadpool_limits(2, "blas"):
        cq.ContactProblem(stiffness=chain, load=np.ones(m), normal=np.eye(m), gap=np.ones(m))
        cq.LocalProblem(delassus=chain, offset=np.ones(m), friction=0.3, dimension=2)
    assert seen == {1}
