"""Who can touch whom: the rows E_N, E_T and the gaps of nodes and an obstacle, for people with their own matrices."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from contactqp.elements.obstacle import Plane, tangents
from contactqp.errors import InvalidProblem

__all__ = ["Pairing", "Plane", "pair"]


class Pairing(NamedTuple):
    """What ContactProblem takes as ``normal``, ``gap`` and ``tangent``."""

    normal: Any  # (p, n) sparse, E_N
    gap: NDArray[np.float64]  # (p,), positive when open
    tangent: Any  # ((d-1) p, n) sparse, E_T, contact-major


def pair(
    points: ArrayLike, obstacle: Plane, *, unknowns: ArrayLike | None = None, dimension: int | None = None
) -> Pairing:
    """Pair every point with the obstacle: E_N u <= gap, with E_N = -n' and gap = (x - point).n.

    Parameters
    ----------
    points : (p, d) array
        The nodes that may touch [length], d = 1, 2 or 3.
    obstacle : Plane
        Its normal points to the side where the body is.
    unknowns : (p, d) array of int, optional
        unknowns[i, a] is the place of node i's displacement along axis a in u. By default u is (p d,), node by node.
    dimension : int, optional
        n, the number of all unknowns; by default one more than the largest in `unknowns`.

    Returns
    -------
    Pairing
        (normal, gap, tangent); unpacks as ``E_N, g, E_T``. The tangents of a point are orthonormal.

    Raises
    ------
    InvalidProblem
        Shapes that do not fit, numbers that are not finite, unknowns out of range.

    Examples
    --------
    >>> E_N, g, E_T = pair([[0.0, 0.001]], Plane(point=[0.0, 0.0], normal=[0.0, 1.0]))
    >>> E_N.toarray().tolist(), g.tolist(), E_T.toarray().tolist()
    ([[0.0, -1.0]], [0.001], [[1.0, 0.0]])
    """
    x = _points(points, obstacle.dimension)
    columns, n = _unknowns(unknowns, x.shape, dimension)
    outward = obstacle.outward().astype(float)
    along = tangents(outward).astype(float)
    rows = np.repeat(np.arange(len(x)), x.shape[1])
    normal = sp.csr_array((np.tile(-outward, len(x)), (rows, columns.ravel())), shape=(len(x), n))
    return Pairing(normal, np.asarray(obstacle.distance(x), dtype=float), _tangent_rows(along, columns, n))


def _tangent_rows(along: NDArray[np.float64], columns: NDArray[np.int64], n: int) -> Any:
    """Row (d-1) i + k holds tangent k of contact i."""
    p, d = columns.shape
    rows = np.repeat(np.arange((d - 1) * p), d)
    places = np.repeat(columns, d - 1, axis=0)
    tangent = sp.csr_array((np.tile(along, (p, 1)).ravel(), (rows, places.ravel())), shape=((d - 1) * p, n))
    tangent.eliminate_zeros()
    return tangent


def _points(points: ArrayLike, dimension: int) -> NDArray[np.float64]:
    x = np.asarray(points, dtype=float)
    if x.ndim != 2 or x.shape[1] != dimension:
        raise InvalidProblem(f"points: expected shape (p, {dimension}) as the obstacle has it, got {x.shape}")
    if not np.all(np.isfinite(x)):
        raise InvalidProblem(f"points: expected finite numbers, got {x[~np.isfinite(x)][0]}")
    return x


def _unknowns(
    unknowns: ArrayLike | None, shape: tuple[int, ...], dimension: int | None
) -> tuple[NDArray[np.int64], int]:
    columns = np.arange(shape[0] * shape[1]).reshape(shape) if unknowns is None else np.asarray(unknowns)
    if columns.shape != shape or (columns.size and not np.issubdtype(columns.dtype, np.integer)):
        raise InvalidProblem(f"unknowns: expected whole numbers of shape {shape}, got {columns.dtype} {columns.shape}")
    largest = int(columns.max(initial=-1))
    n = largest + 1 if dimension is None else dimension
    if largest >= n or columns.min(initial=0) < 0:
        raise InvalidProblem(f"unknowns: expected numbers from 0 to {n - 1}, got {int(columns.min())} to {largest}")
    return columns.astype(np.int64), n
