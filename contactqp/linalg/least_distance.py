"""The least displacement that opens rows by what they lack, where some of them nearly depend on others, and forces.

All work on the rows themselves: their products with each other would lose half of the digits that tell them apart.
"""

from __future__ import annotations

import numpy as np

from contactqp.linalg.polishing import WITHIN_ROUNDING
from contactqp.model.arrays import Array, Vector

# Least-distance programming ends with less than this where the conditions conflict: the rounding of its last equation.
CONFLICT = 1e-14


def least_retreat(rows: Array, ties: Array, excess: Vector) -> Vector | None:
    """min |w| over rows w <= -excess, ties w = 0; None where these conflict, or too many steps would be taken.

    Least-distance programming (Lawson and Hanson 1974, chapter 23): with G = -rows, h = excess and r the residual of
    min |[G'; h'] y - (0; 1)| over y >= 0, w_j = -r_j / r_last.
    """
    from scipy.optimize import nnls

    size = np.linalg.norm(rows, axis=1)
    wanted = excess / size
    largest = float(np.max(wanted))
    columns = np.hstack([-(rows / size[:, None]).T, ties.T, -ties.T])
    matrix = np.vstack([columns, np.concatenate([wanted / largest, np.zeros(2 * len(ties))])])
    unit = np.append(np.zeros(len(columns)), 1.0)
    try:
        share, _ = nnls(matrix, unit, maxiter=30 * matrix.shape[1])
    except RuntimeError:  # too many steps
        return None
    left = matrix @ share - unit
    return None if -left[-1] <= CONFLICT else np.asarray(largest * left[:-1] / -left[-1])


def least_forces(rows: Array, ties: Array, resultant: Vector) -> Vector | None:
    """min |rows' l + ties' n - resultant| over l >= 0; None where too many steps would be taken."""
    from scipy.optimize import nnls

    size = np.linalg.norm(rows, axis=1)
    matrix = np.hstack([(rows / size[:, None]).T, ties.T, -ties.T])
    try:
        share, _ = nnls(matrix, resultant, maxiter=30 * matrix.shape[1])
    except RuntimeError:  # too many steps
        return None
    return np.asarray(share[: len(rows)] / size)


def least_closing(rows: Array, ties: Array, excess: Vector) -> Vector:
    """min |w| with rows w = -excess, ties w = 0, in the sense of least squares; what is dependent to rounding counts
    as dependent."""
    every = np.vstack([rows, ties])
    size = np.linalg.norm(every, axis=1)
    wanted = np.concatenate([-excess, np.zeros(len(ties))]) / size
    return np.asarray(np.linalg.lstsq(every / size[:, None], wanted, rcond=WITHIN_ROUNDING)[0])
