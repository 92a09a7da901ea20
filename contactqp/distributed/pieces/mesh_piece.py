"""The elements of one rank as a mesh: facets towards other ranks are no boundary, and sets may have no part here."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from contactqp.elements.geometry import Block
from contactqp.elements.mesh import Mesh
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index


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
