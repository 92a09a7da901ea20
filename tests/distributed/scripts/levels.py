"""Levels of smoothed aggregation on several ranks, against the same products of whole matrices."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from contactqp.distributed import preconditioner, v_cycle
from contactqp.distributed.distributing import distribute
from contactqp.distributed.environment import petsc
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.smoothed_aggregation import Tentative, smoothed_levels
from contactqp.distributed.solving import iteration_of
from contactqp.errors import Unsupported
from contactqp.multigrid import JACOBI
from tests.blocks_in_space import layered, on_paraboloid, on_sphere, stacked

preconditioner.COARSEST = 40
ranks = Ranks()


def whole(matrix) -> np.ndarray:
    """A matrix of PETSc's, dense, on every rank."""
    indptr, indices, values = matrix.getValuesCSR()
    here = sp.csr_matrix((values, indices, indptr), shape=(len(indptr) - 1, matrix.getSize()[1])).toarray()
    return ranks.gathered(here)


def tentative(K, coarse_size: int):
    """A random T: the blocks of nodes of this rank in aggregates that other ranks have columns of."""
    PETSc, size = petsc(), K.getBlockSize()
    random = np.random.default_rng(ranks.rank)
    blocks, aggregates = K.getLocalSize()[0] // size, 3 * ranks.size
    column = random.integers(aggregates, size=blocks)[:, None] * coarse_size + np.arange(coarse_size)
    T = PETSc.Mat().createAIJ(((K.getLocalSize()[0], None), (3 * coarse_size, None)), nnz=coarse_size, comm=K.comm)
    T.setBlockSizes(size, coarse_size)
    first = K.getOwnershipRange()[0]
    for i in range(size * blocks):
        T.setValues([first + i], column[i // size].astype(PETSc.IntType), random.standard_normal(coarse_size))
    T.assemble()
    return T


def largest_difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.max(abs(a - b)) / np.max(abs(b)))


def products_are_those_of_whole_matrices(whole_problem, size: int) -> None:
    problem = distribute(whole_problem, ranks)
    assert problem.stiffness.getBlockSize() == size
    T = tentative(problem.stiffness, 6)
    (level,), coarse = smoothed_levels(ranks, problem.stiffness, [Tentative.of(T)], problem.metric)
    K, D = whole(problem.stiffness), ranks.gathered(problem.metric)
    P = whole(T) - (JACOBI / level.largest / D)[:, None] * (K @ whole(T))
    assert largest_difference(whole(level.prolong.matrix()), P) <= 1e-14
    assert largest_difference(whole(coarse), P.T @ K @ P) <= 1e-13


def the_cycle_is_symmetric_and_its_spectrum_ends_at_one(problem, part: float) -> None:
    """Else conjugate gradients would not converge, and one would be no bound on the largest eigenvalue of M K."""
    many = distribute(problem, ranks)
    way = iteration_of(many, "gamg")
    assert len(way._precondition._hierarchy._levels) >= 1
    rows = np.flatnonzero(many.contact_number < part * problem.contacts)
    M = dense(many, way._precondition.holding(way.rows.entries[rows]))
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
    return np.column_stack([many.whole(operator(unit), many.dof_number) for unit in units])


def a_failure_leaves_the_stiffness_of_bodies_that_float_as_it_was() -> None:
    """Another solver would be given another problem, and its answer certified."""
    many = distribute(on_paraboloid((3, 3, 2), sides=False), ranks)
    before = np.array(many.stiffness.getDiagonal().array)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(v_cycle, "LARGEST_DENSE", 1)
        with pytest.raises(Unsupported, match="use hypre or mumps"):
            iteration_of(many, "gamg")
    assert np.array_equal(many.stiffness.getDiagonal().array, before)


products_are_those_of_whole_matrices(layered(0.1, (4, 4, 6)), 1)
products_are_those_of_whole_matrices(on_sphere((4, 5, 3)), 3)
for problem, part in (
    (on_paraboloid((3, 3, 3)), 0.0),
    (on_sphere((3, 3, 3)), 0.5),
    (stacked((3, 3, 2), (2, 2, 2)), 1.0),
):
    the_cycle_is_symmetric_and_its_spectrum_ends_at_one(problem, part)
a_failure_leaves_the_stiffness_of_bodies_that_float_as_it_was()
if ranks.rank == 0:
    print("equal")
