"""Check numbers that the user gives, find numbers among others, and compute lengths that stay exact where rational."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from fractions import Fraction
from numbers import Rational
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Index, Mask
from contactqp.model.problem_data import read_array


def keep_own(holder: Any, *names: str) -> None:
    """Replace attributes of a frozen object by copies that cannot change: arrays by read-only ones, lists by tuples."""
    for name in names:
        value = getattr(holder, name)
        if isinstance(value, np.ndarray):
            value = value.copy()
            value.setflags(write=False)
        object.__setattr__(holder, name, tuple(value) if isinstance(value, list) else value)


def real_vector(what: str, value: Any, size: int) -> Array:
    """Return a copy of `size` real numbers, NaN included.

    Raises InvalidProblem: another shape, or no real numbers; `what` names them.
    """
    read = read_array(what, value)
    if read.shape != (size,):
        raise InvalidProblem(f"{what}: expected shape ({size},), got {read.shape}")
    return read


def real_number(what: str, value: Any) -> float:
    """Return one finite float.

    Raises
    ------
    InvalidProblem
        Anything else; `what` names the number.

    >>> real_number("radius", 2)
    2.0
    """
    number = read_array(what, np.nan if value is None else value)
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
    number = read_array(what, np.nan if value is None else value)
    if number.ndim or not (math.isfinite(number) and number > 0):
        raise InvalidProblem(f"{what}: expected a positive {kind}, got {value}")
    return float(number)


# The range of moduli, tensions and thicknesses, in which products and quotients do not overflow.
LEAST_MODERATE = 1e-120


def moderate_number(what: str, value: float, kind: str) -> float:
    """Return one number from 1e-120 to 1e120; `kind` is what it measures: ``"modulus"``.

    Raises
    ------
    InvalidProblem

    >>> moderate_number("membrane", 2.0, "tension")
    2.0
    """
    number = positive_number(what, value, kind)
    if not LEAST_MODERATE <= number <= 1 / LEAST_MODERATE:
        raise InvalidProblem(
            f"{what}: expected a {kind} from {LEAST_MODERATE:g} to {1 / LEAST_MODERATE:g}, got {number:g}; "
            "state it in another unit"
        )
    return number


Number = Fraction | float
# Object arrays hold Fractions, float arrays hold floats; NumPy's types cannot tell the two apart.
Numbers = NDArray[Any]


_IRRATIONAL: ContextVar[Callable[[Any], Any]] = ContextVar("_IRRATIONAL", default=math.sqrt)


@contextmanager
def irrational_roots(root: Callable[[Any], Any]) -> Iterator[None]:
    """Within a `with` block, compute irrational roots by `root` in place of floats.

    Its results must support arithmetic with Fractions; the formulas of elements then keep them.
    """
    token = _IRRATIONAL.set(root)
    try:
        yield
    finally:
        _IRRATIONAL.reset(token)


def square_root(square: Number) -> Number:
    """Return the square root of a nonnegative number, a Fraction where it is rational, else a float.

    >>> square_root(Fraction(25, 4)), square_root(Fraction(2))
    (Fraction(5, 2), 1.4142135623730951)
    """
    if isinstance(square, Rational):
        numerator, denominator = math.isqrt(square.numerator), math.isqrt(square.denominator)
        if (numerator**2, denominator**2) == (square.numerator, square.denominator):
            return Fraction(numerator, denominator)
    root: Number = _IRRATIONAL.get()(square)
    return root


def squared_length(vector: Numbers) -> Number:
    """Return the square of a vector's Euclidean length, in the numbers of the vector."""
    total: Number = np.dot(vector, vector)
    if isinstance(total, Rational):
        return Fraction(total)
    return float(total) if isinstance(total, float) else total


def unit_vector(vector: Any, what: str) -> Numbers:
    """Return n = v / |v|, exact where |v| is rational.

    Raises
    ------
    InvalidProblem
        v = 0; `what` names it.

    >>> unit_vector([Fraction(3), Fraction(4)], "direction")
    array([Fraction(3, 5), Fraction(4, 5)], dtype=object)
    """
    v = np.asarray(vector)
    if v.dtype.kind == "O" and not all(isinstance(one, Rational) for one in v.flat):
        v = v.astype(float)
    if v.dtype.kind == "f":
        v = _near_one(v)
    square = squared_length(v)
    if not square > 0:
        raise InvalidProblem(f"{what}: expected a vector of positive length, got {[float(c) for c in v]}")
    n: Numbers = v / square_root(square)
    return n


def _near_one(vector: Array) -> Array:
    """Return a vector of floats scaled by a power of two to a size near one, so that no square overflows."""
    _, power = np.frexp(np.max(np.abs(vector), initial=0.0))
    scaled: Array = np.ldexp(vector, -power)
    return scaled


def places_among(labels: Index, wanted: Index) -> tuple[Index, Mask]:
    """Return the place of each wanted number among distinct labels in any order, and whether it is one of them.

    >>> places_among(np.array([30, 10, 20]), np.array([10, 15]))
    (array([1, 2]), array([ True, False]))
    """
    if not len(labels):
        return np.zeros(len(wanted), dtype=np.int64), np.zeros(len(wanted), dtype=bool)
    order = np.argsort(labels, kind="stable")
    places = order[np.minimum(np.searchsorted(labels, wanted, sorter=order), len(labels) - 1)]
    return places, labels[places] == wanted
