"""Partition a mesh over ranks: neighbours across facets, the graph's cut, and each rank's elements as a mesh."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from contactqp.distributed.distributing import partition
from contactqp.distributed.pieces.sources import OUTSIDE, Share, Source
from contactqp.distributed.ranks import Ranks, asked
from contactqp.elements.geometry import Block, facet_keys, groups
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import REFERENCES
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index

# Each rank shows so many of its codes, for the ranges of codes to become about equal.
SAMPLES = 128


def ranges(ranks: Ranks, codes: Index) -> Index:
    """Return where to cut all codes into one range a rank, about equally full: (size - 1,). Collective.

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


# Which elements share a facet, on whatever ranks they are.

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


# The elements of one rank as a mesh: facets towards other ranks are no boundary, and sets may have no part here.


@dataclass(frozen=True, eq=False)
class MeshPiece(Mesh):
    """A mesh of which other ranks have the rest; it may have no elements.

    The nodes that this rank owns come first, then those that others own; both in the order of their numbers.

    Parameters
    ----------
    outside : (p, 2) array of int
        Pairs (element, local facet) on the boundary of the whole mesh.
    own : mapping of name to (k,) arrays of int
        The nodes that this rank owns of every set and side of the whole mesh, ascending.
    faceless : tuple of str
        Node sets that hold no whole facet, on any rank.
    numbers : (N,) array of int
        Of the nodes in the whole mesh.
    owned : int
        How many of them this rank owns.
    whole : int
        How many nodes the whole mesh has.
    """

    outside: Index = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    own: Mapping[str, Index] = field(default_factory=dict)
    faceless: tuple[str, ...] = ()
    numbers: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    owned: int = 0
    whole: int = 0

    def __post_init__(self) -> None:
        if self.elements:
            super().__post_init__()

    @cached_property
    def boundary(self) -> Index:
        """The facets here of the whole mesh's boundary."""
        return self.outside

    @property
    def total(self) -> int:
        """How many nodes the whole mesh has."""
        return self.whole

    def number(self, node: int) -> int:
        """Its number in the whole mesh."""
        return int(self.numbers[node])

    def places(self, what: str, numbers: Index) -> Index:
        """The nodes of these numbers that this rank owns."""
        wanted = super().places(what, numbers)
        return np.flatnonzero(np.isin(self.numbers[: self.owned], wanted))

    def nodes(self, name: str) -> Index:
        """The nodes of a set or side that this rank owns."""
        if name not in self.own:
            raise self._unknown(name)
        return self.own[name]

    def side(self, name: str) -> tuple[Block, ...]:
        """The facets of this rank; none where other ranks have them all."""
        if name not in self.own:
            raise self._unknown(name)
        if name in self.faceless:
            raise InvalidProblem(f"side {name!r} has no faces: no boundary facet has all its nodes in that node set")
        if name in self.sides:
            return self.facets_of(self.sides[name])
        return self.facets_within(self.node_sets[name]) if name in self.node_sets else ()

    def with_names(self, own: Mapping[str, Index], faceless: tuple[str, ...]) -> MeshPiece:
        """The same piece with `own` and `faceless`, which the ranks find together once they have their pieces."""
        mesh = copy.copy(self)
        object.__setattr__(mesh, "own", own)
        object.__setattr__(mesh, "faceless", faceless)
        return mesh

    def _unknown(self, name: str) -> InvalidProblem:
        known = ", ".join(map(repr, sorted(self.own))) or "none"
        return InvalidProblem(f"mesh: there is no set {name!r}; it has {known}")


# From equal shares of the elements to pieces: the graph of neighbours is cut, and elements go where it says.


@dataclass(frozen=True, eq=False)
class DealtMesh:
    """One rank's piece of one mesh.

    Attributes
    ----------
    mesh : MeshPiece
    owners : (N,) array of int
        The rank that owns each of its nodes.
    """

    mesh: MeshPiece
    owners: Index


