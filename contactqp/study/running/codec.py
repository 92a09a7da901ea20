"""Frozen dataclasses as JSON and back, by the annotations of their fields.

Strings, numbers, truth values and None stay what they are; NaN and infinities too, in Python's dialect of JSON. Arrays
and bytes become base64, tuples and lists become lists, fractions text. What is annotated as Any must be plain already.
"""

from __future__ import annotations

import base64
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from fractions import Fraction
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

_PLAIN = {str, int, float, bool}
_BYTES, _ARRAY, _KIND, _SHAPE = "base64", "array", "dtype", "shape"


def encode(value: Any) -> Any:
    """Plain data of a value.

    Raises
    ------
    TypeError
        The value holds something that is no plain data and no dataclass of it.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: encode(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "model_dump"):
        return value.model_dump()
    if isinstance(value, Mapping):
        return {str(key): encode(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [encode(item) for item in value]
    if isinstance(value, bytes):
        return {_BYTES: _text(value)}
    if isinstance(value, np.ndarray):
        return {_ARRAY: _text(np.ascontiguousarray(value).tobytes()), _KIND: value.dtype.str, _SHAPE: value.shape}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Fraction):
        return str(value)
    if value is None or isinstance(value, str | int | float):
        return value
    raise TypeError(f"expected plain data, got {type(value).__name__}")


def decode(data: Any, kind: Any) -> Any:
    """The value of a type that `encode` made these data of.

    Raises
    ------
    KeyError, TypeError, ValueError
        The data are not of that type.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return _decode_union(data, arguments)
    if kind is Any or kind in _PLAIN or data is None:
        return data
    if origin is np.ndarray or kind is np.ndarray:
        return np.frombuffer(_bytes(data[_ARRAY]), dtype=data[_KIND]).reshape(data[_SHAPE]).copy()
    if origin is tuple:
        return tuple(decode(item, _item(arguments, i)) for i, item in enumerate(data))
    if origin is not None and issubclass(origin, Mapping):
        return {key: decode(item, arguments[1]) for key, item in data.items()}
    if origin is list:
        return [decode(item, arguments[0]) for item in data]
    if kind is bytes:
        return _bytes(data[_BYTES])
    if hasattr(kind, "__dataclass_fields__"):
        return kind(**{name: decode(data[name], hint) for name, hint in _hints(kind).items() if name in data})
    return kind(**data) if hasattr(kind, "model_dump") else kind(data)


def _decode_union(data: Any, kinds: tuple[Any, ...]) -> Any:
    """A type or None, or one of several types that are what they are in JSON."""
    kinds = tuple(kind for kind in kinds if kind is not type(None))
    if data is None or set(kinds) <= _PLAIN:
        return data
    if len(kinds) > 1:
        raise TypeError(f"expected one type or none, got {kinds}")
    return decode(data, kinds[0])


def _item(arguments: tuple[Any, ...], i: int) -> Any:
    """The type of entry i of a tuple."""
    return arguments[0] if arguments[-1] is Ellipsis else arguments[i]


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _bytes(text: str) -> bytes:
    return base64.b64decode(text, validate=True)
