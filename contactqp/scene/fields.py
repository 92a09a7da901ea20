"""Define the types of keys in case files, and the one-line messages about wrong ones.

A message states the path of the key, what was expected, what came, and the nearest existing name.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import accumulate
from typing import Annotated, Any, Self, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator, ValidationError, WithJsonSchema

from contactqp.errors import SceneError
from contactqp.scene.units import (
    KINDS,
    NotANumber,
    Quantity,
    describe,
    quantity_pattern,
    read_number,
    read_quantity,
    read_unit,
    split_number,
)


class Block(BaseModel):
    """A table of a case file: no unknown keys, nothing changes after it is read."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True, defer_build=True)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with some keys changed, without cached properties of the original."""
        copied = super().model_copy(update=update, deep=deep)
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]
        return copied


def check_own_keys(table: Block, kind: str, required: Sequence[str], optional: Sequence[str]) -> None:
    """Raise ValueError where a table lacks a key that its kind needs, or has one of another kind.

    Parameters
    ----------
    table : Block
    kind : the kind of the table, such as "sphere"
    required, optional : sequences of str
        The keys of the kind; those that tables of all kinds have are among the optional ones, first.
    """
    for key in required:
        if getattr(table, key) is None:
            raise ValueError(f"{key}: expected for a {kind}, and missing")
    for key in type(table).model_fields:
        if key not in (*required, *optional) and getattr(table, key) is not None:
            own = ", ".join([*optional[:2], *required, *optional[2:]])
            raise ValueError(f"{key}: a {kind} has no such key; its own: {own}")


# A pattern for a JSON schema: the text begins like a number, as 12, -1.5e3, 5/7 or sqrt(2).
_BEGINS_AS_NUMBER = r"^\s*[-+]?(\d|\.\d|sqrt)"


def _quantity(*kinds: str, roots: bool = False) -> tuple[PlainValidator, WithJsonSchema]:
    """Return a validator of quantities of these kinds, and their entry in the JSON schema."""
    allowed = [KINDS[kind] for kind in kinds]
    schema: dict[str, Any] = {
        "type": ["string", "number"] if "number" in kinds else "string",
        "pattern": _BEGINS_AS_NUMBER,
        "description": " or ".join(f'{kind.article} such as "{kind.example}"' for kind in allowed),
        "examples": [kind.example for kind in allowed],
    }
    return PlainValidator(lambda value: read_quantity(value, allowed, roots=roots)), WithJsonSchema(schema)


def add_patterns_of_units(schema: Any) -> None:
    """Add the units of quantities to a JSON schema, whose patterns otherwise only check how a number begins.

    This is done only when the schema is printed, as the list of units takes longer to build than a small case to solve.
    """
    if isinstance(schema, list):
        for part in schema:
            add_patterns_of_units(part)
    elif isinstance(schema, dict):
        if schema.get("pattern") == _BEGINS_AS_NUMBER and "description" in schema:
            read = [read_unit(split_number(example)[1])[1] for example in schema["examples"]]
            schema["pattern"] = quantity_pattern(read)
        for part in schema.values():
            add_patterns_of_units(part)


def _number(value: Any) -> Fraction:
    try:
        return read_number(value)
    except NotANumber as error:
        raise ValueError(f"expected a number, got {error}") from None


def _must(holds: Callable[[Any], bool], expected: str) -> AfterValidator:
    """Return a validator of a number or quantity whose message states what was expected."""

    def check(value: Any) -> Any:
        if not holds(value.si if isinstance(value, Quantity) else value):
            got = repr(value.text) if isinstance(value, Quantity) else f"{float(value):g}"
            raise ValueError(f"expected {expected}, got {got}")
        return value

    return AfterValidator(check)


_POSITIVE = _must(lambda size: size > 0, "a positive number")
_NOT_NEGATIVE = _must(lambda size: size >= 0, "zero or a positive number")


def _name(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f'expected a name in quotes such as "wall", got {describe(value)}')
    if not value.strip() or value != value.strip() or "\n" in value:
        raise ValueError(f"expected a name without blanks around it, got {value!r}")
    return value


def _plain_name(owner: str, part: str) -> Callable[[Any], str]:
    """Return a validator of names, which must not contain the full stop that separates a name from its part."""

    def read(value: Any) -> str:
        if "." in _name(value):
            raise ValueError(f"expected a {owner}'s name without a full stop ({part}), got {value!r}")
        return _name(value)

    return read


