"""|K| x of a matrix that PETSc holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Vector
from contactqp.distributed.row_parts import row_parts
from contactqp.distributed.rows import Rows


def stiffness_sizes(problem: DistributedProblem, x: Vector) -> Vector:
    """|K| x (n_here,). Collective; nothing is kept."""
    K = problem.stiffness
    first, last = K.getOwnershipRange()
    out = np.zeros(last - first)
    row, column, size = [], [], []  # of the entries whose unknowns are on other ranks
    for begin, end, indptr, indices, values in row_parts(problem.ranks, K):
        data = np.abs(values, out=values)
        away = np.flatnonzero((indices < first) | (indices >= last))
        row.append(begin + np.searchsorted(indptr, away, side="right") - 1)
        column.append(indices[away].astype(np.int64))
        size.append(data[away])
        indices -= first
        indices[away], data[away] = 0, 0.0
        out[begin:end] = sp.csr_matrix((data, indices, indptr), shape=(end - begin, last - first)) @ x
    return out + _away(K, np.concatenate(row), np.concatenate(column), np.concatenate(size)).lengths(x)


def _away(K: Any, row: NDArray[np.intp], column: NDArray[np.int64], size: Vector) -> Rows:
    """Entries of |K| over unknowns of other ranks."""
    touched, place = np.unique(column, return_inverse=True)
    return Rows(sp.csr_matrix((size, (row, place)), shape=(K.getLocalSize()[0], len(touched))), touched, K)
