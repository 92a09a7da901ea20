"""The boundary of a mesh: facets that belong to one element only, and finding facets by their nodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.geometry import Block
from contactqp.elements.reference import REFERENCES
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index


def boundary(blocks: Sequence[Block]) -> Index:
    """The (p, 2) pairs (element, local facet) of the facets that belong to one element only.

    Raises
    ------
    InvalidProblem
        A facet belongs to three elements: they overlap.
    """
    pairs, keys = [], []
    first = 0
    for block in blocks:
        elements, local = np.divmod(np.arange(len(block) * len(block.kind.facets)), len(block.kind.facets))
        pairs.append(np.stack([elements + first, local], axis=1))
        keys.append(facet_keys(block.nodes[:, list(block.kind.facets)].reshape(len(elements), -1), block.kind.facet))
        first += len(block)
    pair, key = np.concatenate(pairs), np.concatenate(keys)
    order, new = groups(key)
    starts = np.flatnonzero(new)
    count = np.diff(np.append(starts, len(order)))
    if count.max(initial=0) > 2:
        three = pair[order[starts[np.argmax(count > 2)] :][:3], 0]
        raise InvalidProblem(f"mesh: elements {', '.join(map(str, three))} share one facet; expected two at most")
    single = order[starts[count == 1]]
    facets: Index = pair[np.sort(single)]
    return facets


def facet_keys(facets: Index, kind: str) -> Index:
    """What tells facets apart whatever their turn: their smallest corners in ascending order, (p, 2) or (p, 3).

    Two faces of a mesh that share three corners are one face, so three corners are enough for four.
    """
    corners = np.sort(facets[:, : REFERENCES[kind].corners], axis=1)
    return corners[:, : min(3, corners.shape[1])]


def find(facets: Index, among: Index) -> Index:
    """For each row of `facets` (keys) its place in `among` (distinct keys), or -1."""
    order, new = groups(np.concatenate([among, facets]))
    group = np.empty(len(order), dtype=np.int64)
    group[order] = np.cumsum(new) - 1
    place = np.full(len(order), -1)
    place[group[: len(among)]] = np.arange(len(among))
    return place[group[len(among) :]]


def groups(keys: Index) -> tuple[Index, NDArray[np.bool_]]:
    """An order that puts equal rows side by side, and where in it a new row begins."""
    base = int(keys.max(initial=0)) + 1
    if keys.min(initial=0) >= 0 and base ** keys.shape[1] <= np.iinfo(np.int64).max:
        packed = keys @ base ** np.arange(keys.shape[1])  # one number a row sorts five times as fast
        order = np.argsort(packed, kind="stable")
    else:
        order = np.lexsort(keys.T)
    ordered = keys[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order, new
