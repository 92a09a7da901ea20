"""The public functions compute under their own settings of NumPy's floating-point errors."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")


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
