"""Unknowns that hold bodies which float.

Retained beside those that contacts and ties touch, they leave no rigid motion to the interior: it can be factorised.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.factorization import connected_parts, right_singular
from contactqp.model.arrays import Array

# Nodes of a body that are retained where it may float: three that are no line hold it.
FAR_APART = 4
# Motions, their largest unknown at one, that the retained unknowns hold by less than this part of the best held one, or
# of one, get an unknown more to hold them.
HARDLY_HELD = 1e-4


def unknowns_far_apart(stiffness: Any) -> NDArray[np.intp]:
    """Return the unknowns of `FAR_APART` nodes of every body, each as far from those before as the graph of K allows.

    Unknowns that K couples with the same others are those of one node.
    """
    graph = sp.csr_matrix(stiffness)
    _, label = connected_parts(graph)
    starts = np.unique(label, return_index=True)[1]
    chosen: list[NDArray[np.intp]] = [starts]
    for _ in range(FAR_APART - 1):
        order = np.lexsort((_hops_away(graph, np.concatenate(chosen)), label))
        chosen.append(order[np.append(np.flatnonzero(np.diff(label[order])), len(order) - 1)])
    nodes = np.unique(np.concatenate(chosen))
    return np.unique(np.concatenate([_of_same_node(graph, int(j)) for j in nodes])).astype(np.intp)


def _hops_away(graph: Any, starts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the distance of each unknown from the nearest start (n,), in entries of K; every body has a start."""
    from scipy.sparse.csgraph import breadth_first_order

    size = graph.shape[0]  # and the number of an unknown more, from which the search starts
    indices = np.concatenate([graph.indices, starts.astype(graph.indices.dtype)])
    rows = np.append(graph.indptr, len(indices)).astype(graph.indptr.dtype)
    searched = sp.csr_matrix((np.ones(len(indices)), indices, rows), shape=(size + 1, size + 1))
    _, before = breadth_first_order(searched, size)
    ahead = np.where(before < 0, np.arange(size + 1), before)  # who found each: nobody the first, which stays put
    hops = (before >= 0).astype(np.intp)
    while np.any(hops[ahead]):
        hops, ahead = hops + hops[ahead], ahead[ahead]
    return np.asarray(hops[:size] - 1)


def _of_same_node(graph: Any, j: int) -> NDArray[np.intp]:
    near = np.sort(graph.indices[graph.indptr[j] : graph.indptr[j + 1]])
    return np.array(
        [k for k in near if np.array_equal(np.sort(graph.indices[graph.indptr[k] : graph.indptr[k + 1]]), near)]
    )


def fixing_unknowns(motions: Array, retained: NDArray[np.intp], diagonal: Array) -> NDArray[np.intp]:
    """Return stiff unknowns that, held together with the retained ones, leave no rigid motion to the interior."""
    from scipy.linalg import qr

    if not motions.shape[1]:
        return np.zeros(0, dtype=np.intp)
    scaled = motions * np.sqrt(np.where(diagonal > 0, diagonal, np.max(diagonal, initial=0.0) or 1.0))[:, None]
    scaled = scaled / np.max(abs(scaled), axis=0)
    free = scaled
    if retained.size:
        values, rotation = right_singular(scaled[retained])
        held = values > HARDLY_HELD * max(1.0, np.max(values))  # what holds a motion by rounding holds nothing
        free = scaled @ rotation[np.count_nonzero(held) :].T
    if not free.shape[1]:
        return np.zeros(0, dtype=np.intp)
    _, _, pivots = qr(free.T, mode="economic", pivoting=True)
    return np.asarray(pivots[: free.shape[1]], dtype=np.intp)
