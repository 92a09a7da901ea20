"""Read quantities with units exactly: "15 cm^2" is Fraction(3, 2000) m^2. Text is parsed, never evaluated as Python.

The list of units is short on purpose. A general one contains dozens that a typing error could hit by accident, and
takes longer to load than a small case to solve.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple

from contactqp.errors import shown

# Limits within which powers and products of numbers stay in the range of a double.
LARGEST_EXPONENT = 100
LONGEST_TEXT = 500
DEEPEST_BRACKET = 20
# Decimals of an irrational root, far beyond the precision of numbers that it is compared with.
ROOT_DIGITS = 100

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<root>sqrt)(?=\s*\()|(?P<sign>[-+*/()]))"
)


class NotANumber(ValueError):
    """The text is not a number in this grammar."""


def split_number(text: str, *, roots: bool = False) -> tuple[Fraction, str]:
    """Return the number that a text starts with, and the rest of the text (its unit).

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
    """Return the value; raise NotANumber if it is too large or too small to compute with."""
    if value and not Fraction(10) ** -LARGEST_EXPONENT <= abs(value) <= Fraction(10) ** LARGEST_EXPONENT:
        raise NotANumber(f"{text!r}, which is out of range (1e-{LARGEST_EXPONENT} to 1e{LARGEST_EXPONENT})")
    return value


def decimal(text: str) -> Fraction:
    """Return one decimal number, exactly."""
    mantissa, _, exponent = text.lower().partition("e")
    if exponent and abs(int(exponent)) > 2 * LARGEST_EXPONENT:
        raise NotANumber(f"{text!r}, which is out of range (1e-{LARGEST_EXPONENT} to 1e{LARGEST_EXPONENT})")
    return Fraction(mantissa) * Fraction(10) ** int(exponent or 0)


def root(value: Fraction) -> Fraction:
    """Return the square root, exact where it is rational, otherwise to ROOT_DIGITS decimals."""
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
            raise NotANumber(self.not_understood())
        self.depth += 1
        if self.depth > DEEPEST_BRACKET:
            raise NotANumber(f"more than {DEEPEST_BRACKET} brackets inside each other")
        value = self.sum()
        self.depth -= 1
        if not self.take(")"):
            rest = self.text[self.place :].strip()
            ends = not rest or rest[0].isalpha()
            raise NotANumber(f"{self.text!r}, whose bracket is not closed" if ends else self.not_understood())
        return value

    def not_understood(self) -> str:
        """Return the end of the message: the text, and the place from which it cannot be read as a number."""
        rest = self.text[self.place :].strip()
        if rest.startswith("sqrt") and not self.roots:
            return f"{self.text!r}: no root here, where numbers are exact; write a decimal or a fraction"
        if not rest or not self.place:
            return f"{self.text!r}"
        allowed = "decimals, + - * /, brackets and sqrt(...)" if self.roots else "decimals, + - * / and brackets"
        return f"{self.text!r}, which is not a number from {rest!r} on: numbers are {allowed}"

    def take(self, signs: str) -> str:
        """Take the next character if it is one of `signs`, and return it, else ""."""
        match = _TOKEN.match(self.text, self.place)
        if match is None or not match["sign"] or match["sign"] not in signs:
            return ""
        self.place = match.end()
        return match["sign"]


COMMON_UNITS = (
    *("m", "mm", "cm", "um", "in", "ft", "s", "rad"),
    *("N", "kN", "MN", "Pa", "kPa", "MPa", "GPa", "kg", "t", "J"),
)
# The name of a unit with an exponent of one digit, and the sign before it.
_NAME = re.compile(
    r"(?P<sign>\s*[*/]\s*|\s+)?(?P<name>[^\W\d_][^\W²³⁴]*)(\s*(\^|\*\*)\s*(?P<power>-?\d)|(?P<raised>[²³⁴]))?"
)
_RAISED = {"²": 2, "³": 3, "⁴": 4}


class Dimension(NamedTuple):
    """Powers of force, length and time."""

    force: int
    length: int
    time: int

    def power(self, exponent: int) -> Dimension:
        """Return the dimension raised to a power."""
        return Dimension(*(exponent * power for power in self))

    def times(self, other: Dimension) -> Dimension:
        """Return the dimension of a product."""
        return Dimension(*(mine + theirs for mine, theirs in zip(self, other, strict=True)))


NO_DIMENSION = Dimension(0, 0, 0)
_LENGTH, _FORCE, _STRESS = Dimension(0, 1, 0), Dimension(1, 0, 0), Dimension(1, -2, 0)
_MASS = Dimension(1, -1, 2)  # 1 kg is 1 N s^2/m

