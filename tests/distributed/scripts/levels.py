"""Levels of smoothed aggregation on several ranks, against the same products of whole matrices."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from contactqp.distributed import preconditioner, smoothed_aggregation
from contactqp.distributed import rows as stored_rows_module
from contactqp.distributed import smoothed_aggregation as aggregates_module
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks, aij_copy
from contactqp.distributed.rows import chosen_rows, stored_rows
from contactqp.distributed.smoothed_aggregation import Aggregates, smoothed_level
from contactqp.distributed.solving import iteration_of
from contactqp.errors import Unsupported
from contactqp.linalg.multigrid import JACOBI
from tests.blocks_in_space import layered, on_paraboloid, on_sphere, stacked

smoothed_aggregation.COARSEST = 40
stored_rows_module.AT_A_TIME = 7  # K comes in several parts
ranks = Ranks()


def whole(matrix) -> np.ndarray:
    """A matrix of PETSc's, dense, on every rank."""
    indptr, indices, values = matrix.getValuesCSR()
    here = sp.csr_matrix((values, indices, indptr), shape=(len(indptr) - 1, matrix.getSize()[1])).toarray()
    return ranks.gathered(here)


def dense_rows(rows, columns: int) -> np.ndarray:
    """The rows of all ranks over all unknowns."""
    here = np.zeros((rows.count, columns))
    here[:, rows.touched] = rows.entries.toarray()
    return ranks.gathered(here)


def random_aggregates(K) -> Aggregates:
    """The nodes of this rank in aggregates that other ranks have, and some in none."""
    random = np.random.default_rng(ranks.rank)
    of = random.integers(-1, 3 * ranks.size, size=K.getLocalSize()[0] // K.getBlockSize())
    return Aggregates(of, 3 * np.arange(ranks.size + 1))


def largest_difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.max(abs(a - b)) / np.max(abs(b)))


