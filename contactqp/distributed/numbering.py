"""New numbers for the unknowns: the nodes of rank 0 first, then those of rank 1, ..., on each in their old order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.asking import asked
from contactqp.distributed.partition import partition
from contactqp.distributed.ranks import Ranks


class Numbering:
    """What a rank knows of the new numbers: those of the blocks of its share; it asks for others. Collective.

    Parameters
    ----------
    ranks : Ranks
    stiffness : CSR or BSR matrix
        The rows of K of this rank's share, which follow those of the rank before, over all unknowns.
    size : int
        Unknowns of a block.

    Attributes
    ----------
    owner : (blocks of the share,) array
        The rank that each block goes to.
    first : int
        The old number of the first block of the share.
    """

    def __init__(self, ranks: Ranks, stiffness: Any, size: int) -> None:
        self.ranks, self.size = ranks, size
        indptr, indices = stiffness.indptr, stiffness.indices
        self.owner = partition(ranks, indptr.astype(np.int64), indices.astype(np.int64))
        counts = np.bincount(self.owner, minlength=ranks.size)
        every = ranks.gathered(counts[None, :])  # how many each share has for each rank
        self.first = ranks.first(len(self.owner))
        self._share_ends = np.cumsum(every.sum(axis=1))
        self._ends = np.cumsum(every.sum(axis=0))
        before = self._ends - every.sum(axis=0) + every[: ranks.rank].sum(axis=0)
        order = np.argsort(self.owner, kind="stable")
        self._new = np.empty(len(order), dtype=np.int64)
        self._new[order] = np.repeat(before - (np.cumsum(counts) - counts), counts) + np.arange(len(order))

    def new_blocks(self, blocks: NDArray[Any]) -> NDArray[np.int64]:
        """The new numbers of blocks, in any order and more than once. Collective."""
        distinct, place = np.unique(blocks, return_inverse=True)
        whom = np.searchsorted(self._share_ends, distinct, side="right")
        (found,) = asked(self.ranks, whom, distinct, lambda came, _: (self._new[came - self.first],))
        return np.asarray(found[place])

    def new(self, unknowns: NDArray[Any]) -> NDArray[np.int64]:
        """The new numbers of unknowns. Collective."""
        return np.asarray(self.size * self.new_blocks(unknowns // self.size) + unknowns % self.size)

    def owner_of(self, new: NDArray[np.int64]) -> NDArray[np.intp]:
        """The ranks of unknowns in their new numbers."""
        return np.asarray(np.searchsorted(self.size * self._ends, new, side="right"))
