"""Which elements share a facet, on whatever ranks they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from contactqp.distributed.asking import asked
from contactqp.distributed.pieces.sources import OUTSIDE, Share
from contactqp.distributed.ranks import Ranks
from contactqp.elements.geometry import facet_keys, groups
from contactqp.elements.reference import REFERENCES
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index

# An odd number with bits all over (the golden ratio's): it spreads facets evenly over the ranks.
_SPREAD = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The shares with the marks of the boundary, and who is beside whom: elements of this rank, and any element."""

    shares: list[Share]
    here: Index  # (k,) numbers of elements
    there: Index  # (k,)


def neighbours(ranks: Ranks, shares: Sequence[Share], first: int) -> Neighbours:
    """Collective.

    Parameters
    ----------
    shares : sequence of Share
        Of one mesh; the elements of this rank have the numbers from `first`, share after share.

    Raises
    ------
    InvalidProblem
        Three elements share a facet: they overlap.
    """
    facets = [share.facets[:, : _corners(share)] for share in shares]
    known, local = np.unique(np.concatenate([part.ravel() for part in facets]), return_inverse=True)
    keys, element, at, begin = [], [], 0, first
    for share, part in zip(shares, facets, strict=True):
        numbers = local[at : at + part.size].reshape(part.shape)
        keys.append(facet_keys(numbers, share.kind.facet))
        element.append(begin + np.arange(len(part)) // max(share.marks.shape[1], 1))
        at, begin = at + part.size, begin + len(share.nodes)
    key, number = np.concatenate(keys), np.concatenate(element)
    other = np.full(len(number), -1)
    with ranks.together():
        _match(key, number, other)
    alone = np.flatnonzero(other < 0)
    other[alone] = _elsewhere(ranks, known[key[alone]], number[alone])
    marked, at = [], 0
    for share in shares:
        outside = other[at : at + share.marks.size].reshape(share.marks.shape) < 0
        marked.append(Share(share.kind, share.nodes, np.where(outside, share.marks | OUTSIDE, share.marks)))
        at += share.marks.size
    shared = other >= 0
    return Neighbours(marked, number[shared], other[shared])


def _corners(share: Share) -> int:
    return REFERENCES[share.kind.facet].corners


def _match(keys: Index, element: Index, other: Index) -> None:
    """Writes the element on the other side of each facet that two elements among these share."""
    order, new = groups(keys)
    start = np.flatnonzero(new)
    count = np.diff(np.append(start, len(order)))
    if count.max(initial=0) > 2:
        three = element[order[start[np.argmax(count > 2)] :][:3]]
        raise InvalidProblem(f"mesh: elements {', '.join(map(str, three))} share one facet; expected two at most")
    a, b = order[start[count == 2]], order[start[count == 2] + 1]
    other[a], other[b] = element[b], element[a]


def _elsewhere(ranks: Ranks, keys: Index, element: Index) -> Index:
    """The element of another rank that has the same facet, or -1."""
    if ranks.size == 1:
        return np.full(len(element), -1)
    mixed = (keys.astype(np.uint64) + np.uint64(1)).sum(axis=1, dtype=np.uint64) * _SPREAD >> np.uint64(32)
    whom = (mixed % np.uint64(ranks.size)).astype(np.int64)

    def answer(came: Index, _: Index) -> tuple[Index]:
        other = np.full(len(came), -1)
        with ranks.together():
            _match(came[:, :-1], came[:, -1], other)
        return (other,)

    return asked(ranks, whom, np.column_stack([keys, element]), answer)[0]