PREFIXES = {
    name: Fraction(10) ** exponent
    for names, exponent in (
        (("nano", "n"), -9),
        (("micro", "µ", "μ", "u"), -6),  # the micro sign and the Greek letter, which look alike
        (("milli", "m"), -3),
        (("centi", "c"), -2),
        (("deci", "d"), -1),
        (("kilo", "k"), 3),
        (("mega", "M"), 6),
        (("giga", "G"), 9),
    )
    for name in names
}
_INCH, _POUND = Fraction("0.0254"), Fraction("0.45359237")
_POUND_FORCE = _POUND * Fraction("9.80665")
# The value of each unit in newton, metre and second, by all of its names.
UNITS = {
    name: (Fraction(value), dimension)
    for names, value, dimension in (
        (("meter", "metre", "m"), 1, _LENGTH),
        (("micron",), Fraction(1, 10**6), _LENGTH),
        (("second", "s"), 1, Dimension(0, 0, 1)),
        (("minute", "min"), 60, Dimension(0, 0, 1)),  # not a thousandth of an inch
        (("gram", "g"), Fraction(1, 1000), _MASS),
        (("radian", "rad"), 1, NO_DIMENSION),
        (("newton", "N"), 1, _FORCE),
        (("pascal", "Pa"), 1, _STRESS),
        (("joule", "J"), 1, Dimension(1, 1, 0)),
        (("tonne", "t"), 1000, _MASS),
        (("bar",), 100000, _STRESS),
        (("kilogram_force", "kgf"), Fraction("9.80665"), _FORCE),
        (("inch", "in"), _INCH, _LENGTH),
        (("foot", "ft"), 12 * _INCH, _LENGTH),
        (("pound", "lb"), _POUND, _MASS),
        (("pound_force", "lbf"), _POUND_FORCE, _FORCE),
        (("kip",), 1000 * _POUND_FORCE, _FORCE),
        (("psi",), _POUND_FORCE / _INCH**2, _STRESS),
        (("ksi",), 1000 * _POUND_FORCE / _INCH**2, _STRESS),
    )
    for name in names
}
# Shorter names have no plural: Pas is not pascal.
_SHORTEST_PLURAL = 3
_PLURALS = {"lbs": "lb", "inches": "inch", "feet": "foot"}
# Masses and forces that are taken for each other.
_WEIGHTS = {"lb": "lbf", "lbs": "lbf", "pound": "lbf", "pounds": "lbf", "kg": "kgf", "lbf": "lb", "kgf": "kg"}


@dataclass(frozen=True)
class Kind:
    """A kind of numbers in a scene: its name, dimensions and an example."""

    name: str
    dimension: Dimension
    example: str

    @property
    def article(self) -> str:
        """Return the name of the kind with an article."""
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name}"


KINDS = {
    kind.name: kind
    for kind in (
        Kind("number", NO_DIMENSION, "0.3"),
        Kind("angle", NO_DIMENSION, "0.001 rad"),
        Kind("length", Dimension(0, 1, 0), "2 m"),
        Kind("area", Dimension(0, 2, 0), "15 cm^2"),
        Kind("second moment of area", Dimension(0, 4, 0), "2000 cm^4"),
        Kind("force", Dimension(1, 0, 0), "300 kN"),
        Kind("moment", Dimension(1, 1, 0), "20 kN*m"),
        Kind("energy", Dimension(1, 1, 0), "3 kN*m"),
        Kind("stiffness", Dimension(1, -1, 0), "1e5 kN/m"),
        Kind("tension", Dimension(1, -1, 0), "5 N/m"),
        Kind("force per length", Dimension(1, -1, 0), "2 kN/m"),
        Kind("modulus", Dimension(1, -2, 0), "210 GPa"),
        Kind("pressure", Dimension(1, -2, 0), "1 MPa"),
        Kind("stress", Dimension(1, -2, 0), "1 MPa"),
        Kind("density", Dimension(1, -4, 2), "7850 kg/m^3"),
        Kind("mass", Dimension(1, -1, 2), "2 kg"),
        Kind("acceleration", Dimension(0, 1, -2), "9.81 m/s^2"),
        Kind("time", Dimension(0, 0, 1), "2 ms"),
        Kind("velocity", Dimension(0, 1, -1), "3 m/s"),
        Kind("angular velocity", Dimension(0, 0, -1), "0.1 rad/s"),
        Kind("momentum", Dimension(1, 0, 1), "2 N*s"),
    )
}


