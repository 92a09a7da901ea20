"""Define the base class of elements between nodes in case files: keys, matrices, quantities and drawing.

A kind of elements is a subclass of `Element` in a file of its own, whose fields are the keys of an entry. It must
define its stiffness; the other methods have defaults for elements without mass, rotations and quantities.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Protocol

import numpy as np
from pydantic import Field

from contactqp.elements.members import weight
from contactqp.elements.scalars import Number, Numbers, square_root, squared_length
from contactqp.errors import SceneError
from contactqp.model.arrays import Array
from contactqp.scene import fields
from contactqp.scene.fields import Block, Name, TwoNames, refuse_unknown
from contactqp.scene.units import Quantity

ROTATION = "theta"
# A matrix with the names of its unknowns.
NamedMatrix = tuple[Sequence[str], Numbers]


@dataclass(frozen=True)
class Measure:
    """A quantity that claims can ask for, and what the claim must or may state."""

    meaning: str
    kinds: tuple[str, ...] = ()  # of its value, see units.KINDS; none for words
    words: tuple[str, ...] = ()  # of which its value consists; several are joined by "; ", and all must be found
    at: str | None = None  # what ``at`` names: "unknown", "contact", "support", "tie", "body" or an element's noun
    along: str | None = None  # what ``along`` names: a second "unknown", or an "axis"
    near: bool = False  # ``near`` is a point: the node there is meant
    component: bool = False  # ``component`` is one of COMPONENTS
    matrix: bool = False  # its value is ``rows``
    solved: bool = True  # needs a solution; otherwise read off the problem
    path: bool = False  # needs the load path, or a motion
    motion: bool = False  # needs a motion
    statics: bool = False  # means nothing in a motion
    large: bool = False  # needs large deformations
    small: bool = False  # means nothing at large deformations
    counted: bool = False  # there are several of it: ``occurrence`` says which
    event: bool = False  # ``event`` is a change of a contact, and ``occurrence`` which of several
    friction: bool = False  # needs a contact with friction
    rates: bool = False  # has derivatives: ``with_respect_to`` may ask for one
    whole_way: bool = False  # of the whole load path, not of an instant of it
    of: str = "nodes"  # the scenes that it can be asked of: "nodes", "bodies" or "both"
    read: Callable[[Any, Any], float] | None = None  # from an element and a NodeAnswer, where it is asked of elements


class NodeScene(Protocol):
    """The part of a scene that an element reads; numbers are exact, in the scene's units."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Return the axes, of x, y and z, that nodes move along."""

    @property
    def large(self) -> bool:
        """Return whether displacements may be large."""

    @property
    def weighs(self) -> bool:
        """Return whether masses act: as weights under gravity, or as inertia in a motion."""

    def value(self, quantity: Quantity) -> Fraction:
        """Return a quantity in the scene's units."""

    def point(self, node: str) -> Numbers:
        """Return the position of a node, (dimension,) [length]."""

    def displacements(self, *nodes: str) -> tuple[str, ...]:
        """Return the names of the displacements of nodes, one for each axis, node by node."""


class NodeAnswer(Protocol):
    """The part of an answer that quantities of elements are evaluated from; floats in the scene's units."""

    @property
    def scene(self) -> NodeScene:
        """Return the scene that was solved."""

    def displacement(self, unknown: str) -> float:
        """Return the displacement or rotation of an unknown; 0 where it is fixed."""

    def of_node(self, node: str) -> Array:
        """Return the displacement of a node, (dimension,) [length]."""

    def bar_force_now(self, name: str) -> float:
        """Return the axial force of a bar at large displacements [force]."""


@dataclass(frozen=True, eq=False)
class Line:
    """An element as it is drawn.

    Attributes
    ----------
    nodes : tuple of str, those it connects; a single one is connected to the ground
    path, displacement : (k, dimension) arrays, points along the element, and what they move by [length]
    """

    nodes: tuple[str, ...]
    path: Array
    displacement: Array


