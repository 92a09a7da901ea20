"""The nodes of one rank's pieces: who owns each, and its numbers in the whole structure and in PETSc's order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.asking import asked
from contactqp.distributed.pieces.dealing import DealtMesh
from contactqp.distributed.ranks import Ranks
from contactqp.model.arrays import Array, Index


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes body after body, those of each body as its piece has them: N of them, of which the rank owns k.

    Attributes
    ----------
    ranks : Ranks
    numbers : (N,) array of int
        In the whole structure, body after body as one process has them.
    owners : (N,) array of int
        Ranks.
    place : (N,) array of int
        In PETSc's order: rank after rank, those of a rank by their numbers.
    first : int
        The place of the first that this rank owns.
    """

    ranks: Ranks
    numbers: Index
    owners: Index
    place: Index
    first: int

    @cached_property
    def own(self) -> Index:
        """(k,) which of the nodes this rank owns; in PETSc's order."""
        return np.flatnonzero(self.owners == self.ranks.rank)

    @cached_property
    def ghosts(self) -> Index:
        """(N - k,) which of the nodes others own."""
        return np.flatnonzero(self.owners != self.ranks.rank)

    def summed(self, values: Array) -> Array:
        """(k, c) at own nodes, from what each rank brings to all of its nodes (N, c). Collective."""
        total = values[self.own]
        came, brought = self.ranks.exchanged(self.owners[self.ghosts], self.place[self.ghosts], values[self.ghosts])
        np.add.at(total, came - self.first, brought)
        return np.asarray(total)

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """(N, ...) at all nodes of this rank, from those of the own (k, ...). Collective."""
        every = np.empty((len(self.numbers), *values.shape[1:]), dtype=values.dtype)
        every[self.own] = values
        every[self.ghosts] = asked(
            self.ranks,
            self.owners[self.ghosts],
            self.place[self.ghosts],
            lambda came, _: (values[came - self.first],),
        )[0]
        return every


def number_nodes(ranks: Ranks, meshes: Sequence[DealtMesh]) -> Nodes:
    """The nodes of meshes side by side. Collective."""
    offsets = np.cumsum([0, *[part.mesh.total for part in meshes]])
    numbers = np.concatenate([part.mesh.numbers + first for part, first in zip(meshes, offsets[:-1], strict=True)])
    owners = np.concatenate([part.owners for part in meshes])
    own, ghosts = np.flatnonzero(owners == ranks.rank), np.flatnonzero(owners != ranks.rank)
    first, mine = ranks.first(len(own)), numbers[own]
    place = np.empty(len(numbers), dtype=np.int64)
    place[own] = first + np.arange(len(own))
    place[ghosts] = asked(
        ranks, owners[ghosts], numbers[ghosts], lambda came, _: (first + np.searchsorted(mine, came),)
    )[0]
    return Nodes(ranks, numbers, owners, place, first)
