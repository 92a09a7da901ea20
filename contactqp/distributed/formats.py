"""How PETSc holds K: in the blocks of its nodes, for products, or row by row, for what takes nothing else.

A product in blocks of three reads one number of a column for nine values and takes some half of the time.
"""

from __future__ import annotations

from typing import Any

import scipy.sparse as sp

from contactqp.distributed.environment import petsc


def held_in_blocks(comm: Any, rows: sp.bsr_matrix) -> Any:
    """Rows of this rank over the unknowns of all ranks, as PETSc.Mat: BAIJ, of single unknowns AIJ. Collective."""
    PETSc = petsc()
    size = rows.blocksize[0]
    matrix = PETSc.Mat().create(comm)
    matrix.setType(block_type(size))
    matrix.setSizes(((rows.shape[0], rows.shape[1]), (rows.shape[0], rows.shape[1])), bsize=size)
    indptr, indices = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType)
    matrix.setPreallocationCSR((indptr, indices, rows.data.reshape(-1)))
    matrix.assemble()
    return matrix


def held_in_rows(matrix: Any) -> Any:
    """A copy of a symmetric matrix as AIJ, which PETSc's multigrids and factorisations take. Collective."""
    PETSc = petsc()
    copy = matrix.convert(PETSc.Mat.Type.AIJ, PETSc.Mat())
    copy.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return copy


def block_type(size: int) -> str:
    """PETSc's name of the type that holds blocks of so many unknowns."""
    Type = petsc().Mat.Type
    return str(Type.BAIJ if size > 1 else Type.AIJ)