def deal(ranks: Ranks, sources: Sequence[Source]) -> list[DealtMesh]:
    """The pieces of meshes that are cut together, so that every rank has as many elements as any other. Collective.

    Raises
    ------
    InvalidProblem
        A mesh that is no good, on any rank.
    """
    shares = [source.shares() for source in sources]
    counts = [sum(len(share.nodes) for share in some) for some in shares]
    first = ranks.first(sum(counts))
    here, there = [], []
    for i, some in enumerate(shares):
        found = neighbours(ranks, some, first + sum(counts[:i]))
        shares[i] = [sources[i].marked(share) for share in found.shares]
        here.append(found.here - first)
        there.append(found.there)
    owner = _cut(ranks, sum(counts), np.concatenate(here), np.concatenate(there))
    pieces, at = [], 0
    for i, source in enumerate(sources):
        some, shares[i] = shares[i], []
        for place, share in enumerate(some):
            whom = owner[at : at + len(share.nodes)]
            at += len(share.nodes)
            some[place] = Share(share.kind, *ranks.exchanged(whom, share.nodes, share.marks))
        pieces.append(_piece(ranks, source, some))
    return pieces


def _cut(ranks: Ranks, count: int, here: Index, there: Index) -> Index:
    """The rank that each element of this rank goes to."""
    order = np.argsort(here, kind="stable")
    indptr = np.concatenate([[0], np.cumsum(np.bincount(here, minlength=count))])
    return partition(ranks, indptr, there[order]).astype(np.int64)


def _piece(ranks: Ranks, source: Source, shares: list[Share]) -> DealtMesh:
    flat = [np.zeros(0, dtype=np.int64), *[share.nodes.ravel() for share in shares]]
    codes, local = np.unique(np.concatenate(flat), return_inverse=True)
    numbers, owners, total = numbered(ranks, codes)
    points, members = source.nodes(codes)
    order = np.argsort(owners != ranks.rank, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    owners, members = owners[order], members[order]
    blocks, marks, at = [], [], 0
    for share in shares:
        nodes = place[local[at : at + share.nodes.size].reshape(share.nodes.shape)]
        at += share.nodes.size
        if len(nodes):
            blocks.append(Block(share.kind, nodes))
            marks.append(share.marks)
    sets = {name: np.flatnonzero(members & (1 << i)) for i, name in enumerate(source.node_sets)}
    sides = {name: _marked(marks, 1 << bit) for bit, name in enumerate(source.sides, start=1)}
    with ranks.together():
        mesh = MeshPiece(
            points[order],
            tuple(blocks),
            {name: nodes for name, nodes in sets.items() if len(nodes)},
            {name: pairs for name, pairs in sides.items() if len(pairs)},
            outside=_marked(marks, OUTSIDE),
            numbers=numbers[order],
            owned=int(np.count_nonzero(owners == ranks.rank)),
            whole=total,
        )
    return DealtMesh(_named(ranks, source, mesh, owners), owners)


def _marked(marks: Sequence[Index], bit: int) -> Index:
    """Pairs (element, local facet) with that bit; elements are counted block after block."""
    found, first = [np.zeros((0, 2), dtype=np.int64)], 0
    for part in marks:
        pairs = np.argwhere(part & bit)
        pairs[:, 0] += first
        found.append(pairs)
        first += len(part)
    return np.concatenate(found)


def _named(ranks: Ranks, source: Source, mesh: MeshPiece, owners: Index) -> MeshPiece:
    """With the own nodes of sides that facets of other ranks give, and the sets that hold no facet."""
    numbers, owned = mesh.numbers, mesh.owned
    bits = np.zeros(len(numbers), dtype=np.int64)
    for bit, name in enumerate(source.sides):
        for block in mesh.facets_of(mesh.sides[name]) if name in mesh.sides else ():
            bits[block.nodes] |= 1 << bit
    ghost = np.flatnonzero((owners != ranks.rank) & (bits > 0))
    came, told = ranks.exchanged(owners[ghost], numbers[ghost], bits[ghost])
    np.bitwise_or.at(bits, np.searchsorted(numbers[:owned], came), told)
    own = {name: np.flatnonzero(bits[:owned] & (1 << bit)) for bit, name in enumerate(source.sides)}
    faceless = []
    for name in source.node_sets:
        nodes = mesh.node_sets.get(name, np.zeros(0, dtype=np.int64))
        own[name] = nodes[nodes < owned]
        if name not in source.sides and not ranks.any(len(mesh.facets_within(nodes)) > 0):
            faceless.append(name)
    return mesh.with_names(own, tuple(faceless))
