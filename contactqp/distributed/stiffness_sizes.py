"""|K| x of a matrix that PETSc holds."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.rows import Rows
from contactqp.distributed.stored_rows import StoredBlocks, stored_rows
from contactqp.model.arrays import Vector


def stiffness_sizes(problem: DistributedProblem, x: Vector) -> Vector:
    """|K| x (n_here,). Collective; nothing is kept."""
    with stored_rows(problem.stiffness) as stored:
        touched = stored.unknowns_of_others
        away = Rows(sp.csr_matrix((0, len(touched))), touched, problem.stiffness).near(x)
        out = np.zeros(len(x))
        for begin, end in stored.parts():
            sizes = _sizes(stored.here, begin, end, x) + _sizes(stored.away, begin, end, away)
            out[begin * stored.size : end * stored.size] = sizes
    return out


def _sizes(blocks: StoredBlocks, begin: int, end: int, x: Vector) -> Vector:
    rows = blocks.rows(begin, end)
    np.abs(rows.data, out=rows.data)
    return np.asarray(rows @ x)
