"""The bodies of K: parts of it that no entry connects, on whatever ranks they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from contactqp.distributed.pieces.nodes import Nodes
from contactqp.model.arrays import Index


def connected_parts(nodes: Nodes, meeting: Any, free: NDArray[np.bool_]) -> Index:
    """(own nodes,) the number of the part that each node is in, by the least node of each; 0 where held. Collective.

    Parameters
    ----------
    nodes : Nodes
    meeting : sparse matrix
        (nodes, elements) of this rank: which nodes its elements have.
    free : (nodes,) array of bool
        Nodes that supports do not hold altogether; the others connect nothing.
    """
    ranks = nodes.ranks
    some = sp.csr_matrix(meeting)[np.flatnonzero(free)]
    graph = sp.bmat([[None, some], [some.T, None]], format="csr")
    count, label = connected_components(graph, directed=False) if some.nnz else (0, np.zeros(some.shape[0], int))
    _, label = np.unique(label[: some.shape[0]], return_inverse=True)
    first = ranks.first(count)
    mine = np.full(len(nodes.numbers), -1)
    mine[free] = first + label
    theirs = nodes.spread(mine[nodes.own])
    joined = np.unique(np.stack([mine, theirs])[:, mine >= 0], axis=1)
    joined = ranks.gathered(joined.T)
    total = int(ranks.sum(count))
    edges = sp.coo_matrix((np.ones(len(joined)), tuple(joined.T)), shape=(total, total))
    parts, part = connected_components(edges, directed=False)
    least = np.full(parts, np.iinfo(np.int64).max)
    np.minimum.at(least, part[mine[free]], nodes.numbers[free])
    order = np.argsort(-ranks.max(-least))
    rank_of = np.empty_like(order)
    rank_of[order] = np.arange(parts)
    own = mine[nodes.own]
    return np.where(own >= 0, rank_of[part[np.maximum(own, 0)]] if parts else 0, 0).astype(np.int64)
