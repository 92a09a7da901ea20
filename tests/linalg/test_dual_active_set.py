"""The dual active-set method on many rows: an inverse that is updated, and an end where digits are missing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import least_norm, nonnegative
from contactqp.linalg.equilibration import equilibrated
from contactqp.linalg.extended import ExtendedAnswer
from contactqp.linalg.least_norm import by_corrections
from contactqp.linalg.nonnegative import (
    StrictProgram,
    by_strict_programs,
    dual_active_set,
    forces_without_tension,
    nonnegative_least_squares,
)
from contactqp.linalg.sparse_saddle import WASTED_AT_FIRST, ClosedState, Effort
from contactqp.solving.methods import Settings, find
from tests.linalg.test_crossover import plan


def unit_compliances(rows: np.ndarray) -> np.ndarray:
    """W of rows of length one on springs of one."""
    rows = rows / np.linalg.norm(rows, axis=1)[:, None]
    return rows @ rows.T


@pytest.mark.sampled(2)
@pytest.mark.parametrize("many", [5, 40, 200])
def test_an_inverse_that_is_updated_leads_to_the_same_forces(many: int, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(7)
    rows = random.normal(size=(120, 150))
    W = unit_compliances(rows - 1.2 * np.roll(rows, 1, axis=0))
    h, none = random.normal(size=120) + 0.5, np.zeros(120, dtype=bool)
    monkeypatch.setattr(nonnegative, "MANY", many)
    force, steps, ended = dual_active_set(W, h, none, np.full(120, 1e-12), 5000)
    assert ended
    assert steps > np.count_nonzero(force) > 40  # rows were dropped on the way
    assert np.all(force >= 0)
    left = h - W @ force
    assert np.max(left) <= 1e-11
    assert abs(left[force > 0]).max() <= 1e-11


def test_rows_that_repeat_replace_each_other_beside_an_inverse(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.repeat(np.random.default_rng(3).normal(size=(30, 40)), 2, axis=0)
    W = unit_compliances(rows)
    h = np.tile([1.0, 1.5], 30)
    monkeypatch.setattr(nonnegative, "MANY", 3)
    force, _, ended = dual_active_set(W, h, np.zeros(60, dtype=bool), np.full(60, 1e-12), 1000)
    assert ended
    assert np.all(force >= 0)
    assert np.max(h - W @ force) <= 1e-11


def test_it_ends_where_the_energy_rises_no_more() -> None:
    """Tenth differences of a sequence: the singular values of W go down to 1e-26."""
    size, order = 120, 10
    signs = [(-1.0) ** (order - k) * math.comb(order, k) for k in range(order + 1)]
    rows = sum(np.diag(np.full(size - abs(k), sign), k)[: size - order] for k, sign in enumerate(signs))
    i = np.arange(size)
    data = abs(i / size - 0.7) + 0.1 * np.sin(i + 1.0)
    h = -(rows @ data) / np.linalg.norm(rows, axis=1)
    none = np.zeros(len(h), dtype=bool)
    _, steps, ended = dual_active_set(unit_compliances(rows), h, none, np.full(len(h), 1e-12), 50_000)
    assert not ended
    assert steps < 2000


@pytest.mark.parametrize("shape", [(3, 0), (0, 3), (0, 0)])
def test_least_squares_of_empty_matrices_do_not_reach_scipy(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """SciPy 1.17 frees memory twice where there are no columns, and returns what memory held without rows."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError(shape)

    monkeypatch.setattr("scipy.optimize.nnls", never)
    share, residual = nonnegative_least_squares(np.zeros(shape), np.ones(shape[0]))
    assert share.tolist() == [0.0] * shape[1]
    assert residual == math.sqrt(shape[0])
    force, missing = forces_without_tension(np.zeros(shape[::-1]), np.ones(shape[0]), np.ones(shape[1], dtype=bool))
    assert force.tolist() == [0.0] * shape[1]
    assert missing == residual


def test_least_squares_without_negative_parts_in_closed_form() -> None:
    share, residual = nonnegative_least_squares(np.array([[1.0, 0.0], [0.0, 2.0]]), np.array([-3.0, 4.0]))
    assert share.tolist() == [0.0, 2.0]
    assert residual == 3.0


