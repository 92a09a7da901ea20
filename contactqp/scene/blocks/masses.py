"""Point masses: ``masses`` of a case file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

from contactqp.elements.members import point_mass_matrix
from contactqp.elements.scalars import Number
from contactqp.errors import SceneError
from contactqp.scene import fields
from contactqp.scene.blocks.element import Element, NamedMatrix, NodeScene
from contactqp.scene.fields import Name


class PointMass(Element):
    """A mass at a node: it weighs `mass` times the scene's gravity, and has inertia in a motion."""

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

    def weights(self, scene: NodeScene) -> Iterator[tuple[str, Number]]:
        """Yield the mass at its node."""
        yield self.node, scene.value(self.mass)

    def check(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError where neither gravity nor a motion acts on it."""
        if not scene.weighs:
            raise SceneError(f"gravity: expected, since {where} ({self.name!r}) weighs, and missing")

    def drawn(self, scene: NodeScene, displacement: Mapping[str, float]) -> None:
        """Return nothing: a mass has no extent."""
