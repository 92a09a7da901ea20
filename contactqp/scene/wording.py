"""How a wrong case is spoken of: one line, the key's path, what was expected, what came, the nearest known name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from contactqp.scene.units import describe

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
