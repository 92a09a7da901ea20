"""Real numbers known to lie in balls mid +- radius (flint's arb), which compute with Fractions in formulas."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from numbers import Rational
from typing import Any

from flint import arb

from contactqp.oracle.exact.decimals import rounded_up
from contactqp.oracle.exact.rational import fraction, from_fraction


class Ball:
    """A number of a scene, and everything that rounding may have done to it; the precision is flint's at the time.

    >>> two = root(Fraction(2)) ** 2
    >>> two > Fraction(1), two > 2, 2 > two, two.value.contains(2)
    (True, False, False, True)
    """

    __slots__ = ("value",)

    def __init__(self, value: arb) -> None:
        self.value = value

    def __add__(self, other: Any) -> Any:
        return _made(other, lambda x: self.value + x)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return _made(other, lambda x: self.value - x)

    def __rsub__(self, other: Any) -> Any:
        return _made(other, lambda x: x - self.value)

    def __mul__(self, other: Any) -> Any:
        return _made(other, lambda x: self.value * x)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return _made(other, lambda x: self.value / x)

    def __rtruediv__(self, other: Any) -> Any:
        return _made(other, lambda x: x / self.value)

    def __pow__(self, exponent: int) -> Ball:
        return Ball(self.value**exponent)

    def __neg__(self) -> Ball:
        return Ball(-self.value)

    def __abs__(self) -> Ball:
        return Ball(abs(self.value))

    def __gt__(self, other: Any) -> bool:
        """Proven; what cannot be decided is not."""
        return bool(self.value > to_arb(other))

    def __lt__(self, other: Any) -> bool:
        return bool(self.value < to_arb(other))

    def __bool__(self) -> bool:
        """False if it is known to be zero."""
        return not self.value.is_zero()


def root(square: Any) -> Ball:
    """The square root of a number that is not negative."""
    return Ball(to_arb(square).sqrt())


def to_arb(value: Any) -> arb:
    """The ball of a number."""
    found = _arb_of(value)
    if found is None:
        raise TypeError(f"expected a number that a ball computes with, got {type(value).__name__}")
    return found


def _arb_of(value: Any) -> arb | None:
    if isinstance(value, Ball):
        return value.value
    if isinstance(value, Rational):
        return arb(from_fraction(Fraction(value)))
    return None  # a float may be rounded: nothing rigorous can be said of it


def _made(other: Any, operation: Callable[[arb], arb]) -> Any:
    found = _arb_of(other)
    return NotImplemented if found is None else Ball(operation(found))


def midpoint(value: arb) -> Fraction:
    """The midpoint, a dyadic number, as it stands."""
    return fraction(value.mid().fmpq())


def radius(value: arb) -> float:
    """The radius, rounded up to a double."""
    exact = fraction(value.rad().fmpq())
    return rounded_up(exact)
