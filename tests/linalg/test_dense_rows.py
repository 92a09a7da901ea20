"""Constraints between all unknowns are multiplied as dense matrices; loops took 20 to 50 times as long."""

from __future__ import annotations

import time
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.dense import Delassus
from contactqp.linalg.runtime import dense_product, is_nearly_dense
from contactqp.solving.methods.complementarity import complementarity_problem, compliance
from contactqp.solving.methods.textbook_algebra import springs


def dense(n: int, density: float = 1.0, seed: int = 1) -> cq.ContactProblem:
    """Integers of three digits: products of two are exact, and so are their sums."""
    random = np.random.default_rng(seed)
    E = random.integers(-99, 100, (n, n)) * (random.random((n, n)) <= density)
    np.fill_diagonal(E, 100)
    return cq.ContactProblem(16.0 * np.eye(n), np.ones(n), E.astype(float), np.ones(n))


@pytest.mark.parametrize("density", [1.0, 0.2, 0.02])
@pytest.mark.parametrize("n", [3, 60, 150])
def test_products_are_the_exact_ones(n: int, density: float) -> None:
    problem, closed = dense(n, density), np.arange(n) % 3 > 0
    E = problem.normal.toarray()
    exact = [[sum(Fraction(row[k]) * Fraction(column[k]) for k in range(n)) for column in E] for row in E[:3]]
    assert dense_product(problem.normal, E.T)[:3].tolist() == exact
    K, load = springs(problem, closed, np.full(n, 4.0))
    whole = E.astype(int)[closed]
    assert np.array_equal(K, np.asarray(16 * np.eye(n) + 4.0 * (whole.T @ whole).astype(float)))
    assert np.array_equal(load, 1 + 4.0 * whole.sum(axis=0).astype(float))
    W = Delassus(Condensation(problem))
    size = np.sqrt(np.diag(E @ E.T))
    assert W.W * np.outer(size, size) == pytest.approx(E @ E.T, rel=1e-12, abs=1e-12 * np.max(size) ** 2)


def test_few_entries_are_multiplied_one_by_one() -> None:
    assert is_nearly_dense(dense(40).normal)
    assert not is_nearly_dense(sp.identity(40, format="csr"))


def seconds(call: Callable[[], Any]) -> float:
    """Return the least time of the processor that three calls took."""
    taken = []
    for _ in range(3):
        began = time.process_time()
        call()
        taken.append(time.process_time() - began)
    return min(taken)


def test_dense_rows_cost_what_blas_takes() -> None:
    """Springs take 1.3 products of this size and the complementarity problem 3.6; by loops they took 54 and 26."""
    problem = dense(700)
    E, every = problem.normal.toarray(), np.ones(700, dtype=bool)
    reduced = compliance("lemke", problem)
    product = seconds(lambda: E @ reduced.response)
    assert seconds(lambda: springs(problem, every, np.full(700, 4.0))) < 12 * product
    assert seconds(lambda: complementarity_problem(problem, reduced)) < 12 * product
