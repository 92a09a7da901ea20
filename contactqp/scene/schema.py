"""Define the keys of a case file. The same names build a scene in Python: ``Scene(title=..., axes=["x"],
nodes=[...])``.

Elements between nodes have their keys in `contactqp.scene.blocks`, elastic bodies in `contactqp.scene.schema_bodies`.

Functions of a scene give its unknowns, which of them are fixed, the load factors on its path, and the initial values of
its motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import ceil
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from contactqp.scene import fields
from contactqp.scene.blocks import Frame
from contactqp.scene.blocks.beams_and_strings import LineLoad
from contactqp.scene.blocks.element import ROTATION
from contactqp.scene.claims import Expectation, Published, Remark, Report, Study
from contactqp.scene.fields import Block, Name, Number, TwoNames, add_patterns_of_units, check_own_keys, no_such
from contactqp.scene.schema_bodies import Body, Membrane, PointLoad, PressureLoad, Support, Traction

# The required and the optional keys of each kind of obstacle.
OBSTACLES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "plane": (("point", "normal"), ()),
    "circle": (("centre", "radius"), ("inside",)),
    "sphere": (("centre", "radius"), ("inside",)),
    "cylinder": (("point", "axis", "radius"), ("inside",)),
    "paraboloid": (("apex", "axis", "radius"), ("inside", "measure")),
}


# The subjects of cases, in the order in which they are listed.
PHYSICS = (
    "bars, springs and beams",
    "strings and membranes",
    "elastic bodies",
    "friction",
    "large displacements",
    "motion and impact",
)


_TOUCHING = ("node", "nodes", "side", "sides", "membrane")


class Obstacle(Block):
    """A rigid obstacle; bodies are outside of it, or in the hole that it leaves if `inside`.

    plane: through `point`; `normal`, of any length, points out of it, to where the body is. At small displacements
    nodes touch planes only; sides of bodies touch all of these.
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
        given = self.model_fields_set - {"name", "kind"}
        fitting = [kind for kind, keys in OBSTACLES.items() if given <= {*keys[0], *keys[1]}]
        if "kind" not in self.model_fields_set and fitting and self.kind not in fitting:
            expected = " or ".join(map(repr, fitting))
            raise ValueError(f"kind: expected {expected} beside {', '.join(sorted(given))}, and missing: a plane")
        required, optional = OBSTACLES[self.kind]
        check_own_keys(self, self.kind, required, ("name", "kind", *optional))
        return self


