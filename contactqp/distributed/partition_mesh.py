"""Partition meshes over ranks: equal shares of the elements, their neighbours, the cut of the graph, and each rank's
elements as a mesh.

Elements come from shapes, of which each rank generates a slab, and from files, which one rank reads and distributes.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from contactqp.distributed.distributing import partition_graph
from contactqp.distributed.ranks import Ranks, ask_ranks
from contactqp.elements.mesh import Mesh
from contactqp.elements.mesh_files import Lattice
from contactqp.elements.reference_elements import REFERENCES, Block, Reference, facet_keys, groups
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.model.arrays import Array, Index

# Bit 0 of a facet's marks is set on the boundary of the whole mesh, bit 1 + i on side i.
OUTSIDE = 1
# The bits of a 64-bit number besides bit 0 and the sign.
MOST_NAMES = 62


@dataclass(frozen=True, eq=False)
class Share:
    """Elements of one kind on one rank.

    Attributes
    ----------
    kind : the reference element
    nodes : (E, n) array of int, codes of the nodes, integers in the order of the node numbers of the whole mesh marks :
    (E, facets) array of int, bits of each facet: OUTSIDE, and those of the sides
    """

    kind: Reference
    nodes: Index
    marks: Index

    @property
    def facets(self) -> Index:
        """Return the nodes (E facets, k) of all facets, element by element."""
        return self.nodes[:, list(self.kind.facets)].reshape(self.marks.size, len(self.kind.facets[0]))


class LatticeSource:
    """A shape, of which each rank generates a slab of each patch only.

    All methods are collective, as those of `FileSource`.

    Attributes
    ----------
    sides, node_sets : tuple of str, the names of the sides and of the node sets
    """

    def __init__(self, ranks: Ranks, lattice: Lattice) -> None:
        self.ranks, self.lattice = ranks, lattice
        self.sides, self.node_sets = tuple(lattice.sides), tuple(lattice.nearest)

    def shares(self) -> list[Share]:
        """Return an equal share of the elements, the same kinds in the same order on all ranks."""
        codes = self.lattice.elements(self.ranks.rank, self.ranks.size)
        marks = np.zeros((len(codes), len(self.lattice.reference.facets)), dtype=np.int64)
        return [Share(self.lattice.reference, codes, marks)]

    def marked(self, share: Share) -> Share:
        """Return the share, whose bits OUTSIDE are set, with the bits of the sides."""
        marks = share.marks.copy()
        element, facet = np.nonzero(marks & OUTSIDE)
        nodes = np.take_along_axis(share.nodes[element], np.array(share.kind.facets)[facet], axis=1)
        for bit, name in enumerate(self.sides, start=1):
            inside = self.lattice.on_side(name, nodes.ravel()).reshape(nodes.shape).all(axis=1)
            marks[element[inside], facet[inside]] |= 1 << bit
        return Share(share.kind, share.nodes, marks)

    def nodes(self, codes: Index) -> tuple[Array, Index]:
        """Return coordinates (N, d) of nodes and the bits (N,) of their node sets, bit i of set i."""
        points = np.asarray(self.lattice.position(self.lattice.keys(codes)))
        bits = np.zeros(len(codes), dtype=np.int64)
        for i, point in enumerate(self.lattice.nearest.values()):
            apart = np.linalg.norm(points - point, axis=1)
            best = int(np.argmin(apart)) if len(codes) else -1
            mine = (float(apart[best]), int(codes[best])) if len(codes) else (np.inf, -1)
            bits[codes == min(self.ranks.comm.allgather(mine))[1]] |= 1 << i
        return points, bits


class FileSource:
    """A mesh that rank 0 reads and keeps until it is distributed, so that rank 0 needs memory for the whole mesh.

    Parameters
    ----------
    ranks : Ranks, the processes
    read : function
        Returns the mesh; called by rank 0 only. Its ContactQPError is raised on all ranks.
    """

    def __init__(self, ranks: Ranks, read: Callable[[], Mesh]) -> None:
        self.ranks = ranks
        self._mesh: Mesh | None = None
        with ranks.raising_together():
            if ranks.rank == 0:
                self._mesh = read()
                if max(len(self._mesh.sides), len(self._mesh.node_sets)) > MOST_NAMES:
                    raise Unsupported(f"mesh: expected at most {MOST_NAMES} sides and sets to be dealt out, got more")
        mesh = self._mesh
        names = None if mesh is None else (tuple(mesh.sides), tuple(mesh.node_sets), mesh.dimension)
        self.sides, self.node_sets, self.dimension = ranks.broadcast(names)

    def shares(self) -> list[Share]:
        """Return equal shares of the elements of each kind in their order, which rank 0 distributes."""
        mesh = self._mesh
        kinds = self.ranks.broadcast(None if mesh is None else [block.kind.name for block in mesh.blocks])
        found, first = [], 0
        for i, name in enumerate(kinds):
            kind = REFERENCES[name]
            nodes = np.zeros((0, len(kind.nodes)), dtype=np.int64)
            marks = np.zeros((0, len(kind.facets)), dtype=np.int64)
            if mesh is not None:
                nodes, marks = mesh.blocks[i].nodes, self._marks(mesh, first, len(mesh.blocks[i]), len(kind.facets))
                first += len(nodes)
            share = np.arange(len(nodes)) * self.ranks.size // max(len(nodes), 1)
            found.append(Share(kind, *self.ranks.exchange(share, nodes, marks)))
        return found

    def _marks(self, mesh: Mesh, first: int, count: int, facets: int) -> Index:
        marks = np.zeros((count, facets), dtype=np.int64)
        for bit, name in enumerate(self.sides, start=1):
            pairs = mesh.sides[name]
            mine = pairs[(pairs[:, 0] >= first) & (pairs[:, 0] < first + count)]
            marks[mine[:, 0] - first, mine[:, 1]] |= 1 << bit
        return marks

    def marked(self, share: Share) -> Share:
        """Return the share unchanged, as it has all bits."""
        return share

    def nodes(self, codes: Index) -> tuple[Array, Index]:
        """Return coordinates (N, d) of nodes and the bits (N,) of their node sets; rank 0 drops the mesh."""
        mesh = self._mesh
        bits = np.zeros(0 if mesh is None else len(mesh.points), dtype=np.int64)
        if mesh is not None:
            for i, name in enumerate(self.node_sets):
                bits[mesh.node_sets[name]] |= 1 << i

        def found(asked: Index, _: Index) -> tuple[Array, Index]:
            return (np.zeros((0, self.dimension)) if mesh is None else mesh.points[asked]), bits[asked]

        points, members = ask_ranks(self.ranks, np.zeros(len(codes), dtype=np.int64), codes, found)
        self._mesh = None  # the whole mesh is distributed
        return points, members


Source = LatticeSource | FileSource

# The number of samples of codes of each rank, by which ranges of about equal size are chosen.
SAMPLES = 128


def number_codes(ranks: Ranks, codes: Index) -> tuple[Index, Index, int]:
    """Number codes among the distinct ones of all ranks in ascending order, and find their owners. Collective.

    Parameters
    ----------
    ranks : the processes
    codes : (k,) array of int, the codes of this rank, distinct and ascending

    Returns
    -------
    numbers, owners : (k,) arrays of int
        The number of each code, and its owner, the lowest rank that has it.
    total : int
        The number of distinct codes.
    """
    total = 0

    def number(asked: Index, sender: Index) -> tuple[Index, Index]:
        nonlocal total
        distinct, inverse = np.unique(asked, return_inverse=True)
        owner = np.full(len(distinct), ranks.size)
        np.minimum.at(owner, inverse, sender)
        total = int(ranks.sum(len(distinct)))
        return ranks.offset(len(distinct)) + inverse, owner[inverse]

    # Each rank numbers one range of codes; samples of all codes give the limits of about equal ranges.
    shown = codes[np.linspace(0, len(codes) - 1, min(SAMPLES, len(codes))).astype(np.int64)]
    every = np.sort(ranks.gathered(shown))
    limits = every[len(every) * np.arange(1, ranks.size) // ranks.size]
    numbers, owners = ask_ranks(ranks, np.searchsorted(limits, codes, side="right"), codes, number)
    return numbers, owners, total


# The multiplier of a hash (golden ratio), which distributes facets evenly over the ranks.
_SPREAD = np.uint64(0x9E3779B97F4A7C15)


def neighbours(ranks: Ranks, shares: Sequence[Share], first: int) -> tuple[list[Share], Index, Index]:
    """Find the elements that share a facet, across ranks. Collective.

    Raises InvalidProblem: three elements share a facet: they overlap.

    Parameters
    ----------
    ranks : the processes
    shares : sequence of Share, this rank's shares of one mesh
    first : the number of this rank's first element; they are numbered share after share

    Returns
    -------
    marked : list of Share
        The shares with the marks of the boundary.
    here, there : (k,) arrays of int
        The numbers of elements of this rank, and of their neighbours on any rank.
    """
    facets = [share.facets[:, : REFERENCES[share.kind.facet].corners] for share in shares]
    corners, local = np.unique(np.concatenate([part.ravel() for part in facets]), return_inverse=True)
    keys, element, at, begin = [], [], 0, first
    for share, part in zip(shares, facets, strict=True):
        numbers = local[at : at + part.size].reshape(part.shape)
        keys.append(facet_keys(numbers, share.kind.facet))
        element.append(begin + np.arange(len(part)) // max(share.marks.shape[1], 1))
        at, begin = at + part.size, begin + len(share.nodes)
    key, number = np.concatenate(keys), np.concatenate(element)
    other = np.full(len(number), -1)
    with ranks.raising_together():
        _match(key, number, other)
    alone = np.flatnonzero(other < 0)
    other[alone] = _on_other_rank(ranks, corners[key[alone]], number[alone])
    marked, at = [], 0
    for share in shares:
        outside = other[at : at + share.marks.size].reshape(share.marks.shape) < 0
        marked.append(Share(share.kind, share.nodes, np.where(outside, share.marks | OUTSIDE, share.marks)))
        at += share.marks.size
    shared = other >= 0
    return marked, number[shared], other[shared]


def _match(keys: Index, element: Index, other: Index) -> None:
    """Store the neighbouring element of each facet that two of these elements share."""
    order, new = groups(keys)
    start = np.flatnonzero(new)
    count = np.diff(np.append(start, len(order)))
    if count.max(initial=0) > 2:
        three = element[order[start[np.argmax(count > 2)] :][:3]]
        raise InvalidProblem(f"mesh: elements {', '.join(map(str, three))} share one facet; expected two at most")
    a, b = order[start[count == 2]], order[start[count == 2] + 1]
    other[a], other[b] = element[b], element[a]


def _on_other_rank(ranks: Ranks, keys: Index, element: Index) -> Index:
    """Return the element of another rank that has the same facet, or -1."""
    if ranks.size == 1:
        return np.full(len(element), -1)
    mixed = (keys.astype(np.uint64) + np.uint64(1)).sum(axis=1, dtype=np.uint64) * _SPREAD >> np.uint64(32)
    owner = (mixed % np.uint64(ranks.size)).astype(np.int64)

    def matched(facets: Index, _: Index) -> tuple[Index]:
        other = np.full(len(facets), -1)
        with ranks.raising_together():
            _match(facets[:, :-1], facets[:, -1], other)
        return (other,)

    return ask_ranks(ranks, owner, np.column_stack([keys, element]), matched)[0]


@dataclass(frozen=True, eq=False)
class MeshPiece(Mesh):
    """The elements of one rank as a mesh, possibly without elements, and with sets that may be empty here.

    The nodes that this rank owns come first, then those of others, both in the order of their numbers. Facets towards
    elements of other ranks are not boundary.

    Attributes
    ----------
    boundary : (p, 2) array of int, pairs (element, local facet) on the boundary of the whole mesh
    own : mapping of name to (k,) arrays of int
        The nodes that this rank owns of every set and side of the whole mesh, ascending.
    faceless : tuple of str, node sets that contain no whole facet on any rank
    numbers : (N,) array of int, the numbers of the nodes in the whole mesh
    owners : (N,) array of int, the rank that owns each node
    owned : the number of nodes that this rank owns
    total : the number of nodes of the whole mesh
    """

    boundary: Index = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    own: Mapping[str, Index] = field(default_factory=dict)
    faceless: tuple[str, ...] = ()
    numbers: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    owners: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    owned: int = 0
    total: int = 0

    def __post_init__(self) -> None:
        if self.elements:
            super().__post_init__()

    def number(self, node: int) -> int:
        """Return the number of a node in the whole mesh."""
        return int(self.numbers[node])

    def places(self, what: str, numbers: Index) -> Index:
        """Return the nodes with these numbers that this rank owns."""
        wanted = super().places(what, numbers)
        return np.flatnonzero(np.isin(self.numbers[: self.owned], wanted))

    def nodes(self, name: str) -> Index:
        """Return the nodes of a set or side that this rank owns."""
        if name not in self.own:
            raise self._unknown(name)
        return self.own[name]

    def side(self, name: str) -> tuple[Block, ...]:
        """Return the facets of a side on this rank, possibly none."""
        if name not in self.own:
            raise self._unknown(name)
        if name in self.faceless:
            raise InvalidProblem(f"side {name!r} has no faces: no boundary facet has all its nodes in that node set")
        if name in self.sides:
            return self.facets_of(self.sides[name])
        return self.facets_within(self.node_sets[name]) if name in self.node_sets else ()

    def with_names(self, own: Mapping[str, Index], faceless: tuple[str, ...]) -> MeshPiece:
        """Return the piece with `own` and `faceless`, which the ranks determine together after partitioning."""
        mesh = copy.copy(self)
        object.__setattr__(mesh, "own", own)
        object.__setattr__(mesh, "faceless", faceless)
        return mesh

    def _unknown(self, name: str) -> InvalidProblem:
        names = ", ".join(map(repr, sorted(self.own))) or "none"
        return InvalidProblem(f"mesh: there is no set {name!r}; it has {names}")


def partition_meshes(ranks: Ranks, sources: Sequence[Source]) -> list[MeshPiece]:
    """Partition meshes together into equal numbers of elements for all ranks, and return the pieces. Collective.

    Raises InvalidProblem: a mesh is invalid, on any rank.
    """
    shares = [source.shares() for source in sources]
    counts = [sum(len(share.nodes) for share in some) for some in shares]
    first = ranks.offset(sum(counts))
    here, there = [], []
    for i, some in enumerate(shares):
        marked, element, other = neighbours(ranks, some, first + sum(counts[:i]))
        shares[i] = [sources[i].marked(share) for share in marked]
        here.append(element - first)
        there.append(other)
    element, other = np.concatenate(here), np.concatenate(there)
    indptr = np.append(0, np.cumsum(np.bincount(element, minlength=sum(counts))))
    owner = partition_graph(ranks, indptr, other[np.argsort(element, kind="stable")]).astype(np.int64)
    pieces, at = [], 0
    for i, source in enumerate(sources):
        some, shares[i] = shares[i], []
        for place, share in enumerate(some):
            destination = owner[at : at + len(share.nodes)]
            at += len(share.nodes)
            some[place] = Share(share.kind, *ranks.exchange(destination, share.nodes, share.marks))
        pieces.append(_piece(ranks, source, some))
    return pieces


def _piece(ranks: Ranks, source: Source, shares: list[Share]) -> MeshPiece:
    flat = [np.zeros(0, dtype=np.int64), *[share.nodes.ravel() for share in shares]]
    codes, local = np.unique(np.concatenate(flat), return_inverse=True)
    numbers, owners, total = number_codes(ranks, codes)
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
    with ranks.raising_together():
        mesh = MeshPiece(
            points[order],
            tuple(blocks),
            {name: nodes for name, nodes in sets.items() if len(nodes)},
            {name: pairs for name, pairs in sides.items() if len(pairs)},
            boundary=_marked(marks, OUTSIDE),
            numbers=numbers[order],
            owners=owners,
            owned=int(np.count_nonzero(owners == ranks.rank)),
            total=total,
        )
    return _named(ranks, source, mesh)


def _marked(marks: Sequence[Index], bit: int) -> Index:
    """Return pairs (element, local facet) whose marks have a bit; elements are numbered block after block."""
    found, first = [np.zeros((0, 2), dtype=np.int64)], 0
    for part in marks:
        pairs = np.argwhere(part & bit)
        pairs[:, 0] += first
        found.append(pairs)
        first += len(part)
    return np.concatenate(found)


def _named(ranks: Ranks, source: Source, mesh: MeshPiece) -> MeshPiece:
    """Return the piece with its own nodes of all sets and sides, and the sets without a whole facet on any rank."""
    numbers, owners, owned = mesh.numbers, mesh.owners, mesh.owned
    bits = np.zeros(len(numbers), dtype=np.int64)
    for bit, name in enumerate(source.sides):
        for block in mesh.facets_of(mesh.sides[name]) if name in mesh.sides else ():
            bits[block.nodes] |= 1 << bit
    ghost = np.flatnonzero((owners != ranks.rank) & (bits > 0))
    node, added = ranks.exchange(owners[ghost], numbers[ghost], bits[ghost])  # facets of other ranks on own nodes
    np.bitwise_or.at(bits, np.searchsorted(numbers[:owned], node), added)
    own = {name: np.flatnonzero(bits[:owned] & (1 << bit)) for bit, name in enumerate(source.sides)}
    faceless = []
    for name in source.node_sets:
        nodes = mesh.node_sets.get(name, np.zeros(0, dtype=np.int64))
        own[name] = nodes[nodes < owned]
        if name not in source.sides and not ranks.any(len(mesh.facets_within(nodes)) > 0):
            faceless.append(name)
    return mesh.with_names(own, tuple(faceless))
