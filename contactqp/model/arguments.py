"""Check the arguments of public functions against the types in their signatures.

A `checked` function raises InvalidProblem before it computes anything; the message names the argument, what was
expected and what came. Arrays are read by the functions themselves (`contactqp.model.problem_data`).
"""

from __future__ import annotations

import builtins
import inspect
import numbers
import os
from collections.abc import Callable, Iterable, Mapping, Sequence, Set, Sized
from decimal import Decimal
from fractions import Fraction
from functools import wraps
from pathlib import Path
from types import UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, WrongCall, cure_of, shown
from contactqp.model.arrays import COLLECTING, Index, Indices, misfit
from contactqp.model.problem_data import is_masked, is_whole, refuse_masked

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", bound=type)

# Types whose entries have an order, without text.
SEQUENCES = (Sequence, Iterable, tuple, list)
# Larger integers cannot be counts and do not fit NumPy's types.
LARGEST_WHOLE = 2**63
# Longer iterables are refused.
MOST_ENTRIES = 10**8
NO_SEQUENCES = (str, bytes, Mapping, Set)


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function with a check of its arguments against the signature; one-time iterables are turned into
    tuples.

    Raises
    ------
    InvalidProblem
        An argument has another type. A call that does not fit the signature raises WrongCall, also a TypeError.
    """
    signature = inspect.signature(function)
    stated: dict[str, Any] = {}

    @wraps(function)
    def checking(*args: P.args, **kwargs: P.kwargs) -> R:
        if not stated:
            stated.update(_stated_types(function, signature))
        try:
            given = signature.bind(*args, **kwargs)
        except TypeError as error:
            raise WrongCall(f"{_called(function, args, {})}: {misfit(signature, kwargs, error)}") from None
        for name in given.arguments.keys() & stated.keys():
            place = f"{_called(function, args, given.arguments)}: {name}"
            given.arguments[name] = _accepted(place, given.arguments[name], stated[name])
        return function(*given.args, **given.kwargs)

    return checking


def checks(kind: C) -> C:
    """Check the arguments of the constructor and of the public methods of a class."""
    for name, value in tuple(vars(kind).items()):
        if inspect.isfunction(value) and (name == "__init__" or not name.startswith("_")):
            setattr(kind, name, checked(value))
    return kind


def _called(function: Callable[..., Any], args: tuple[Any, ...], given: Mapping[str, Any]) -> str:
    """Return the name of a function for messages, such as ``Structure.assemble``, or for a constructor its object's
    name or class.
    """
    if "." not in function.__qualname__ or not args:
        return function.__name__
    kind = (args[0] if isinstance(args[0], type) else type(args[0])).__name__
    if function.__name__ != "__init__":
        return f"{kind}.{function.__name__}"
    name = given.get("name")
    return str.__str__(name) if isinstance(name, str) else kind


def _stated_types(function: Callable[..., Any], signature: inspect.Signature) -> dict[str, Any]:
    names = _Names(inspect.unwrap(function).__globals__)
    stated = {
        name: eval(one.annotation, {}, names) if isinstance(one.annotation, str) else one.annotation
        for name, one in signature.parameters.items()
        if one.annotation is not one.empty and one.kind not in COLLECTING
    }
    return stated or {"": Any}


class _Names(dict[str, Any]):
    """The names of a module; one that is imported for type checkers only stands for any class of that name."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, None) or type(name, (_ByName,), {})


class _ByName:
    """A class identified by its name, so that it need not be imported."""


def _accepted(place: str, value: Any, stated: Any) -> Any:
    """Return a value of the stated type, a sequence where one is stated, or refuse it."""
    options = get_args(stated) if get_origin(stated) in (Union, UnionType) else (stated,)
    if any(_is_of(value, option) for option in options):
        # Unions for array-like arguments may contain float; an array with axes is not converted to one.
        scalar = isinstance(value, (np.ndarray, np.floating, Decimal, Fraction)) and _is_real(value)
        if isinstance(value, str):
            value = str.__str__(value)  # whatever the annotation of a subclass is
            if not any(option in (Path, os.PathLike) for option in options) and not _can_be_written(value):
                raise InvalidProblem(f"{place}: expected text, got one with half of a character: {shown(value)}")
        return float(value) if float in options and scalar else value
    for option in options:
        if get_origin(option) in SEQUENCES and _is_sequence(value):
            entries, kinds = _entries(place, value), get_args(option)
            if get_origin(option) is tuple and Ellipsis not in kinds and len(entries) != len(kinds):
                raise InvalidProblem(f"{place}: expected {len(kinds)} entries, got {shown(value)}")
            accepted = tuple(_accepted(f"{place}[{i}]", one, kinds[0]) for i, one in enumerate(entries))
            as_they_came = all(one is other for one, other in zip(accepted, entries, strict=True))
            return value if isinstance(value, Sequence) and as_they_came else accepted
        if get_origin(option) is Mapping and isinstance(value, Mapping) and not sp.issparse(value):
            for key, one in _entries(place, value):
                _accepted(f"{place}: a key", key, get_args(option)[0])
                _accepted(f"{place}[{shown(key)}]", one, get_args(option)[1])
            return value
    words = " or ".join(dict.fromkeys(_words(option) for option in options if option is not type(None)))
    cure = cure_of(value) if "Problem" in words or not isinstance(value, str) else ""
    raise InvalidProblem(f"{place}: expected {words}, got {shown(value)}{cure}")


