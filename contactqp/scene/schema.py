"""The keys of a case file. The same names build a scene in Python: ``Scene(title=..., axes=["x"], nodes=[...])``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from contactqp.scene import fields
from contactqp.scene.claims import Expectation, Published, Remark, Report, Study
from contactqp.scene.fields import Block, Name, NodeName, Number, TwoNames
from contactqp.scene.schema_bodies import Body, Membrane, PointLoad, PressureLoad, Support, Traction
from contactqp.scene.schema_contacts import Contact, Obstacle
from contactqp.scene.schema_motion import Motion
from contactqp.scene.schema_path import LoadPath
from contactqp.scene.units import KINDS, Quantity, UnitSystem, describe, read_unit


class UnitNames(Block):
    """The units that the scene is computed and answered in; every number in the file still carries its own."""

    length: str = "m"
    force: str = "N"

    @model_validator(mode="after")
    def _right_dimensions(self) -> Self:
        for kind in ("length", "force"):
            text = getattr(self, kind)
            if read_unit(text)[1] != KINDS[kind].dimension:
                raise ValueError(f"{kind}: expected a unit of {kind}, got {text!r}")
        return self


class Node(Block):
    """A point of a body, with a displacement along each axis."""

    name: NodeName
    at: fields.Point


class Bar(Block):
    """An axial bar between two nodes, in one, two or three dimensions.

    In one dimension, or at large deformations, it may have `divisions`, elements of equal length; the nodes inside are
    ``bar 1``, ``bar 2``. With a `density` it weighs, and has inertia in a motion. Its `law` at large deformations is
    linear in Green's strain if nothing else is stated.
    """

    name: Name
    nodes: TwoNames
    area: fields.Area
    modulus: fields.Modulus
    density: fields.Density | None = None
    divisions: Annotated[int, Field(strict=True, ge=1, le=100_000)] = 1
    law: Literal["green", "engineering", "logarithmic"] | None = None

    @property
    def chain(self) -> tuple[Name, ...]:
        """Its nodes from end to end."""
        return (self.nodes[0], *(f"{self.name} {i}" for i in range(1, self.divisions)), self.nodes[1])

    @property
    def segments(self) -> tuple[tuple[Name, Name], ...]:
        """The pairs of nodes next to each other."""
        return tuple(pairwise(self.chain))


class Spring(Block):
    """A spring between two nodes along the line between them, or along `direction`; with one node, to the ground."""

    name: Name
    nodes: Annotated[tuple[Name, ...], Field(min_length=1, max_length=2)]
    stiffness: fields.Stiffness
    direction: fields.Vector | None = None


class Beam(Block):
    """A plane Euler-Bernoulli beam; its nodes get the rotation ``theta``, from the first axis to the second."""

    name: Name
    nodes: TwoNames
    area: fields.Area
    inertia: fields.Inertia
    modulus: fields.Modulus


class String(Block):
    """A string under a constant tension, through nodes on a straight line; it resists deflections across that line.

    Along the line it resists nothing: there its nodes are fixed, or held by something else.
    """

    name: Name
    nodes: Annotated[tuple[Name, ...], Field(min_length=2)]
    tension: fields.PositiveForce

    @property
    def segments(self) -> tuple[tuple[Name, Name], ...]:
        """The pairs of nodes next to each other."""
        return tuple(pairwise(self.nodes))


class PointMass(Block):
    """A mass at a node: it weighs `mass` times the scene's gravity, and has inertia in a motion."""

    name: Name
    node: Name
    mass: fields.Mass


class StiffnessMatrix(Block):
    """A stiffness that another program printed, on displacements named ``node.axis``."""

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


class Term(Block):
    """One unknown of a tie and its factor; a rotation's factor is a length, its lever."""

    unknown: Name
    factor: fields.Factor


class Tie(Block):
    """A multi-point constraint: sum of factor times unknown = value."""

    name: Name
    terms: Annotated[tuple[Term, ...], Field(min_length=1)]
    value: fields.TieValue


class Load(Block):
    """A force along an unknown, or a moment about a rotation. Corners of a path speak of it by its `name`."""

    name: Name | None = None
    unknown: Name
    value: fields.Force


class LineLoad(Block):
    """A constant force per length on a string, along the axes."""

    name: Name
    string: Name
    value: fields.LineForces


def _inside(bar: Bar, ends: Mapping[str, Node]) -> Iterator[Node]:
    start, end = (ends[name].at for name in bar.nodes)
    for i, name in enumerate(bar.chain[1:-1], start=1):
        at = [a.si + (b.si - a.si) * i / bar.divisions for a, b in zip(start, end, strict=True)]
        yield Node(name=name, at=tuple(Quantity(x, KINDS["length"].dimension, f"{x} m") for x in at))


def _axes(value: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(value)) != len(value):
        raise ValueError(f"expected distinct axes, got {describe(value)} {list(value)}")
    return value


class SceneData(Block):
    """What a case file says, before anybody has looked whether its parts fit each other: frozen data."""

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
    fixed: tuple[Name, ...] = ()  # unknowns, or nodes with all of theirs
    ties: tuple[Tie, ...] = ()
    bodies: tuple[Body, ...] = ()
    membranes: tuple[Membrane, ...] = ()
    supports: tuple[Support, ...] = ()  # of bodies and membranes
    obstacles: tuple[Obstacle, ...] = ()
    contacts: tuple[Contact, ...] = ()
    loads: tuple[Load, ...] = ()  # on unknowns of nodes
    line_loads: tuple[LineLoad, ...] = ()  # on strings
    tractions: tuple[Traction, ...] = ()  # on sides of bodies
    pressures: tuple[PressureLoad, ...] = ()
    point_loads: tuple[PointLoad, ...] = ()
    path: LoadPath | None = None
    motion: Motion | None = None
    expect: tuple[Expectation, ...] = ()
    published: tuple[Published, ...] = ()
    remarks: tuple[Remark, ...] = ()
    study: tuple[Study, ...] = ()
    report: Report | None = None
    _file: Path | None = PrivateAttr(default=None)

    @property
    def system(self) -> UnitSystem:
        """The units of every number that leaves the scene."""
        return UnitSystem(self.units.length, self.units.force)

    @property
    def file(self) -> Path | None:
        """The case file it was read from, if any."""
        return self._file

    @property
    def large(self) -> bool:
        """Whether displacements may be large."""
        return self.deformation == "large"

    @property
    def meshed(self) -> tuple[Body | Membrane, ...]:
        """All that has a mesh."""
        return (*self.bodies, *self.membranes)

    @cached_property
    def every_node(self) -> Mapping[str, Node]:
        """By their names, those inside of divided bars too."""
        stated = {node.name: node for node in self.nodes}
        return stated | {node.name: node for bar in self.bars for node in _inside(bar, stated)}

    def node(self, name: str) -> Node:
        return self.every_node[name]

    def string(self, name: str) -> String:
        return next(string for string in self.strings if string.name == name)

    def body(self, name: str) -> Body:
        return next(body for body in self.bodies if body.name == name)

    def obstacle(self, name: str) -> Obstacle:
        return next(obstacle for obstacle in self.obstacles if obstacle.name == name)
