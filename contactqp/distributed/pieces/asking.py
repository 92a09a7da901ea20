"""Which rank answers for what, of things that many ranks know."""

from __future__ import annotations

import numpy as np

from contactqp.distributed.asking import asked
from contactqp.distributed.ranks import Ranks
from contactqp.model.arrays import Index

# Each rank shows so many of its codes, for the ranges of codes to become about equal.
SAMPLES = 128


def ranges(ranks: Ranks, codes: Index) -> Index:
    """Where to cut all codes into one range for each rank, about equally full: (size - 1,). Collective.

    Parameters
    ----------
    codes : (k,) array of int
        Those of this rank, ascending.
    """
    shown = codes[np.linspace(0, len(codes) - 1, min(SAMPLES, len(codes))).astype(np.int64)]
    every = np.sort(ranks.gathered(shown))
    return every[len(every) * np.arange(1, ranks.size) // ranks.size]


def numbered(ranks: Ranks, codes: Index) -> tuple[Index, Index, int]:
    """The number of each code among the distinct ones of all ranks in ascending order, and who owns it. Collective.

    Parameters
    ----------
    codes : (k,) array of int
        Those of this rank, distinct and ascending.

    Returns
    -------
    numbers, owners : (k,) arrays of int
        The owner is the lowest rank that has the code.
    total : int
        How many distinct codes there are.
    """
    total = 0

    def answer(came: Index, asker: Index) -> tuple[Index, Index]:
        nonlocal total
        distinct, inverse = np.unique(came, return_inverse=True)
        owner = np.full(len(distinct), ranks.size)
        np.minimum.at(owner, inverse, asker)
        total = int(ranks.sum(len(distinct)))
        return ranks.first(len(distinct)) + inverse, owner[inverse]

    whom = np.searchsorted(ranges(ranks, codes), codes, side="right")
    numbers, owners = asked(ranks, whom, codes, answer)
    return numbers, owners, total
