"""Fractions found near an approximation: the simplest ones, proven in integers, never taken for proven when wrong."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.oracle.exact.reconstructed_answer import Column, guessed, reconstruct, simplest, solves
from contactqp.oracle.exact.refinement import Fixed, refine
from contactqp.testing import problem as gallery


@pytest.mark.slow
@pytest.mark.parametrize("name", ["large-1", "large-5"])
def test_membranes_that_graze_are_decided_in_fractions(name: str) -> None:
    known = gallery(name)
    answer = cq.exact(known.problem)
    assert answer.rational
    assert answer.way == "iterative refinement, and the fractions nearest to it"
    assert answer.displacement.tolist() == list(known.exact.displacement)
    assert answer.normal_force.tolist() == list(known.exact.normal_force)
    assert answer.contact_status.count("grazing") == {"large-1": 4, "large-5": 12}[name]
    assert answer.gap.tolist() == list(known.exact.gap)
    u = [F(x) for x in answer.displacement]
    load = [F(float(x)) for x in known.problem.load]
    stiffness = sp.coo_matrix(known.problem.stiffness)
    entries = zip(stiffness.row.tolist(), stiffness.col.tolist(), stiffness.data.tolist(), strict=True)
    strained = sum((F(x) * u[i] * u[j] for i, j, x in entries), F(0))
    assert answer.energy == strained / 2 - sum(x * y for x, y in zip(load, u, strict=True))


def test_the_simplest_fraction_of_an_interval() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        low, high = sorted(
            F(int(x), int(y)) for x, y in zip(rng.integers(-99, 99, 2), rng.integers(1, 99, 2), strict=True)
        )
        least = next(q for q in range(1, 10**4) if -((-low * q).__floor__()) <= high * q)
        found = simplest(low, high)
        assert low <= found <= high
        assert found.denominator == least


def test_numbers_of_large_denominators_are_not_guessed() -> None:
    rng = np.random.default_rng(1)
    digits = np.array([int.from_bytes(rng.bytes(45), "big") for _ in range(3)], dtype=object)
    assert guessed(Fixed(digits, 360)) is None
    nothing = guessed(Fixed(np.zeros(2, dtype=object), 0))
    assert nothing is not None
    assert nothing.fractions().tolist() == [0, 0]


@pytest.mark.parametrize("part", ["displacement", "normal_force", "tie_force"])
def test_no_number_may_be_another(part: str) -> None:
    problem = cq.ContactProblem(
        np.diag([2.0, 3.0, 5.0]), [3.0, 1.0, 7.0], np.eye(3), [0.5, 4.0, 0.25], tie=[[0.0, 1.0, 1.0]], tie_value=[0.5]
    )
    answer = reconstruct(refine(problem))
    assert answer is not None
    assert answer.normal_force.fractions().tolist() == [2, 0, F(11, 2)]
    column = getattr(answer, part)
    for i in range(len(column.integers)):
        for change in (-1, 1):
            integers = column.integers << 200
            integers[i] += change
            assert not solves(problem, replace(answer, **{part: Column(integers, column.denominator << 200)}))


def test_a_pull_and_an_overlap_that_balance_are_refused() -> None:
    bar = cq.ContactProblem([[2.0]], [1.0], [[1.0]], [1.0])
    answer = reconstruct(refine(bar))
    assert answer is not None
    one, half, nothing = (Column(np.array([x], dtype=object), q) for x, q in ((1, 1), (1, 2), (0, 1)))
    assert solves(bar, replace(answer, displacement=half, normal_force=nothing))
    pulled = Column(np.array([-1], dtype=object), 1)
    assert not solves(bar, replace(answer, displacement=one, normal_force=pulled))  # K u + l = 2 - 1 = 1, gap 0
    near = cq.ContactProblem([[2.0]], [1.0], [[1.0]], [0.25])
    assert not solves(near, replace(answer, displacement=half, normal_force=nothing))
    pushed_from_afar = cq.ContactProblem([[2.0]], [1.0], [[1.0]], [3.0])
    back = Column(np.array([-1], dtype=object), 1)
    assert not solves(pushed_from_afar, replace(answer, displacement=back, normal_force=Column(one.integers * 3, 1)))


@pytest.mark.slow
def test_forces_that_are_not_the_only_ones_are_not_called_so() -> None:
    """One stop of a grazing membrane twice: proven fractions, but there are others beside them."""
    known = gallery("large-1").problem
    closed = int(np.argmax(gallery("large-1").exact.normal_force))
    normal = sp.vstack([known.normal, known.normal[[closed]]]).tocsr()
    twice = cq.ContactProblem(known.stiffness, known.load, normal, np.append(known.gap, known.gap[closed]))
    with pytest.raises(cq.NotCertified):
        cq.exact(twice)
