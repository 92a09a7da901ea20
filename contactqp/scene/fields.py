"""The types of the keys of a case file, and how a wrong one is worded."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Annotated, Any, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator, ValidationError

from contactqp.scene.units import KINDS, NotANumber, Quantity, describe, read_number, read_quantity


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


# How a wrong case is spoken of: one line, the key's path, what was expected, what came, the nearest known name.

Location = tuple[int | str, ...]


def unknown(name: object, known: Iterable[str], what: str) -> str:
    """``there is no node 'B1'; nearest: 'B'``, or all that there are if none is near."""
    names = list(known)
    near = difflib.get_close_matches(str(name), names, n=1)
    if near:
        return f"there is no {what} {name!r}; nearest: {near[0]!r}"
    return f"there is no {what} {name!r}; known: " + (", ".join(repr(n) for n in sorted(names)) or "none")


def key_path(location: Location, data: Mapping[str, Any]) -> str:
    """``bars[1].area (bar 'left')``, from where pydantic found the error."""
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    name = _name_of(location, data)
    return f"{path} ({name!r})" if name and path else path


def _name_of(location: Location, data: Any) -> str | None:
    """The name of the innermost table that the location is in and that has one."""
    name = None
    for part in location:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            break
        if isinstance(data, Mapping) and isinstance(data.get("name"), str):
            name = data["name"]
    return name


def first_error(error: ValidationError, model: type[BaseModel], data: Mapping[str, Any]) -> str:
    """The first thing that is wrong, in one line, and how many more there are."""
    # An unknown key explains the key that is then missing, so it is said first.
    errors = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    first, others = errors[0], len(errors) - 1
    message = f"{key_path(first['loc'], data)}: {_sentence(first, model)}".removeprefix(": ")
    return " ".join(message.split()) + (f" (and {others} more)" if others else "")


def _sentence(error: Any, model: type[BaseModel]) -> str:
    kind, context = error["type"], error.get("ctx", {})
    if kind == "extra_forbidden":
        *table, key = error["loc"]
        return unknown(key, table_keys(model, table), "key")
    if kind == "missing":
        return "expected, and missing"
    if kind == "value_error":
        return str(context["error"])
    if kind == "too_short":
        return f"expected at least {context['min_length']}, got {context['actual_length']}"
    if kind == "too_long":
        return f"expected at most {context['max_length']}, got {context['actual_length']}"
    if kind == "literal_error":
        return f"expected {context['expected']}, got {describe(error['input'])}"
    expected = {
        "model_type": "a table",
        "dict_type": "a table",
        "tuple_type": "a list",
        "string_type": "a text in quotes",
        "int_type": "a whole number",
        "bool_type": "true or false",
    }
    if kind in expected:
        return f"expected {expected[kind]}, got {describe(error['input'])}"
    return f"{error['msg'][:1].lower()}{error['msg'][1:]}, got {describe(error['input'])}"


def table_keys(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """The known keys of the table at a location of the scene."""
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            model = _inner_model(model.model_fields[part].annotation) or model
    return list(model.model_fields)


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in get_args(annotation):
        if found := _inner_model(argument):
            return found
    return None
