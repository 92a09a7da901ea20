"""|K| x of a matrix that PETSc holds, which shows its entries in copies only."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Vector
from contactqp.distributed.rows import Rows

# Rows that are copied at a time. With the eighty entries a row of bodies in space the copies take 0.15 GB,
# whatever the size of K; with fewer rows PETSc's way through all columns, each time, takes longer than they.
AT_A_TIME = 2**15


def stiffness_sizes(problem: DistributedProblem, x: Vector) -> Vector:
    """|K| x (n_here,). Collective; nothing is kept."""
    K = problem.stiffness
    first, last = K.getOwnershipRange()
    out = np.zeros(last - first)
    row, column, size = [], [], []  # of the entries whose unknowns are on other ranks
    for i in range(int(problem.ranks.max(-(-(last - first) // AT_A_TIME)))):
        begin = min(i * AT_A_TIME, last - first)
        end = min(begin + AT_A_TIME, last - first)
        indptr, indices, data = _copied(K, first + begin, first + end)
        away = np.flatnonzero((indices < first) | (indices >= last))
        row.append(begin + np.searchsorted(indptr, away, side="right") - 1)
        column.append(indices[away].astype(np.int64))
        size.append(data[away])
        indices -= first
        indices[away], data[away] = 0, 0.0
        out[begin:end] = sp.csr_matrix((data, indices, indptr), shape=(end - begin, last - first)) @ x
    return out + _away(K, np.concatenate(row), np.concatenate(column), np.concatenate(size)).lengths(x)


def _copied(K: Any, begin: int, end: int) -> tuple[NDArray[Any], NDArray[Any], Vector]:
    """Rows of |K| on this rank, in CSR over all unknowns."""
    PETSc = petsc()
    first, last = K.getOwnershipRangeColumn()
    rows = PETSc.IS().createStride(end - begin, begin, 1, comm=K.comm)
    columns = PETSc.IS().createStride(last - first, first, 1, comm=K.comm)
    part = K.createSubMatrix(rows, columns)
    indptr, indices, data = part.getValuesCSR()
    for item in (rows, columns, part):
        item.destroy()
    return indptr, indices, np.abs(data, out=data)


def _away(K: Any, row: NDArray[np.intp], column: NDArray[np.int64], size: Vector) -> Rows:
    """Entries of |K| over unknowns of other ranks."""
    touched, place = np.unique(column, return_inverse=True)
    return Rows(sp.csr_matrix((size, (row, place)), shape=(K.getLocalSize()[0], len(touched))), touched, K)
