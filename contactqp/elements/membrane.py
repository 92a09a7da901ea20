"""The flat membrane: a scalar deflection under a constant tension, Poisson's equation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.mesh import Mesh
from contactqp.elements.nodal_pressure import tributary_areas
from contactqp.elements.reference_elements import at_rule
from contactqp.elements.scalars import positive_number
from contactqp.elements.solid import assemble, pattern
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem, shown


@dataclass(frozen=True, eq=False)
class Membrane:
    """A membrane in the plane z = 0 that deflects by w along z: its energy is the integral of T/2 |grad w|^2.

    Small slopes; the tension does not change. Unknown i is the deflection of node i.

    Parameters
    ----------
    mesh : Mesh
        In 2D.
    tension : float
        T > 0, the force per length across any cut [force / length].
    name : str
        Used in every message.

    Raises
    ------
    InvalidProblem
        No mesh, a mesh in 3D, a tension that is not positive.
    """

    mesh: Mesh
    tension: float
    name: str = "membrane"

    def __post_init__(self) -> None:
        if not isinstance(self.mesh, Mesh):
            raise InvalidProblem(f"{self.name}: expected a Mesh as its mesh, got {shown(self.mesh)}")
        if self.mesh.dimension != 2:
            raise InvalidProblem(f"{self.name}: expected a plane mesh for a membrane, got one in 3D")
        positive_number(self.name, self.tension, "tension")

    @property
    def axes(self) -> str:
        """Return the axes that a node moves along."""
        return "z"

    @property
    def size(self) -> int:
        """Return the number of unknowns N."""
        return len(self.mesh.points)

    @property
    def points(self) -> NDArray[np.float64]:
        """Return the nodes in space, (N, 3) with z = 0 [length]."""
        return np.column_stack([self.mesh.points, np.zeros(self.size)])

    @cached_property
    def stiffness(self) -> Any:
        """Return K_ij, T times the integral of grad N_i . grad N_j: (N, N) CSC [force / length]."""
        where = pattern([block.nodes for block in self.mesh.blocks], self.size)
        entries = []
        for block in self.mesh.blocks:
            geometry = at_rule(block, self.mesh.points, block.kind.fine_rule)
            weights = self.tension * geometry.determinant * block.kind.fine_rule.weights
            gradient = geometry.gradient
            K = np.einsum("eq,eqia,eqja->eij", weights, gradient, gradient, optimize=True)
            entries.append(((K + np.swapaxes(K, 1, 2)) / 2).ravel())
        return assemble(where, np.concatenate(entries)[np.newaxis, np.newaxis])

    def rigid_motions(self) -> NDArray[np.float64]:
        """Return the one motion that costs no energy, all nodes alike, (N, 1)."""
        return np.ones((self.size, 1))

    def areas(self) -> NDArray[np.float64]:
        """Return the area that belongs to each node, (N,) [length^2].

        Raises
        ------
        InvalidProblem
            Elements of several kinds.
        """
        return tributary_areas(self.surface)

    @property
    def surface(self) -> Surface:
        """Return its elements as facets in space, with the nodes' only unknowns, along z.

        Raises
        ------
        InvalidProblem
            Elements of several kinds.
        """
        if len(self.mesh.blocks) > 1:
            kinds = ", ".join(block.kind.name for block in self.mesh.blocks)
            raise InvalidProblem(f"{self.name}: expected elements of one kind in a membrane, got {kinds}")
        facets = self.mesh.blocks[0].nodes
        return Surface(self.points, facets, np.arange(3 * self.size).reshape(-1, 3), name=self.name)
