"""From element matrices to one sparse matrix: linear in the number of elements, and symmetric to the last digit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.model.arrays import Index


@dataclass(frozen=True, eq=False)
class Pattern:
    """Which pairs of nodes meet in an element, as compressed rows, and where each pair of each element stands in them.

    Attributes
    ----------
    indptr, indices : arrays of int
        Row i holds the nodes indices[indptr[i]:indptr[i + 1]], ascending.
    slots : (total of E n^2,) array of int
        The place in `indices` of every pair (first node, second node) of every element, element by element.
    """

    indptr: Index
    indices: Index
    slots: Index


def pattern(connectivities: Sequence[Index], nodes: int) -> Pattern:
    """The pattern of elements with the given (E, n) node numbers among `nodes` nodes, by two counting sorts."""
    rows = np.concatenate([np.repeat(c, c.shape[1], axis=1).ravel() for c in connectivities])
    columns = np.concatenate([np.tile(c, (1, c.shape[1])).ravel() for c in connectivities])
    order = _counting_sort(columns, nodes)
    order = order[_counting_sort(rows[order], nodes)]
    row, column = rows[order], columns[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (row[1:] != row[:-1]) | (column[1:] != column[:-1])
    slots = np.empty(len(order), dtype=np.int64)
    slots[order] = np.cumsum(new) - 1
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row[new], minlength=nodes))])
    return Pattern(indptr, column[new], slots)


def assemble(where: Pattern, entries: NDArray[np.float64]) -> Any:
    """The (nodes d, nodes d) CSC matrix of symmetric element matrices; as `blocks_of_nodes`."""
    return from_blocks(where, blocks_of_nodes(where, entries))


def blocks_of_nodes(where: Pattern, entries: NDArray[np.float64]) -> NDArray[np.float64]:
    """The blocks (pairs in the pattern, d, d) of symmetric element matrices, summed up.

    Parameters
    ----------
    where : Pattern
    entries : (d, d, total of E n^2) array
        entries[a, b, s] couples axis a of the first node of pair s with axis b of its second node.

    Notes
    -----
    Both (i, j) and (j, i) add up their elements one after the other in the order of the elements, so that symmetric
    element matrices give a matrix that is symmetric to the last digit.
    """
    d, count = entries.shape[0], len(where.indices)
    blocks = np.empty((count, d, d))
    for a in range(d):
        for b in range(d):
            blocks[:, a, b] = np.bincount(where.slots, weights=entries[a, b], minlength=count)
    return blocks


def from_blocks(where: Pattern, blocks: NDArray[np.float64]) -> Any:
    """The (nodes d, nodes d) CSC matrix of these blocks; its rows are its columns."""
    size = blocks.shape[1] * (len(where.indptr) - 1)
    # The sparse direct solvers take 32-bit indices, as SciPy does where they are enough.
    whole = np.int32 if blocks.size < np.iinfo(np.int32).max else np.int64
    indices, indptr = where.indices.astype(whole), where.indptr.astype(whole)
    rows = sp.bsr_array((blocks, indices, indptr), shape=(size, size)).tocsr()
    return sp.csc_array((rows.data, rows.indices, rows.indptr), shape=(size, size))


def _counting_sort(keys: Index, largest: int) -> Index:
    """The stable order of whole numbers below `largest`: transposing one compressed row is a counting sort."""
    row = sp.csr_array((np.arange(len(keys)), keys, [0, len(keys)]), shape=(1, largest))
    order: Index = row.tocsc().data
    return order
