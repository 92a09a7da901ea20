"""Sources of elements: shapes, of which each rank makes a slab, and files, which one rank reads and distributes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.ranks import Ranks, asked
from contactqp.elements.lattice import Lattice
from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import REFERENCES, Reference
from contactqp.errors import Unsupported
from contactqp.model.arrays import Index

# Bit 0 of a facet's marks: it lies on the boundary of the whole mesh. Bit 1 + i: it belongs to side i.
OUTSIDE = 1
# What a 64-bit number has room for beside bit 0 and its sign.
MOST_NAMES = 62


@dataclass(frozen=True, eq=False)
class Share:
    """Elements of one kind that one rank has.

    Attributes
    ----------
    kind : Reference
    nodes : (E, n) array of int
        Codes of their nodes: whole numbers in the order of the node numbers of the whole mesh.
    marks : (E, facets) array of int
        Bits of each facet: OUTSIDE, and those of the sides.
    """

    kind: Reference
    nodes: Index
    marks: Index

    @property
    def facets(self) -> Index:
        """The nodes of all facets, element by element: (E facets, k)."""
        return self.nodes[:, list(self.kind.facets)].reshape(self.marks.size, len(self.kind.facets[0]))


class Source(Protocol):
    """A mesh of which this rank has a share. Its methods are collective."""

    @property
    def sides(self) -> tuple[str, ...]: ...

    @property
    def node_sets(self) -> tuple[str, ...]: ...

    @property
    def dimension(self) -> int: ...

    def shares(self) -> list[Share]:
        """An equal share of the elements, the same kinds in the same order on all ranks."""
        ...

    def marked(self, share: Share) -> Share:
        """The share with the bits of the sides, once OUTSIDE is known."""
        ...

    def nodes(self, codes: Index) -> tuple[NDArray[np.float64], Index]:
        """Coordinates (N, d) and the bits (N,) of the node sets, bit i of set i."""
        ...


@dataclass(frozen=True, eq=False)
class LatticeSource:
    """A shape: every rank makes a slab of each of its patches and nothing else."""

    ranks: Ranks
    lattice: Lattice

    @property
    def sides(self) -> tuple[str, ...]:
        return tuple(self.lattice.sides)

    @property
    def node_sets(self) -> tuple[str, ...]:
        return tuple(self.lattice.nearest)

    @property
    def dimension(self) -> int:
        return self.lattice.reference.dimension

    def shares(self) -> list[Share]:
        codes = self.lattice.elements(self.ranks.rank, self.ranks.size)
        marks = np.zeros((len(codes), len(self.lattice.reference.facets)), dtype=np.int64)
        return [Share(self.lattice.reference, codes, marks)]

    def marked(self, share: Share) -> Share:
        marks = share.marks.copy()
        outside = (marks & OUTSIDE) > 0
        element, facet = np.nonzero(outside)
        nodes = np.take_along_axis(share.nodes[element], np.array(share.kind.facets)[facet], axis=1)
        for bit, name in enumerate(self.sides, start=1):
            inside = self.lattice.on_side(name, nodes.ravel()).reshape(nodes.shape).all(axis=1)
            marks[element[inside], facet[inside]] |= 1 << bit
        return Share(share.kind, share.nodes, marks)

    def nodes(self, codes: Index) -> tuple[NDArray[np.float64], Index]:
        points = np.asarray(self.lattice.position(self.lattice.keys(codes)))
        bits = np.zeros(len(codes), dtype=np.int64)
        for i, point in enumerate(self.lattice.nearest.values()):
            apart = np.linalg.norm(points - point, axis=1)
            best = int(np.argmin(apart)) if len(codes) else -1
            mine = (float(apart[best]), int(codes[best])) if len(codes) else (np.inf, -1)
            bits[codes == min(self.ranks.comm.allgather(mine))[1]] |= 1 << i
        return points, bits


class FileSource:
    """A mesh that rank 0 alone reads and holds until it is dealt out: reading, not solving, needs room for all of it.

    Parameters
    ----------
    read : function
        Returns the mesh; called by rank 0 only. What it refuses all ranks refuse.
    """

    def __init__(self, ranks: Ranks, read: Callable[[], Mesh]) -> None:
        self.ranks = ranks
        self._mesh: Mesh | None = None
        with ranks.together():
            if ranks.rank == 0:
                self._mesh = read()
                if max(len(self._mesh.sides), len(self._mesh.node_sets)) > MOST_NAMES:
                    raise Unsupported(f"mesh: expected at most {MOST_NAMES} sides and sets to be dealt out, got more")
        mesh = self._mesh
        told = None if mesh is None else (tuple(mesh.sides), tuple(mesh.node_sets), mesh.dimension)
        self.sides, self.node_sets, self.dimension = ranks.comm.bcast(told)

    def shares(self) -> list[Share]:
        """Rank 0 gives each rank as many elements of each kind, in their order."""
        mesh = self._mesh
        kinds = self.ranks.comm.bcast(None if mesh is None else [block.kind.name for block in mesh.blocks])
        found, first = [], 0
        for i, name in enumerate(kinds):
            kind = REFERENCES[name]
            nodes = np.zeros((0, len(kind.nodes)), dtype=np.int64)
            marks = np.zeros((0, len(kind.facets)), dtype=np.int64)
            if mesh is not None:
                nodes, marks = mesh.blocks[i].nodes, self._marks(mesh, first, len(mesh.blocks[i]), len(kind.facets))
                first += len(nodes)
            share = np.arange(len(nodes)) * self.ranks.size // max(len(nodes), 1)
            found.append(Share(kind, *self.ranks.exchanged(share, nodes, marks)))
        return found

    def _marks(self, mesh: Mesh, first: int, count: int, facets: int) -> Index:
        marks = np.zeros((count, facets), dtype=np.int64)
        for bit, name in enumerate(self.sides, start=1):
            pairs = mesh.sides[name]
            mine = pairs[(pairs[:, 0] >= first) & (pairs[:, 0] < first + count)]
            marks[mine[:, 0] - first, mine[:, 1]] |= 1 << bit
        return marks

    def marked(self, share: Share) -> Share:
        return share

    def nodes(self, codes: Index) -> tuple[NDArray[np.float64], Index]:
        mesh = self._mesh
        bits = np.zeros(0 if mesh is None else len(mesh.points), dtype=np.int64)
        if mesh is not None:
            for i, name in enumerate(self.node_sets):
                bits[mesh.node_sets[name]] |= 1 << i

        def answer(came: Index, _: Index) -> tuple[NDArray[np.float64], Index]:
            return (np.zeros((0, self.dimension)) if mesh is None else mesh.points[came]), bits[came]

        points, members = asked(self.ranks, np.zeros(len(codes), dtype=np.int64), codes, answer)
        self._mesh = None  # dealt out
        return points, members
