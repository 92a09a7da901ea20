"""Exact numbers in text: "1.5e-3", "41/31500", "22680 + 26250*sqrt(2)". Nothing is ever evaluated as a program."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction

# Powers and products of such numbers stay inside the range of a double.
LARGEST_EXPONENT = 100
LONGEST_TEXT = 500
DEEPEST_BRACKET = 20
# Decimals kept of an irrational root: far beyond any number it is compared with.
ROOT_DIGITS = 100

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<root>sqrt)(?=\s*\()|(?P<sign>[-+*/()]))"
)


class NotANumber(ValueError):
    """The text is no number in this grammar; the message says what came."""


def split_number(text: str, *, roots: bool = False) -> tuple[Fraction, str]:
    """The number that a text starts with, and the rest of the text (its unit).

    Sums, products, quotients and brackets of decimals are exact. With `roots`, ``sqrt(...)`` is allowed too: exact
    where it is rational, otherwise rounded to 100 decimals.

    >>> split_number("15 cm^2")
    (Fraction(15, 1), 'cm^2')
    >>> split_number("41/31500 m")
    (Fraction(41, 31500), 'm')
    >>> float(split_number("3*sqrt(2) m", roots=True)[0])
    4.242640687119285
    """
    if len(text) > LONGEST_TEXT:
        raise NotANumber(f"a text of {len(text)} characters")
    reader = _Reader(text, roots)
    value = reader.sum()
    return in_range(value, text), text[reader.place :].strip()


def in_range(value: Fraction, text: str) -> Fraction:
    """The value, refused if it is too large or too small to compute with."""
    if value and not Fraction(10) ** -LARGEST_EXPONENT <= abs(value) <= Fraction(10) ** LARGEST_EXPONENT:
        raise NotANumber(f"{text!r}, which is out of range (1e-{LARGEST_EXPONENT} to 1e{LARGEST_EXPONENT})")
    return value


def decimal(text: str) -> Fraction:
    """One decimal number, exactly."""
    mantissa, _, exponent = text.lower().partition("e")
    if exponent and abs(int(exponent)) > 2 * LARGEST_EXPONENT:
        raise NotANumber(f"{text!r}, which is out of range (1e-{LARGEST_EXPONENT} to 1e{LARGEST_EXPONENT})")
    return Fraction(mantissa) * Fraction(10) ** int(exponent or 0)


def root(value: Fraction) -> Fraction:
    """The square root, exact where it is rational, otherwise to ROOT_DIGITS decimals."""
    if value < 0:
        raise NotANumber("the root of a negative number")
    product = value.numerator * value.denominator  # sqrt(p/q) = sqrt(p q) / q
    if math.isqrt(product) ** 2 == product:
        return Fraction(math.isqrt(product), value.denominator)
    scale = 10**ROOT_DIGITS
    return Fraction(math.isqrt(product * scale**2), scale * value.denominator)


@dataclass
class _Reader:
    """Recursive descent over sum := product (+|- product)*, product := signed (*|/ signed)*."""

    text: str
    roots: bool
    place: int = 0
    depth: int = 0

    def sum(self) -> Fraction:
        total = self.product()
        while sign := self.take("+-"):
            total += self.product() if sign == "+" else -self.product()
        return total

    def product(self) -> Fraction:
        value = self.signed()
        while sign := self.take("*/"):
            factor = self.signed()
            if sign == "/" and factor == 0:
                raise NotANumber(f"{self.text!r}, which divides by zero")
            value = value * factor if sign == "*" else value / factor
        return value

    def signed(self) -> Fraction:
        negative = False
        while sign := self.take("+-"):
            negative ^= sign == "-"
        return -self.atom() if negative else self.atom()

    def atom(self) -> Fraction:
        match = _TOKEN.match(self.text, self.place)
        if match is not None and match["number"]:
            self.place = match.end()
            return decimal(match["number"])
        if match is not None and match["root"] and self.roots:
            self.place = match.end()
            return root(self.bracket())
        return self.bracket()

    def bracket(self) -> Fraction:
        if not self.take("("):
            raise NotANumber(f"{self.text!r}")
        self.depth += 1
        if self.depth > DEEPEST_BRACKET:
            raise NotANumber(f"more than {DEEPEST_BRACKET} brackets inside each other")
        value = self.sum()
        self.depth -= 1
        if not self.take(")"):
            raise NotANumber(f"{self.text!r}, whose bracket is not closed")
        return value

    def take(self, signs: str) -> str:
        """The next sign if it is one of these, which is then read; otherwise nothing."""
        match = _TOKEN.match(self.text, self.place)
        if match is None or not match["sign"] or match["sign"] not in signs:
            return ""
        self.place = match.end()
        return match["sign"]
