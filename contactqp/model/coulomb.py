"""The states of contacts under Coulomb's law, their slips, and rows that resist motions or have rounded levers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from itertools import product
from math import prod
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.model.arrays import EPS, Array, Vector


class ContactState(IntEnum):
    """The state of a contact; in the plane it slips with s < 0 (SLIP_BACK) or s > 0 (SLIP_ON).

    The product of a slipping state with mu l_N is the friction force in the plane. CLOSED is a closed contact without
    friction where states are reported; where combinations of states are solved it is SLIP_ON, with mu l_N = 0.
    """

    SLIP_BACK = -1
    OPEN = 0
    SLIP_ON = 1
    STICK = 2
    CLOSED = 3


# As plain numbers, with which NumPy compares arrays in less than half the time of members of an enumeration.
SLIP_BACK, OPEN, SLIP_ON, STICK, CLOSED = map(int, ContactState)
Status = NDArray[np.int8]


def plane_states(friction: Any) -> tuple[int, ...]:
    """Return the possible states of a contact in the plane with this coefficient of friction.

    Without friction these are OPEN, and SLIP_ON for a closed contact: its friction force mu l_N is zero.
    """
    return (OPEN, STICK, SLIP_BACK, SLIP_ON) if friction > 0 else (OPEN, SLIP_ON)


def all_combinations(friction: Iterable[Any]) -> Iterator[tuple[int, ...]]:
    """Return every combination of the states of contacts in the plane with coefficients of friction (m,)."""
    return combinations_of([plane_states(mu) for mu in friction])


def combinations_of(choices: Sequence[tuple[int, ...]]) -> Iterator[tuple[int, ...]]:
    """Return every combination of one choice for each contact."""
    return product(*choices)


def number_of_combinations(choices: Iterable[tuple[int, ...]]) -> int:
    """Return the number of combinations of one choice for each contact."""
    return prod(len(choice) for choice in choices)


def combinations_at(contacts: Any, choices: Sequence[tuple[int, ...]], status: Status) -> Iterator[Status]:
    """Yield states (m,) with each combination of choices at the given contacts, and those of `status` elsewhere."""
    for chosen in combinations_of(choices):
        combination = status.copy()
        combination[contacts] = chosen
        yield combination


# The values of `contact_status`, with friction open, grazing, stick or slip, without it the first three. Tables of many
# cases and files of pictures number them in this order.
STATUS_WORDS = ("open", "grazing", "closed", "stick", "slip")


def status_names(status: Status) -> NDArray[np.str_]:
    """Return the names "open", "stick" and "slip" of states (m,)."""
    return np.select([status == OPEN, status == STICK], ["open", "stick"], "slip").astype("<U8")


# Sides of the polygon circumscribed about the disc of slips, which it exceeds by 0.5 % between them; and the sides on
# either side of a given slip, each half as far from it as the last: between these it exceeds the disc by 1e-6, and by
# more than the tolerance of linear programs.
SIDES, SIDES_NEARBY = 32, 7


def resisting_rows(problem: Any, sides: Array | None = None, within: bool = True) -> Any:
    """Return the rows E_N, and E_N + mu t'E_T with friction (CSR): no contact resists a motion z with E z <= 0.

    t are the two directions of the plane, in space the corners of a polygon around the unit circle; without `within`
    its sides' normals, and motions that contacts resist may have E z <= 0, too.

    Parameters
    ----------
    problem : ContactProblem
    sides : (m, k) array of increasing angles, optional
        The directions of slip at which the polygon of each contact touches the circle; equally spaced by default.
    within : bool
    """
    if not problem.frictional or problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        return problem.normal
    width, rough = problem.slip_origin.shape[1], np.flatnonzero(problem.friction > 0)
    directions = corners(len(rough), width, None if sides is None else sides[rough], within)
    weights = np.concatenate([problem.friction[rough, None] * directions, np.ones((*directions.shape[:2], 1))], axis=2)
    tangential = width * rough[:, None] + np.arange(width)
    places = np.column_stack([tangential, len(problem.slip_origin) * width + rough])
    count = len(directions)
    combine = sp.csr_matrix(
        (weights.ravel(), np.tile(places.ravel(), count), np.arange(0, weights.size + 1, width + 1)),
        shape=(count * len(rough), (width + 1) * len(problem.slip_origin)),
    )
    resisting = combine @ sp.vstack([problem.tangent, problem.normal], format="csr")
    return sp.csr_matrix(sp.vstack([problem.normal[problem.friction <= 0], resisting]))


def corners(contacts: int, width: int, sides: Array | None = None, within: bool = True) -> Array:
    """Return directions t (k, m, d-1) with max_t t's >= |s| for every slip s: the corners of a polygon at each contact.

    Parameters
    ----------
    contacts, width : m and d - 1
    sides : (m, k) array of increasing angles, optional
        The directions in which the polygon's sides touch the circle; equally spaced by default.
    within : bool
        Whether the corners are wanted; otherwise the points of the circle are returned, with max_t t's <= |s|.
    """
    if width == 1:
        return np.broadcast_to([[[1.0]], [[-1.0]]], (2, contacts, 1))
    if sides is None:
        sides = np.broadcast_to(np.pi / SIDES * (2 * np.arange(SIDES) - 1), (contacts, SIDES))
    half = (np.diff(sides, append=sides[:, :1] + 2 * np.pi) / 2).T if within else np.zeros(sides.T.shape)
    angle = sides.T + half
    return np.asarray(np.stack([np.cos(angle), np.sin(angle)], axis=-1) / np.cos(half)[..., None])


def sides_from(slip: Array) -> Array:
    """Return equally spaced angles (m, SIDES) of the sides of polygons, the first in the direction of slips (m, 2)."""
    return np.asarray(np.arctan2(slip[:, 1], slip[:, 0])[:, None] + 2 * np.pi * np.arange(SIDES) / SIDES)


def sides_nearby(slip: Array, finer: int = 0) -> Array:
    """Return angles (m, k) of the sides of polygons about the circle that are near to it in the direction of slips.

    With `finer` they begin where those that are less fine by one end.
    """
    ahead = np.pi / SIDES * 2.0 ** -(np.arange(SIDES_NEARBY) + (SIDES_NEARBY - 1.0) * finer)
    apart = np.sort(np.concatenate([2 * np.pi * np.arange(SIDES) / SIDES, ahead, 2 * np.pi - ahead]))
    return np.asarray(np.arctan2(slip[:, 1], slip[:, 0])[:, None] + apart)


def slips(problem: Any, displacement: Vector) -> Array | None:
    """Return the slips E_T u - slip_origin, (m, d-1) [length]; None without tangential rows."""
    if problem.tangent is None or problem.slip_origin is None:
        return None
    shape = problem.slip_origin.shape
    return np.asarray((problem.tangent @ displacement).reshape(shape) - problem.slip_origin)


# A lever of this part of the contact's other lever is the rounding of the direction of its normal.
ROUNDED_LEVER = 8 * EPS


def without_rounded_levers(stiffness: Any, normal: Any, tangent: Any) -> tuple[Any, Any]:
    """Return normal and tangential rows (CSR) without entries that are rounding, on unknowns without stiffness.

    The entries of a contact's rows at one unknown are components of one vector, the motion of the contact point. Its
    direction is rounded: the normal force of a disc, n, has the lever n x R n = 1e-18 R about the middle, where the
    friction force has R. Nothing but rows resists a rotation without stiffness, and a disc that turns by 1e17 would
    let its contact open.

    Parameters
    ----------
    stiffness : (n, n) array or sparse matrix
    normal, tangent : (m, n) and ((d-1) m, n) CSR arrays
    """
    width, stiff, size = tangent.shape[0] // max(normal.shape[0], 1), stiffness.diagonal() > 0, abs(normal)
    for k in range(width):
        size = size.maximum(abs(tangent[k::width]))
    size = size.multiply(np.where(stiff, 0.0, ROUNDED_LEVER)).tocsr()
    contacts = np.arange(normal.shape[0]).repeat(width)
    return _entries_beyond(size, normal), _entries_beyond(size[contacts], tangent)


def _entries_beyond(size: Any, rows: Any) -> Any:
    """Return rows (CSR) without the entries that are smaller than those of `size`."""
    small = abs(rows) < size
    if not small.multiply(abs(rows) > 0).nnz:
        return rows
    kept = (rows - rows.multiply(small)).tocsr()
    kept.sort_indices()
    kept.eliminate_zeros()
    return kept
