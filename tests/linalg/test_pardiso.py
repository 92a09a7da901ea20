"""PARDISO: one analysis for all matrices with the same entries, orders of elimination, and what it is given."""

import os

import numpy as np
import pytest
import scipy.sparse as sp
from threadpoolctl import threadpool_limits

from contactqp.linalg import pardiso
from contactqp.linalg.factorization import with_added_diagonal
from contactqp.linalg.pardiso import EliminationOrder, NotPositive, Pardiso
from tests.linalg.test_elimination import needs_pardiso, pressed_block


def strip_with_rows(cells, share):
    """The stiffness of a strip and rows that close every so many of the nodes beneath it, as one saddle point."""
    problem = pressed_block(cells)
    rows = sp.csr_matrix(problem.normal[::share])
    lower = -1e-9 * sp.identity(rows.shape[0])
    return problem.dimension, sp.bmat([[problem.stiffness_rows, rows.T], [rows, lower]], format="csc")


@pytest.mark.sampled(2)
@needs_pardiso
@pytest.mark.parametrize("threads", [1, 2])
def test_an_order_of_elimination_is_found_once_and_its_pivots_round_little(monkeypatch, threads):
    """On several threads too, each of which takes memory that is no fill-in."""
    n, matrix = strip_with_rows(40, 1)
    asked = []
    plain = Pardiso.__init__

    def seen(self, *given, **named):
        asked.append(given[3] if len(given) > 3 else None)
        plain(self, *given, **named)

    monkeypatch.setattr(Pardiso, "__init__", seen)
    order, unknowns, held = EliminationOrder(n), np.arange(n), np.setdiff1d(np.arange(n), [0, 5, 90])
    pardiso._library()  # limits reach what is loaded
    with threadpool_limits(threads):
        first = order.factorised(matrix[:n, :n], unknowns)
        second = order.factorised(matrix, unknowns, pardiso.INDEFINITE)
        third = order.factorised(matrix[held][:, held], held)
    assert asked[0] is None
    assert sorted(asked[1]) == list(range(matrix.shape[0]))
    assert asked[2] is not None
    right = np.random.default_rng(0).standard_normal(matrix.shape[0])
    for factor, of in ((first, unknowns), (second, np.arange(matrix.shape[0])), (third, held)):
        found = factor.solve_all(right[of])
        assert np.max(abs(matrix[of][:, of] @ found - right[of])) <= 1e-11 * np.max(abs(found))
    # An order that is found for the saddle point eliminates some rows before their unknowns: pivots of 1e-9.
    assert np.max(abs(matrix @ second.solve_all(right) - right)) <= 1e-13 * np.max(abs(second.solve_all(right)))


@pytest.mark.slow
@needs_pardiso
def test_minimum_degree_orders_plane_stiffnesses_alone(monkeypatch):
    """Saddle points of programs, and rows that touch everything, may take it minutes."""
    n, matrix = strip_with_rows(40, 1)
    asked = []
    plain = Pardiso.__init__

    def seen(self, *given, **named):
        asked.append(named["ordering"])
        plain(self, *given, **named)

    monkeypatch.setattr(Pardiso, "__init__", seen)
    unknowns, everything = np.arange(n), sp.csr_matrix((np.ones(n), (np.zeros(n, dtype=int), np.arange(n))), (n, n))
    arrow = sp.csr_matrix(matrix[:n, :n] + everything + everything.T)
    EliminationOrder(n).factorised(matrix[:n, :n], unknowns)
    EliminationOrder(n).factorised(matrix, unknowns, pardiso.INDEFINITE)
    EliminationOrder(n).factorised(arrow, unknowns, pardiso.INDEFINITE)
    assert asked == [pardiso.MINIMUM_DEGREE, pardiso.NESTED_DISSECTION, pardiso.NESTED_DISSECTION]


