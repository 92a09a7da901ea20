"""The surfaces that may touch, which all ranks have whole: few nodes beside those of the bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.pieces.nodes import Nodes
from contactqp.distributed.ranks import Ranks
from contactqp.elements.facet import Surface
from contactqp.elements.pairing import Pairing
from contactqp.elements.structure import Structure
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Index


@dataclass(frozen=True, eq=False)
class Touching:
    """Nodes of surfaces, t of them, in the order of their numbers; d t unknowns, node by node. The same on all ranks.

    Attributes
    ----------
    structure : Structure
        Of this rank's pieces.
    firsts : (bodies + 1,) array of int
        The number of each body's first node in the whole structure.
    numbers, place, owners : (t,) arrays of int
        Of the nodes: in the whole structure, in PETSc's order, and the ranks that own them.
    points : (t, d) array [length]
    facets : mapping of (body, side) to (p, k) array of int
        Places in `numbers`.
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
        """d t."""
        return int(self.points.size)

    def body(self, name: str) -> Any:
        """This rank's piece of a body."""
        return self.structure.body(name)

    def surface(self, body: str, side: str) -> Surface:
        """A side of a body, numbered in the unknowns of these nodes."""
        part = self.structure.solid(body)
        unknowns = np.arange(self.size).reshape(self.points.shape)
        revolved = part.model == "axisymmetric"
        return Surface(self.points, self.facets[body, side], unknowns, f"{body}.{side}", part.thickness, revolved)

    def in_body(self, body: str, nodes: Index) -> Index:
        """The numbers in a body of nodes of its surfaces."""
        return np.asarray(self.numbers[nodes] - self.first(body))

    def first(self, body: str) -> int:
        """The number of a body's first node in the whole structure."""
        return int(self.firsts[[part.name for part in self.structure.bodies].index(body)])

    def of_body(self, body: str) -> NDArray[np.bool_]:
        """Which nodes a body has, (t,)."""
        first = self.first(body)
        total = self.structure.body(body).mesh.total
        mask: NDArray[np.bool_] = (self.numbers >= first) & (self.numbers < first + total)
        return mask

    def named(self, body: str, pairing: Pairing) -> Pairing:
        """The pairing with its nodes as the body numbers them."""
        return replace(pairing, nodes=self.in_body(body, pairing.nodes), unpaired=self.in_body(body, pairing.unpaired))

    def gathered(self, nodes: Nodes, values: NDArray[Any]) -> NDArray[Any]:
        """What the owners know of these nodes, (t, ...), on every rank, from (own nodes, ...). Collective."""
        mine = self.owners == nodes.ranks.rank
        found = nodes.ranks.gathered(values[self.place[mine] - nodes.first])
        where = nodes.ranks.gathered(np.flatnonzero(mine))
        every = np.empty_like(found)
        every[where] = found
        return every


def touching(structure: Structure, nodes: Nodes, sides: Sequence[tuple[str, str]]) -> Touching:
    """Gathers the sides of bodies. Collective.

    Raises
    ------
    InvalidProblem
        No such side, a side without faces, a side of several kinds of facet.
    """
    ranks = nodes.ranks
    firsts = np.cumsum([0, *[body.mesh.total for body in structure.bodies]])
    facets = {side: _gathered(ranks, structure, nodes, *side) for side in dict.fromkeys(sides)}
    numbers = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *[part.ravel() for part in facets.values()]]))
    own = nodes.numbers[nodes.own]
    place = np.searchsorted(own, numbers)
    mine = np.flatnonzero((place < len(own)) & (own[np.minimum(place, len(own) - 1)] == numbers) if len(own) else [])
    points = np.concatenate([body.mesh.points for body in structure.bodies])[nodes.own[place[mine]]]
    order = np.argsort(ranks.gathered(mine))
    return Touching(
        structure,
        firsts,
        numbers,
        ranks.gathered(nodes.first + place[mine])[order],
        ranks.gathered(np.full(len(mine), ranks.rank))[order],
        ranks.gathered(points)[order],
        {side: np.searchsorted(numbers, part) for side, part in facets.items()},
    )


def _gathered(ranks: Ranks, structure: Structure, nodes: Nodes, name: str, side: str) -> Index:
    """The facets of a side of all ranks by the numbers of their nodes, in an order that no partition changes."""
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
