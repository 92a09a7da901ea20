"""Graded division of a line."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.model.problem_data import is_whole

Towards = Literal["low", "high", "both", "middle"]


def spacing(cells: int, grading: float, towards: Towards) -> NDArray[np.float64]:
    """Ends and middles of cells from 0 to 1, (2 cells + 1,), whose sizes shrink geometrically towards one place.

    Parameters
    ----------
    cells : int
        At least one.
    grading : float
        Largest over smallest size, at least 1.
    towards : str
        Where the cells are smallest: the ``"low"`` end, the ``"high"`` end, ``"both"`` ends or the ``"middle"``.

    >>> spacing(2, 3.0, "low").tolist()
    [0.0, 0.125, 0.25, 0.625, 1.0]
    """
    if not is_whole(cells) or cells < 1:
        raise InvalidProblem(f"shape: expected whole numbers of divisions >= 1, got {cells!r}")
    if not (math.isfinite(grading) and grading >= 1):
        raise InvalidProblem(f"shape: expected a grading >= 1, got {grading}")
    i = np.arange(cells)
    distance = {
        "low": i,
        "high": cells - 1 - i,
        "both": np.minimum(i, cells - 1 - i),
        "middle": abs(i - (cells - 1) / 2),
    }[towards]
    spread = float(distance.max() - distance.min())
    sizes = grading ** ((distance - distance.min()) / spread) if spread else np.ones(cells)
    ends = np.concatenate([[0.0], np.cumsum(sizes) / sizes.sum()])
    ends[-1] = 1.0
    values = np.empty(2 * cells + 1)
    values[::2] = ends
    values[1::2] = (ends[1:] + ends[:-1]) / 2
    return values
