"""Stiffness matrices that another program printed, and point masses: ``matrices`` and ``masses`` of a case file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from contactqp.elements import scalars
from contactqp.elements.members import point_mass_matrix
from contactqp.errors import SceneError
from contactqp.scene import fields
from contactqp.scene.blocks.element import Element, NamedMatrix, NodeScene
from contactqp.scene.fields import Name, Number
from contactqp.scene.units import KINDS, Quantity, read_unit


class StiffnessMatrix(Element):
    """A stiffness that another program printed, on displacements named ``node.axis``."""

    title: ClassVar[str] = "stiffness matrices from elsewhere"
    noun: ClassVar[str] = "matrix"
    beside_bodies: ClassVar[str] = "a body has its own stiffness"

    name: Name
    unknowns: Annotated[tuple[Name, ...], Field(min_length=1)]
    unit: str
    rows: Annotated[tuple[tuple[Number, ...], ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _square(self) -> Self:
        n = len(self.unknowns)
        if len(self.rows) != n or any(len(row) != n for row in self.rows):
            raise ValueError(f"expected {n} rows of {n} numbers, got rows of {[len(row) for row in self.rows]}")
        if read_unit(self.unit)[1] != KINDS["stiffness"].dimension:
            raise ValueError(f'unit: expected a unit of stiffness such as "kN/m", got {self.unit!r}')
        return self

    @property
    def chain(self) -> tuple[Name, ...]:
        """Return the nodes of its unknowns, each once."""
        return tuple(dict.fromkeys(name.rpartition(".")[0] for name in self.unknowns))

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:
        """Yield the printed numbers in the scene's units."""
        factor, dimension = read_unit(self.unit)
        unit = scene.value(Quantity(factor, dimension, self.unit))
        yield self.unknowns, np.array([[unit * number for number in row] for row in self.rows])


class PointMass(Element):
    """A mass at a node, with the weight `mass` times the scene's gravity, and inertia in a motion."""

    title: ClassVar[str] = "point masses"
    noun: ClassVar[str] = "point mass"
    semidefinite: ClassVar[bool] = True
    beside_bodies: ClassVar[str] = "a body weighs by its density"
    large: ClassVar[bool] = True
    inertial: ClassVar[bool] = True

    name: Name
    node: Name
    mass: fields.Mass

    @property
    def has_mass(self) -> bool:
        """Return True."""
        return True

    def named_nodes(self) -> Iterator[tuple[str, Name]]:
        """Yield its one node."""
        yield "node", self.node

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:  # noqa: ARG002
        """Yield nothing: a mass has no stiffness."""
        yield from ()

    def masses(self, scene: NodeScene, lumped: bool) -> Iterator[NamedMatrix]:  # noqa: ARG002
        """Yield the mass matrix m I of its node."""
        yield scene.displacements(self.node), point_mass_matrix(scene.value(self.mass), len(scene.axes))

    def weights(self, scene: NodeScene) -> Iterator[tuple[str, scalars.Number]]:
        """Yield the mass at its node."""
        yield self.node, scene.value(self.mass)

    def check(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError where neither gravity nor a motion acts on it."""
        if not scene.weighs:
            raise SceneError(f"gravity: expected, since {where} ({self.name!r}) weighs, and missing")

    def drawn(self, scene: NodeScene, displacement: Mapping[str, float]) -> None:
        """Return nothing: a mass has no extent."""
