"""A block of case files as somebody else would write it: a torsional spring that turns a beam's node back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np

from contactqp.errors import SceneError
from contactqp.scene import fields
from contactqp.scene.blocks.element import ROTATION, Element, Measure, NamedMatrix, NodeAnswer, NodeScene
from contactqp.scene.scene import register_block


def _moment(hinge: TorsionSpring, answer: NodeAnswer) -> float:
    stiffness = answer.scene.value(hinge.stiffness) * answer.scene.value(hinge.lever)
    return float(stiffness) * answer.displacement(f"{hinge.node}.{ROTATION}")


class TorsionSpring(Element):
    """A force per length at a lever, which resists a node's rotation: the moment is k lever^2 theta."""

    title: ClassVar[str] = "torsional springs"
    noun: ClassVar[str] = "torsional spring"
    quantities: ClassVar[Mapping[str, Measure]] = {
        "hinge force": Measure("force at the lever's end", ("force",), at="torsional spring", read=_moment)
    }

    node: fields.Name
    stiffness: fields.Stiffness
    lever: fields.PositiveLength

    def named_nodes(self) -> Iterator[tuple[str, str]]:
        """Yield its one node."""
        yield "node", self.node

    @property
    def turning(self) -> tuple[str, ...]:
        """Its node turns."""
        return (self.node,)

    def check_axes(self, scene: NodeScene, where: str) -> None:
        """It turns in a plane."""
        if len(scene.axes) != 2:
            raise SceneError(f"{where} ({self.name!r}): expected a scene with two axes, got {len(scene.axes)}")

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:
        """Yield k lever^2 on the rotation."""
        stiffness = scene.value(self.stiffness) * scene.value(self.lever) ** 2
        yield [f"{self.node}.{ROTATION}"], np.array([[stiffness]])


def register() -> None:
    """Add the block to case files."""
    register_block("torsion_springs", TorsionSpring)