def per(kind: Kind, other: Kind) -> Kind:
    """Return the kind of numbers of one kind per unit of another.

    >>> per(KINDS["force"], KINDS["length"]).example
    '1 kN/m'
    """
    dimension = kind.dimension.times(other.dimension.power(-1))
    unit = UnitSystem("m", "kN").label(dimension) if any(dimension) else ""
    return Kind(f"{kind.name} per {other.name}", dimension, f"1 {unit}".strip())


@dataclass(frozen=True)
class Quantity:
    """An exact value in newton, metre and second, with the text it came from."""

    si: Fraction
    dimension: Dimension
    text: str = field(compare=False)

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class UnitSystem:
    """The units that a scene is computed in; time is in seconds."""

    length: str
    force: str

    def value(self, quantity: Quantity) -> Fraction:
        """Return the number of a quantity in these units, exactly."""
        return quantity.si / self._factor(quantity.dimension)

    def label(self, dimension: Dimension) -> str:
        """Return the unit of numbers of that dimension in this system, such as ``kN/m``."""
        parts = ((self.force, dimension.force), (self.length, dimension.length), ("s", dimension.time))
        above = [_power(unit, power) for unit, power in parts if power > 0]
        below = [_power(unit, -power) for unit, power in parts if power < 0]
        if not above and below:
            above = ["1"]
        return "/".join(["*".join(above), *below])

    def _factor(self, dimension: Dimension) -> Fraction:
        length, force = read_unit(self.length)[0], read_unit(self.force)[0]
        return length**dimension.length * force**dimension.force


def number(system: UnitSystem, quantity: Quantity) -> float:
    """Return the quantity in these units, rounded once."""
    return float(system.value(quantity))


def vector(system: UnitSystem, quantities: Sequence[Quantity]) -> tuple[float, ...]:
    """Return quantities in these units, each rounded once."""
    return tuple(number(system, quantity) for quantity in quantities)


def _power(unit: str, power: int) -> str:
    return unit if power == 1 else f"{unit}^{power}"


@cache
def read_unit(text: str) -> tuple[Fraction, Dimension]:
    """Return the value of a unit in newton, metre and second, and its dimension.

    >>> read_unit("kN/m")
    (Fraction(1000, 1), Dimension(force=1, length=-1, time=0))
    """
    value, dimension, place = Fraction(1), NO_DIMENSION, 0
    while place < len(text):
        match = _NAME.match(text, place)
        if match is None or (match["sign"] is None) != (place == 0) or match["power"] in ("0", "-0"):
            raise NotANumber(f"{text!r} is not a unit")
        exponent = _RAISED.get(match["raised"], int(match["power"] or 1)) * (-1 if "/" in (match["sign"] or "") else 1)
        factor, one = _single_unit(match["name"])
        value, dimension, place = value * factor**exponent, dimension.times(one.power(exponent)), match.end()
    return value, dimension


def _single_unit(name: str) -> tuple[Fraction, Dimension]:
    """Return the value and dimension of one unit by its name, with a prefix or none.

    Raises NotANumber: there is no such unit; the nearest are named.
    """
    for singular in (name, _PLURALS.get(name, name.removesuffix("s"))):
        if singular != name and name not in _PLURALS and len(singular) < _SHORTEST_PLURAL:
            break
        if singular in UNITS:
            return UNITS[singular]
        for prefix, factor in PREFIXES.items():
            unit = singular.removeprefix(prefix)
            if unit != singular and unit in UNITS and (singular == name or len(unit) >= _SHORTEST_PLURAL):
                return factor * UNITS[unit][0], UNITS[unit][1]
    near = [unit for unit in COMMON_UNITS if unit.lower() == name.lower()]
    near = near or [f"{name[:i]}*{name[i:]}" for i in range(1, len(name)) if _are_units(name, i)]
    near = near or difflib.get_close_matches(name, COMMON_UNITS, n=3, cutoff=0.5)
    raise NotANumber(f"the unit {name!r} is unknown" + (f" (nearest: {', '.join(near)})" if near else ""))


