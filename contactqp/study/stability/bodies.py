"""What axes are built of: chains of springs, and rows that pick unknowns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def chain(springs: Sequence[float], *, ground: bool = True) -> Matrix:
    """The stiffness of springs in a row: the first one holds to the ground, or, without ground, joins unknowns 0, 1.

    Sums are those of doubles: exact where the springs have few bits.
    """
    size = len(springs) + (not ground)
    K = np.zeros((size, size))
    for i, k in enumerate(springs):
        ends = (i - 1, i) if ground else (i, i + 1)
        for a in ends:
            if a >= 0:
                K[a, a] += k
        if ends[0] >= 0:
            K[ends[0], ends[1]] -= k
            K[ends[1], ends[0]] -= k
    return K


def blocks(*parts: Matrix) -> Matrix:
    """Bodies that share no unknown."""
    sizes = [len(part) for part in parts]
    K, start = np.zeros((sum(sizes), sum(sizes))), 0
    for part, size in zip(parts, sizes, strict=True):
        K[start : start + size, start : start + size] = part
        start += size
    return K


def rows(n: int, *entries: dict[int, float]) -> Matrix:
    """One row (n,) for each dictionary of unknowns and coefficients."""
    E = np.zeros((len(entries), n))
    for row, places in zip(E, entries, strict=True):
        for j, value in places.items():
            row[j] = value
    return E
