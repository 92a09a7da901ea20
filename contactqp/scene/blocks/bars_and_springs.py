"""Axial bars, and springs between nodes or to the ground: ``bars`` and ``springs`` of a case file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from contactqp.elements.members import (
    spring_force,
    spring_stiffness,
    spring_to_ground,
    truss_axial_force,
    truss_stiffness,
)
from contactqp.elements.scalars import Numbers
from contactqp.errors import SceneError
from contactqp.scene import fields
from contactqp.scene.blocks.element import (
    Divided,
    Element,
    Measure,
    NamedMatrix,
    NodeAnswer,
    NodeScene,
    refuse_zero_direction,
    refuse_zero_length,
)
from contactqp.scene.fields import Name


def _bar_force(bar: Bar, answer: NodeAnswer) -> float:
    """Return the axial force, at large displacements that of the deformed bar."""
    scene = answer.scene
    if scene.large:
        return answer.bar_force_now(bar.name)
    displacement = np.concatenate([answer.of_node(node) for node in bar.nodes])
    modulus, area = scene.value(bar.modulus), scene.value(bar.area)
    start, end = map(scene.point, bar.nodes)
    return float(truss_axial_force(modulus, area, start, end, displacement))


class Bar(Divided):
    """An axial bar between two nodes, in one, two or three dimensions.

    In one dimension, or at large deformations, it may have `divisions`, elements of equal length; the nodes inside are
    ``bar 1``, ``bar 2``. With a `density` it has weight, and inertia in a motion. Its default `law` at large
    deformations is linear in Green's strain.
    """

    title: ClassVar[str] = "axial bars"
    noun: ClassVar[str] = "bar"
    semidefinite: ClassVar[bool] = True
    large: ClassVar[bool] = True
    inertial: ClassVar[bool] = True
    quantities: ClassVar[Mapping[str, Measure]] = {
        "bar force": Measure("axial force, positive in tension", ("force",), at="bar", read=_bar_force)
    }

    modulus: fields.Modulus
    law: Literal["green", "engineering", "logarithmic"] | None = None

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:
        """Yield the stiffness of every division."""
        modulus, area = scene.value(self.modulus), scene.value(self.area)
        for ends in self.segments:
            yield scene.displacements(*ends), truss_stiffness(modulus, area, *map(scene.point, ends))

    def masses(self, scene: NodeScene, lumped: bool) -> Iterator[NamedMatrix]:
        """Yield the mass of every division of a bar with a density."""
        from contactqp.elements.loads import bar_mass

        if self.density is not None:
            density, area = scene.value(self.density), scene.value(self.area)
            for ends in self.segments:
                start, end = map(scene.point, ends)
                yield scene.displacements(*ends), bar_mass(density, area, start, end, lumped)

    def check_axes(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError for divisions in a plane or in space, unless displacements are large."""
        if self.divisions > 1 and len(scene.axes) > 1 and not scene.large:
            raise SceneError(
                f"{where}.divisions ({self.name!r}): expected 1 in a scene with {len(scene.axes)} axes, where nothing "
                f"holds the nodes inside of a bar across it, got {self.divisions}"
            )

    def check_motion(self, where: str) -> None:
        """Raise SceneError without a density, which may be zero."""
        if self.density is None:
            raise SceneError(f'{where}.density ({self.name!r}): expected in a motion, as in "7850 kg/m^3", and missing')

    def check_claim(self, where: str) -> None:
        """Raise SceneError for a bar with divisions, as each of them has its own force."""
        if self.divisions > 1:
            raise SceneError(f"{where}: expected a bar in one piece, got {self.name!r}, each part of which has its own")


def _spring_force(item: Spring, answer: NodeAnswer) -> float:
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
        "spring force": Measure("force of a spring, positive in tension", ("force",), at="spring", read=_spring_force)
    }

    name: Name
    nodes: Annotated[tuple[Name, ...], Field(min_length=1, max_length=2)]
    stiffness: fields.Stiffness
    direction: fields.Vector | None = None

    def along(self, scene: NodeScene) -> Numbers:
        """Return the direction of the spring, not normalised: as stated, from node to node, or along the only axis."""
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
