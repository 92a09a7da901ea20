"""Rational numbers as doubles and as decimals."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np

# Digits of a midpoint in data and in tables; radii are widened by what is cut off.
DIGITS, SHOWN_DIGITS = 50, 20

# Two digits of a radius, shown this much larger, are not less than it.
ROUNDING_UP = 1.06

# Longer fractions are cut out of tables, not out of data.
WIDEST = 44


def nearest(x: Fraction) -> float:
    """The nearest double, infinite beyond the largest: Python divides integers of any size correctly rounded."""
    try:
        return x.numerator / x.denominator
    except OverflowError:
        return math.inf if x > 0 else -math.inf


def rounded_up(x: Fraction) -> float:
    """The least double that is not smaller."""
    near = nearest(x)
    return near if near == math.inf or Fraction(near) >= x else float(np.nextafter(near, math.inf))


def ratio(x: Fraction) -> str:
    """ "p/q", of any length; Python alone refuses to print more than 4300 digits.

    >>> ratio(Fraction(-7, 3)), ratio(Fraction(4))
    ('-7/3', '4')
    """
    from contactqp.oracle.exact.rational import from_fraction

    return str(from_fraction(x))


def decimal(x: Fraction, digits: int = DIGITS) -> str:
    """A number rounded to so many significant digits.

    >>> decimal(Fraction(2, 3), 5), decimal(Fraction(-1, 800), 5), decimal(Fraction(99999, 10000), 3)
    ('6.6667e-1', '-1.2500e-3', '1.00e1')
    """
    if not x:
        return "0"
    size = abs(x)
    exponent = round((size.numerator.bit_length() - size.denominator.bit_length()) * 0.30103)
    while size >= Fraction(10) ** (exponent + 1):
        exponent += 1
    while size < Fraction(10) ** exponent:
        exponent -= 1
    shown = str(round(size * Fraction(10) ** (digits - 1 - exponent)))
    if len(shown) > digits:
        exponent += 1
    return f"{'-' if x < 0 else ''}{shown[0]}.{shown[1:digits]}e{exponent}"


def widened(x: Fraction, radius: float, digits: int) -> float:
    """The radius around the number as it is printed, rounded up."""
    exact = Fraction(radius) + abs(x) * Fraction(1, 10 ** (digits - 1))
    return rounded_up(exact)


def number_data(x: Fraction, radius: float | None) -> dict[str, Any]:
    """{"exact", "double"} of a rational number, {"mid", "radius", "double"} of an interval."""
    double = nearest(x)
    known: dict[str, Any] = {"double": double if math.isfinite(double) else None}
    if radius is None:
        return {"exact": ratio(x)} | known
    return {"mid": decimal(x), "radius": widened(x, radius, DIGITS)} | known


def cut(shown: str) -> str:
    """Return a fraction as tables show it: its beginning alone where it is long."""
    return shown if len(shown) <= WIDEST else f"{shown[:12]}... ({len(shown)} digits)"
