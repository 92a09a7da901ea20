"""Quantities with their units, exactly: "15 cm^2" is Fraction(3, 2000) m^2. Nothing is ever evaluated as a program.

pint reads the units, on a short list of its own making: the whole of pint's list takes longer to read than to solve a
small case, and knows dozens of units that a typing error in a mechanics case would hit by accident.
"""

from __future__ import annotations

import difflib
import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple

from contactqp.errors import shown

# pint imports dask where it is installed, which takes as long as all the rest of it. A command's process does without;
# in somebody's own program pint stays as it is.
if "contactqp.cli" in sys.modules and "dask" not in sys.modules:
    sys.modules["dask"] = None  # type: ignore[assignment]
    import pint

    del sys.modules["dask"]
else:
    import pint

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
    """Return the value, refused if it is too large or too small to compute with."""
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
        """Read the next sign if it is one of these; otherwise nothing."""
        match = _TOKEN.match(self.text, self.place)
        if match is None or not match["sign"] or match["sign"] not in signs:
            return ""
        self.place = match.end()
        return match["sign"]


_DEFINITIONS = (
    "nano- = 1e-9 = n-",
    "micro- = 1e-6 = µ- = u-",
    "milli- = 1e-3 = m-",
    "centi- = 1e-2 = c-",
    "deci- = 1e-1 = d-",
    "kilo- = 1e3 = k-",
    "mega- = 1e6 = M-",
    "giga- = 1e9 = G-",
    "meter = [length] = m = metre",
    "second = [time] = s",
    "gram = [mass] = g",
    "radian = [] = rad",
    "newton = kilogram * meter / second ** 2 = N",
    "pascal = newton / meter ** 2 = Pa",
    "joule = newton * meter = J",
    "tonne = 1000 * kilogram = t",
    "bar = 100000 * pascal",
    "kilogram_force = 9.80665 * newton = kgf",
    "inch = 0.0254 * meter = in",
    "foot = 12 * inch = ft",
    "pound = 453.59237 * gram = lb",
    "pound_force = 0.45359237 * kilogram_force = lbf",
    "kip = 1000 * pound_force",
    "psi = pound_force / inch ** 2",
    "ksi = 1000 * psi",
)
COMMON_UNITS = (
    "m",
    "mm",
    "cm",
    "um",
    "N",
    "kN",
    "MN",
    "Pa",
    "kPa",
    "MPa",
    "GPa",
    "kg",
    "t",
    "s",
    "J",
    "rad",
    "in",
    "ft",
)
# Names with an exponent of one digit, joined by *, / or a space: what pint is asked to read, and nothing else.
_UNIT = re.compile(r"[^\W\d_]\w*(\s*(\^|\*\*)\s*-?\d)?(\s*[*/ ]\s*[^\W\d_]\w*(\s*(\^|\*\*)\s*-?\d)?)*")


class Dimension(NamedTuple):
    """Powers of force, length and time."""

    force: int
    length: int
    time: int


@dataclass(frozen=True)
class Kind:
    """What a number in a scene can be, and how one is written."""

    name: str
    dimension: Dimension
    example: str

    @property
    def article(self) -> str:
        """Return its name with an article."""
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name}"


KINDS = {
    kind.name: kind
    for kind in (
        Kind("number", Dimension(0, 0, 0), "0.3"),
        Kind("angle", Dimension(0, 0, 0), "0.001 rad"),
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
        Kind("momentum", Dimension(1, 0, 1), "2 N*s"),
    )
}


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
        """Return the number that a quantity is in these units, exactly."""
        return quantity.si / self._factor(quantity.dimension)

    def label(self, dimension: Dimension) -> str:
        """Return how a number of that dimension is written here, as in ``kN/m``."""
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
def _registry() -> pint.UnitRegistry[Any]:
    registry: pint.UnitRegistry[Any] = pint.UnitRegistry(None, non_int_type=Fraction, cache_folder=None)
    registry.load_definitions(_DEFINITIONS)
    return registry


def _first_unknown(error: pint.UndefinedUnitError) -> str:
    names: Any = error.unit_names  # one name or several, as pint's versions have it
    return names if isinstance(names, str) else str(next(iter(names)))


