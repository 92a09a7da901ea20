"""The keys of obstacles and contacts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Self

from pydantic import model_validator

from contactqp.scene import fields
from contactqp.scene.fields import Block, Name, TwoNames

# What each kind of obstacle must state, and what it may.
OBSTACLES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "plane": (("point", "normal"), ()),
    "circle": (("centre", "radius"), ("inside",)),
    "sphere": (("centre", "radius"), ("inside",)),
    "cylinder": (("point", "axis", "radius"), ("inside",)),
    "paraboloid": (("apex", "axis", "radius"), ("inside", "measure")),
}


_TOUCHING = ("node", "nodes", "side", "sides", "membrane")


class Obstacle(Block):
    """A rigid obstacle; bodies are outside of it, or in the hole that it leaves if `inside`.

    plane: through `point`; `normal`, of any length, points out of it, to where the body is.
    circle (2D), sphere (3D): around `centre`. cylinder (3D): infinite, about the `axis` through `point`.
    paraboloid (2D or 3D): `radius` is that of curvature at its `apex`; `axis` points out of it. Its gap is measured
    along the axis, as Hertz's theory does, or with ``measure = "normal"`` as the distance.
    """

    name: Name
    kind: Literal["plane", "circle", "sphere", "cylinder", "paraboloid"] = "plane"
    point: fields.Point | None = None
    normal: fields.Vector | None = None
    centre: fields.Point | None = None
    apex: fields.Point | None = None
    axis: fields.Vector | None = None
    radius: fields.PositiveLength | None = None
    inside: bool | None = None
    measure: Literal["axis", "normal"] | None = None

    @model_validator(mode="after")
    def _own_keys(self) -> Self:
        required, optional = OBSTACLES[self.kind]
        for key in required:
            if getattr(self, key) is None:
                raise ValueError(f"{key}: expected for a {self.kind}, and missing")
        for key in type(self).model_fields:
            own = ("name", "kind", *required, *optional)
            if key not in own and getattr(self, key) is not None:
                raise ValueError(f"{key}: a {self.kind} has no such key; its own: {', '.join(own)}")
        return self


class Contact(Block):
    """Who may touch whom: one of five.

    `node` and `obstacle`; two `nodes`, along `direction` or else along the line from the first to the second; a `side`
    of a body (``"block.bottom"``) and `obstacle`; two `sides`, the slave's first, by the `pairing` ``"mortar"`` or
    ``"node-to-segment"``. Parts of two sides further apart than `reach` have no partner, and at the start a side may
    be inside of what it touches by `overlap`; the defaults of both follow the size of the facets. A `membrane` and
    `obstacle`: it stays above.

    `friction` is Coulomb's coefficient; between nodes, or a node and an obstacle, slip is counted from `slip_origin`,
    the displacement along the axes (of the first node against the second) that stood when they touched. A load path
    finds that itself.
    """

    name: Name
    node: Name | None = None
    nodes: TwoNames | None = None
    side: Name | None = None
    sides: TwoNames | None = None
    membrane: Name | None = None
    obstacle: Name | None = None
    direction: fields.Vector | None = None
    pairing: Literal["mortar", "node-to-segment"] | None = None
    reach: fields.PositiveLength | None = None
    overlap: fields.NotNegativeLength | None = None
    friction: fields.FrictionCoefficient | None = None
    slip_origin: fields.Point | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        stated = [key for key in _TOUCHING if getattr(self, key) is not None]
        if not stated:
            raise ValueError("expected 'node', 'nodes', 'side', 'sides' or 'membrane', got none")
        if len(stated) > 1:
            raise ValueError(f"expected one of {', '.join(_TOUCHING)}, got both {stated[0]!r} and {stated[1]!r}")
        key = stated[0]
        if key not in ("nodes", "sides") and self.obstacle is None:
            raise ValueError(f"expected 'obstacle', what the {key} may touch, and it is missing")
        if key in ("nodes", "sides") and self.obstacle is not None:
            raise ValueError(f"expected {key!r} or 'obstacle', got both")
        if key != "nodes" and self.direction is not None:
            raise ValueError("direction: expected none, the obstacle or the surface has its normal")
        if key == "sides" and self.pairing is None:
            raise ValueError("pairing: expected 'mortar' or 'node-to-segment' for two sides, and missing")
        for option in ("pairing", "reach", "overlap"):
            own = ("side", "sides") if option == "overlap" else ("sides",)
            if key not in own and getattr(self, option) is not None:
                raise ValueError(f"{option}: expected none with {key!r}")
        if key == "membrane" and self.friction:
            raise ValueError("friction: expected none, a membrane does not slide")
        if self.slip_origin is not None and (key not in ("node", "nodes") or not self.friction):
            raise ValueError("slip_origin: expected with friction between nodes, or a node and an obstacle, only")
        for side in self.touching_sides:
            body, _, name = side.partition(".")
            if not body or not name:
                raise ValueError(f'{key}: expected sides of bodies such as "block.bottom", got {side!r}')
        return self

    @property
    def touched(self) -> tuple[str, ...]:
        """The one node, or the two."""
        return self.nodes or ((self.node,) if self.node else ())

    @property
    def touching_sides(self) -> tuple[str, ...]:
        """The one side, or the slave's and the master's."""
        return self.sides or ((self.side,) if self.side else ())