def quantity_pattern(dimensions: Sequence[Dimension]) -> str:
    """Return a regular expression of texts such as ``"15 cm^2"``, for editors that check a case while it is written.

    It checks single units and powers of lengths for these dimensions. In products such as ``kN*m`` it checks only the
    names; `read_quantity` checks the dimension.
    """

    def words(of: Sequence[Dimension] | None) -> str:
        named = [name for name, (_, dimension) in UNITS.items() if of is None or dimension in of]
        named += [plural for plural, name in _PLURALS.items() if name in named]
        named = [name + "s?" * (len(name) >= _SHORTEST_PLURAL and name not in _PLURALS) for name in named]
        taken = [name for name in UNITS if name[:1] in PREFIXES and name[1:] in named and name not in named]
        other = f"(?!({'|'.join(taken)})$)" if taken else ""  # a unit of its own, as min beside m and in
        return f"{other}({'|'.join(PREFIXES)})?({'|'.join(named)})" if named else ""

    power = r"(\s*(\^|\*\*)\s*-?\d|[²³⁴])"
    allowed = [rf"{words(None)}{power}?(\s*[*/ ]\s*{words(None)}{power}?)+", words(dimensions)]
    for dimension in dimensions:
        if dimension == Dimension(0, dimension.length, 0) and dimension.length > 1:
            raised = "²³⁴"[dimension.length - 2]
            allowed.append(rf"{words([Dimension(0, 1, 0)])}(\s*(\^|\*\*)\s*{dimension.length}|{raised})")
    unit = f"({'|'.join(filter(None, allowed))})" + "?" * (NO_DIMENSION in dimensions)
    return rf"^(?=[-+\s(]*(\d|\.\d|sqrt))(sqrt|[-+*/().\deE\s])+{unit}\s*$"


def _are_units(text: str, place: int) -> bool:
    """Return whether a text is two units without a sign between them, as in ``kNm``."""
    return text[:place] in COMMON_UNITS and text[place:] in COMMON_UNITS


def read_number(value: Any) -> Fraction:
    """Read an exact number without a unit, from a number or a text such as ``"5/7"``.

    A float stands for its printed decimal digits: 0.1 is 1/10.
    """
    if isinstance(value, str):
        number, rest = split_number(value)
        if rest:
            raise NotANumber(f"{value!r}, which is a number with {rest!r} after it")
        return number
    if isinstance(value, bool) or not isinstance(value, int | float | Decimal | Fraction):
        raise NotANumber(describe(value))
    if isinstance(value, int | Fraction):
        return in_range(Fraction(value), "a number")
    written = repr(float(value)) if isinstance(value, float) else str(value)
    if not Decimal(written).is_finite():
        raise NotANumber(written)
    return in_range(decimal(written), written)


def read_quantity(value: Any, kinds: Sequence[Kind], *, roots: bool = False) -> Quantity:
    """Read a quantity of one of these kinds, from a text such as ``"15 cm^2"``.

    Raises
    ------
    NotANumber
        No number, no unit, an unknown unit, or a unit of another dimension; the message has the form ``expected ...,
        got ...``.
    """
    try:
        return _quantity(value, kinds, roots)
    except NotANumber as error:
        written = " or ".join(f'{kind.article} such as "{kind.example}"' for kind in kinds)
        raise NotANumber(f"expected {written}, got {error}") from None


def _quantity(value: Any, kinds: Sequence[Kind], roots: bool) -> Quantity:
    if isinstance(value, Quantity):
        value = value.text
    dimensionless = any(kind.dimension == NO_DIMENSION for kind in kinds)
    if not isinstance(value, str):
        number = read_number(value)
        if not dimensionless:
            raise NotANumber(f"{value}, a number without a unit")
        return Quantity(number, NO_DIMENSION, str(value))
    number, unit = split_number(value, roots=roots)
    try:
        factor, dimension = read_unit(unit)
    except NotANumber as error:
        raise NotANumber(f"{value!r}: {error}") from None
    if dimension not in {kind.dimension for kind in kinds}:
        cure = weight_or_mass(unit, kinds)
        raise NotANumber(
            f"{value!r}, " + (f"which is {describe_dimension(dimension)}{cure}" if unit else "a number without a unit")
        )
    return Quantity(in_range(number * factor, value), dimension, value)


def weight_or_mass(unit: str, kinds: Sequence[Kind]) -> str:
    """Return the unit with weights for masses, or masses for weights, in brackets, or "" if that is of no such kind."""
    other = re.sub("[a-z]+", lambda word: _WEIGHTS.get(word[0], word[0]), unit)
    right = other != unit and read_unit(other)[1] in {kind.dimension for kind in kinds}
    return f" (nearest: {other})" if right else ""


def describe_dimension(dimension: Dimension) -> str:
    """Return the dimension as a word, such as "force", or as powers where there is no word."""
    for kind in KINDS.values():
        if kind.dimension == dimension:
            return kind.article
    return f"in {UnitSystem('m', 'N').label(dimension)}"


def describe(value: Any) -> str:
    """Return a description of a value that should have been a number, in the terms of a case file."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, Decimal):
        return f"{value} (number)"
    if isinstance(value, str) or type(value).__module__ not in ("builtins", "datetime", "fractions"):
        return shown(value)
    return f"{value} ({type(value).__name__})"