class Element(Block):
    """An entry of a block of elements between nodes; a subclass defines its keys and its stiffness.

    Attributes
    ----------
    title : str
        What `explain` calls these elements, as in "axial bars".
    noun : str
        What one of them is called, as in "bar": in messages, in a picture's legend, and where `at` of a claim names it.
    beside_bodies : str
        Why a scene of elastic bodies cannot contain them; by default that the combination is not offered.
    vectors : tuple of str
        The keys that have a component for each axis.
    large, inertial : bool
        Whether they have a form at large displacements, and whether they can have mass.
    semidefinite : bool
        Whether the stiffness is positive semidefinite for all admissible numbers; otherwise this is checked when
        needed.
    quantities : mapping of str to Measure
        What claims can ask of one of them, each with its `read`.
    """

    title: ClassVar[str]
    noun: ClassVar[str]
    beside_bodies: ClassVar[str] = ""
    vectors: ClassVar[tuple[str, ...]] = ()
    large: ClassVar[bool] = False
    inertial: ClassVar[bool] = False
    semidefinite: ClassVar[bool] = False
    quantities: ClassVar[Mapping[str, Measure]] = {}

    name: Name

    def stiffnesses(self, scene: NodeScene) -> Iterator[NamedMatrix]:
        """Yield the matrices [force / length] whose sum is the element's stiffness, each on the unknowns it names."""
        raise NotImplementedError(f"{type(self).__name__}: an element has a stiffness")

    def masses(self, scene: NodeScene, lumped: bool) -> Iterator[NamedMatrix]:  # noqa: ARG002
        """Yield the matrices whose sum is the element's mass, consistent or lumped; none without mass."""
        yield from ()

    def weights(self, scene: NodeScene) -> Iterator[tuple[str, Number]]:  # noqa: ARG002
        """Yield nodes and the masses that gravity acts on there, none without mass."""
        yield from ()

    def gravity_forces(self, scene: NodeScene, gravity: Numbers) -> Iterator[tuple[str, Number]]:
        """Yield the forces of its weight with the names of their unknowns; `gravity` is along the axes."""
        for node, mass in self.weights(scene):
            yield from zip(scene.displacements(node), weight(mass, gravity), strict=True)

    @property
    def has_mass(self) -> bool:
        """Return whether this element has mass."""
        return False

    @property
    def chain(self) -> tuple[Name, ...]:
        """Return the nodes that the element connects, from end to end."""
        return tuple(node for _, node in self.named_nodes())

    @property
    def turning(self) -> tuple[Name, ...]:
        """Return the nodes at which the element has a rotation as unknown."""
        return ()

    def named_nodes(self) -> Iterator[tuple[str, Name]]:
        """Yield every key of the entry that names a node, and the node."""
        for j, name in enumerate(getattr(self, "nodes", ())):
            yield f"nodes[{j}]", name

    def inner_nodes(
        self,
        at: Mapping[str, Sequence[Quantity]],  # noqa: ARG002
    ) -> Iterator[tuple[str, tuple[Fraction, ...]]]:
        """Yield the nodes that the element adds, with their positions [m], from those of the stated nodes."""
        yield from ()

    def check_axes(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError where the scene has too many axes for it, or too few; `where` is as in ``bars[1]``."""

    def check_nodes(self, stated: Mapping[str, Any], where: str) -> None:
        """Raise SceneError where the scene lacks a node of the element; called before positions are looked up."""

    def check(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError where the numbers of the element do not fit the scene's nodes, which exist."""

    def check_motion(self, where: str) -> None:
        """Raise SceneError where it cannot be in a scene that moves."""

    def check_claim(self, where: str) -> None:
        """Raise SceneError where a claim at it has no answer; `where` is as in ``expect[1].at``."""

    def drawn(self, scene: NodeScene, displacement: Mapping[str, float]) -> Line | None:
        """Return the line that is drawn, by default straight through the nodes, None without nodes.

        `displacement` has every unknown of the scene by its name.
        """
        nodes = self.chain
        moved = [[displacement[unknown] for unknown in scene.displacements(node)] for node in nodes]
        path = np.array([scene.point(node) for node in nodes], dtype=float)
        return Line(nodes, path, np.array(moved)) if nodes else None


class Divided(Element):
    """An element along the line between two nodes, in `divisions` of equal length.

    The nodes between its divisions are called after it, ``name 1``, ``name 2``. With a `density` and its `area` it has
    mass.
    """

    nodes: TwoNames
    area: fields.Area
    density: fields.Density | None = None
    divisions: Annotated[int, Field(strict=True, ge=1, le=100_000)] = 1

    @property
    def chain(self) -> tuple[Name, ...]:
        """Return its nodes from end to end."""
        return (self.nodes[0], *(f"{self.name} {i}" for i in range(1, self.divisions)), self.nodes[1])

    @property
    def segments(self) -> tuple[tuple[Name, Name], ...]:
        """Return the pairs of nodes next to each other."""
        return tuple(pairwise(self.chain))

    @property
    def has_mass(self) -> bool:
        """Return whether it has a density above zero."""
        return bool(self.density and self.density.si)

    def weights(self, scene: NodeScene) -> Iterator[tuple[str, Number]]:
        """Yield half the mass of each division at each of its ends, as for both mass matrices."""
        if self.density is None:
            return
        per_length = scene.value(self.density) * scene.value(self.area)
        for ends in self.segments:
            start, end = map(scene.point, ends)
            half = per_length * square_root(squared_length(end - start)) / 2
            yield from ((node, half) for node in ends)

    def inner_nodes(self, at: Mapping[str, Sequence[Quantity]]) -> Iterator[tuple[str, tuple[Fraction, ...]]]:
        """Yield the nodes between its divisions, at equal distances."""
        start, end = (at[name] for name in self.nodes)
        for i, name in enumerate(self.chain[1:-1], start=1):
            yield name, tuple(a.si + (b.si - a.si) * i / self.divisions for a, b in zip(start, end, strict=True))

    def check_nodes(self, stated: Mapping[str, Any], where: str) -> None:
        """Raise SceneError unless its ends are stated nodes, and its inner nodes have names of their own."""
        for key, name in self.named_nodes():
            refuse_unknown(f"{where}.{key} ({self.name!r})", name, stated, "node")
        for name in self.chain[1:-1]:
            if name in stated:
                told = f"expected no node {name!r}, which stands inside of the {self.noun}"
                raise SceneError(f"{where}.divisions ({self.name!r}): {told}")

    def check(self, scene: NodeScene, where: str) -> None:
        """Raise SceneError for zero length."""
        refuse_zero_length(scene, self.nodes, f"{where}.nodes ({self.name!r})")

    def linear(
        self, scene: NodeScene, start: Sequence[Fraction], end: Sequence[Fraction]
    ) -> Iterator[tuple[str, Fraction]]:
        """Yield every displacement of its nodes, linear between the values of both ends; of velocities alike."""
        for i, node in enumerate(self.chain):
            part = Fraction(i, self.divisions)
            between = [a + part * (b - a) for a, b in zip(start, end, strict=True)]
            yield from zip(scene.displacements(node), between, strict=True)


def refuse_zero_length(scene: NodeScene, nodes: Sequence[str], where: str) -> None:
    """Raise SceneError for an element between a node and itself, or between coincident nodes."""
    first, second = nodes
    if first == second:
        raise SceneError(f"{where}: expected two different nodes, got {first!r} twice")
    if (scene.point(first) == scene.point(second)).all():
        raise SceneError(
            f"{where}: expected nodes apart from each other, got zero length between {first!r} and {second!r}"
        )


def refuse_zero_direction(direction: Iterable[Fraction] | None, where: str) -> None:
    """Raise SceneError for the zero vector."""
    if direction is not None and not any(direction):
        raise SceneError(f"{where}: expected a direction, got the zero vector")
