"""Forces of rows that balance a given residual: B'l = r in the least-squares sense, one connected group at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.model.arrays import Array, Vector

# Rows of unit length that are closer to dependent than this are dependent.
DEPENDENT = 1e-12
# Groups of more rows than this are solved for iteratively.
DENSE_ROWS = 1500
# Forces without tension may explain this much less of the residual than any forces would.
NEARLY_AS_WELL = 1e-9


def balancing_forces(
    rows: Any, residual: Vector, pushing_only: NDArray[np.bool_], scale: Vector
) -> tuple[Vector, bool]:
    """Forces l (q,) of rows B (q, n) with B'l = r, and whether some were shared among dependent rows.

    Unknowns are scaled by `scale` (n,), 1/sqrt(K_jj). Where rows are independent the forces are what they are; where
    they are not, those that only push share the resultant without tension if that explains it as well.
    """
    from scipy.sparse.csgraph import connected_components

    count = rows.shape[0]
    force, shared = np.zeros(count), False
    if not count:
        return force, shared
    scaled = sp.csr_matrix(rows @ sp.diags(scale))
    length = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1))).ravel()
    scaled = sp.csr_matrix(sp.diags(1 / length) @ scaled)
    target = residual * scale
    _, label = connected_components(abs(scaled) @ abs(scaled).T, directed=False)
    order = np.argsort(label, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
        part = scaled[members]
        touched = np.unique(part.indices)
        B, r = part[:, touched], target[touched]
        if len(members) > DENSE_ROWS:
            force[members] = _iteratively(B, r)
            continue
        force[members], dependent = _densely(B.toarray(), r, pushing_only[members])
        shared |= dependent
    return force / length, shared


def _densely(B: Array, r: Vector, pushing_only: NDArray[np.bool_]) -> tuple[Vector, bool]:
    if len(B) == 1:
        return B @ r, False
    force, _, rank, _ = np.linalg.lstsq(B.T, r, rcond=DEPENDENT)
    if rank == len(B):
        return np.asarray(force), False
    from scipy.optimize import nnls

    size = float(np.linalg.norm(r))
    if size == 0:
        return np.zeros(len(B)), True
    columns = np.vstack([B, -B[~pushing_only]]).T
    try:
        share, left = nnls(columns, r / size, maxiter=30 * columns.shape[1])
    except RuntimeError:  # SciPy's word for too many steps
        return np.asarray(force), True
    if left > np.linalg.norm(B.T @ force - r) / size + NEARLY_AS_WELL:
        return np.asarray(force), True
    without_tension = share[: len(B)].copy()
    without_tension[~pushing_only] -= share[len(B) :]
    return np.asarray(size * without_tension), True


def _iteratively(B: Any, r: Vector) -> Vector:
    from scipy.sparse.linalg import lsqr

    return np.asarray(lsqr(B.T, r, atol=1e-15, btol=1e-15, conlim=0.0, iter_lim=20 * B.shape[0])[0])
