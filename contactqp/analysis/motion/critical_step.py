"""The longest time step of central differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.factorization import factorise

# Up to here all frequencies are found at once.
DENSE_SIZE = 200


def critical_step(mass: Any, stiffness: Any) -> float:
    """2 / omega, omega the highest frequency of K x = omega^2 M x on the unknowns with mass [time]; inf without any.

    Unknowns without mass are held: that makes frequencies no lower.
    """
    moving = np.flatnonzero(mass.diagonal() > 0)
    K = sp.csr_matrix(stiffness)[moving][:, moving]
    M = sp.csr_matrix(mass)[moving][:, moving]
    if not len(moving) or not np.any(K.data):
        return np.inf
    if len(moving) <= DENSE_SIZE:
        from scipy.linalg import eigvalsh

        highest = float(eigvalsh(K.toarray(), M.toarray())[-1])
    else:
        from scipy.sparse.linalg import LinearOperator, eigsh

        factor = factorise(M)
        inverse = LinearOperator(M.shape, matvec=factor.solve, dtype=float)
        start = np.random.default_rng(0).standard_normal(len(moving))
        highest = float(eigsh(K, 1, M=M, Minv=inverse, which="LA", v0=start, tol=1e-8, return_eigenvectors=False)[0])
    return 2 / np.sqrt(highest) if highest > 0 else np.inf
