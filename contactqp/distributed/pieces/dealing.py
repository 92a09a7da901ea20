"""From equal shares of the elements to pieces: the graph of neighbours is cut, and elements go where it says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from contactqp.distributed.partition import partition
from contactqp.distributed.pieces.asking import numbered
from contactqp.distributed.pieces.facets import neighbours
from contactqp.distributed.pieces.mesh_piece import MeshPiece
from contactqp.distributed.pieces.sources import OUTSIDE, Share, Source
from contactqp.distributed.ranks import Ranks
from contactqp.elements.geometry import Block
from contactqp.model.arrays import Index


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
