"""Types of arrays, by what they hold, and the settings of NumPy's floating-point errors that functions compute under.

Shapes stand beside each field and in each docstring.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, wraps
from inspect import isfunction
from typing import ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = NDArray[np.float64]  # one number an unknown, contact, tie
Index = NDArray[np.int64]
Indices = NDArray[np.intp]  # as NumPy's own functions return them
Mask = NDArray[np.bool_]


P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", bound=type)


def own_floating_point(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function overflow, underflow and divide by zero without a word, whatever `np.seterr` says.

    What comes of it is infinite or NaN, which no certificate passes; under `np.seterr(all="raise")`, or with warnings
    as errors, harmless underflow would end a solve with somebody else's exception.
    """

    @wraps(function)
    def computing(*args: P.args, **kwargs: P.kwargs) -> R:
        with np.errstate(all="ignore"):
            return function(*args, **kwargs)

    return computing


def computes(kind: C) -> C:
    """Give the constructor and all public methods and properties of a class settings of their own, as above."""
    for name, value in tuple(vars(kind).items()):
        if name.startswith("_") and name != "__post_init__":
            continue
        if isfunction(value):
            setattr(kind, name, own_floating_point(value))
        elif isinstance(value, cached_property):
            value.func = own_floating_point(value.func)
        elif isinstance(value, property) and value.fget is not None:
            setattr(kind, name, property(own_floating_point(value.fget), doc=value.__doc__))
    return kind