_NAME = WithJsonSchema({"type": "string", "description": "a name in quotes"})
Name = Annotated[str, PlainValidator(_name), _NAME]
NodeName = Annotated[str, PlainValidator(_plain_name("node", "node.axis names an unknown")), _NAME]
TwoNames = Annotated[tuple[Name, ...], Field(min_length=2, max_length=2)]
BodyName = Annotated[str, PlainValidator(_plain_name("body", "body.side names a side")), _NAME]
Number = Annotated[
    Fraction,
    PlainValidator(_number),
    WithJsonSchema({"type": ["number", "string"], "pattern": _BEGINS_AS_NUMBER, "examples": [0.3, "5/7"]}),
]
FrictionCoefficient = Annotated[Number, _must(lambda size: size >= 0, "a number that is not negative")]
Length = Annotated[Quantity, *_quantity("length")]
PositiveLength = Annotated[Quantity, *_quantity("length"), _POSITIVE]
NotNegativeLength = Annotated[Quantity, *_quantity("length"), _NOT_NEGATIVE]
Area = Annotated[Quantity, *_quantity("area"), _POSITIVE]
Inertia = Annotated[Quantity, *_quantity("second moment of area"), _POSITIVE]
Modulus = Annotated[Quantity, *_quantity("modulus"), _POSITIVE]
Stiffness = Annotated[Quantity, *_quantity("stiffness"), _POSITIVE]
Tension = Annotated[Quantity, *_quantity("tension"), _POSITIVE]
KnobStiffness = Annotated[Quantity, *_quantity("stiffness")]  # the method says what it accepts
Mass = Annotated[Quantity, *_quantity("mass"), _POSITIVE]
Density = Annotated[Quantity, *_quantity("density"), _NOT_NEGATIVE]
Poisson = Annotated[Number, _must(lambda size: -1 < size < Fraction(1, 2), "Poisson's ratio above -1 and below 0.5")]
Grading = Annotated[Number, _must(lambda size: size >= 1, "a ratio of sizes of at least 1")]
Pressure = Annotated[Quantity, *_quantity("pressure")]
PositiveForce = Annotated[Quantity, *_quantity("force"), _POSITIVE]
PureForce = Annotated[Quantity, *_quantity("force")]
Acceleration = Annotated[Quantity, *_quantity("acceleration")]
Force = Annotated[Quantity, *_quantity("force", "moment")]
Factor = Annotated[Quantity, *_quantity("number", "length")]
TieValue = Annotated[Quantity, *_quantity("length", "angle")]
# Roots are allowed, as the time in which a wave crosses an element is one.
Time = Annotated[Quantity, *_quantity("time", roots=True)]
PositiveTime = Annotated[Time, _POSITIVE]
Velocity = Annotated[Quantity, *_quantity("velocity", "angular velocity")]
SOME = Field(min_length=1)
Vector = Annotated[tuple[Number, ...], Field(min_length=1, max_length=3)]
Forces = Annotated[tuple[PureForce, ...], Field(min_length=2, max_length=3)]
LineForces = Annotated[
    tuple[Annotated[Quantity, *_quantity("force per length")], ...], Field(min_length=2, max_length=3)
]
Tractions = Annotated[tuple[Pressure, ...], Field(min_length=2, max_length=3)]
Velocities = Annotated[tuple[Velocity, ...], Field(min_length=1, max_length=3)]
Displacements = Annotated[tuple[TieValue, ...], Field(min_length=1, max_length=3)]
Point = Annotated[tuple[Length, ...], Field(min_length=1, max_length=3)]


Location = tuple[int | str, ...]

# The most characters of a name, and of a list of names, in a message.
LONGEST_NAME, LONGEST_LIST = 80, 400


def no_such(name: object, allowed: Iterable[str], what: str) -> str:
    """Return a message that a name does not exist, with the nearest name, or the first names where none is near.

    ``there is no node 'B1'; nearest: 'B'``.
    """
    names, text = list(allowed), _in_quotes(name)
    near = difflib.get_close_matches(str(name)[:LONGEST_NAME], names, n=1)
    if near:
        return f"there is no {what} {text}; nearest: {near[0]!r}"
    return f"there is no {what} {text}; known: {_first_of(names) or 'none'}"


def _in_quotes(name: object) -> str:
    text = repr(name)
    return text if len(text) <= LONGEST_NAME else f"{text[:LONGEST_NAME]}…"


