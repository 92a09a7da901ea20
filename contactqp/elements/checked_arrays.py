"""Checks of numbers that a user gives: they become floats, or InvalidProblem says what came instead."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.model.problem_data import read_array


def real_array(what: str, value: Any) -> NDArray[np.float64]:
    """Return a copy of real numbers as an array of floats; fractions become floats.

    Raises
    ------
    InvalidProblem
        Rows of different lengths, masked arrays, or entries that are no real numbers; `what` is what they belong to.

    >>> real_array("points", [[0, 1], [2, 3]]).tolist()
    [[0.0, 1.0], [2.0, 3.0]]
    """
    return read_array(what, value)


def real_number(what: str, value: Any) -> float:
    """Return one finite float.

    Raises
    ------
    InvalidProblem
        Anything else; `what` is what it belongs to.

    >>> real_number("radius", 2)
    2.0
    """
    number = real_array(what, np.nan if value is None else value)
    if number.ndim or not math.isfinite(number):
        raise InvalidProblem(f"{what}: expected one finite number, got {value}")
    return float(number)


def positive_number(what: str, value: Any, kind: str) -> float:
    """Return one finite float above zero; `kind` is what it measures: ``"length"``.

    Raises
    ------
    InvalidProblem

    >>> positive_number("circle radius", 0.5, "length")
    0.5
    """
    number = real_array(what, np.nan if value is None else value)
    if number.ndim or not (math.isfinite(number) and number > 0):
        raise InvalidProblem(f"{what}: expected a positive {kind}, got {value}")
    return float(number)
