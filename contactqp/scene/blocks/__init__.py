"""Collect the blocks of elements between nodes in a table, the fields of `Frame`.

Each kind of elements is a subclass of `contactqp.scene.blocks.element.Element` and a field of `Frame`.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from functools import cached_property
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from contactqp.elements.scalars import Numbers
from contactqp.scene import fields
from contactqp.scene.blocks.bars_and_springs import Bar, Spring
from contactqp.scene.blocks.beams_and_strings import Beam, String
from contactqp.scene.blocks.element import Divided, Element, Measure
from contactqp.scene.blocks.matrices import PointMass, StiffnessMatrix
from contactqp.scene.fields import Block, Name, NodeName
from contactqp.scene.units import KINDS, Quantity, UnitSystem, describe, read_unit, weight_or_mass


class UnitNames(Block):
    """The units that the scene is computed and answered in; every number in the file still carries its own."""

    length: str = "m"
    force: str = "N"

    @model_validator(mode="after")
    def _right_dimensions(self) -> Self:
        for kind in ("length", "force"):
            text = getattr(self, kind)
            if read_unit(text)[1] != KINDS[kind].dimension:
                cure = weight_or_mass(text, [KINDS[kind]])
                raise ValueError(f"{kind}: expected a unit of {kind}, got {text!r}{cure}")
        return self


class Node(Block):
    """A point of a body, with a displacement along each axis."""

    name: NodeName
    at: fields.Point


def _axes(value: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(value)) != len(value):
        raise ValueError(f"expected distinct axes, got {describe(value)} {list(value)}")
    return value


class Frame(Block):
    """The heading of a case, its nodes, and the elements between them: the table of all blocks of elements."""

    title: Name
    source: str = ""
    about: str = ""
    units: UnitNames = UnitNames()
    axes: Annotated[tuple[Literal["x", "y", "z"], ...], Field(min_length=1, max_length=3), AfterValidator(_axes)]
    deformation: Literal["small", "large"] = "small"
    gravity: Annotated[tuple[fields.Acceleration, ...], Field(min_length=1, max_length=3)] | None = None
    nodes: tuple[Node, ...] = ()
    bars: tuple[Bar, ...] = ()
    springs: tuple[Spring, ...] = ()
    beams: tuple[Beam, ...] = ()
    strings: tuple[String, ...] = ()
    masses: tuple[PointMass, ...] = ()
    matrices: tuple[StiffnessMatrix, ...] = ()

    @cached_property
    def system(self) -> UnitSystem:
        """Return the units of every number that leaves the scene."""
        return UnitSystem(self.units.length, self.units.force)

    @property
    def large(self) -> bool:
        """Return whether displacements may be large."""
        return self.deformation == "large"

    @cached_property
    def every_node(self) -> Mapping[str, tuple[Quantity, ...]]:
        """Return the position of every node by its name, also of those inside of divided bars."""
        stated = {node.name: node.at for node in self.nodes}
        inner = (entry for _, element in self.elements for entry in element.inner_nodes(stated))
        length = KINDS["length"].dimension
        return stated | {name: tuple(Quantity(x, length, f"{x} m") for x in at) for name, at in inner}

    @cached_property
    def elements(self) -> tuple[tuple[str, Element], ...]:
        """Return all elements between nodes with their keys such as ``bars[1]``, block by block."""
        return tuple((f"{key}[{i}]", element) for key in BLOCKS for i, element in enumerate(getattr(self, key)))

    @property
    def divided(self) -> tuple[Divided, ...]:
        """Return the elements that may have divisions, bars and beams."""
        return (*self.bars, *self.beams)

    def element(self, noun: str, name: str) -> Element:
        """Return the element of a kind, such as "bar", and a name."""
        return next(element for _, element in self.elements if (element.noun, element.name) == (noun, name))

    def value(self, quantity: Quantity) -> Fraction:
        """Return a quantity in the scene's units, exactly."""
        return self.system.value(quantity)

    def point(self, node: str) -> Numbers:
        """Return the position of a node, (dimension,) [length], exactly."""
        return np.array([self.system.value(x) for x in self.every_node[node]])

    def displacements(self, *nodes: str) -> tuple[str, ...]:
        """Return the names of the displacements of nodes, one for each axis, node by node."""
        return tuple(f"{node}.{axis}" for node in nodes for axis in self.axes)


def _kind(annotation: Any) -> type[Element] | None:
    """Return the class of elements in a list of a case file, None for other keys."""
    inner = next(iter(get_args(annotation)), None)
    return inner if isinstance(inner, type) and issubclass(inner, Element) else None


# The kinds of elements by their keys in a case file.
BLOCKS: dict[str, type[Element]] = {
    key: kind for key, field in Frame.model_fields.items() if (kind := _kind(field.annotation))
}


def element_quantities() -> dict[str, Measure]:
    """Return the quantities of elements that claims can ask for, by name, block by block."""
    return {name: measure for kind in BLOCKS.values() for name, measure in kind.quantities.items()}