def _first_of(names: Collection[str]) -> str:
    """Return as many names as a line holds, and how many more there are."""
    quoted = [_in_quotes(name) for name in sorted(names)]
    ends = list(accumulate(len(name) for name in quoted))
    count = max(1, sum(end <= LONGEST_LIST for end in ends))
    more = f" and {len(quoted) - count} more" if len(quoted) > count else ""
    return ", ".join(quoted[:count]) + more


def refuse_unknown(key: str, name: object, allowed: Collection[str], what: str) -> None:
    """Raise SceneError unless a name is one that there is.

    Parameters
    ----------
    key : str
        Where the name stands, as in ``bars[1].nodes[0] ('left')``.
    name : str
    allowed : collection of str
    what : what is called so, as in "node"
    """
    if name not in allowed:
        raise SceneError(f"{key}: {no_such(name, allowed, what)}")


def key_path(location: Location, data: Mapping[str, Any]) -> str:
    """Return the path of a key, as in ``bars[1].area ('left')``, from where pydantic found the error."""
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    name = _name_of(location, data)
    return f"{path} ({name!r})" if name and path else path


def _name_of(location: Location, data: Any) -> str | None:
    """Return the name of the innermost table that the location is in and that has one."""
    name = None
    for part in location:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            break
        if isinstance(data, Mapping) and isinstance(data.get("name"), str):
            name = data["name"]
    return name


def first_errors(error: ValidationError, model: type[BaseModel], data: Mapping[str, Any]) -> str:
    """Return one line with the first two errors and the number of all."""
    # An unknown key explains a missing one, which is then not reported.
    errors = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    unknown = {tuple(e["loc"][:-1]) for e in errors if e["type"] == "extra_forbidden"}
    errors = [e for e in errors if not (e["type"] == "missing" and tuple(e["loc"][:-1]) in unknown)]
    # A list with a wrong entry is also reported as too short, which is left out.
    within = {tuple(e["loc"][:depth]) for e in errors for depth in range(1, len(e["loc"]))}
    errors = [e for e in errors if tuple(e["loc"]) not in within]
    told = [f"{key_path(e['loc'], data)}: {_sentence(e, model)}".removeprefix(": ") for e in errors[:2]]
    message = told[0] + "".join(f" (1 of {len(errors)}; the next: {text})" for text in told[1:])
    return " ".join(message.split())


def _sentence(error: Any, model: type[BaseModel]) -> str:
    kind, context = error["type"], error.get("ctx", {})
    if kind == "extra_forbidden":
        *table, key = error["loc"]
        return no_such(key, table_keys(model, table), "key")
    if kind == "missing":
        return f"expected{_example(model, error['loc'])}, and missing"
    if kind == "value_error":
        return str(context["error"])
    if kind == "too_short":
        return f"expected at least {context['min_length']}, got {context['actual_length']}"
    if kind == "too_long":
        return f"expected at most {context['max_length']}, got {context['actual_length']}"
    if kind in ("greater_than_equal", "less_than_equal"):
        beyond, limit = ("least", "ge") if kind == "greater_than_equal" else ("most", "le")
        return f"expected a number of at {beyond} {context[limit]}, got {error['input']}"
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
        needed = _needed(model, error["loc"]) if kind == "model_type" else ""
        return f"expected {expected[kind]}{needed}, got {describe(error['input'])}"
    return f"{error['msg'][:1].lower()}{error['msg'][1:]}, got {describe(error['input'])}"


def table_keys(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """Return the keys that the table at a location of the scene can have."""
    return list(_table(model, location).model_fields)


def _needed(model: type[BaseModel], location: Sequence[int | str]) -> str:
    """Return the required keys of the table at a location as text, empty where there are none."""
    fields = _table(model, location).model_fields
    needed = [repr(key) for key, field in fields.items() if field.is_required()]
    return f" with {' and '.join(needed)}" if 0 < len(needed) < 4 else ""


def _table(model: type[BaseModel], location: Sequence[int | str]) -> type[BaseModel]:
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            model = _inner_model(model.model_fields[part].annotation) or model
    return model


def _example(model: type[BaseModel], location: Sequence[int | str]) -> str:
    """Return `` an area such as "15 cm^2"`` for a key that takes a quantity; empty for others."""
    *table, key = location
    field = _table(model, table).model_fields.get(str(key))
    schemas = (extra.json_schema for extra in (field.metadata if field else ()) if isinstance(extra, WithJsonSchema))
    found = next((schema for schema in schemas if schema and "such as" in schema.get("description", "")), None)
    return f" {found['description']}" if found else ""


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in get_args(annotation):
        if found := _inner_model(argument):
            return found
    return None
