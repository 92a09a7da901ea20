"""The types that the keys of a case file can have."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator

from contactqp.scene.expression import NotANumber
from contactqp.scene.units import KINDS, Quantity, describe, read_number, read_quantity


class Block(BaseModel):
    """A table of a case file: no unknown keys, nothing changes after it is read."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


def _reader(kind: str, roots: bool = False) -> Callable[[Any], Quantity]:
    return lambda value: read_quantity(value, [KINDS[kind]], roots=roots)


def _positive(value: Quantity) -> Quantity:
    if value.si <= 0:
        raise ValueError(f"expected a positive number, got {value.text!r}")
    return value


def _number(value: Any) -> Fraction:
    try:
        return read_number(value)
    except NotANumber as error:
        raise ValueError(f"expected a number, got {error}") from None


def _not_negative(value: Fraction) -> Fraction:
    if value < 0:
        raise ValueError(f"expected a number that is not negative, got {float(value):g}")
    return value


def _poisson(value: Fraction) -> Fraction:
    if not -1 < value < Fraction(1, 2):
        raise ValueError(f"expected Poisson's ratio above -1 and below 0.5, got {float(value):g}")
    return value


def _grading(value: Fraction) -> Fraction:
    if value < 1:
        raise ValueError(f"expected a ratio of sizes of at least 1, got {float(value):g}")
    return value


def _zero_or_more(value: Quantity) -> Quantity:
    if value.si < 0:
        raise ValueError(f"expected zero or a positive number, got {value.text!r}")
    return value


def _name(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f'expected a name in quotes such as "wall", got {describe(value)}')
    if not value.strip() or value != value.strip() or "\n" in value:
        raise ValueError(f"expected a name without blanks around it, got {value!r}")
    return value


def _node_name(value: Any) -> str:
    if "." in _name(value):
        raise ValueError(f"expected a node's name without a full stop (node.axis names an unknown), got {value!r}")
    return _name(value)


def _body_name(value: Any) -> str:
    if "." in _name(value):
        raise ValueError(f"expected a body's name without a full stop (body.side names a side), got {value!r}")
    return _name(value)


Name = Annotated[str, PlainValidator(_name)]
NodeName = Annotated[str, PlainValidator(_node_name)]
TwoNames = Annotated[tuple[Name, ...], Field(min_length=2, max_length=2)]
BodyName = Annotated[str, PlainValidator(_body_name)]
Number = Annotated[Fraction, PlainValidator(_number)]
FrictionCoefficient = Annotated[Number, AfterValidator(_not_negative)]
Length = Annotated[Quantity, PlainValidator(_reader("length"))]
PositiveLength = Annotated[Quantity, PlainValidator(_reader("length")), AfterValidator(_positive)]
NotNegativeLength = Annotated[Quantity, PlainValidator(_reader("length")), AfterValidator(_zero_or_more)]
Area = Annotated[Quantity, PlainValidator(_reader("area")), AfterValidator(_positive)]
Inertia = Annotated[Quantity, PlainValidator(_reader("second moment of area")), AfterValidator(_positive)]
Modulus = Annotated[Quantity, PlainValidator(_reader("modulus")), AfterValidator(_positive)]
Stiffness = Annotated[Quantity, PlainValidator(_reader("stiffness")), AfterValidator(_positive)]
Tension = Annotated[Quantity, PlainValidator(_reader("tension")), AfterValidator(_positive)]
KnobStiffness = Annotated[Quantity, PlainValidator(_reader("stiffness"))]  # the method says what it accepts
Mass = Annotated[Quantity, PlainValidator(_reader("mass")), AfterValidator(_positive)]
Density = Annotated[Quantity, PlainValidator(_reader("density")), AfterValidator(_zero_or_more)]
Poisson = Annotated[Number, AfterValidator(_poisson)]
Grading = Annotated[Number, AfterValidator(_grading)]
Pressure = Annotated[Quantity, PlainValidator(_reader("pressure"))]
PositiveForce = Annotated[Quantity, PlainValidator(_reader("force")), AfterValidator(_positive)]
PureForce = Annotated[Quantity, PlainValidator(_reader("force"))]
Acceleration = Annotated[Quantity, PlainValidator(_reader("acceleration"))]
Force = Annotated[Quantity, PlainValidator(lambda value: read_quantity(value, [KINDS["force"], KINDS["moment"]]))]
Factor = Annotated[Quantity, PlainValidator(lambda value: read_quantity(value, [KINDS["number"], KINDS["length"]]))]
TieValue = Annotated[Quantity, PlainValidator(lambda value: read_quantity(value, [KINDS["length"], KINDS["angle"]]))]
# Times in which a wave crosses an element are roots.
Time = Annotated[Quantity, PlainValidator(_reader("time", roots=True))]
PositiveTime = Annotated[Time, AfterValidator(_positive)]
Velocity = Annotated[Quantity, PlainValidator(_reader("velocity"))]
Vector = Annotated[tuple[Number, ...], Field(min_length=1, max_length=3)]
Forces = Annotated[tuple[PureForce, ...], Field(min_length=2, max_length=3)]
LineForces = Annotated[
    tuple[Annotated[Quantity, PlainValidator(_reader("force per length"))], ...], Field(min_length=2, max_length=3)
]
Tractions = Annotated[tuple[Pressure, ...], Field(min_length=2, max_length=3)]
Velocities = Annotated[tuple[Velocity, ...], Field(min_length=1, max_length=3)]
Point = Annotated[tuple[Length, ...], Field(min_length=1, max_length=3)]
