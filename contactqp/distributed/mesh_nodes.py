"""Number the nodes of one rank's pieces and find owners, connected bodies and surfaces; assemble the distributed
stiffness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from contactqp.distributed.partition_mesh import MeshPiece
from contactqp.distributed.ranks import Ranks, ask_ranks, block_type, petsc
from contactqp.elements.pairing import Pairing
from contactqp.elements.reference_elements import Block, batches
from contactqp.elements.scalars import places_among
from contactqp.elements.solid import Body, pattern
from contactqp.elements.structure import Part, Structure
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class Nodes:
    """The N nodes of one rank, body after body, each in the order of its piece; the rank owns k of them.

    Attributes
    ----------
    ranks : the processes
    numbers : (N,) array of int, the numbers in the whole structure, as in one process owners : (N,) array of int, the
    rank that owns each node
    place : (N,) array of int, the index in PETSc's order: rank after rank, those of a rank by their numbers
    first : the index of the first node that this rank owns
    """

    ranks: Ranks
    numbers: Index
    owners: Index
    place: Index
    first: int

    @cached_property
    def own(self) -> Index:
        """Return the nodes (k,) that this rank owns, in PETSc's order."""
        return np.flatnonzero(self.owners == self.ranks.rank)

    @cached_property
    def ghosts(self) -> Index:
        """Return the nodes (N - k,) that other ranks own."""
        return np.flatnonzero(self.owners != self.ranks.rank)

    def summed(self, values: Array) -> Array:
        """Return the sums (k, c) at own nodes of the values (N, c) at the nodes of each rank. Collective."""
        total = values[self.own]
        place, added = self.ranks.exchange(self.owners[self.ghosts], self.place[self.ghosts], values[self.ghosts])
        np.add.at(total, place - self.first, added)
        return np.asarray(total)

    def with_ghosts(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values (N, ...) at all nodes of this rank, from those (k, ...) at own nodes. Collective."""
        every = np.empty((len(self.numbers), *values.shape[1:]), dtype=values.dtype)
        every[self.own] = values
        owners, places = self.owners[self.ghosts], self.place[self.ghosts]
        (every[self.ghosts],) = ask_ranks(self.ranks, owners, places, lambda asked, _: (values[asked - self.first],))
        return every


def number_nodes(ranks: Ranks, meshes: Sequence[MeshPiece]) -> Nodes:
    """Number the nodes of meshes side by side. Collective."""
    offsets = np.cumsum([0, *[mesh.total for mesh in meshes]])
    numbers = np.concatenate([mesh.numbers + first for mesh, first in zip(meshes, offsets[:-1], strict=True)])
    owners = np.concatenate([mesh.owners for mesh in meshes])
    own, ghosts = np.flatnonzero(owners == ranks.rank), np.flatnonzero(owners != ranks.rank)
    first, mine = ranks.offset(len(own)), numbers[own]
    place = np.empty(len(numbers), dtype=np.int64)
    place[own] = first + np.arange(len(own))
    (place[ghosts],) = ask_ranks(
        ranks, owners[ghosts], numbers[ghosts], lambda asked, _: (first + np.searchsorted(mine, asked),)
    )
    return Nodes(ranks, numbers, owners, place, first)


def connected_parts(nodes: Nodes, meeting: Any, free: Mask) -> Index:
    """Return the number of the body, a connected part of K, of each own node. Collective.

    Bodies are numbered in the order of their lowest nodes. Nodes that are not free get 0.

    Parameters
    ----------
    nodes : the nodes of this rank
    meeting : (N, elements) sparse matrix, the nodes that each element of this rank has
    free : (N,) array of bool, nodes that have a free unknown; the others connect nothing

    Returns
    -------
    (k,) array of int
        The same numbers on all ranks.
    """
    ranks = nodes.ranks
    some = sp.csr_matrix(meeting)[np.flatnonzero(free)]
    graph = sp.bmat([[None, some], [some.T, None]], format="csr")
    count, label = connected_components(graph, directed=False) if some.nnz else (0, np.zeros(some.shape[0], int))
    _, label = np.unique(label[: some.shape[0]], return_inverse=True)
    first = ranks.offset(count)
    mine = np.full(len(nodes.numbers), -1)
    mine[free] = first + label
    theirs = nodes.with_ghosts(mine[nodes.own])
    joined = np.unique(np.stack([mine, theirs])[:, mine >= 0], axis=1)
    joined = ranks.gathered(joined.T)
    total = int(ranks.sum(count))
    edges = sp.coo_matrix((np.ones(len(joined)), tuple(joined.T)), shape=(total, total))
    parts, part = connected_components(edges, directed=False)
    least = np.full(parts, np.iinfo(np.int64).max)
    np.minimum.at(least, part[mine[free]], nodes.numbers[free])
    order = np.argsort(-ranks.max(-least))
    rank_of = np.empty_like(order)
    rank_of[order] = np.arange(parts)
    own = mine[nodes.own]
    return np.where(own >= 0, rank_of[part[np.maximum(own, 0)]] if parts else 0, 0).astype(np.int64)


@dataclass(frozen=True, eq=False)
class ContactSurfaces:
    """The surfaces that may touch, complete on every rank: t nodes in the order of their numbers.

    Their d t unknowns are numbered node by node.

    Attributes
    ----------
    structure : the pieces of this rank
    firsts : (bodies + 1,) array of int, the number of each body's first node in the whole structure
    numbers, place, owners : (t,) arrays of int
        The number of each node in the whole structure, its index in PETSc's order, and its owner.
    points : (t, d) array, coordinates of the nodes [length]
    facets : mapping of (body, side) to (p, k) array of int, the nodes of each facet, as indices in `numbers`
    """

    structure: Structure
    firsts: Index
    numbers: Index
    place: Index
    owners: Index
    points: Array
    facets: dict[tuple[str, str], Index]

    @property
    def size(self) -> int:
        """Return the number d t of unknowns."""
        return int(self.points.size)

    def body(self, name: str) -> Any:
        """Return this rank's piece of a body."""
        return self.structure.body(name)

    def surface(self, body: str, side: str) -> Surface:
        """Return a side of a body with the unknowns of these nodes."""
        part = self.structure.solid(body)
        unknowns = np.arange(self.size).reshape(self.points.shape)
        revolved = part.model == "axisymmetric"
        return Surface(self.points, self.facets[body, side], unknowns, f"{body}.{side}", part.thickness, revolved)

    def first(self, body: str) -> int:
        """Return the number of a body's first node in the whole structure."""
        return int(self.firsts[[part.name for part in self.structure.bodies].index(body)])

    def of_body(self, body: str) -> Mask:
        """Return flags (t,) of the nodes of a body."""
        first = self.first(body)
        total = self.structure.body(body).mesh.total
        return np.asarray((self.numbers >= first) & (self.numbers < first + total))

    def named(self, body: str, pairing: Pairing) -> Pairing:
        """Return the pairing with the body's numbers of its nodes."""
        nodes, unpaired = (self.numbers[part] - self.first(body) for part in (pairing.nodes, pairing.unpaired))
        return replace(pairing, nodes=nodes, unpaired=unpaired)

    def gathered(self, nodes: Nodes, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values (t, ...) at these nodes on every rank from those (k, ...) at own nodes. Collective."""
        mine = self.owners == nodes.ranks.rank
        found = nodes.ranks.gathered(values[self.place[mine] - nodes.first])
        where = nodes.ranks.gathered(np.flatnonzero(mine))
        every = np.empty_like(found)
        every[where] = found
        return every


def gather_surfaces(structure: Structure, nodes: Nodes, sides: Sequence[tuple[str, str]]) -> ContactSurfaces:
    """Gather the sides of bodies on every rank. Collective.

    Raises InvalidProblem: a side does not exist, has no facets, or facets of several kinds.
    """
    ranks = nodes.ranks
    firsts = np.cumsum([0, *[body.mesh.total for body in structure.bodies]])
    facets = {side: _gathered(ranks, structure, nodes, *side) for side in dict.fromkeys(sides)}
    numbers = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *[part.ravel() for part in facets.values()]]))
    place, here = places_among(nodes.numbers[nodes.own], numbers)
    mine = np.flatnonzero(here)
    points = np.concatenate([body.mesh.points for body in structure.bodies])[nodes.own[place[mine]]]
    order = np.argsort(ranks.gathered(mine))
    return ContactSurfaces(
        structure,
        firsts,
        numbers,
        ranks.gathered(nodes.first + place[mine])[order],
        ranks.gathered(np.full(len(mine), ranks.rank))[order],
        ranks.gathered(points)[order],
        {side: np.searchsorted(numbers, part) for side, part in facets.items()},
    )


def _gathered(ranks: Ranks, structure: Structure, nodes: Nodes, name: str, side: str) -> Index:
    """Return the facets of a side on all ranks by node numbers, in an order independent of the partition."""
    body = structure.solid(name)
    first = structure.first(name) // body.dimension
    found = body.mesh.side(side)
    kinds = sorted({kind for some in ranks.comm.allgather([block.kind.name for block in found]) for kind in some})
    if len(kinds) > 1:
        raise InvalidProblem(
            f"{name}: side {side!r} has facets of several kinds ({', '.join(kinds)}); expected one kind"
        )
    width = ranks.max(max((block.nodes.shape[1] for block in found), default=0))
    mine = [nodes.numbers[first + block.nodes] for block in found]
    every = ranks.gathered(np.concatenate([np.zeros((0, width), dtype=np.int64), *mine]))
    return np.asarray(every[np.lexsort(every.T[::-1])])


def assemble_stiffness(bodies: Sequence[Body], nodes: Nodes) -> Any:
    """Assemble K of all unknowns, including constrained ones, as PETSc.Mat with one block per node. Collective.

    `bodies` are this rank's pieces, in the order of `nodes`. Elements are added in batches, to need little memory
    besides that of K.
    """
    PETSc = petsc()
    d = bodies[0].dimension
    size = (d * len(nodes.own), None)
    K = PETSc.Mat().create(comm=nodes.ranks.comm)
    K.setSizes((size, size), bsize=d)
    K.setType(block_type(d))
    here, elsewhere = _row_lengths(bodies, nodes)
    blocks = [count.astype(PETSc.IntType) for count in (here, elsewhere)]
    K.setPreallocationNNZ((blocks[0], blocks[1]) if nodes.ranks.size > 1 else blocks[0])
    K.setUp()
    first = 0
    for body in bodies:
        place = nodes.place[first : first + len(body.mesh.points)].astype(PETSc.IntType)
        first += len(place)
        for block in body.mesh.blocks:
            for part in batches(block, (block.nodes.shape[1] * d) ** 2):
                _add(K, body, part, place)
    K.assemble()
    K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return K


def _add(K: Any, body: Body, part: Block, place: NDArray[Any]) -> None:
    PETSc = petsc()
    used, numbers = np.unique(part.nodes, return_inverse=True)
    where = pattern([numbers.reshape(part.nodes.shape)], len(used))
    blocks = body.node_blocks([part], where)
    indptr = where.indptr.astype(PETSc.IntType)
    K.setValuesBlockedIJV(indptr, place[used[where.indices]], blocks, addv=True, rowmap=place[used])


def _row_lengths(bodies: Sequence[Body], nodes: Nodes) -> tuple[Index, Index]:
    """Return how many nodes of this rank and of others each own node couples with in elements of any rank."""
    ranks, first, count = nodes.ranks, nodes.first, len(nodes.own)
    has = incidence(bodies)
    meeting = sp.csr_matrix(has @ has.T)
    row = np.repeat(np.arange(len(nodes.numbers)), np.diff(meeting.indptr))
    place, other = nodes.place[row], nodes.place[meeting.indices]
    foreign = nodes.owners[row] != ranks.rank
    rows, columns = ranks.exchange(nodes.owners[row[foreign]], place[foreign], other[foreign])
    touched = np.zeros(count, dtype=bool)
    touched[rows - first] = True
    # Only rows with contributions of other ranks may have repeated columns.
    mine = ~foreign
    mine[mine] = touched[place[mine] - first]
    pairs = np.stack([np.concatenate([rows, place[mine]]), np.concatenate([columns, other[mine]])])
    pairs = np.unique(pairs, axis=1)
    alone = ~foreign & ~mine
    rows = np.concatenate([place[alone], pairs[0]]) - first
    columns = np.concatenate([other[alone], pairs[1]]) - first
    here = (columns >= 0) & (columns < count)
    return np.bincount(rows[here], minlength=count), np.bincount(rows[~here], minlength=count)


def incidence(bodies: Sequence[Part]) -> Any:
    """Return the incidence matrix (nodes, elements) of ones for this rank, as CSR."""
    element, node, first, elements = [], [], 0, 0
    for body in bodies:
        for block in body.mesh.blocks:
            element.append(np.repeat(np.arange(elements, elements + len(block)), block.nodes.shape[1]))
            node.append(first + block.nodes.ravel())
            elements += len(block)
        first += len(body.mesh.points)
    none = np.zeros(0, dtype=np.int64)
    rows, columns = np.concatenate([none, *node]), np.concatenate([none, *element])
    return sp.csr_matrix((np.ones(len(rows), dtype=np.float32), (rows, columns)), shape=(first, elements))
