"""Stiffness matrices that another program printed: ``matrices`` of a case file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

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
