"""Performance profiles (Dolan and More 2002): the part of the problems solved within a factor of the fastest time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from contactqp.model.arrays import Array

Solver = TypeVar("Solver")


def ratios(seconds: Mapping[Solver, Sequence[float]]) -> dict[Solver, Array]:
    """t / min t of every problem, (problems,) a solver; infinite where a solver did not solve it.

    Parameters
    ----------
    seconds : solver -> (problems,), positive, infinite where not solved

    Examples
    --------
    >>> ratios({"a": [1.0, 4.0], "b": [3.0, np.inf]})
    {'a': array([1., 1.]), 'b': array([ 3., inf])}
    """
    times = np.array(list(seconds.values()), dtype=float)
    fastest = np.min(times, axis=0)
    compared = np.divide(times, fastest, out=np.full_like(times, np.inf), where=np.isfinite(times))
    return dict(zip(seconds, compared, strict=True))


def profile(compared: Array, factors: Array) -> Array:
    """rho(tau) = the part of all problems with t / min t <= tau, for every factor tau.

    Examples
    --------
    >>> profile(np.array([1.0, 3.0, np.inf]), np.array([1.0, 2.0, 4.0])).round(2)
    array([0.33, 0.33, 0.67])
    """
    return np.asarray(np.mean(compared[:, None] <= factors, axis=0))
