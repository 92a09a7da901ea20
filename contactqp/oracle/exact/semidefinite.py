"""Proof that a rational stiffness is positive semidefinite, without which an equilibrium is no minimum."""

from __future__ import annotations

import numpy as np
from flint import fmpq_mat

from contactqp.oracle.exact.rational import PRIMES, independent_columns, null_space, number, take, take_columns

EPS = float(np.finfo(float).eps)


def is_semidefinite(K: fmpq_mat) -> bool:
    """Whether z'Kz >= 0 for all z, exactly.

    K has the rank of its rows and columns J, and is then semidefinite where K_JJ is definite. That a floating-point
    Cholesky factorisation of K_JJ - s I exists proves it (Rump 2006, BIT 46, 433), s being what rounding may have
    added; where it does not, the leading minors decide.
    """
    n = K.nrows()
    kept = next(
        (
            found
            for prime in PRIMES
            if len(found := independent_columns(K, prime)) == n or null_space(K).ncols() == n - len(found)
        ),
        list(range(n)),
    )
    core = take_columns(take(K, kept), kept)
    if any(core[i, i] <= 0 for i in range(len(kept))):
        return False
    return not kept or _cholesky_proves(core) or _minors_prove(core)


def _cholesky_proves(K: fmpq_mat) -> bool:
    try:
        doubles = np.array([number(x) for x in K.entries()]).reshape(K.nrows(), K.ncols())
        if not np.all(np.diag(doubles) > 0):  # too small for doubles
            return False
        # Powers of two scale without rounding.
        scale = np.exp2(-np.round(np.log2(np.diag(doubles)) / 2))
        doubles = doubles * np.outer(scale, scale)
        size = len(doubles)
        shift = 2 * (size + 4) * EPS * (np.trace(doubles) + float(np.max(np.sum(abs(doubles), axis=1))))
        np.linalg.cholesky(doubles - shift * np.eye(size))
    except (np.linalg.LinAlgError, OverflowError):
        return False
    return bool(np.all(np.isfinite(doubles)))


def _minors_prove(K: fmpq_mat) -> bool:
    """Sylvester's criterion by elimination without fractions."""
    integers, _ = K.numer_denom()
    order, _, _, upper = integers.fflu()
    size = integers.nrows()
    in_place = all(order[i, i] == 1 for i in range(size))
    return in_place and all(upper[i, i] > 0 for i in range(size))