class Contact(Block):
    """A pair of partners that may touch, in one of five forms.

    `node` and `obstacle`; two `nodes`, along `direction` or else along the line from the first to the second; a `side`
    of a body (``"block.bottom"``) and `obstacle`; two `sides`, the slave's first, by the `pairing` ``"mortar"`` or
    ``"node-to-segment"``. Parts of two sides further apart than `reach` have no partner, and at the start a side may
    be inside of what it touches by `overlap`; the defaults of both follow the size of the facets. A `membrane` and
    `obstacle`: it stays above.

    `friction` is Coulomb's coefficient; between nodes, or a node and an obstacle, slip is counted from `slip_origin`,
    the displacement along the axes (of the first node against the second) at first contact. On a load path it is
    computed.
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
        for both in (self.nodes, self.sides):
            if both is not None and both[0] == both[1]:
                raise ValueError(f"{key}: expected two that may touch each other, got {both[0]!r} twice")
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
        """Return the one node, or the two."""
        return self.nodes or ((self.node,) if self.node else ())

    @property
    def touching_sides(self) -> tuple[str, ...]:
        """Return the one side, or the slave's and the master's."""
        return self.sides or ((self.side,) if self.side else ())


# The controls of a path at large deformations, with the keys of each.
CONTROLS: dict[str, tuple[str, ...]] = {
    "load": (),
    "displacement": ("controlled", "target"),
    "arc-length": ("arc_length",),
}

# The factors of loads by their names.
Corner = dict[Name, Number]


class LoadPath(Block):
    """The path of the loads, proportional from zero to their values or piecewise linear between corners.

    A corner states the factors of the loads there, 0 for loads that it does not name. Loads with the same `name` share
    a factor, and ``gravity`` names the weight of masses and bodies::

        corners = [{ gravity = 1 }, { gravity = 1, push = 1 }, { gravity = 1, push = -0.5 }]

    In between each factor is linear in the pseudo-time, which is 0 where nothing is loaded, 1 at the first corner, 2 at
    the second. Each way from corner to corner has `steps` equal steps. With ``events = "exact"`` every change of
    contact is found exactly, in steps between its events and the corners, and `steps` are only for drawing curves.

    With ``deformation = "large"`` there are 10 `steps` if none are stated, and `control` says how they are taken. By
    ``"load"``, the default, the load factor grows. By ``"displacement"`` the unknown `controlled` goes to `target` in
    equal steps, and by ``"arc-length"`` each step is `arc_length` long; then the load factor follows, and the path goes
    through limit points.
    """

    steps: Annotated[int, Field(strict=True, ge=1, le=1_000_000)] | None = None
    events: Literal["exact"] | None = None
    corners: Annotated[tuple[Corner, ...], Field(min_length=1, max_length=1000)] | None = None
    control: Literal["load", "displacement", "arc-length"] | None = None
    controlled: Name | None = None
    target: fields.Length | None = None
    arc_length: fields.PositiveLength | None = None

    @model_validator(mode="after")
    def _own_keys(self) -> Self:
        control = self.control or "load"
        for owner, keys in CONTROLS.items():
            for key in keys:
                if owner != control and getattr(self, key) is not None:
                    raise ValueError(f"{key}: expected with control = {owner!r} only, got it with {control!r}")
        for key in CONTROLS["displacement"] if control == "displacement" else ():
            if getattr(self, key) is None:
                raise ValueError(f"{key}: expected with control = 'displacement', and missing")
        return self


MOST_STEPS = 1_000_000


def _known_scheme(value: str) -> str:
    from contactqp.analysis.motion.schemes import SCHEMES

    if value not in SCHEMES:
        raise ValueError(no_such(value, SCHEMES, "scheme"))
    return value


class _Start(Block):
    """An initial value of a body, a bar, a node, or one unknown ``node.axis``."""

    of: Name


class StartVelocity(_Start):
    """An initial velocity along the axes, one number for an unknown; for a bar or beam `to` is that of its second node,
    linear between.
    """

    value: fields.Velocities
    to: fields.Velocities | None = None


class StartDisplacement(_Start):
    """An initial displacement, with the keys of a velocity."""

    value: fields.Displacements
    to: fields.Displacements | None = None


class Motion(Block):
    """The scene moves: from `start` on for `duration`, in equal steps, all loads constant.

    `scheme` is one of `contactqp.impact`, and `theta`, `restitution` and `penalty` are its parameters. `mass` is
    ``consistent`` or ``lumped``. Parts that `displacements` and `velocities` do not name start undeformed and at rest.
    """

    start: Annotated[fields.Time, Field(validate_default=True)] = "0 s"  # type: ignore[assignment]
    duration: fields.PositiveTime
    time_step: fields.PositiveTime
    scheme: Annotated[Name, AfterValidator(_known_scheme)] = "moreau-jean"
    theta: Number | None = None
    restitution: Number | None = None
    penalty: fields.Stiffness | None = None
    mass: Literal["consistent", "lumped"] = "consistent"
    displacements: tuple[StartDisplacement, ...] = ()
    velocities: tuple[StartVelocity, ...] = ()

    @model_validator(mode="after")
    def _fits_the_scheme(self) -> Self:
        from contactqp.analysis.motion.schemes import SCHEMES

        for name, low in (("theta", Fraction(1, 2)), ("restitution", Fraction(0))):
            value = getattr(self, name)
            if value is not None and not low <= value <= 1:
                raise ValueError(f"{name}: expected a number from {float(low):g} to 1, got {float(value):g}")
        for name in ("theta", "restitution", "penalty"):
            if getattr(self, name) is not None and name not in SCHEMES[self.scheme].knobs:
                takers = ", ".join(other for other, kind in SCHEMES.items() if name in kind.knobs)
                raise ValueError(f"{name}: the scheme {self.scheme!r} has none, only {takers}")
        if self.scheme == "penalty" and self.penalty is None:
            raise ValueError("penalty: expected for the scheme 'penalty', and missing")
        if self.steps > MOST_STEPS:
            raise ValueError(f"time_step: expected at most {MOST_STEPS} steps, got {self.steps} of {self.time_step}")
        return self

    @property
    def steps(self) -> int:
        """Return the number of steps."""
        return ceil(self.duration.si / self.time_step.si)

    @property
    def end(self) -> Fraction:
        """Return when the last step ends [s]."""
        return self.start.si + self.duration.si


class Term(Block):
    """One unknown of a tie and its factor; a rotation's factor is a length, its lever."""

    unknown: Name
    factor: fields.Factor


class Tie(Block):
    """A multi-point constraint: sum of factor times unknown = value.

    With one term of factor 1 it states a displacement, such as that of a support that settles, and its force is what
    holds the node there.
    """

    name: Name
    terms: Annotated[tuple[Term, ...], Field(min_length=1)]
    value: fields.TieValue


class Load(Block):
    """A force along an unknown, or a moment about a rotation; corners of a path refer to its `name`."""

    name: Name | None = None
    unknown: Name
    value: fields.Force


