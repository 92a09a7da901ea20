"""The shifted geometric mean of run times (Mittelmann's benchmarks): neither the longest nor the shortest decide."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

# What is added to every time before and taken off after the mean [s]: times far below it count as equal.
SHIFT = 1e-3
# What a failure counts as, and where the clock stops [s].
LIMIT = 10.0


def shifted_geometric_mean(seconds: Iterable[float], shift: float = SHIFT, limit: float = LIMIT) -> float:
    """exp(mean log(min(t, limit) + shift)) - shift [s]; failures are infinite and count as the limit.

    Examples
    --------
    >>> round(shifted_geometric_mean([0.001, 0.007]), 12)
    0.003
    >>> round(shifted_geometric_mean([float("inf"), 10.0]), 12)
    10.0
    """
    times = np.minimum(np.array(list(seconds), dtype=float), limit)
    return float(np.exp(np.mean(np.log(times + shift))) - shift)
