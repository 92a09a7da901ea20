"""Membranes and other scalar fields over an obstacle: one unknown a node, u >= height(x)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.elements.contact_rows import contact_rows, count_unknowns
from contactqp.elements.pairing import Pairing
from contactqp.elements.reading import real_array
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import own_floating_point
from contactqp.model.problem_data import read_whole

Side = Literal["above", "below"]


@own_floating_point
def pair_scalar(
    points: ArrayLike,
    obstacle_height: ArrayLike | Callable[[NDArray[np.float64]], Any],
    *,
    side: Side = "above",
    unknowns: ArrayLike | None = None,
    dimension: int | None = None,
) -> Pairing:
    """Hold a scalar field on one side of an obstacle at the nodes: s (u - height) >= 0, s = 1 above and -1 below.

    E_N = -s at the node's unknown and gap = -s height, so that gap - E_N u = s (u - height). The multiplier is the
    force on the membrane at the node, positive along s [force]; a pressure is its projection onto the surface.

    Parameters
    ----------
    points : (p, d) array
        The nodes [length], d = 1, 2 or 3: the domain of u.
    obstacle_height : callable or (p,) array
        Heights [the unit of u], or a function from (p, d) points to them. An infinite height on the far side of the
        membrane (-inf above, +inf below) means that there is no obstacle: the node is left out and listed as unpaired.
    side : "above" or "below"
        Where the membrane is.
    unknowns : (p,) array of int, optional
        The place of each node in u; by default 0 to p-1.
    dimension : int, optional
        n, the number of all unknowns; by default one more than the largest in `unknowns`.

    Returns
    -------
    Pairing
        Without tangents: E_T has no rows. `direction` is s, (p, 1).

    Raises
    ------
    InvalidProblem
        Shapes that do not fit, heights that are NaN or infinite on the membrane's side, unknowns out of range.

    Examples
    --------
    >>> pairing = pair_scalar([[0.0, 0.0], [1.0, 0.0]], [0.5, -np.inf])
    >>> pairing.normal.toarray().tolist(), pairing.gap.tolist(), pairing.unpaired.tolist()
    ([[-1.0, 0.0]], [-0.5], [1])
    """
    if side not in get_args(Side):
        raise InvalidProblem(f"side: expected one of {get_args(Side)}, got {side!r}")
    x = real_array("points", points)
    if x.ndim != 2 or not np.all(np.isfinite(x)):
        raise InvalidProblem(f"points: expected finite numbers of shape (p, d), got shape {x.shape}")
    sign = 1.0 if side == "above" else -1.0
    given = obstacle_height(x) if callable(obstacle_height) else obstacle_height
    height = real_array("obstacle_height", given)
    if height.shape != (len(x),):
        raise InvalidProblem(f"obstacle_height: expected shape ({len(x)},), got {height.shape}")
    wrong = np.flatnonzero(np.isnan(height) | (height == sign * np.inf))
    if wrong.size:
        i = int(wrong[0])
        raise InvalidProblem(f"obstacle_height: expected a number at node {i}, {x[i].tolist()}, got {height[i]}")
    places = np.arange(len(x)) if unknowns is None else read_whole("unknowns", unknowns)
    if places.shape != (len(x),):
        raise InvalidProblem(
            f"unknowns: expected whole numbers of shape ({len(x)},), got {places.dtype} {places.shape}"
        )
    if places.min(initial=0) < 0:
        raise InvalidProblem(f"unknowns: expected numbers from 0, got {int(places.min())}")
    n = count_unknowns(int(places.max(initial=-1)), dimension)
    nodes = np.flatnonzero(np.isfinite(height))
    one = np.ones(len(nodes))
    normals = sign * one[:, np.newaxis]
    contact, columns = np.arange(len(nodes)), places[nodes, np.newaxis].astype(np.int64)
    E_N, E_T = contact_rows(contact, one, columns, normals, np.zeros((len(nodes), 0, 1)), (len(nodes), n))
    unpaired = np.flatnonzero(~np.isfinite(height))
    return Pairing(E_N, -sign * height[nodes], E_T, nodes, x[nodes], normals, unpaired)
