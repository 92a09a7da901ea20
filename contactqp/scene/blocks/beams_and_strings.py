"""Slender members and their loads: ``beams``, ``strings`` and ``line_loads`` of a case file.

Beams are plane Euler-Bernoulli beams; strings are under a constant tension.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from contactqp.elements.members import (
    beam_displacements,
    beam_load,
    beam_mass,
    beam_stiffness,
    string_load,
    string_stiffness,
)
from contactqp.elements.scalars import Number, Numbers
from contactqp.errors import SceneError
from contactqp.scene import fields
from contactqp.scene.blocks.element import (
    ROTATION,
    Divided,
    Element,
    Line,
    NamedMatrix,
    NodeScene,
    refuse_zero_length,
)
from contactqp.scene.fields import Block, Name

# Points along a drawn beam, enough for its cubic to look smooth.
POINTS = 25


class Beam(Divided):
    """A plane Euler-Bernoulli beam; its nodes get the rotation ``theta``, from the first axis to the second.

    It may have `divisions`, elements of equal length; the nodes inside are ``beam 1``, ``beam 2``, and contacts, loads
    and claims can name them. With a `density` it has weight, and inertia in a motion, the rotation of its sections
    left out.
    """

    title: ClassVar[str] = "plane Euler-Bernoulli beams"
    noun: ClassVar[str] = "beam"
    semidefinite: ClassVar[bool] = True
    inertial: ClassVar[bool] = True

    inertia: fields.Inertia
    modulus: fields.Modulus

    @property
    def turning(self) -> tuple[Name, ...]:
        """Return all of its nodes."""
        return self.chain

    def unknowns(self, scene: NodeScene, ends: tuple[Name, Name]) -> tuple[str, ...]:
        """Return the names of (u_x, u_y, theta) of the start and of the end of a division."""
        return tuple(name for node in ends for name in (*scene.displacements(node), f"{node}.{ROTATION}"))

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:
        """Yield the stiffness of every division along and across itself."""
        modulus, area, inertia = (scene.value(q) for q in (self.modulus, self.area, self.inertia))
        for ends in self.segments:
            yield self.unknowns(scene, ends), beam_stiffness(modulus, area, inertia, *map(scene.point, ends))

    def masses(self, scene: NodeScene, lumped: bool) -> Iterator[NamedMatrix]:
        """Yield the mass of every division of a beam with a density."""
        if self.density is not None:
            density, area = scene.value(self.density), scene.value(self.area)
            for ends in self.segments:
                start, end = map(scene.point, ends)
                yield self.unknowns(scene, ends), beam_mass(density, area, start, end, lumped)

    def gravity_forces(self, scene: NodeScene, gravity: Numbers) -> Iterator[tuple[str, Number]]:
        """Yield the consistent forces and moments of its weight."""
        if self.density is not None:
            yield from self.spread(scene, scene.value(self.density) * scene.value(self.area) * gravity)

    def spread(self, scene: NodeScene, per_length: Numbers) -> Iterator[tuple[str, Number]]:
        """Yield the consistent forces and moments of a constant force per length, with the names of their unknowns."""
        for ends in self.segments:
            yield from zip(self.unknowns(scene, ends), beam_load(per_length, *map(scene.point, ends)), strict=True)

    def linear(
        self, scene: NodeScene, start: Sequence[Fraction], end: Sequence[Fraction]
    ) -> Iterator[tuple[str, Fraction]]:
        """Yield every displacement of its nodes, linear between its ends, and the rotation that goes with it."""
        yield from super().linear(scene, start, end)
        (x, y), d = (b - a for a, b in zip(start, end, strict=True)), np.subtract(*map(scene.point, self.nodes[::-1]))
        rotation: Fraction = (d[0] * y - d[1] * x) / np.dot(d, d)
        yield from ((f"{node}.{ROTATION}", rotation) for node in self.chain)

    def check_axes(self, scene: NodeScene, where: str) -> None:  # noqa: ARG002
        """Raise SceneError outside of a plane."""
        if len(scene.axes) != 2:
            raise SceneError(f"beams: expected a scene with two axes, got {len(scene.axes)}")

    def drawn(self, scene: NodeScene, displacement: Mapping[str, float]) -> Line:
        """Return its deflected curve."""
        path, moved, at = [], [], np.linspace(0.0, 1.0, max(2, POINTS // self.divisions))
        for ends in self.segments:
            start, end = (np.array(scene.point(node), dtype=float) for node in ends)
            known = np.array([displacement[name] for name in self.unknowns(scene, ends)])
            path.append(start + np.outer(at, end - start))
            moved.append(beam_displacements(start, end, known, at))
        return Line(self.chain, np.concatenate(path), np.concatenate(moved))


class String(Element):
    """A string under a constant tension, through nodes on a straight line; it resists deflections across that line.

    It has no stiffness along the line, where its nodes must be fixed or held by other elements.
    """

    title: ClassVar[str] = "strings under constant tension"
    noun: ClassVar[str] = "string"
    semidefinite: ClassVar[bool] = True

    name: Name
    nodes: Annotated[tuple[Name, ...], Field(min_length=2)]
    tension: fields.PositiveForce

    @property
    def segments(self) -> tuple[tuple[Name, Name], ...]:
        """Return the pairs of nodes next to each other."""
        return tuple(pairwise(self.nodes))

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:
        """Yield the stiffness of every segment across the string."""
        tension = scene.value(self.tension)
        for ends in self.segments:
            yield scene.displacements(*ends), string_stiffness(tension, *map(scene.point, ends))

    def check_axes(self, scene: NodeScene, where: str) -> None:  # noqa: ARG002
        """Raise SceneError in one dimension, where it has no axis to deflect along."""
        if len(scene.axes) == 1:
            raise SceneError(
                "strings: expected a scene with two axes or three, since they deflect across themselves, got 1"
            )

    def check(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError unless its nodes are on a straight line.

        A tension that changes direction at a node would load it.
        """
        where = f"{where}.nodes ({self.name!r})"
        for ends in self.segments:
            refuse_zero_length(scene, ends, where)
        spans = [scene.point(end) - scene.point(start) for start, end in self.segments]
        for node, before, after in zip(self.nodes[1:], spans, spans[1:], strict=False):
            along: Fraction = np.dot(before, after)
            if along <= 0 or along**2 != np.dot(before, before) * np.dot(after, after):
                raise SceneError(
                    f"{where}: expected nodes one after another on a straight line, got a turn at {node!r}"
                )


class LineLoad(Block):
    """A constant force per length on a string or a beam, along the axes.

    On a beam it gives consistent forces and moments, for which nodal displacements are exact.
    """

    name: Name
    string: Name | None = None
    beam: Name | None = None
    value: fields.LineForces

    @model_validator(mode="after")
    def _has_one(self) -> LineLoad:
        if (self.string is None) == (self.beam is None):
            got = "none" if self.string is None else "both"
            raise ValueError(f"expected 'string' or 'beam', got {got}")
        return self

    def forces(self, scene: NodeScene, loaded: String | Beam) -> Iterator[tuple[str, Number]]:
        """Yield the nodal forces and moments on a string or beam, each with the name of its unknown."""
        per_length = np.array([scene.value(component) for component in self.value])
        if isinstance(loaded, Beam):
            yield from loaded.spread(scene, per_length)
            return
        for ends in loaded.segments:
            forces = string_load(per_length, *map(scene.point, ends))
            yield from zip(scene.displacements(*ends), forces, strict=True)
