"""The rows of a matrix that PETSc holds, some of them at a time: it shows its entries in copies only."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.ranks import Ranks, Vector

# Rows that are copied at a time. With the eighty entries a row of bodies in space the copies take some 0.07 GB,
# whatever the size of K; with fewer rows PETSc's way through all columns, each time, takes longer than they.
AT_A_TIME = 2**14


class RowPart(NamedTuple):
    """Some rows of this rank, from its `begin`-th to before its `end`-th, in CSR over the unknowns of all ranks."""

    begin: int
    end: int
    indptr: NDArray[Any]
    indices: NDArray[Any]
    values: Vector


def row_parts(ranks: Ranks, matrix: Any, at_a_time: int = AT_A_TIME) -> Iterator[RowPart]:
    """All rows of this rank, and empty parts while other ranks have more. Collective."""
    first, last = matrix.getOwnershipRange()
    for i in range(int(ranks.max(-(-(last - first) // at_a_time)))):
        begin = min(i * at_a_time, last - first)
        end = min(begin + at_a_time, last - first)
        yield RowPart(begin, end, *_copied(matrix, first + begin, first + end))


def _copied(matrix: Any, begin: int, end: int) -> tuple[NDArray[Any], NDArray[Any], Vector]:
    PETSc = petsc()
    first, last = matrix.getOwnershipRangeColumn()
    rows = PETSc.IS().createStride(end - begin, begin, 1, comm=matrix.comm)
    columns = PETSc.IS().createStride(last - first, first, 1, comm=matrix.comm)
    part = matrix.createSubMatrix(rows, columns)
    indptr, indices, values = part.getValuesCSR()
    for item in (rows, columns, part):
        item.destroy()
    return np.asarray(indptr), indices, values