def rows_are_those_of_the_whole_matrix(whole_problem) -> None:
    """Some rows of K as they stand on this rank, in any order, and |K| x."""
    problem = distribute(whole_problem, ranks)
    K, first = whole(problem.stiffness), problem.stiffness.getOwnershipRange()[0]
    random = np.random.default_rng(ranks.rank)
    for part in (0, 2, 1):
        chosen = random.permutation(len(problem.load))[: part * len(problem.load) // 2]
        assert np.array_equal(chosen_rows(problem.stiffness, chosen).toarray(), K[first + chosen])
    x = random.standard_normal(len(problem.load))
    sizes = ranks.gathered(problem.product_sizes(x))
    assert largest_difference(sizes, abs(K) @ ranks.gathered(x)) <= 1e-14


def levels_are_those_of_whole_matrices(whole_problem, size: int) -> None:
    """T'T = 1 and B = T B_coarse on every aggregate; P = (I - 4/(3 rho) D^-1 K) T; P'KP."""
    problem = distribute(whole_problem, ranks)
    stiffness = problem.stiffness
    assert stiffness.getBlockSize() == size
    motions = np.random.default_rng(5 + ranks.rank).standard_normal((len(problem.load), 4))
    motions[:, 3] = motions[:, 0] - 2 * motions[:, 1]  # no motion of its own
    aggregates = random_aggregates(stiffness)
    tentative, coarse_motions = aggregates_module.tentative(ranks, aggregates, motions, size)
    T = ranks.gathered(tentative.rows.toarray())
    number = ranks.gathered(np.repeat(aggregates.of, size))
    B = np.where(number[:, None] >= 0, ranks.gathered(motions), 0.0)
    assert largest_difference(T @ ranks.gathered(coarse_motions), B) <= 1e-13
    several = [np.count_nonzero(number == i) >= 3 for i in range(3 * ranks.size)]
    expected = np.diag(np.ravel([[1.0, 1.0, 1.0, 0.0] if many else 4 * [0.0] for many in several]))
    kept = np.repeat(several, 4)
    assert largest_difference((T.T @ T)[np.ix_(kept, kept)], expected[np.ix_(kept, kept)]) <= 1e-12
    assert np.array_equal(T != 0, (T != 0) & (number[:, None] == np.repeat(np.arange(3 * ranks.size), 4)))
    with stored_rows(stiffness) as stored:
        level, coarse = smoothed_level(ranks, stiffness, stored, tentative, problem.metric)
    K, D = whole(stiffness), ranks.gathered(problem.metric)
    P = T - (JACOBI / level.largest / D)[:, None] * (K @ T)
    assert largest_difference(dense_rows(level.prolong, coarse.getSize()[0]), P) <= 1e-13
    assert largest_difference(whole(coarse), P.T @ K @ P) <= 1e-13


def aggregates_are_neighbours(whole_problem) -> None:
    """Every node that K couples with another is in one, and each is connected."""
    problem = distribute(whole_problem, ranks)
    size = problem.stiffness.getBlockSize()
    with stored_rows(problem.stiffness) as stored:
        fine = aggregates_module.aggregates(problem.stiffness.comm, stored, finest=True)
        small = aggregates_module.aggregates(problem.stiffness.comm, stored, finest=False)
    K = whole(problem.stiffness)
    near = np.add.reduceat(np.add.reduceat(abs(K), range(0, len(K), size), axis=0), range(0, len(K), size), axis=1) > 0
    for found in (fine, small):
        number = ranks.gathered(found.of)
        assert np.array_equal(number >= 0, np.count_nonzero(near, axis=1) > 1)
        assert set(number[number >= 0]) == set(range(found.starts[-1]))
        for i in range(found.starts[-1]):
            assert connected_components(near[np.ix_(number == i, number == i)])[0] == 1
    assert 1 <= fine.starts[-1] < small.starts[-1] < len(near) / 2


def a_matrix_of_another_type_is_refused() -> None:
    """Its memory would be read as what it is not."""
    rows = aij_copy(distribute(on_sphere((3, 3, 2)), ranks).stiffness)
    refused = pytest.raises(Unsupported, match=r"^stiffness: expected PETSc's BAIJ for blocks of 3 unknowns, got")
    with refused, stored_rows(rows):
        pass


def the_cycle_is_symmetric_and_its_spectrum_ends_at_one(problem, part: float) -> None:
    """Else conjugate gradients would not converge, and one would be no bound on the largest eigenvalue of M K."""
    many = distribute(problem, ranks)
    iteration = iteration_of(many, "gamg")
    assert len(iteration._precondition._hierarchy._levels) >= 1
    rows = np.flatnonzero(many.contact_number < part * problem.contacts)
    M = dense(many, iteration._precondition.with_rows(iteration.rows.entries[rows]))
    E = problem.normal.toarray()[: int(np.ceil(part * problem.contacts))]
    K = problem.stiffness.toarray()
    strength = 10.0 / np.sum(E**2 / np.diag(K), axis=1)
    assert largest_difference(M, M.T) <= 1e-13
    lower = np.linalg.cholesky(K + (E.T * strength) @ E)
    spectrum = np.linalg.eigvalsh(lower.T @ ((M + M.T) / 2) @ lower)
    assert spectrum[0] > 0.03, spectrum[0]
    assert spectrum[-1] <= 1 + 1e-12, spectrum[-1]


def dense(many, operator) -> np.ndarray:
    """M in the order of unknowns of one process."""
    units = ((many.dof_number == j).astype(float) for j in range(many.dimension))
    return np.column_stack([many.gathered(operator(unit), many.dof_number) for unit in units])


def a_failure_leaves_the_stiffness_of_bodies_that_float_as_it_was() -> None:
    """Another solver would be given another problem, and its answer certified."""
    many = distribute(on_paraboloid((3, 3, 2), sides=False), ranks)
    before = np.array(many.stiffness.getDiagonal().array)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(preconditioner, "LARGEST_DENSE", 1)
        with pytest.raises(Unsupported, match="use hypre or mumps"):
            iteration_of(many, "gamg")
    assert np.array_equal(many.stiffness.getDiagonal().array, before)


rows_are_those_of_the_whole_matrix(layered(0.1, (4, 4, 6)))
rows_are_those_of_the_whole_matrix(on_sphere((4, 5, 3)))
levels_are_those_of_whole_matrices(layered(0.1, (4, 4, 6)), 1)
levels_are_those_of_whole_matrices(on_sphere((4, 5, 3)), 3)
aggregates_are_neighbours(on_sphere((4, 5, 3)))
for problem, part in (
    (on_paraboloid((3, 3, 3)), 0.0),
    (on_sphere((3, 3, 3)), 0.5),
    (stacked((3, 3, 2), (2, 2, 2)), 1.0),
):
    the_cycle_is_symmetric_and_its_spectrum_ends_at_one(problem, part)
a_matrix_of_another_type_is_refused()
a_failure_leaves_the_stiffness_of_bodies_that_float_as_it_was()
if ranks.rank == 0:
    print("equal")
