"""Springs between nodes or to the ground: ``springs`` of a case file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from contactqp.elements.members import spring_force, spring_stiffness, spring_to_ground
from contactqp.elements.scalars import Numbers
from contactqp.errors import SceneError
from contactqp.scene import fields
from contactqp.scene.blocks.element import (
    Element,
    Measure,
    NamedMatrix,
    NodeAnswer,
    NodeScene,
    refuse_zero_direction,
    refuse_zero_length,
)
from contactqp.scene.fields import Name


def _force(item: Spring, answer: NodeAnswer) -> float:
    """Return the force; a spring to the ground is stretched by its node's displacement."""
    relative = answer.of_node(item.nodes[-1])
    if len(item.nodes) == 2:
        relative = relative - answer.of_node(item.nodes[0])
    return float(spring_force(answer.scene.value(item.stiffness), item.along(answer.scene), relative))


class Spring(Element):
    """A spring between two nodes along the line between them, or along `direction`; with one node, to the ground."""

    title: ClassVar[str] = "springs"
    noun: ClassVar[str] = "spring"
    semidefinite: ClassVar[bool] = True
    vectors: ClassVar[tuple[str, ...]] = ("direction",)
    quantities: ClassVar[Mapping[str, Measure]] = {
        "spring force": Measure("force of a spring, positive in tension", ("force",), at="spring", read=_force)
    }

    name: Name
    nodes: Annotated[tuple[Name, ...], Field(min_length=1, max_length=2)]
    stiffness: fields.Stiffness
    direction: fields.Vector | None = None

    def along(self, scene: NodeScene) -> Numbers:
        """Return its direction, of any length: as stated, from node to node, or along the scene's only axis."""
        if self.direction is not None:
            return np.array(self.direction)
        if len(self.nodes) == 1:
            return np.array([Fraction(1)])
        return scene.point(self.nodes[1]) - scene.point(self.nodes[0])

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:
        """Yield k n n' on its node, or on the difference of its two."""
        formula = spring_stiffness if len(self.nodes) == 2 else spring_to_ground
        yield scene.displacements(*self.nodes), formula(scene.value(self.stiffness), self.along(scene))

    def check(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError unless it has a direction."""
        refuse_zero_direction(self.direction, f"{where}.direction ({self.name!r})")
        if self.direction is None and len(self.nodes) == 2:
            refuse_zero_length(scene, self.nodes, f"{where}.nodes ({self.name!r})")
        elif self.direction is None and len(scene.axes) > 1:
            raise SceneError(f"{where}.direction ({self.name!r}): expected for a spring to the ground, and missing")
