"""Numbers as people give them: floats, or one clear line that says what came instead."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem

NUMERIC = "biuf"  # kinds of NumPy's types that are real numbers


def real_array(what: str, value: Any) -> NDArray[np.float64]:
    """An array of floats, a copy; fractions become floats, text and complex numbers become none.

    Raises
    ------
    InvalidProblem
        Rows of different lengths, or entries that are no real numbers; `what` is what they belong to.

    >>> real_array("points", [[0, 1], [2, 3]]).tolist()
    [[0.0, 1.0], [2.0, 3.0]]
    """
    try:
        array = np.array(value)
        if array.dtype.kind == "O":
            return array.astype(float, copy=False)
    except (TypeError, ValueError):
        raise InvalidProblem(f"{what}: expected real numbers in rows of one length, got others") from None
    if array.dtype.kind not in NUMERIC:
        raise InvalidProblem(f"{what}: expected real numbers, got {array.dtype}")
    return array.astype(float, copy=False)


def real_number(what: str, value: Any) -> float:
    """One finite float.

    Raises
    ------
    InvalidProblem
        Anything else; `what` is what it belongs to.

    >>> real_number("radius", 2)
    2.0
    """
    number = real_array(what, value)
    if number.ndim or not math.isfinite(number):
        raise InvalidProblem(f"{what}: expected one finite number, got {value}")
    return float(number)


def positive_number(what: str, value: Any, kind: str) -> float:
    """One finite float above zero; `kind` is what it measures: ``"length"``.

    Raises
    ------
    InvalidProblem

    >>> positive_number("circle radius", 0.5, "length")
    0.5
    """
    number = real_array(what, value)
    if number.ndim or not (math.isfinite(number) and number > 0):
        raise InvalidProblem(f"{what}: expected a positive {kind}, got {value}")
    return float(number)