def _is_sequence(value: Any) -> bool:
    """Return whether a value is a sequence of entries; a sparse matrix is not treated as one."""
    return isinstance(value, Iterable) and not isinstance(value, NO_SEQUENCES) and not sp.issparse(value)


def is_readable(value: Any) -> bool:
    """Return whether a collection is finite and not longer than any reasonable argument."""
    if isinstance(value, (np.ndarray, np.generic)):
        return True
    try:
        return len(value) <= MOST_ENTRIES if isinstance(value, Sized) else not hasattr(value, "__getitem__")
    except Exception:  # noqa: BLE001  a length below zero
        return False


def _entries(place: str, value: Iterable[Any]) -> tuple[Any, ...]:
    """Return the entries of an iterable, or the pairs of a mapping."""
    mapping = isinstance(value, Mapping)
    try:
        if isinstance(value, Sized) and not is_readable(value):
            raise ValueError(f"more than {MOST_ENTRIES:.0e} entries")
        return tuple(value.items() if isinstance(value, Mapping) else value)
    except Exception as error:
        expected = "a mapping" if mapping else "a sequence"
        raise InvalidProblem(f"{place}: expected {expected}, got {shown(value)} ({shown(error)})") from error


def _is_of(value: Any, stated: Any) -> bool:
    """Return whether a value has a type that is neither a union nor a sequence nor a mapping."""
    kind = get_origin(stated) or stated
    if kind is Any:
        return True
    if kind is Literal:
        return isinstance(value, str) and value in get_args(stated)
    if kind is int:
        return is_whole(value) and abs(value) < LARGEST_WHOLE
    if kind is float:
        return _is_real(value)
    if kind is bool:
        return isinstance(value, (bool, np.bool_))
    if kind is Callable:
        return callable(value)
    if kind in (Path, os.PathLike):
        return isinstance(value, os.PathLike) and _is_path(value)
    if not isinstance(kind, type) or kind.__module__.partition(".")[0] == "numpy" or kind is object:
        return kind not in SEQUENCES and kind is not Mapping  # any array, and anything
    if issubclass(kind, _ByName):
        return any(base.__name__ == kind.__name__ for base in type(value).__mro__)
    if getattr(kind, "_is_protocol", False):
        return not isinstance(value, type) and all(_has(value, name) for name in _members(kind))
    return isinstance(value, kind) and kind not in (*SEQUENCES, Mapping)


def _is_real(value: Any) -> bool:
    """Return whether a value is one real number, in an array without axes too; truth values are not."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.ndim == 0 and value.dtype.kind in "iuf" and not is_masked(value)
    if isinstance(value, bool) or not isinstance(value, (numbers.Real, Decimal)):
        return False
    try:
        float(value)
    except Exception:  # noqa: BLE001  beyond 1.8e308, a signalling NaN, somebody else's class
        return False
    return True


def _can_be_written(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:  # an unpaired surrogate, as in names of files
        return False
    return True


def _is_path(value: Any) -> bool:
    try:
        return isinstance(os.fspath(value), str)
    except Exception:  # noqa: BLE001  somebody else's class
        return False


def _members(protocol: type) -> list[str]:
    return [name for name in vars(protocol) if not name.startswith("_")]


def _has(value: Any, name: str) -> bool:
    try:
        return hasattr(value, name)
    except Exception:  # noqa: BLE001  a property of somebody else's class
        return True


def _words(stated: Any) -> str:
    """Return a type in words for messages: ``a number``, ``a Mesh``, ``a sequence with each a Support``."""
    kind = get_origin(stated) or stated
    simple = {float: "a number", int: "a whole number", bool: "True or False", str: "a string", Callable: "a function"}
    if kind in simple:
        return simple[kind]
    if kind is Literal:
        return "one of " + ", ".join(map(repr, get_args(stated)))
    if kind in (Path, os.PathLike):
        return "a path"
    if kind in (Union, UnionType):
        return " or ".join(map(_words, get_args(stated)))
    if kind in SEQUENCES:
        return f"a sequence, each {_words(get_args(stated)[0])}"
    if kind is Mapping:
        return "a mapping"
    if getattr(kind, "_is_protocol", False):
        return f"an object with {', '.join(_members(kind))}"
    return "an array" if kind in (Any, np.ndarray) else f"a {getattr(kind, '__name__', kind)}"


def read_whole(name: str, value: Any) -> Index:
    """Return a copy of whole numbers of any shape.

    Raises InvalidProblem: rows of different lengths, masked arrays, or entries that are not whole numbers.
    """
    refuse_masked(name, value)
    try:
        whole = np.array(value)
    except Exception:  # noqa: BLE001  whatever an object says of itself as an array
        raise InvalidProblem(f"{name}: expected whole numbers in rows of one length, got {shown(value)}") from None
    if whole.size and whole.dtype.kind not in "iu":
        raise InvalidProblem(f"{name}: expected whole numbers, got {whole.dtype} {whole.shape}")
    return whole.astype(np.int64)


def read_places(name: str, value: Any, count: int) -> Indices:
    """Return indices below `count`, given as integers or as a mask of `count` truth values.

    Raises InvalidProblem: neither of these, or an index out of range.
    """
    chosen = isinstance(value, np.ndarray) and value.dtype == bool and value.shape == (count,)
    places = np.flatnonzero(value) if chosen else read_whole(name, value)
    if places.ndim != 1 or np.any((places < 0) | (places >= count)):
        raise InvalidProblem(f"{name}: expected places from 0 to {count - 1}, got {shown(value)}")
    return places.astype(np.intp)