@cache
def read_unit(text: str) -> tuple[Fraction, Dimension]:
    """Return the value of one such unit in newton, metre and second, and its dimension.

    >>> read_unit("kN/m")
    (Fraction(1000, 1), Dimension(force=1, length=-1, time=0))
    """
    if not text:
        return Fraction(1), Dimension(0, 0, 0)
    if not _UNIT.fullmatch(text):
        raise NotANumber(f"{text!r} is no unit")
    registry = _registry()
    try:
        quantity = registry.Quantity(Fraction(1), registry.parse_units(text)).to_root_units()
    except KeyError:  # pint's own, of a unit to the power of zero
        raise NotANumber(f"{text!r} is no unit") from None
    except pint.UndefinedUnitError as error:
        unknown = _first_unknown(error)
        near = [name for name in COMMON_UNITS if name.lower() == unknown.lower()]
        near = near or [f"{unknown[:i]}*{unknown[i:]}" for i in range(1, len(unknown)) if _are_units(unknown, i)]
        near = near or difflib.get_close_matches(unknown, COMMON_UNITS, n=3, cutoff=0.5)
        raise NotANumber(
            f"the unit {unknown!r} is unknown" + (f" (nearest: {', '.join(near)})" if near else "")
        ) from None
    powers = {name: int(str(power)) for name, power in quantity.dimensionality.items()}
    mass, length, time = powers.get("[mass]", 0), powers.get("[length]", 0), powers.get("[time]", 0)
    # pint's root unit of mass is the gram; 1 kg = 1 N s^2/m.
    return Fraction(quantity.magnitude) / Fraction(1000) ** mass, Dimension(mass, length - mass, time + 2 * mass)


def quantity_pattern(dimensions: Sequence[Dimension]) -> str:
    """Return a regular expression of texts such as ``"15 cm^2"``, for editors that check a case while it is written.

    It knows every unit by name, which single units are of one of these dimensions, and powers of lengths. Of units that
    are joined, as in ``kN*m``, it does not know the dimension; `read_quantity` does.
    """
    prefixes, units = _prefixes_and_units()

    def words(of: Sequence[Dimension] | None) -> str:
        named = [name for name in units if of is None or read_unit(name)[1] in of]
        return f"({'|'.join(prefixes)})?({'|'.join(named)})" if named else ""

    power = r"(\s*(\^|\*\*)\s*-?\d|[²³⁴])"
    allowed = [rf"{words(None)}{power}?(\s*[*/ ]\s*{words(None)}{power}?)+", words(dimensions)]
    for dimension in dimensions:
        if dimension == Dimension(0, dimension.length, 0) and dimension.length > 1:
            raised = "²³⁴"[dimension.length - 2]
            allowed.append(rf"{words([Dimension(0, 1, 0)])}(\s*(\^|\*\*)\s*{dimension.length}|{raised})")
    unit = f"({'|'.join(filter(None, allowed))})" + "?" * (Dimension(0, 0, 0) in dimensions)
    return rf"^(?=[-+\s(]*(\d|\.\d|sqrt))(sqrt|[-+*/().\deE\s])+{unit}\s*$"


def _prefixes_and_units() -> tuple[list[str], list[str]]:
    """Return the names of prefixes and of units, the short ones and the long ones, as they are defined."""
    written = [[part.strip() for part in definition.split("=")] for definition in _DEFINITIONS]
    names = [name for parts in written for name in (parts[0], *parts[2:])]
    return [name[:-1] for name in names if name.endswith("-")], [name for name in names if not name.endswith("-")]


def _are_units(text: str, place: int) -> bool:
    """Return whether a text is two units without a sign between them, as in ``kNm``."""
    return text[:place] in COMMON_UNITS and text[place:] in COMMON_UNITS


def read_number(value: Any) -> Fraction:
    """Read an exact number without a unit, from a number or a text such as ``"5/7"``.

    A float means the decimal digits it is printed with: 0.1 is 1/10.
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
        No number, no unit, an unknown unit, or a unit of another dimension; the message is a whole sentence part:
        ``expected ..., got ...``.
    """
    try:
        return _quantity(value, kinds, roots)
    except NotANumber as error:
        written = " or ".join(f'{kind.article} such as "{kind.example}"' for kind in kinds)
        raise NotANumber(f"expected {written}, got {error}") from None


def _quantity(value: Any, kinds: Sequence[Kind], roots: bool) -> Quantity:
    if isinstance(value, Quantity):
        value = value.text
    dimensionless = any(kind.dimension == Dimension(0, 0, 0) for kind in kinds)
    if not isinstance(value, str):
        number = read_number(value)
        if not dimensionless:
            raise NotANumber(f"{value}, a number without a unit")
        return Quantity(number, Dimension(0, 0, 0), str(value))
    number, unit = split_number(value, roots=roots)
    try:
        factor, dimension = read_unit(unit)
    except NotANumber as error:
        raise NotANumber(f"{value!r}: {error}") from None
    if dimension not in {kind.dimension for kind in kinds}:
        raise NotANumber(
            f"{value!r}, " + (f"which is {describe_dimension(dimension)}" if unit else "a number without a unit")
        )
    return Quantity(in_range(number * factor, value), dimension, value)


def describe_dimension(dimension: Dimension) -> str:
    """Return the dimension in words where there is a word for it."""
    for kind in KINDS.values():
        if kind.dimension == dimension:
            return kind.article
    return f"in {UnitSystem('m', 'N').label(dimension)}"


def describe(value: Any) -> str:
    """Return what came instead of a number, in the words of a case file."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, str) or type(value).__module__ not in ("builtins", "datetime", "fractions"):
        return shown(value)
    return f"{value} ({type(value).__name__})"
