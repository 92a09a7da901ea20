"""Questions to other ranks, and their answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.ranks import Ranks
from contactqp.model.arrays import Index

Answer = Callable[[NDArray[Any], Index], tuple[NDArray[Any], ...]]


def asked(ranks: Ranks, whom: NDArray[Any], question: NDArray[Any], answer: Answer) -> tuple[NDArray[Any], ...]:
    """Row i of a question goes to rank whom[i]; the answers come back row for row. Collective.

    Parameters
    ----------
    answer : function
        From the rows that came to this rank and the ranks that they came from to arrays, row for row. All ranks call
        it once, so that it may be collective.
    """
    place = np.arange(len(question))
    came, where, asker = ranks.exchanged(whom, question, place, np.full(len(place), ranks.rank))
    back, *found = ranks.exchanged(asker, where, *answer(came, asker))
    order = np.empty(len(back), dtype=np.int64)
    order[back] = np.arange(len(back))
    return tuple(part[order] for part in found)
