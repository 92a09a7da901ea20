"""E_N and E_T from relative motions: each contact moves as a weighted sum of node displacements."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array
from contactqp.model.problem_data import is_whole

Places = NDArray[np.int64]


def contact_rows(
    contact: Places, weight: Array, unknowns: Places, normals: Array, tangents: Array, shape: tuple[int, int]
) -> tuple[Any, Any]:
    """E_N and E_T of contacts that approach by -n.w and slip by t.w, w = sum over the entries of weight u_node.

    Entries of one contact add up. A node that meets an obstacle is one entry of weight 1; a node that meets a facet has
    further ones of weight -N_j for the facet's nodes.

    Parameters
    ----------
    contact : (e,) array of int
        The contact that an entry belongs to.
    weight : (e,) array [-]
    unknowns : (e, d) array of int
        Where the displacement of the entry's node stands in u.
    normals : (e, d) array
        n, unit vectors out of the obstacle.
    tangents : (e, d-1, d) array
        Orthonormal.
    shape : (contacts, n)

    Returns
    -------
    (contacts, n) and ((d-1) contacts, n) sparse arrays, the second contact-major.
    """
    contacts, n = shape
    d = unknowns.shape[1]
    along = (np.arange(d - 1) + (d - 1) * contact[:, np.newaxis])[:, :, np.newaxis]
    E_N = _sum((-weight[:, np.newaxis] * normals, contact[:, np.newaxis], unknowns), (contacts, n))
    E_T = _sum((weight[:, None, None] * tangents, along, unknowns[:, np.newaxis, :]), ((d - 1) * contacts, n))
    return E_N, E_T


def _sum(entries: tuple[Array, Places, Places], shape: tuple[int, int]) -> Any:
    values, rows, columns = (np.broadcast_to(part, entries[0].shape).ravel() for part in entries)
    matrix = sp.csr_array(sp.coo_array((values, (rows, columns)), shape=shape))
    matrix.eliminate_zeros()
    return matrix


def count_unknowns(largest: int, dimension: int | None) -> int:
    """n: as stated, else one more than the largest number in use.

    Raises
    ------
    InvalidProblem
        Unknowns are numbered beyond the stated dimension, or it is no whole number.
    """
    if dimension is None:
        return largest + 1
    if not is_whole(dimension):
        raise InvalidProblem(f"dimension: expected the number of all unknowns, got {dimension!r}")
    if largest >= dimension:
        raise InvalidProblem(f"unknowns: expected numbers from 0 to {dimension - 1}, got {largest}")
    return dimension
