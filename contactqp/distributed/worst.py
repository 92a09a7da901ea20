"""Where on the ranks the worst of something is, and what its rank says of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.problem import Numbers
from contactqp.distributed.ranks import Ranks
from contactqp.model.arrays import Vector


def worst(ranks: Ranks, *values: Vector) -> list[float]:
    """The largest of each array on any rank, NaN where one is; 0 of nothing. Collective."""
    here = np.array([[np.max(part, initial=0.0) for part in values]])
    return [float(value) for value in np.max(ranks.gathered(here), axis=0)]


def said_of_worst(ranks: Ranks, values: Vector, numbers: Numbers, say: Callable[[int], str]) -> str:
    """What the rank of the largest value, or of NaN, says of its place there. Collective.

    Parameters
    ----------
    values : (a,) array, at least one on some rank
    numbers : (a,) array of int
        How one process would number them: of equals the first counts.
    say : function
        From a place on this rank to a sentence.
    """
    size = np.where(np.isnan(values), np.inf, values)
    order = np.lexsort((numbers, -size, ~np.isnan(values)))
    best = [(bool(np.isnan(values[i])), float(size[i]), -int(numbers[i])) for i in order[:1]]
    return str(_said(ranks, best, lambda: say(int(order[0]))))


def said_of_first(ranks: Ranks, flags: NDArray[np.bool_], numbers: Numbers, say: Callable[[int], str]) -> str | None:
    """What the rank with the first flag that is set says of its place; None where none is set. Collective."""
    places = np.flatnonzero(flags)
    first = places[np.argsort(numbers[places], kind="stable")][:1]
    return _said(ranks, [-int(numbers[i]) for i in first], lambda: say(int(first[0])))


def _said(ranks: Ranks, best: list[Any], say: Callable[[], str]) -> str | None:
    """What the rank of the largest entry says."""
    every = [(entry, -rank) for rank, entries in enumerate(ranks.comm.allgather(best)) for entry in entries]
    if not every:
        return None
    chosen = -max(every)[1]
    said: str = ranks.comm.bcast(say() if ranks.rank == chosen else None, root=chosen)
    return said
