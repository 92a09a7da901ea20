"""Residuals by slices have digits beyond double precision; products by threads and steps of GMRES are what they say."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.errors import BackendFailed, Unsupported
from contactqp.linalg import pardiso
from contactqp.linalg.influence import SlicedStiffness
from contactqp.linalg.krylov import flexible_gmres
from contactqp.linalg.measures import lengths, sizes_of
from contactqp.linalg.pardiso import products

needs_pardiso = pytest.mark.skipif(not pardiso.available(), reason="needs pypardiso")


@pytest.mark.sampled(2)
@pytest.mark.parametrize("unit", [1.0, 1e-20, 3e15])
def test_residuals_are_those_of_rationals(unit: float) -> None:
    rng = np.random.default_rng(3)
    shape = np.where(rng.random((30, 30)) < 0.2, rng.standard_normal((30, 30)), 0.0)
    scale = 10.0 ** rng.uniform(-3, 3, 30) * unit
    K = scale[:, None] * (shape @ shape.T + np.eye(30)) * scale
    x = rng.standard_normal((30, 3)) / scale[:, None] * [1.0, 1e-12, 1e7]
    right = np.column_stack([K @ column for column in x.T])  # but for rounding, which is what is left
    sliced = SlicedStiffness(sp.csr_array(K), 1 / np.sqrt(K.diagonal()))
    found = sliced.residual(right, x)
    for j in range(3):
        true = [
            float(Fraction(right[i, j]) - sum(Fraction(K[i, k]) * Fraction(x[k, j]) for k in range(30)))
            for i in range(30)
        ]
        size = np.sqrt(K.diagonal()) * np.max(abs(x[:, j]) * np.sqrt(K.diagonal()))
        assert np.max(abs(found[:, j] - true) / size) < 30 * 2.0**-62
        assert np.max(abs(np.array(true)) / size) > 2.0**-56
    assert not sliced.residual(np.zeros((30, 1)), np.zeros((30, 1))).any()


def test_rows_that_are_too_long_are_refused() -> None:
    with pytest.raises(Unsupported, match="600 entries"):
        SlicedStiffness(sp.csr_array(np.ones((600, 600))), np.ones(600))


def a_matrix(block: int | None) -> Any:
    rng = np.random.default_rng(5)
    entries = sp.coo_matrix((rng.random(3240), rng.integers(1800, size=(2, 3240))), shape=(1800, 1800))
    K = sp.csr_matrix(entries + sp.identity(1800))
    return K if block is None else K.tobsr((block, block))


@needs_pardiso
@pytest.mark.parametrize("block", [None, 2, 3, 6])
def test_products_by_threads_are_those_of_one(block: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """By rows and in blocks, and of vectors that are no rows of memory; not of a few entries, nor if switched off."""
    matrix, x = a_matrix(block), np.random.default_rng(6).standard_normal((1800, 2))
    assert products(matrix) == matrix.__matmul__
    monkeypatch.setattr(pardiso, "MANY_ENTRIES", 1000)
    threaded = products(matrix)
    assert isinstance(threaded, pardiso._Products)
    for column in x.T:
        sizes = abs(matrix) @ abs(column)
        assert np.max(abs(threaded(column) - matrix @ column) / sizes) <= 8 * np.finfo(float).eps
    assert np.array_equal(threaded(x[:, 0]), threaded(x[:, 0]))
    assert products(matrix.tocsc()) != threaded
    monkeypatch.setenv(pardiso.SOLVER_VARIABLE, "superlu")
    assert products(matrix) == matrix.__matmul__


@needs_pardiso
@pytest.mark.parametrize("block", [None, 3])
def test_what_the_library_does_not_take_is_refused(block: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """An operation that no version of MKL knows, and a status from making the matrix: versions differ in what they
    refuse there.
    """
    monkeypatch.setattr(pardiso, "MANY_ENTRIES", 1)
    with monkeypatch.context() as changed:
        changed.setattr(pardiso, "NOT_TRANSPOSED", 7)
        product = products(a_matrix(block))
        with pytest.raises(BackendFailed, match="status 3 "):
            product(np.ones(1800))
    monkeypatch.setattr(pardiso._library(), f"mkl_sparse_d_create_{'csr' if block is None else 'bsr'}", lambda *_: 2)
    with pytest.raises(BackendFailed, match="status 2 "):
        products(a_matrix(block))


def dots(some: Any, b: Any) -> Any:
    return some @ b


def test_flexible_gmres_reduces_what_it_is_asked_to() -> None:
    """Along directions of a preconditioner that changes from step to step, and from a first one that is known."""
    rng = np.random.default_rng(7)
    A = np.eye(60) + 0.3 * rng.standard_normal((60, 60)) / np.sqrt(60)
    r, taken = rng.standard_normal(60), []

    def along(v: Any) -> Any:
        taken.append(1.0 + 0.5 * len(taken) * abs(np.sin(np.arange(60))))
        return v * taken[-1]

    for reduction in (1e-2, 1e-10):
        taken.clear()
        z, steps = flexible_gmres(along, A.__matmul__, dots, r, reduction, 60)
        left = np.linalg.norm(r - A @ z) / np.linalg.norm(r)
        assert left <= reduction * (1 + 1e-3)
        assert steps == len(taken) < 60
    known, same = flexible_gmres(lambda v: v, A.__matmul__, dots, r, 1e-6, 60, first=r.copy())
    again, other = flexible_gmres(lambda v: v, A.__matmul__, dots, r, 1e-6, 60)
    assert same == other
    assert known == pytest.approx(again, rel=1e-12, abs=1e-14)


def test_flexible_gmres_ends_where_nothing_is_left() -> None:
    """At a residual of zero, where the space is exhausted, at its last step, and where numbers are none."""
    eye, r = np.eye(4), np.array([1.0, -2.0, 0.0, 3.0])
    assert np.array_equal(flexible_gmres(lambda v: v, eye.__matmul__, dots, 0 * r, 1e-3, 4)[0], 0 * r)
    z, steps = flexible_gmres(lambda v: v, eye.__matmul__, dots, r, 0.0, 4)
    assert steps == 1
    assert z == pytest.approx(r, rel=1e-15)
    A = np.diag([1.0, 2.0, 3.0, 4.0])
    assert flexible_gmres(lambda v: v, A.__matmul__, dots, r, 0.0, 2)[1] == 2
    assert flexible_gmres(lambda v: v, A.__matmul__, dots, r, 0.0, 0)[1] == 0
    with np.errstate(invalid="ignore"):
        _, steps = flexible_gmres(lambda v: v * np.nan, A.__matmul__, dots, r, 1e-3, 4)
    assert steps == 1


def test_sums_of_many_entries_are_those_of_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Products of sparse matrices add in the same order, so that no figure changes at some number of entries."""
    rng = np.random.default_rng(1)
    rows = sp.csr_matrix(np.where(rng.random((40, 60)) < 0.3, rng.random((40, 60)), 0.0))
    sizes, u, force = sizes_of(rows), rng.standard_normal(60), rng.standard_normal(40)
    few = sizes.moved(u), sizes.lengths(abs(u)), sizes.resultant(force), sizes.forces(abs(force))
    monkeypatch.setattr("contactqp.linalg.measures.MANY_ENTRIES", 0)
    many = sizes.moved(u), sizes.lengths(abs(u)), sizes.resultant(force), sizes.forces(abs(force))
    assert all(np.array_equal(one, other) for one, other in zip(few, many, strict=True))
    assert few[0] == pytest.approx(rows @ u)
    assert few[2] == pytest.approx(rows.T @ force)


@pytest.mark.parametrize("columns", [0, 1, 2, 3, 4])
def test_lengths_are_the_same_numbers_however_many_columns_there_are(columns: int) -> None:
    """They neither overflow nor underflow, and an infinite entry beats one that is no number, as by a reduction."""
    rng = np.random.default_rng(columns)
    vectors = rng.normal(size=(200, columns)) * 10.0 ** rng.integers(-300, 300, (200, columns))
    if columns:
        vectors[0], vectors[1], vectors[2] = np.inf, np.nan, 0.0
        vectors[3] = [np.inf, *[np.nan] * (columns - 1)]
    found = lengths(vectors)
    np.testing.assert_array_equal(found, np.hypot.reduce(vectors, axis=-1, initial=0.0))
    assert found.shape == (200,)