@pytest.mark.slow
@needs_pardiso
def test_an_order_that_would_fill_in_is_found_anew():
    n, matrix = strip_with_rows(16, 1)
    order, unknowns = EliminationOrder(n), np.arange(n)
    order.factorised(matrix[:n, :n], unknowns)
    joined = sp.csr_matrix(
        (np.ones(n), (np.arange(n) // 2, np.random.default_rng(0).permutation(n))), shape=(n // 2, n)
    )
    tied = sp.bmat([[matrix[:n, :n], joined.T], [joined, -1e-9 * sp.identity(n // 2)]], format="csc")
    found = order.factorised(tied, unknowns, pardiso.INDEFINITE)
    assert (
        found.entries_of_factors
        < Pardiso(
            tied, np.zeros(0, dtype=np.intp), pardiso.INDEFINITE, order=np.arange(tied.shape[0])
        ).entries_of_factors
    )
    right = np.random.default_rng(1).standard_normal(tied.shape[0])
    assert np.max(abs(tied @ found.solve_all(right) - right)) <= 1e-5 * np.max(abs(right))
    # What was found for bodies joined is not taken for them alone.
    assert order._known(matrix[:n, :n].tocsc(), unknowns) is None


@needs_pardiso
def test_one_analysis_serves_two_matrices_with_the_same_entries():
    K = pressed_block(20).stiffness_rows
    n, right = K.shape[0], np.random.default_rng(0).standard_normal(K.shape[0])
    first, other = EliminationOrder(n).factorised(K, np.arange(n)), with_added_diagonal(K, K.diagonal())
    second = first.beside(other)
    for factor, matrix in ((second, other), (first, K), (second, other)):
        found = factor.solve_all(right)
        assert np.max(abs(matrix @ found - right)) <= 1e-11 * np.max(abs(right))
        assert factor.smallest_pivot == pytest.approx(Pardiso(matrix, np.zeros(0, dtype=int)).smallest_pivot, rel=0.5)
    assert first.beside(K) is None  # two at a time
    del second, factor
    with pytest.raises(NotPositive):
        first.beside(-K)
    third = first.beside(K)
    assert third.solve_all(right) == pytest.approx(first.solve_all(right), rel=1e-12)
    del third
    assert first.beside(sp.identity(n, format="csr")) is None


@pytest.mark.slow
@needs_pardiso
def test_the_library_of_the_package_mkl_is_the_one_that_pypardiso_finds() -> None:
    """Where another were taken, two of them with threads of their own would be loaded in one process."""
    from pypardiso.scipy_aliases import pypardiso_solver

    path = pardiso._installed()
    if path is None:
        pytest.skip("mkl was not installed as a Python package")
    assert os.path.samefile(path, pypardiso_solver.libmkl._name)


@pytest.mark.parametrize("form", ["csr", "csc", "bsr", "coo"])
def test_what_pardiso_and_the_saddle_points_are_given_is_the_matrix(form):
    """One half of a symmetric matrix, whichever way it is stored, and a diagonal that may not all be stored before."""
    half = sp.random(60, 60, 0.1, random_state=1)
    matrix = half + half.T
    given = matrix.asformat(form)
    assert np.array_equal(pardiso.upper_triangle(given).toarray(), np.triu(matrix.toarray()))
    added = np.arange(1.0, 61.0)
    for known in (given, (matrix + sp.identity(60)).asformat(form)):
        expected = known.toarray() + np.diag(added)
        assert np.array_equal(with_added_diagonal(known, added).toarray(), expected)


def test_pardiso_gets_the_diagonal_whole_without_a_search_among_all_unknowns(monkeypatch) -> None:
    """NumPy's unique costs a tenth of a factorisation of 130 000 unknowns, whose rows are in order already."""
    half = sp.random(60, 60, 0.1, random_state=1)
    matrix = sp.csr_array(half + half.T)
    assert np.count_nonzero(matrix.diagonal()) < 60
    monkeypatch.setattr(np, "setdiff1d", None)
    entries = pardiso._entries_of(matrix, pardiso.POSITIVE_DEFINITE)
    assert np.array_equal(entries.toarray(), np.triu(matrix.toarray()))
    assert np.array_equal(entries.indices[entries.indptr[:-1]], np.arange(60))
