"""Define the keys of elastic bodies: meshes, materials, supports and loads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from contactqp.scene import fields
from contactqp.scene.fields import Block, BodyName, Name, check_own_keys, no_such
from contactqp.scene.units import KINDS, read_unit

Axis = Literal["x", "y", "z"]
Divisions = Annotated[int, Field(strict=True, ge=1, le=100_000)]


class ShapeKeys(NamedTuple):
    """The required and optional keys of a shape besides its element, and the lengths of those that are lists."""

    required: tuple[str, ...]
    optional: tuple[str, ...]
    divisions: int
    dimension: int


_BOX, _DISC = ("size", "divisions"), ("radius", "divisions")
SHAPES: Mapping[str, ShapeKeys] = {
    "rectangle": ShapeKeys(_BOX, ("corner", "grading", "towards"), 2, 2),
    "box": ShapeKeys(_BOX, ("corner", "grading", "towards", "crown"), 3, 3),
    "disc": ShapeKeys(_DISC, ("centre", "grading"), 2, 2),
    "half-disc": ShapeKeys(_DISC, ("centre", "grading"), 2, 2),
    "quarter-disc": ShapeKeys(_DISC, ("centre", "grading"), 2, 2),
    "ball": ShapeKeys(_DISC, ("centre", "grading", "part"), 2, 3),
    "cylinder": ShapeKeys(("radius", "height", "divisions"), ("centre", "grading", "part"), 3, 3),
}


def _known(names: tuple[str, ...] | Mapping[str, object], what: str) -> Callable[[str], str]:
    def check(value: str) -> str:
        if value not in names:
            raise ValueError(no_such(value, names, what))
        return value

    return check


def _known_element(value: str) -> str:
    from contactqp.elements.reference_elements import KINDS as ELEMENTS  # importing it computes all quadrature rules

    return _known(ELEMENTS, "element")(value)


class Shape(Block):
    """A simple shape with a structured mesh, graded towards where contact is expected.

    The sides that each shape has, and what its divisions count, are listed in contactqp.elements.shapes.
    """

    kind: Annotated[str, AfterValidator(_known(SHAPES, "shape"))]
    element: Annotated[str, AfterValidator(_known_element)]
    divisions: tuple[Divisions, ...] | None = None
    size: tuple[fields.PositiveLength, ...] | None = None  # of a rectangle or box, along each axis
    radius: fields.PositiveLength | None = None
    height: fields.PositiveLength | None = None
    corner: fields.Point | None = None  # the lowest coordinates of a rectangle or box; by default 0
    centre: fields.Point | None = None  # of the round shapes, and of a cylinder's bottom; by default 0
    grading: fields.Grading | None = None  # largest over smallest element
    crown: fields.PositiveLength | None = None  # radius of curvature of a box's bottom on the axis x = y = 0
    towards: tuple[Name, ...] | None = None  # the sides, or "middle", that elements of a rectangle or box shrink to
    part: Literal["full", "half", "quarter", "eighth"] | None = None

    @model_validator(mode="after")
    def _own_keys(self) -> Self:
        keys = SHAPES[self.kind]
        check_own_keys(self, self.kind, keys.required, ("kind", "element", *keys.optional))
        for name, count in (("divisions", keys.divisions), ("size", keys.dimension)):
            if getattr(self, name) is not None and len(getattr(self, name)) != count:
                raise ValueError(f"{name}: expected {count} for a {self.kind}, got {len(getattr(self, name))}")
        for name in ("corner", "centre"):
            if getattr(self, name) is not None and len(getattr(self, name)) != keys.dimension:
                raise ValueError(
                    f"{name}: expected {keys.dimension} components for a {self.kind}, got {len(getattr(self, name))}"
                )
        if self.towards is not None and self.grading is None:
            raise ValueError("towards: expected with 'grading', without which all elements have one size")
        return self

    @property
    def dimension(self) -> int:
        """Return the number of dimensions, 2 or 3."""
        return SHAPES[self.kind].dimension


class MeshFile(Block):
    """A mesh from a file, whose path is relative to the case file; its coordinates are in `unit`."""

    file: Name
    unit: str
    part: Name | None = None  # the group of elements that makes up the body; by default all
    drop_unconnected: bool = False

    @model_validator(mode="after")
    def _a_length(self) -> Self:
        if read_unit(self.unit)[1] != KINDS["length"].dimension:
            raise ValueError(f'unit: expected a unit of length such as "mm", got {self.unit!r}')
        return self


class _Meshed(Block):
    """A part of the scene with a mesh."""

    name: BodyName
    shape: Shape | None = None
    mesh: MeshFile | None = None

    @model_validator(mode="after")
    def _one_mesh(self) -> Self:
        if (self.shape is None) == (self.mesh is None):
            raise ValueError(f"expected 'shape' or 'mesh', got {'neither' if self.shape is None else 'both'}")
        return self


class Membrane(_Meshed):
    """A membrane in the plane z = 0 that deflects along z under a constant tension [force / length]."""

    tension: fields.Tension


class Body(_Meshed):
    """A linear elastic body.

    `model` is ``plane-strain``, ``plane-stress``, ``axisymmetric`` (x is the radius, y the axis, and every force is
    that of the full circle) or ``3d``. Plane bodies have a `thickness`. Under gravity every body states its density.
    """

    model: Literal["plane-strain", "plane-stress", "axisymmetric", "3d"]
    thickness: fields.PositiveLength | None = None
    modulus: fields.Modulus
    poisson: fields.Poisson
    density: fields.Density | None = None

    @model_validator(mode="after")
    def _fits_the_model(self) -> Self:
        plane = self.model.startswith("plane")
        if plane and self.thickness is None:
            raise ValueError(f"thickness: expected for the model {self.model!r}, and missing")
        if not plane and self.thickness is not None:
            raise ValueError(f"thickness: the model {self.model!r} has none")
        if self.shape is not None and (self.shape.dimension == 3) != (self.model == "3d"):
            raise ValueError(f"model: expected one for a {self.shape.kind}, got {self.model!r}")
        return self


class _Place(Block):
    """Nodes of a body: ``on = "body.set"``, a side or node set, or ``on = "body"`` and the node at `near`."""

    on: Name
    near: fields.Point | None = None

    @property
    def body(self) -> str:
        """Return the name of the body."""
        return self.on.partition(".")[0]

    @property
    def nodes(self) -> str:
        """Return the name of the set; empty with `near`."""
        return self.on.partition(".")[2]

    @model_validator(mode="after")
    def _a_set_or_a_point(self) -> Self:
        if self.near is None and not self.nodes:
            raise ValueError(
                f"on: expected a set of a body such as \"block.top\", or 'near' beside it, got {self.on!r}; a node of "
                "bars or beams is held by 'fixed', moved by a tie of one term and loaded by 'loads'"
            )
        if self.near is not None and self.nodes:
            raise ValueError(f"on: expected a body alone beside 'near', got {self.on!r}")
        return self


class Support(_Place):
    """Prescribed displacement of nodes along an axis: zero holds them."""

    name: Name
    axis: Axis
    value: fields.Length | None = None


class PointLoad(_Place):
    """A force on each of some nodes, in axial symmetry on the full circle."""

    name: Name
    force: fields.Forces


class _OnSide(Block):
    """A side of a body: ``side = "body.side"``."""

    name: Name
    side: Name

    @property
    def body(self) -> str:
        """Return the name of the body."""
        return self.side.partition(".")[0]

    @property
    def nodes(self) -> str:
        """Return the name of the side."""
        return self.side.partition(".")[2]

    @model_validator(mode="after")
    def _a_side(self) -> Self:
        if not self.nodes:
            raise ValueError(f'side: expected a side of a body such as "block.top", got {self.side!r}')
        return self


class Traction(_OnSide):
    """A force per area on a side, along the axes."""

    value: fields.Tractions


class PressureLoad(_OnSide):
    """A pressure on a side, positive where it pushes the body."""

    value: fields.Pressure