class SceneData(Frame):
    """The contents of a case file as frozen data, before the parts are checked against each other."""

    fixed: tuple[Name, ...] = ()  # unknowns, or nodes with all of theirs
    ties: tuple[Tie, ...] = ()
    bodies: tuple[Body, ...] = ()
    membranes: tuple[Membrane, ...] = ()
    supports: tuple[Support, ...] = ()  # of bodies and membranes
    obstacles: tuple[Obstacle, ...] = ()
    contacts: tuple[Contact, ...] = ()
    loads: tuple[Load, ...] = ()  # on unknowns of nodes
    line_loads: tuple[LineLoad, ...] = ()  # on strings and beams
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
    def file(self) -> Path | None:
        """Return the case file it was read from, if any."""
        return self._file

    @property
    def weighs(self) -> bool:
        """Return whether masses act: as weights under gravity, or as inertia in a motion."""
        return self.gravity is not None or self.motion is not None

    @property
    def physics(self) -> str:
        """Return the subject of the case, one of `PHYSICS`."""
        if self.motion is not None:
            return "motion and impact"
        if self.large:
            return "large displacements"
        if any(contact.friction for contact in self.contacts):
            return "friction"
        if self.membranes or self.strings:
            return "strings and membranes"
        return "elastic bodies" if self.bodies else "bars, springs and beams"

    @property
    def meshed(self) -> tuple[Body | Membrane, ...]:
        """Return the bodies and membranes."""
        return (*self.bodies, *self.membranes)

    def body(self, name: str) -> Body:
        """Return the body of that name."""
        return next(body for body in self.bodies if body.name == name)

    def obstacle(self, name: str) -> Obstacle:
        """Return the obstacle of that name."""
        return next(obstacle for obstacle in self.obstacles if obstacle.name == name)


def case_schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of case files; blocks that were registered are in it."""
    schema = SceneData.model_json_schema() | {"title": "A case of contactqp"}
    add_patterns_of_units(schema)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema


@dataclass(frozen=True)
class Unknowns:
    """Every unknown of every node, ``node.axis`` and ``node.theta``, node by node."""

    names: tuple[str, ...]
    fixed: frozenset[str]

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Return the free unknowns."""
        return tuple(name for name in self.names if name not in self.fixed)

    @cached_property
    def place(self) -> dict[str, int]:
        """Return the index of each unknown."""
        return {name: i for i, name in enumerate(self.names)}


def is_rotation(unknown: str) -> bool:
    """Return whether an unknown is a rotation."""
    return unknown.endswith("." + ROTATION)


def unknowns_of(scene: SceneData) -> Unknowns:
    """Return the displacements of all nodes, and rotations at the nodes of beams."""
    turning = {node for _, element in scene.elements for node in element.turning}
    by_node = {
        node: scene.displacements(node) + ((f"{node}.{ROTATION}",) if node in turning else ())
        for node in scene.every_node
    }
    fixed = {unknown for entry in scene.fixed for unknown in by_node.get(entry, (entry,))}
    return Unknowns(tuple(name for names in by_node.values() for name in names), frozenset(fixed))


# The name of the load by the weight of masses and bodies.
GRAVITY = "gravity"


@dataclass(frozen=True)
class Factors:
    """The factors of the named loads, and the factor of all others."""

    others: Fraction = Fraction(0)
    named: Mapping[str, Fraction] = field(default_factory=dict)

    def of(self, name: str | None) -> Fraction:
        """Return the factor of the loads of that name; None is a load without one."""
        return self.others if name is None else self.named.get(name, self.others)


def has_corners(scene: SceneData) -> bool:
    """Return whether the path has corners, at which loads have factors of their own."""
    return scene.path is not None and scene.path.corners is not None


def end_time(scene: SceneData) -> Fraction:
    """Return the pseudo-time at which the path ends: 1 for each leg from corner to corner."""
    return Fraction(len(scene.path.corners) if scene.path and scene.path.corners else 1)


def factors_at(scene: SceneData, time: Fraction) -> Factors:
    """Return the factors at a pseudo-time of the path; without corners, all loads times `time`."""
    if scene.path is None or scene.path.corners is None:
        return Factors(others=time)
    corners: list[Mapping[str, Fraction]] = [{}, *scene.path.corners]
    leg = max(ceil(time), 1)
    before, after, part = corners[leg - 1], corners[leg], time - (leg - 1)
    zero = Fraction(0)
    return Factors(
        named={
            name: before.get(name, zero) + part * (after.get(name, zero) - before.get(name, zero))
            for name in {**before, **after}
        }
    )


def load_names(scene: SceneData) -> Iterator[tuple[str, str | None]]:
    """Yield the key of every load and its name in corners."""
    for key in ("loads", "line_loads", "tractions", "pressures", "point_loads"):
        yield from ((f"{key}[{i}]", load.name) for i, load in enumerate(getattr(scene, key)))
    if scene.gravity is not None:
        yield "gravity", GRAVITY


def start_values(scene: SceneData, item: StartVelocity | StartDisplacement) -> Iterator[tuple[str, Fraction]]:
    """Yield every unknown, or ``body.axis``, with an initial value by this entry, in the scene's units."""
    value = [scene.value(component) for component in item.value]
    member = next((one for one in scene.divided if one.name == item.of), None)
    if member is not None:
        end = value if item.to is None else [scene.value(component) for component in item.to]
        yield from member.linear(scene, value, end)
    elif scene.meshed or item.of in scene.every_node:
        yield from zip(scene.displacements(item.of), value, strict=True)
    else:
        yield item.of, value[0]