def strict(seed: int) -> tuple[StrictProgram, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A strictly convex program of integers with tied rows, of which one is a sum, and rows that repeat."""
    random = np.random.default_rng(seed)
    n = int(random.integers(3, 9))
    root, f = random.integers(-3, 4, (n, n)), random.integers(-9, 10, n).astype(float)
    rows = random.integers(-3, 4, (3 * n, n)).astype(float)
    rows[-1], rows[1] = 2.0 * rows[-2], np.eye(n)[0]
    rows = np.vstack([rows[:2], rows[0] + rows[1], rows[2:]])
    limit, tied = rows @ random.integers(-2, 3, n) + 0.0, np.arange(len(rows)) < 3
    limit += np.where(tied, 0.0, random.integers(0, 3, len(rows)))
    H = root @ root.T + np.eye(n)
    return StrictProgram(H, f, rows, limit, tied), H, f, rows, limit, tied


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(8))
def test_a_dual_active_set_in_factors_ends_at_the_minimum(seed: int) -> None:
    """Forces balance, push, and act on rows that are met; whatever rows it starts with, the point is the same."""
    program, H, f, rows, limit, tied = strict(seed)
    x = program.solve(np.zeros(0, dtype=int), 1e-12, iter(range(1000)))
    assert program.ended
    assert not program.conflicting
    assert np.all(rows @ x <= limit + 1e-10 * abs(rows) @ abs(x) + 1e-10)
    assert rows[tied] @ x == pytest.approx(limit[tied], abs=1e-10)
    assert rows[program.active] @ x == pytest.approx(limit[program.active], abs=1e-9)
    assert rows[program.active].T @ program.force == pytest.approx(f - H @ x, abs=1e-9)
    assert np.all(program.force[~tied[program.active]] >= -1e-12)
    begun = strict(seed)[0]
    start = np.flatnonzero(~tied)[::2]
    assert begun.solve(start, 1e-12, iter(range(1000))) == pytest.approx(x, abs=1e-9)


def test_rows_that_contradict_each_other_are_named() -> None:
    """x <= 1 and -x <= -2 cannot both be met: the second is left as it is, and y goes to its minimum."""
    rows, limit = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([1.0, -2.0])
    program = StrictProgram(np.eye(2), np.array([5.0, 3.0]), rows, limit, np.zeros(2, dtype=bool))
    x = program.solve(np.zeros(0, dtype=int), 1e-12, iter(range(100)))
    assert program.ended
    assert program.conflicting == {1}
    assert x == pytest.approx([1.0, 3.0])


def test_stiffness_beside_which_what_is_added_is_rounding_is_factorised() -> None:
    """Of three unknowns with one stiff sum only rounding was left for the pivots, and Cholesky's factors broke down."""
    stiffness, rows, limit = sp.csr_matrix(np.full((3, 3), 1e15)), sp.identity(3, format="csr"), [1.0, 1.0, -2.0]
    none, nothing = np.zeros(3, dtype=bool), np.zeros(0, dtype=int)
    given = stiffness, np.ones(3), rows, np.array(limit)
    program, x, _ = by_strict_programs(*given, none, nothing, 1e-3, iter(range(100)))
    assert program is not None
    assert x == pytest.approx(limit, abs=1e-12)


def test_corrections_in_dense_factors_wait_until_other_backends_have_been_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They took 6 s of 7 on the first answer of a program of 1169 unknowns, where that of the next held at once."""
    problem, x = plan(8, 160, 90)
    twin, _ = equilibrated(problem)
    found = find("clarabel").solve(twin, Settings(1e-9)).answer
    closed = found.normal_force > twin.gap - twin.normal @ found.displacement
    start, hasty = ClosedState.of(twin, closed, ExtendedAnswer.of(found)), Effort(wasted=WASTED_AT_FIRST)
    monkeypatch.setattr(least_norm, "AS_A_BACKEND", 1e6)
    assert by_corrections(start, hasty) is start
    assert hasty.cut  # so that they are made where no other backend helps
    assert by_corrections(start, Effort()).holds
    assert cq.solve(problem).energy == pytest.approx(problem.energy(x), rel=1e-12)
