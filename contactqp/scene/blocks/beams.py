"""Plane Euler-Bernoulli beams: ``beams`` of a case file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np

from contactqp.elements.members import beam_displacements, beam_stiffness
from contactqp.errors import SceneError
from contactqp.scene import fields
from contactqp.scene.blocks.element import ROTATION, Element, Line, NamedMatrix, NodeScene, refuse_zero_length
from contactqp.scene.fields import Name, TwoNames

# Points along a beam that is drawn: its cubic looks smooth.
POINTS = 25


class Beam(Element):
    """A plane Euler-Bernoulli beam; its nodes get the rotation ``theta``, from the first axis to the second."""

    title: ClassVar[str] = "plane Euler-Bernoulli beams"
    noun: ClassVar[str] = "beam"
    semidefinite: ClassVar[bool] = True

    name: Name
    nodes: TwoNames
    area: fields.Area
    inertia: fields.Inertia
    modulus: fields.Modulus

    @property
    def turning(self) -> tuple[Name, ...]:
        """Return both of its nodes."""
        return self.nodes

    def unknowns(self, scene: NodeScene) -> tuple[str, ...]:
        """Return the names of (u_x, u_y, theta) of its start and of its end."""
        return tuple(name for node in self.nodes for name in (*scene.displacements(node), f"{node}.{ROTATION}"))

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:
        """Yield its stiffness along and across itself."""
        modulus, area, inertia = (scene.value(q) for q in (self.modulus, self.area, self.inertia))
        yield self.unknowns(scene), beam_stiffness(modulus, area, inertia, *map(scene.point, self.nodes))

    def check_axes(self, scene: NodeScene, where: str) -> None:  # noqa: ARG002
        """Raise SceneError outside of a plane."""
        if len(scene.axes) != 2:
            raise SceneError(f"beams: expected a scene with two axes, got {len(scene.axes)}")

    def check(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError for zero length."""
        refuse_zero_length(scene, self.nodes, f"{where}.nodes ({self.name!r})")

    def drawn(self, scene: NodeScene, displacement: Mapping[str, float]) -> Line:
        """Return its deflected curve."""
        start, end = (np.array(scene.point(node), dtype=float) for node in self.nodes)
        at = np.linspace(0.0, 1.0, POINTS)
        ends = np.array([displacement[name] for name in self.unknowns(scene)])
        return Line(self.nodes, start + np.outer(at, end - start), beam_displacements(start, end, ends, at))
