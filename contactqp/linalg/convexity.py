"""Whether an energy is convex: a Cholesky factorisation, or a direction of negative curvature in extended precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed, InvalidProblem
from contactqp.linalg import pardiso
from contactqp.linalg.extended import extend, extended_rows
from contactqp.linalg.factorization import DENSE_SIZE, SuperLU, inverse_root
from contactqp.linalg.schur import LARGE
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem

# Negative curvature of this part of |z|'|K||z| is no rounding of the entries.
CURVED = 1e-12
# Unknowns of a direction that a message names.
NAMED = 6


def refuse_indefinite(problem: ContactProblem) -> None:
    """Raise InvalidProblem if K has negative curvature along a direction, which the message names; found out once."""
    of_stiffness = problem._computed.of_stiffness
    if of_stiffness.convex is None:
        _refuse_indefinite(problem)
        of_stiffness.convex = True


def _refuse_indefinite(problem: ContactProblem) -> None:
    if np.all(2 * problem.diagonal - problem.stiffness_sizes @ np.ones(problem.dimension) >= 0):
        return  # dominant diagonals: Gershgorin's circles
    if problem.dimension > LARGE and pardiso.available() and _factorises(problem):
        return
    scale = inverse_root(problem.diagonal)
    K = sp.csr_matrix(sp.diags(scale) @ problem.stiffness_rows @ sp.diags(scale))
    acting = np.flatnonzero(np.diff(K.indptr))
    direction = _lowest(sp.csr_matrix(K[acting][:, acting]))
    if direction is None:
        return
    z = np.zeros(problem.dimension)
    z[acting] = scale[acting] * direction
    z = z / np.max(abs(z))
    curvature = extend(z).dot(extended_rows(problem).stiffness @ extend(z))
    if curvature < -CURVED * float(abs(z) @ (problem.stiffness_sizes @ abs(z))):
        names = ", ".join(problem.dof_name(int(j)) for j in np.argsort(-abs(z))[:NAMED] if abs(z[j]) > CURVED)
        raise InvalidProblem(
            f"stiffness: expected positive semidefinite, got z'Kz = {curvature:.3g} along a direction z whose largest "
            f"entry is one ({names}): the energy is not convex"
        )


def _factorises(problem: ContactProblem) -> bool:
    """Whether PARDISO finds pivots of K, its diagonal raised a little, that are all positive."""
    if np.any(problem.diagonal <= 0):
        return False
    try:
        pardiso.Pardiso(problem.stiffness_rows + CURVED * sp.diags(problem.diagonal), np.zeros(0, dtype=np.intp))
    except (pardiso.NotPositive, BackendFailed):
        return False
    return True


def _lowest(matrix: Any) -> Vector | None:
    """The vector of the least eigenvalue, if that is negative: where a Cholesky factorisation finds such a pivot."""
    if matrix.nnz == matrix.shape[0]:  # diagonal
        lowest = int(np.argmin(matrix.data)) if matrix.nnz else 0
        return np.eye(1, matrix.shape[0], lowest)[0] if matrix.nnz and matrix.data[lowest] < 0 else None
    lifted = sp.csc_matrix(matrix + CURVED * sp.identity(matrix.shape[0]))
    if matrix.shape[0] <= DENSE_SIZE:
        values, vectors = np.linalg.eigh(matrix.toarray())
        return vectors[:, 0] if values[0] < 0 else None
    try:
        if matrix.shape[0] > LARGE and pardiso.available():
            pardiso.Pardiso(lifted, np.zeros(0, dtype=np.intp))
            return None
        if SuperLU(lifted).smallest_pivot > 0:
            return None
    except (pardiso.NotPositive, InvalidProblem, BackendFailed):
        pass
    from scipy.sparse.linalg import ArpackNoConvergence, eigsh

    try:
        values, vectors = eigsh(matrix, k=1, which="SA", v0=np.ones(matrix.shape[0]), tol=1e-8)
    except ArpackNoConvergence:
        return None
    return vectors[:, 0] if values[0] < 0 else None
