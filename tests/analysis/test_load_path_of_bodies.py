"""A load path of 100 steps on one body makes one factorisation, counted where the factors are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse.linalg as spla

import contactqp as cq
from benchmarks.load_path import price
from benchmarks.price_of_contact import block, fresh
from contactqp.linalg import pardiso, schur
from contactqp.linalg.condensation import condense

STEPS = 100


@pytest.fixture(params=["superlu", "pardiso"])
def made(request, monkeypatch):
    """The sizes of the sparse matrices that were factorised, in order."""
    sizes = []
    monkeypatch.setenv(schur.CHOICE, request.param)
    if request.param == "pardiso":
        pytest.importorskip("pypardiso")
        factorise = pardiso.Pardiso.__init__

        def counted(self, matrix, retained):
            sizes.append(matrix.shape[0] - len(retained))
            factorise(self, matrix, retained)

        monkeypatch.setattr(pardiso.Pardiso, "__init__", counted)
    else:
        splu = spla.splu

        def counted_splu(matrix, **options):
            sizes.append(matrix.shape[0])
            return splu(matrix, **options)

        monkeypatch.setattr(spla, "splu", counted_splu)
    return sizes


@pytest.mark.sampled(4)
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_path_of_100_steps_makes_one_factorisation(dimension, made):
    problem = block(500, dimension)
    history = cq.follow_path(problem, [problem.load], steps=STEPS)
    assert len(history) == STEPS + 1
    assert len(made) == 1
    assert [solution.work.factorisations for solution in history] == [1] + STEPS * [0]
    assert all(solution.certificate.passed and solution.certificate.proven for solution in history)
    closed = (history.normal_forces > 0).sum(axis=1)
    assert closed[0] < closed[STEPS // 2] < closed[-1], "the contact grows along the path"
    alone = cq.solve(fresh(problem)).normal_force
    np.testing.assert_allclose(history[-1].normal_force, alone, rtol=0, atol=1e-12 * alone.max())


def test_steps_on_fresh_problems_are_seen_to_factorise_each_time(made):
    problem = block(500, 2)
    for fraction in (0.2, 0.4, 0.6):
        cq.solve(fresh(problem).replace(load=fraction * problem.load))
    assert len(made) == 3


def test_only_what_is_looked_at_is_expanded():
    """Two corners are reduced; the start is solved, and one step among a hundred polished and certified."""
    problem = block(500, 2)
    history = cq.follow_path(problem, [problem.load], steps=STEPS)
    spent = condense(problem).back_substitutions
    looked = history[STEPS // 2]
    assert looked.certificate.proven
    after = condense(problem).back_substitutions
    assert spent < STEPS // 2
    assert 0 < after - spent <= 6
    assert history[STEPS // 2] is looked
    assert condense(problem).back_substitutions == after


def test_the_benchmark_judges_the_further_step():
    found = price(block(500, 2), steps=3, rounds=1)
    assert found.factorisations == 1
    assert replace(found, first=1.0, step=0.049).met
    assert not replace(found, first=1.0, step=0.051).met
