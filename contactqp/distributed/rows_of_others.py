"""Rows of a matrix that other ranks have."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.ranks import Ranks
from contactqp.model.arrays import Vector

Index = NDArray[Any]


def rows_of_others(
    ranks: Ranks, starts: Index, asked: Index, rows: Any, columns: Index | None = None
) -> tuple[Index, Index, Vector]:
    """The entries of rows of any rank: which of those asked each is in, its column, and itself. Collective.

    Parameters
    ----------
    starts : (ranks + 1,) array of int
        Where the rows of each rank begin.
    asked : (k,) array of int
        Numbers of rows.
    rows : CSR or BSR matrix
        The rows of this rank; of a BSR matrix rows and columns are those of blocks.
    columns : array of int, optional
        What the columns of `rows` stand for.
    """
    owner = np.searchsorted(starts, asked, side="right") - 1
    place, number, asker = ranks.exchanged(owner, np.arange(len(asked)), asked, np.full(len(asked), ranks.rank))
    number = number - starts[ranks.rank]
    begin, count = rows.indptr[number], np.diff(rows.indptr)[number]
    entry = np.repeat(begin - (np.cumsum(count) - count), count) + np.arange(count.sum())
    column = rows.indices[entry] if columns is None else columns[rows.indices[entry]]
    found = ranks.exchanged(np.repeat(asker, count), np.repeat(place, count), column, rows.data[entry])
    return found[0], found[1], found[2]
