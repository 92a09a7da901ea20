"""Which rank gets which vertex of a graph: PETSc's partitioners (PTScotch, ParMETIS), on the graph's own ranks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.ranks import Ranks


def partition(ranks: Ranks, indptr: NDArray[np.int64], indices: NDArray[np.int64]) -> NDArray[np.intp]:
    """The rank of each vertex of this rank, parts of equal size with few edges between them. Collective.

    Parameters
    ----------
    ranks : Ranks
    indptr, indices : arrays of int
        Vertex i of this rank has the neighbours indices[indptr[i]:indptr[i + 1]], numbered through all ranks rank after
        rank. The graph is symmetric; a vertex may be its own neighbour.
    """
    count = len(indptr) - 1
    if ranks.size == 1:
        return np.zeros(count, dtype=np.intp)
    PETSc = petsc()
    first = ranks.first(count)
    row = np.repeat(np.arange(count), np.diff(indptr))
    other = indices != row + first  # the partitioners take no loops
    kept = np.concatenate([[0], np.cumsum(np.bincount(row[other], minlength=count))]).astype(PETSc.IntType)
    edges = indices[other].astype(PETSc.IntType)
    graph = PETSc.Mat().createAIJ(
        size=((count, None), (count, None)), csr=(kept, edges, np.ones(len(edges))), comm=ranks.comm
    )
    parts, owner = PETSc.MatPartitioning().create(ranks.comm), PETSc.IS().create(ranks.comm)
    parts.setAdjacency(graph)
    parts.setFromOptions()
    parts.apply(owner)
    found = np.array(owner.getIndices(), dtype=np.intp)
    for item in (parts, owner, graph):
        item.destroy()
    return found
